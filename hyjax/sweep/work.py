"""What the workers of a sweep do; the modules that do it are loaded when they begin."""

import functools
import importlib
import warnings
from collections.abc import Sequence
from typing import Any

from hyjax.configuration import Configuration

EVALUATION = "hyjax.tuning.frame.evaluation"
SPACE = "hyjax.tuning.frame.space"


def evaluate(payload: dict[str, Any]) -> dict[str, Any]:
    """Loss and metrics of a configuration on the frames of a scene under a light set-up."""
    result: dict[str, Any] = _evaluation().evaluate(payload)
    return result


def time_frames(payload: dict[str, Any]) -> dict[str, Any]:
    """Times of a configuration's frames in milliseconds."""
    result: dict[str, Any] = _evaluation().time_frames(payload)
    return result


def random_configurations(count: int, seed: int) -> Sequence[Configuration]:
    """Draws of the space of configurations."""
    drawn: Sequence[Configuration] = importlib.import_module(SPACE).random_configurations(count, seed)
    return drawn


@functools.cache
def _evaluation() -> Any:
    from hyjax.util.compiled_cache import keep_compiled

    keep_compiled()
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained")
    return importlib.import_module(EVALUATION)
