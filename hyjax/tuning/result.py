"""Times and budgets of a tuning run."""

import dataclasses
from typing import Annotated, TypedDict

import msgspec

Time = Annotated[float, msgspec.Meta(ge=0)]
"""Milliseconds, or a relative error: finite and not negative where it is read from a file."""


@dataclasses.dataclass(frozen=True)
class Milliseconds:
    """Median and 95th percentile of the times of single calls."""

    median: Time
    p95: Time


class CalibrationTime(TypedDict):
    """Steps of a schedule over the factors, with its measured times."""

    steps: list[int]
    median_ms: Time
    p95_ms: Time


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
