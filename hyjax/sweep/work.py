"""Work of a sweep's workers; its modules are loaded when they begin."""

import functools
import warnings
from typing import Any


def evaluate(payload: dict[str, Any]) -> dict[str, Any]:
    """Loss and metrics of a configuration on the frames of a scene under a light set-up."""
    _start()
    from hyjax.tuning import evaluation

    return evaluation.evaluate(payload)


def time_frames(payload: dict[str, Any]) -> dict[str, Any]:
    """Times of a configuration's frames in milliseconds."""
    _start()
    from hyjax.tuning import evaluation

    return evaluation.time_frames(payload)


@functools.cache
def _start() -> None:
    from hyjax.util.compiled_cache import keep_compiled
    from hyjax.util.memory import keep_freed_memory

    keep_freed_memory()
    keep_compiled()
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained")
