"""What the workers of a sweep do; in the words of `hyjax.tuning.evaluation`, which they load when they begin."""

import functools
import importlib
import warnings
from typing import Any


def evaluate(payload: dict[str, Any]) -> dict[str, Any]:
    """Loss and metrics of a configuration on the frames of a scene under a light set-up."""
    result: dict[str, Any] = _evaluation().evaluate(payload)
    return result


def time_frames(payload: dict[str, Any]) -> dict[str, Any]:
    """Times of a configuration's frames in milliseconds."""
    result: dict[str, Any] = _evaluation().time_frames(payload)
    return result


@functools.cache
def _evaluation() -> Any:
    from hyjax.util.compiled_cache import keep_compiled

    keep_compiled()
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained")
    return importlib.import_module("hyjax.tuning.evaluation")
