"""Results of a tuning run: times, scores, candidates."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, TypedDict

import msgspec

from hyjax.core.schedule import Schedule

Time = Annotated[float, msgspec.Meta(ge=0)]
"""Milliseconds, or a relative error: finite and not negative where it is read from a file."""


@dataclasses.dataclass(frozen=True)
class Milliseconds:
    """How long something takes: the median and the 95th percentile of single calls."""

    median: Time
    p95: Time


class CalibrationTime(TypedDict):
    """Steps of a schedule over the factors, with its measured times."""

    steps: list[int]
    median_ms: Time
    p95_ms: Time


@dataclasses.dataclass(frozen=True)
class Scores:
    """Quality of the relit frames against the target's, mean over frames.

    Attributes:
        loss: what was minimised, see `hyjax.metrics.losses`.
        metrics: each of `hyjax.metrics.plain_metrics` by name, of display values where the target is known.
    """

    loss: float
    metrics: Mapping[str, float]

    def row(self) -> dict[str, float]:
        """Loss and metrics by name."""
        return {"loss": self.loss, **self.metrics}


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


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A schedule with what is known about it.

    Attributes:
        schedule: named after where it comes from: `tuned-60fps`, `paper-50`, ...
        predicted: by the latency table.
        measured: on the clock; None if it never was.
        tuning: scores on the tuning frames.
        held_out: scores on the frames that nothing was chosen on; None if there are none.
    """

    schedule: Schedule
    predicted: Milliseconds
    measured: Milliseconds | None = None
    tuning: Scores | None = None
    held_out: Scores | None = None

    @property
    def name(self) -> str:
        return self.schedule.name


@dataclasses.dataclass(frozen=True)
class Tuned:
    """What `hyjax.tune` returns.

    Attributes:
        schedule: the best one for the first budget, measured to fit.
        best: the best for each budget, in the order given; measured to fit.
        budgets: the budgets asked for.
        front: the results for these budgets and the extra ones, without those that another beats in both measured
            time and tuning loss; by time.
        baselines: the paper's schedules and the naive ones.
        history: one entry for each step of the search: `seconds` since its start, `budget`, `phase`, `loss` (best
            so far on the tuning frames).
        record: settings, device, versions, latency table's error, frames: JSON's types.
    """

    schedule: Schedule
    best: list[Candidate]
    budgets: list[Budget]
    front: list[Candidate]
    baselines: list[Candidate]
    history: list[dict[str, Any]]
    record: dict[str, Any]
