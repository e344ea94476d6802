"""Workload: the shapes that a cascade is timed on, and the downsampling factors that its schedules may use.

*Factors* are a row, coarse to fine; *steps* over them are a number for each, 0 where a level is left out.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.core.pyramid import level_shape
from hyjax.core.schedule import Schedule
from hyjax.util.errors import InputError

FACTORS = (32, 16, 8, 4, 2, 1)
# Cells that the shorter side of a level must have to be worth a place among the factors. The paper's coarsest
# has 32 of them; one more level costs compilation and is hardly ever part of a good schedule.
FEWEST_CELLS = 24

DTYPES = ("float16", "bfloat16", "float32", "float64")

Arguments = tuple[Float[Array, "h w lights"], Float[Array, "h w 1"], Float[Array, "h w f"]]


@dataclasses.dataclass(frozen=True)
class Workload:
    """The shapes that a cascade is timed on: `cascade_known` with one channel a light.

    Attributes:
        height: pixels.
        width: pixels.
        lights: channels of the filter.
        guide_channels: features of the guide.
        dtype: of filter and guide.
    """

    height: int
    width: int
    lights: int
    guide_channels: int = 3
    dtype: str = "float32"

    def __post_init__(self) -> None:
        for name in ("height", "width", "lights", "guide_channels"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise InputError(f"workload: {name} must be a whole number >= 1, got {value!r}")
        if self.dtype not in DTYPES:
            raise InputError(f"workload: dtype {self.dtype!r} is unknown; use one of {', '.join(DTYPES)}")
        if self.dtype == "float64" and jax.dtypes.canonicalize_dtype("float64") != "float64":
            raise InputError("workload: dtype float64 needs JAX_ENABLE_X64=1")

    def arguments(self) -> Arguments:
        """Filter, confidence and guide of these shapes on the default device, pseudo-random and always the same."""
        rng = np.random.default_rng(0)
        size = self.height, self.width
        y = rng.random((*size, self.lights), np.float32)
        confidence = (rng.random((*size, 1)) > 0.1).astype(np.float32)
        guide = rng.random((*size, self.guide_channels), np.float32)
        return jnp.asarray(y, self.dtype), jnp.asarray(confidence), jnp.asarray(guide, self.dtype)

    def on_device(self, arguments: Arguments) -> Arguments:
        """Filter, confidence and guide on the default device."""
        size = self.height, self.width
        shapes = (*size, self.lights), (*size, 1), (*size, self.guide_channels)
        for name, array, shape in zip(("filter", "confidence", "guide"), arguments, shapes, strict=True):
            if array.shape != shape:
                raise InputError(f"{name}: shape {array.shape} is not the latency table's {shape}")
        y, confidence, guide = (jnp.asarray(array) for array in arguments)
        return y, confidence, guide

    def __str__(self) -> str:
        lights = f"{self.lights} light{'s' if self.lights > 1 else ''}"
        return f"{self.height}x{self.width}, {lights}, {self.guide_channels} guide channels, {self.dtype}"


def factors_for(height: int, width: int, factors: Sequence[int] = FACTORS) -> tuple[int, ...]:
    """Those of the factors that are not too coarse for a picture of this size."""
    check_factors(factors)
    fitting = tuple(f for f in factors if f == 1 or min(level_shape((height, width), f)) >= FEWEST_CELLS)
    if not fitting:
        raise InputError(f"factors: each of {tuple(factors)} is too coarse for {height}x{width} pixels")
    return fitting


def check_factors(factors: Sequence[int]) -> None:
    """Raise `InputError` unless a schedule can have these factors."""
    whole = all(isinstance(f, int) and not isinstance(f, bool) and f >= 1 for f in factors)
    if not factors or not whole or any(c <= f or c % f for c, f in itertools.pairwise(factors)):
        raise InputError(f"factors: they must fall, each a multiple of the next, got {tuple(factors)}")


def schedule_key(schedule: Schedule) -> str:
    """Key of a schedule's time: `16:5 8:10`, factor and steps, and deviations from the paper's form."""
    text = " ".join(f"{level.factor}:{level.steps}" for level in schedule.levels)
    if schedule.pooling != "edges":
        text += f" pooling={schedule.pooling}"
    if schedule.norm != "l2":
        text += f" norm={schedule.norm}"
    if schedule.upsampling != "bilinear":
        text += f" upsampling={schedule.upsampling}"
    if any(level.fidelity is not None for level in schedule.levels):
        text += " attached"
    return text
