"""Budgets of a tuning run, its frames to tune on and to hold out."""

import dataclasses
import math
from collections.abc import Sequence

from hyjax.data.frames import select_frames, spread
from hyjax.util.errors import InputError

TUNING_FRAMES = 4
HELD_OUT_FRAMES = 4
LEAST_MS, MOST_MS = 1e-6, 1e7
"""Bounds of a budget, in milliseconds."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """A time that something has to fit in.

    Attributes:
        label: what the user called it, such as "60 fps" or "8 ms".
        milliseconds: the time.
    """

    label: str
    milliseconds: float

    @property
    def slug(self) -> str:
        """The label as part of a file's name: `60fps`, `8ms`."""
        return self.label.replace(" ", "")


def parse_budgets(fps: Sequence[float], budget_ms: Sequence[float]) -> list[Budget]:
    """Budgets from frame rates and milliseconds, without repetitions."""
    budgets = {}
    for values, unit in ((fps, "fps"), (budget_ms, "ms")):
        for value in values:
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{unit}: a budget must be finite and > 0, got {value:g}")
            time = 1e3 / value if unit == "fps" else value
            if not LEAST_MS <= time <= MOST_MS:
                raise InputError(f"{unit}: a budget must lie in {LEAST_MS:g} to {MOST_MS:g} ms, got {time:g} ms")
            budgets[f"{value:g} {unit}"] = Budget(f"{value:g} {unit}", time)
    if not budgets:
        raise InputError("budget: none given; ask for --fps 60 or --budget-ms 16.7")
    return list(budgets.values())


def split_frames(count: int, frames: str | None, holdout: str | None) -> tuple[list[int], list[int]]:
    """Indices to tune on and indices that are only reported on.

    Args:
        frames: as for `select_frames`; by default a few, spread over what is not held out.
        holdout: likewise; by default a few of the last quarter, or none if the capture is a single frame.
    """
    last = range(count - max(1, count // 4), count)
    if holdout is not None:
        held = select_frames(holdout, count)
    else:
        asked = [] if frames is None else select_frames(frames, count)
        rest = [i for i in last if i not in asked]
        held = spread(rest, HELD_OUT_FRAMES) if count > 1 else []
    # By default neighbours of held-out frames, which show the same, are not tuned on either.
    free = [i for i in range(count) if i not in held and (holdout is not None or i not in last or count == 1)]
    if frames is not None:
        chosen = [i for i in select_frames(frames, count) if i not in held]
    else:
        chosen = spread(free, TUNING_FRAMES)
    if not chosen:
        raise InputError("frames: all that were chosen are held out, none is left to tune on; give more --frames")
    return chosen, held
