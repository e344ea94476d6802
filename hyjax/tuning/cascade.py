"""Stage of the diffusion alone: levels, steps, κ, λ and α of the cascade for the light, within its own budget."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.configuration import Configuration
from hyjax.core.schedule import PRESETS, Schedule
from hyjax.data.frames import spread
from hyjax.light.color import encoded, to_display
from hyjax.tuning.bench import Workbench
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.cases import Case, raw_filter, refined_filter, scores
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.descent import Objective, polish, starts
from hyjax.tuning.evaluation import Scores
from hyjax.tuning.evaluator import POLISH_ITERATIONS, CascadeEvaluator
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.proposal import with_point
from hyjax.tuning.relaxation import RANGES, RelaxedSchedule, prepare, relaxed_of
from hyjax.tuning.request import Budget, split_frames
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.run import Run
from hyjax.tuning.schedule_clock import LatencySource, OwnTimes
from hyjax.tuning.search import State
from hyjax.tuning.settings import BudgetStage, TuneSettings
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.stage import Stage
from hyjax.tuning.study import Study
from hyjax.util.environment import environment

BASELINES = ("hyjax", "paper-50", "paper-80", "naive-50", "naive-1000")
"""Presets to compare the tuned schedules with, the default first."""
FIRST_CASES = 6
"""Cases of the first batch."""
FIRST_RELAXATIONS, RELAXATION_TURN = 5, 4
"""Relaxations before the screening, and one in so many trials afterwards: here gradients cost little."""
STARTS = 8
"""Starting points of the search for each limit, at most."""
MOST_EXAMPLES = 4


@dataclasses.dataclass(frozen=True)
class CascadeJudge:
    """Scores of the cascades of configurations, by the functions that `relight` runs.

    Attributes:
        known: cases, which are told by their positions.
    """

    known: Sequence[Case]

    def scores(self, configuration: Configuration, cases: Sequence[int]) -> list[Scores]:
        chosen = [self.known[number] for number in cases]
        return [scores([case], [refined_filter(case, configuration.schedule)]) for case in chosen]


class CascadeStage(Stage):
    """The diffusion alone.

    Args:
        holdout: indices that are only reported on.
    """

    name: BudgetStage = "cascade"
    predicts, first, relaxes, turn = True, FIRST_CASES, FIRST_RELAXATIONS, RELAXATION_TURN

    def __init__(
        self,
        bench: Workbench,
        settings: TuneSettings,
        frames: Sequence[int],
        holdout: Sequence[int],
        latency: LatencySource,
    ) -> None:
        self.bench, self.settings = bench, settings
        self.frames, self._environment, progress = list(frames), environment(), not settings.quiet
        tuning, blind = bench.cases(frames, "tuning", progress)
        held_out, more = bench.cases(list(holdout), "held-out", progress)
        self.blind, self.holdout = blind + more, [i for i in holdout if bench.name(i) not in more]
        self._asked = list(holdout)
        self.judge = CascadeJudge([*tuning, *held_out])
        self.cases, self.held_out = range(len(tuning)), range(len(tuning), len(tuning) + len(held_out))
        self.latency, self.own_clock = latency, latency(tuning[0])
        self.clock, self.factors = self.own_clock, self.own_clock.table.factors
        self.space = Space.of_cascade(self.factors, RANGES)
        usual = self.space.configuration(self.space.default, "hyjax").schedule
        self.base = dataclasses.replace(Configuration(), schedule=usual)
        self.own_clock.base = usual
        self._usual_cost = self.own_clock.cost(self.own_clock.table.steps_of(usual))
        self.objective = Objective([prepare(case, self.factors) for case in tuning], self.factors)

    def base_time(self, study: Study) -> FrameTime:
        time = self.own_clock.predict(self.base.schedule)
        return FrameTime(time.median, time.p95, time.median, 1.0, True)

    def limit(self, budget: Budget, base: FrameTime) -> float:
        return budget.milliseconds / self._usual_cost

    def starts(self, limits: Sequence[float]) -> list[Choices]:
        """Steps of the paper's schedules, and for each limit in turn time shared between runs of levels."""
        table, seed = self.own_clock.table, self.settings.scene.seed
        step_counts = [table.steps_of(c.schedule) for c in self.references()]
        points = [RelaxedSchedule.of(steps) for steps in step_counts if max(steps) <= MOST_STEPS]
        drawn = [starts(STARTS, self.own_clock.cost, limit * self._usual_cost, seed) for limit in limits]
        size = len(self.factors)
        turns = itertools.zip_longest(*(singles[size:] + singles[:size] for singles in drawn))  # single steps last
        points += [point for turn in turns for point in turn if point is not None]
        return [with_point(self.space.default, self.space, point, self.factors) for point in points]

    def references(self) -> list[Configuration]:
        reached = [n for n in BASELINES[1:] if all(factor in self.factors for factor, _ in PRESETS[n].steps)]
        return [self.base, *(Configuration(name=name, schedule=Schedule.preset(name)) for name in reached)]

    def evaluator(self, space: Space, study: Study, expired: Callable[[], bool]) -> CascadeEvaluator:
        return CascadeEvaluator(space, self.objective, self.own_clock, self.settings.scene.seed, expired)

    def polished(self, configuration: Configuration, expired: Callable[[], bool]) -> Configuration:
        start = relaxed_of(configuration.schedule, self.factors)
        if not np.any(np.asarray(start.steps)):
            return configuration
        found = polish(self.objective, start, POLISH_ITERATIONS, expired).point
        return dataclasses.replace(configuration, schedule=found.schedule(self.factors, configuration.name))

    def examples(
        self, front: Sequence[Candidate], references: Sequence[Candidate]
    ) -> list[tuple[str, dict[str, Any]]]:
        """At most four frames: the frame, its filters and relit pictures under the paper's and the tuned schedule.

        They take equal time: the tuned one is the best that is no slower than the paper's.
        """
        paper = next((c for c in references if c.name == "paper-50"), references[0])
        within = [c for c in front if c.time.median <= paper.time.median]
        shown = paper, (within[-1] if within else front[0])
        indices = spread(self.holdout or self.frames, MOST_EXAMPLES)
        cases = ((self.bench.name(index), self.bench.case(index)) for index in indices)
        return [(name, _pictures(case, *shown)) for name, case in cases if case is not None]

    def named(self, candidate: Candidate, budget: Budget) -> Configuration:
        configuration = candidate.configuration
        if not candidate.name.startswith("tuned-"):
            return configuration
        name = f"tuned-{budget.slug}" + (f" on {self.own_clock.device}" if self.own_clock.device else "")
        return dataclasses.replace(
            configuration, name=name, schedule=dataclasses.replace(configuration.schedule, name=name)
        )

    def prediction_errors(self, state: State, tuned: Sequence[Candidate]) -> list[float]:
        timed = [c for c in tuned if not c.time.predicted]
        return [abs(self.own_clock.predict(c.configuration.schedule).median / c.time.median - 1) for c in timed]

    def decisive(self) -> dict[str, Any]:
        scene, surfaces = self.bench.scene, (self.bench.scene, self.bench.accurate)
        record = {
            "capture": scene.capture.fingerprint,
            "meshes": [None if each is None else each.caster.arrays.key[:16] for each in surfaces],
            "lights": str(self.bench.lights),
            "guide": self.bench.guide.fingerprint,
            "frames": [int(index) for index in self.frames],
            "size": None if scene.size is None else list(scene.size),
            "seed": self.settings.scene.seed,
            "device": self._environment["device"],
            "versions": {name: self._environment["versions"][name] for name in ("hyjax", "jax", "jaxlib")},
        }
        return record | ({"latency": self.latency.fingerprint} if self.latency.fingerprint else {})

    def record(self) -> dict[str, Any]:
        name, table = self.bench.name, self.own_clock.table
        record: dict[str, Any] = {
            "capture": self.bench.scene.capture.name,
            "guide": self.bench.guide.name,
            "meshes": self.bench.description,
            "frames": {"tuned on": [*map(name, self.frames)], "held out": [*map(name, self._asked)]},
            "frames without surface": self.blind,
            "latency": {
                "table": self.own_clock.source,
                "workload": str(table.workload),
                "median relative error": table.error["median_relative"],
                "worst relative error": table.error["worst_relative"],
                "median ms of other stages": {name: time.median for name, time in table.stages.items()},
            },
        }
        if self.own_clock.device:
            record |= {"device": self.own_clock.device, "searched on": self._environment["device"]}
        return record


def tune_bench(
    bench: Workbench,
    settings: TuneSettings,
    *,
    latency: LatencySource | None = None,
    monitor: RunMonitor | None = None,
) -> Tuned:
    """Find the schedule whose relit frames are closest to the target's within each budget.

    Args:
        bench: the capture, its meshes and lights.
        settings: of the search; of the scene they tell the seed alone.
        latency: of another device, in the place of this machine's.
        monitor: time limit and progress.

    Raises:
        InputError: no frame left to tune on or none that sees the mesh, or a budget that cannot be reached.
    """
    frames, holdout = split_frames(len(bench.scene), settings.frames, settings.holdout)
    latency = latency or OwnTimes(settings.recalibrate, not settings.quiet)
    stage = CascadeStage(bench, settings, frames, holdout, latency)
    monitor = monitor or RunMonitor(settings.limit_seconds, not settings.quiet)
    if settings.target_device.device:
        monitor.begin()  # somebody had to open the page
    budgets = settings.budgets()
    for budget in budgets:  # before the folder holds a run
        stage.own_clock.check_reachable(budget.milliseconds)
    return Run(stage, settings, budgets, monitor).run()


def _pictures(case: Case, paper: Candidate, ours: Candidate) -> dict[str, Float[np.ndarray, "h w 3"]]:
    filters = {
        "raw": raw_filter(case.shaded),
        f"{paper.name}, {paper.time.median:.2f} ms": refined_filter(case, paper.configuration.schedule),
        f"tuned, {ours.time.median:.2f} ms": refined_filter(case, ours.configuration.schedule),
        "target": jnp.where(case.valid[..., None], case.target, 0.0),
    }
    # Filters brighter than white are dimmed, all alike, until their structure shows.
    dim = max(1.0, float(np.percentile(np.asarray(case.target), 98)))
    pictures: dict[str, Any] = {"frame": to_display(case.frame)}
    pictures |= {f"filter: {name}": encoded(relight_filter / dim) for name, relight_filter in filters.items()}
    pictures |= {name: to_display(relight_filter * case.frame) for name, relight_filter in filters.items()}
    return {name: np.asarray(picture) for name, picture in pictures.items()}
