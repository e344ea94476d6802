"""Results of a tuning run: configurations with their times and scores."""

import dataclasses
from typing import Any

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.evaluation import Scores
from hyjax.tuning.request import Budget
from hyjax.tuning.settings import BudgetStage
from hyjax.tuning.trial import Trial


@dataclasses.dataclass(frozen=True)
class Candidate:
    """Configuration with its scores and times.

    Attributes:
        configuration: named after where it comes from.
        tuning: mean scores on the tuning frames; `relative` is the geometric mean of losses over the default's.
        held_out: likewise, on scenes or frames that no setting was chosen with; None if there are none.
        time: of a whole frame, in turns with the default's.
        form: `hyjax`, or `paper` for the paper's own form.
    """

    configuration: Configuration
    tuning: Scores
    held_out: Scores | None
    time: FrameTime
    form: str = "hyjax"

    @property
    def name(self) -> str:
        """Name of the configuration."""
        return self.configuration.name

    def row(self) -> dict[str, Any]:
        """All of it as JSON's types but for the configuration."""
        return {
            "name": self.name,
            "form": self.form,
            "median_ms": self.time.median,
            "p95_ms": self.time.p95,
            "default_ms": self.time.default,
            "tuning": self.tuning,
            "held_out": self.held_out,
        }


@dataclasses.dataclass(frozen=True)
class Effect:
    """Effect on loss and time of one choice by itself.

    Attributes:
        parameter: its name.
        value: in the place of the base's.
        base: value that it was changed from.
        loss, time: factors.
    """

    parameter: str
    value: Any
    base: Any
    loss: float
    time: float


@dataclasses.dataclass(frozen=True)
class Tuned:
    """Result of `hyjax.tune` and `hyjax.tune_schedule`.

    Attributes:
        configuration: the best for the first budget, measured to fit.
        best: the best for each budget.
        budgets: in the order given.
        front: candidates that no other beats in both time and tuning loss, by time.
        references: the default, the presets, the paper's form.
        trials: all of the search.
        effects: of the choices that were tried one by one.
        examples: pictures: rows of (name of the case, pictures by name).
        record: stage, settings, device, versions, cases, prediction errors: JSON's types.
    """

    configuration: Configuration
    best: list[Candidate]
    budgets: list[Budget]
    front: list[Candidate]
    references: list[Candidate]
    trials: list[Trial]
    effects: list[Effect]
    examples: list[tuple[str, dict[str, Any]]]
    record: dict[str, Any]

    @property
    def schedule(self) -> Schedule:
        """Cascade for the light of the best configuration."""
        return self.configuration.schedule

    @property
    def stage(self) -> BudgetStage:
        """Stage of a frame that the budgets are for."""
        return self.record.get("stage", "frame")

    @property
    def candidates(self) -> list[Candidate]:
        """References, front and the best of each budget, each once."""
        found = {id(c): c for c in (*self.references, *self.front, *self.best)}
        return list(found.values())
