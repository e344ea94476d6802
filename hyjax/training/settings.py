"""Settings of a training run. The command line takes its options and their help from here.

The defaults train on two CPU cores; `paper_settings` are the paper's recipe."""

import dataclasses
import math
from typing import Any, Literal

from hyjax.core.step_size import DEFAULT_LAM
from hyjax.util.errors import InputError
from hyjax.util.settings import Settings

Through = Literal["cascade", "steps"]


@dataclasses.dataclass(frozen=True)
class TrainSettings(Settings):
    """Settings of a training run.

    Attributes:
        encoder: `mobilenetv4_conv_small`, `mobilenetv4_conv_medium`, or one that is registered as they are.
        features: channels of the guide.
        pairs: training sources, each drawn from equally often: `rooms` (generated, needs no file), `folder:PATH`
            (your own), or `mosd:`, `diml:`, `nyu:`, `middlebury:`, `capture:PATH`; docs/guide.md has their options.
        start: file with weights to start from, of a whole guide or of an encoder alone as timm has it; random ones
            if empty.
        validation: validation sources, named as pairs are; other crops of the same pictures if empty.
        size: side of the square crops in pixels, a multiple of 32.
        batch: crops an update, over all devices.
        iterations: updates.
        factors: how much coarser the sources are than the crops; one is drawn for each batch.
        through: `cascade` takes the loss after the schedule that the pipeline will run, `steps` after many steps at
            full size.
        schedule: preset, of `cascade`.
        steps_without_gradient: of `steps`: a random number below this comes first.
        steps_with_gradient: of `steps`: so many follow.
        lam: step size λ of `steps`.
        adjusted: multiply by the ratio of source to downsampled prediction after every step.
        depth_weight: of the L1 loss on tinted depth, the paper's only loss.
        shading_weight: of the L1 loss on the surface under random lamps; needs normals, as `rooms` and fused
            captures have them.
        border_weight: of the cross-entropy between conductances and true borders.
        learning_rate: of Adam, at the start.
        decay: factor by which the learning rate is lowered again and again.
        decay_every: updates from one lowering to the next.
        clip: largest global norm of the gradient.
        validate_every: updates between two validations and two pictures.
        checkpoint_every: updates between two checkpoints.
        seed: of weights, crops, lamps and step counts.
    """

    encoder: str = "mobilenetv4_conv_small"
    features: int = 64
    pairs: tuple[str, ...] = ("rooms",)
    start: str = ""
    validation: tuple[str, ...] = ()
    size: int = 256
    batch: int = 4
    iterations: int = 4000
    factors: tuple[int, ...] = (8, 16, 32)
    through: Through = "cascade"
    schedule: str = "paper-50"
    steps_without_gradient: int = 0
    steps_with_gradient: int = 64
    lam: float = DEFAULT_LAM
    adjusted: bool = True
    depth_weight: float = 1.0
    shading_weight: float = 1.0
    border_weight: float = 1.0
    learning_rate: float = 1e-3
    decay: float = 0.9
    decay_every: int = 200
    clip: float = 1.0
    validate_every: int = 250
    checkpoint_every: int = 100
    seed: int = 0

    def check(self) -> "TrainSettings":
        """Return these settings, or raise `InputError` naming the first invalid one."""
        from hyjax.core.schedule import PRESETS

        if self.schedule not in PRESETS:
            raise InputError(f"schedule: no preset {self.schedule!r}; there are {', '.join(PRESETS)}")
        if not self.pairs:
            raise InputError("pairs: none given; name at least one source, such as rooms")
        if self.size < 32 or self.size % 32:
            raise InputError(f"size: {self.size} pixels; crops must be a multiple of 32 wide")
        for name in (
            "iterations",
            "batch",
            "features",
            "validate_every",
            "checkpoint_every",
            "decay_every",
            "steps_with_gradient",
        ):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: must be at least 1, got {getattr(self, name)}")
        if self.steps_without_gradient < 0:
            raise InputError(f"steps_without_gradient: must be at least 0, got {self.steps_without_gradient}")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed: must lie in [0, 2^32), got {self.seed}")
        if not self.factors or any(f < 2 or self.size % f for f in self.factors):
            raise InputError(f"factors: {self.factors} must be 2 or more and divide the size, {self.size}")
        levels = [factor for factor, _ in PRESETS[self.schedule].steps]
        if PRESETS[self.schedule].options:
            raise InputError(
                f"schedule: guides are trained through one of the paper's schedules, not {self.schedule}"
            )
        if self.through == "cascade" and any(f % level and level % f for f in self.factors for level in levels):
            raise InputError(
                f"factors: {self.factors} must each divide, or be a multiple of, every level of {self.schedule}: "
                f"{', '.join(map(str, levels))}"
            )
        weights = [getattr(self, f"{name}_weight") for name in ("depth", "shading", "border")]
        if not all(math.isfinite(w) and w >= 0 for w in weights) or not any(weights):
            raise InputError(f"weights: depth, shading and border must be >= 0 and one above 0, got {weights}")
        for name in ("learning_rate", "clip", "decay"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name}: must be finite and > 0, got {getattr(self, name)}")
        if not 0 < self.lam < 0.25:
            raise InputError(f"lam: a step size must lie inside (0, 1/4) to be stable, got {self.lam}")
        return self

    def record(self) -> dict[str, Any]:
        """Settings in JSON's types."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(self).items()}


def paper_settings() -> TrainSettings:
    """Settings of the paper's training section, which lacks the interval between steps of the learning rate.

    docs/guide.md and `hyjax train --help` list where this differs from the code that Metzger et al. published.
    """
    return TrainSettings(
        size=512,
        batch=8,
        iterations=12_000,
        factors=(32,),
        through="steps",
        steps_without_gradient=20_000,
        steps_with_gradient=512,
        shading_weight=0.0,
        border_weight=0.0,
        learning_rate=1e-4,
        decay_every=1000,
        clip=0.01,
    )
