"""One tuning run: calibrate, search, time the finalists, keep what fits, write it down."""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from hyjax.core.schedule import PRESETS, Schedule
from hyjax.scene.scene import Scene
from hyjax.tuning.bench import Workbench
from hyjax.tuning.budget import MOST_STEPS, Steps
from hyjax.tuning.cases import Case, refined_filter, scores
from hyjax.tuning.descent import Found, Objective
from hyjax.tuning.examples import write_report_with_pictures
from hyjax.tuning.journal import Journal
from hyjax.tuning.latency_estimator import (
    CascadeEstimator,
    LatencyEstimator,
    LatencySource,
    check_reachable,
    has_searched_form,
    smallest_schedules,
)
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.relaxation import RelaxedSchedule, prepare
from hyjax.tuning.report import write_front, write_pareto_csv, write_pareto_plot, write_schedules
from hyjax.tuning.report_text import time_of
from hyjax.tuning.request import split_frames
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Tuned
from hyjax.tuning.search import AGAIN, QUICK, Effort, Search
from hyjax.tuning.settings import TuneSettings
from hyjax.util.environment import environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable

BASELINES = ("hyjax", "paper-50", "paper-80", "naive-50", "naive-1000")
MOST_EXTRA = 3
ATTEMPTS = 4
FINALISTS = 3


def tune_bench(
    bench: Workbench,
    settings: TuneSettings,
    *,
    budgets: Sequence[Budget] | None = None,
    frames: Sequence[int] | None = None,
    holdout: Sequence[int] = (),
    effort: Effort | None = None,
    latency: LatencySource | None = None,
) -> Tuned:
    """Find the schedule whose relit frames are closest to the target's within each budget.

    Args:
        bench: the capture, its meshes and lights.
        settings: of the search; what they say of the scene is not looked at, but for the seed.
        budgets: in the place of the settings'; the first one's schedule is the main result.
        frames: indices to tune on, in the place of the settings' frames, held-out ones included.
        holdout: indices that are only reported on, if `frames` are given.
        effort: how long to look at each budget.
        latency: of another device, in the place of this machine's.

    Raises:
        InputError: no frame left to tune on or none that sees the mesh, a budget that cannot be reached, an `out`
            that cannot be used, or a device that failed.
    """
    budgets, out, progress = budgets or settings.budgets(), settings.out, not settings.quiet
    if frames is None:
        frames, holdout = split_frames(len(bench.scene), settings.frames, settings.holdout)
    chosen = [index for index in frames if index not in holdout]
    if not chosen:
        raise InputError("frames: none is left to tune on; give frames that are not held out")
    monitor = RunMonitor(settings.time_limit, progress)
    if out is not None:
        make_writable(out)
    machine = environment()
    record: dict[str, Any] = {
        "capture": bench.scene.capture.name,
        "guide": bench.guide.name,
        "stage": settings.stage or "cascade",
        "seed": settings.scene.seed,
        "settings": settings.record() | {"meshes": bench.description},
    }
    try:
        decisive = _decisive(bench, chosen, settings.scene.seed, machine)
        if latency is not None:
            decisive["latency"] = latency.fingerprint
        journal = Journal(out, decisive, settings.resume)
        cases, blind = bench.cases(chosen, "tuning", progress)
        holdout_cases, holdout_blind = bench.cases(list(holdout), "held-out", progress)
        estimator = (
            latency(cases[0])
            if latency
            else CascadeEstimator(cases[0], recalibrate=settings.recalibrate, progress=progress)
        )
        for budget in budgets:
            check_reachable(estimator, budget.milliseconds)
        factors = estimator.table.factors
        record |= {
            "frames": {"tuned on": [*map(bench.name, chosen)], "held out": [*map(bench.name, holdout)]},
            "frames without surface": blind + holdout_blind,
            "latency": _latency(estimator),
        } | machine
        if estimator.device:
            record |= {"device": estimator.device, "searched on": machine["device"]}
        run = _Run(estimator, cases, holdout_cases, monitor, budgets, record)
        run.add_baselines([Schedule.preset(name) for name in BASELINES if _reaches(name, factors)], progress)
        search = Search(
            Objective([prepare(case, factors) for case in cases], factors),
            estimator.cost,
            seed=settings.scene.seed,
            remember=journal.remember,
            report=monitor.note,
            expired=monitor.expired,
        )
        try:
            run.write(out)  # the best baseline that fits, until there is better
            for budget in budgets:
                run.search(search, budget, effort or Effort())
                run.write(out)
            if settings.joint and out is not None:
                from hyjax.tuning.joint import tune_and_save  # with flax, which only learned guides need

                best = run.best(budgets[0], within_search=True).schedule
                seen_holdout = [i for i in holdout if bench.name(i) not in holdout_blind]
                record["joint"] = tune_and_save(
                    bench, best, estimator, chosen, seen_holdout, out, monitor, seed=settings.scene.seed
                )
            for budget in run.extra_budgets() if settings.extra else ():
                if not monitor.expired():
                    run.search(search, budget, QUICK)
                    run.write(out)
        finally:  # an interrupted run shows what it has
            if out is not None:
                write_report_with_pictures(out, run.result(), bench, list(holdout) or chosen)
    except jax.errors.JaxRuntimeError as error:
        kept = f"; what was found so far is in {out}, and --resume goes on from there" if out else ""
        line = [*str(error).splitlines(), type(error).__name__][0]
        raise InputError(f"device: {jax.default_backend()} no longer works ({line}){kept}") from None
    return run.result()


def _decisive(bench: Workbench, frames: Sequence[int], seed: int, machine: dict[str, Any]) -> dict[str, Any]:
    """All that decides the search's results, for the journal."""
    scene = bench.scene
    return {
        "capture": scene.capture.fingerprint,
        "meshes": [_fingerprint(scene), None if bench.accurate is None else _fingerprint(bench.accurate)],
        "lights": str(bench.lights),
        "guide": bench.guide.fingerprint,
        "frames": [int(index) for index in frames],
        "size": None if scene.size is None else list(scene.size),
        "seed": seed,
        "device": machine["device"],
        "versions": {name: machine["versions"][name] for name in ("hyjax", "jax", "jaxlib")},
    }


class _Run:
    """Candidates of a run, as far as it has come."""

    def __init__(
        self,
        estimator: LatencyEstimator,
        cases: list[Case],
        holdout: list[Case],
        monitor: RunMonitor,
        budgets: Sequence[Budget],
        record: dict[str, Any],
    ) -> None:
        self.estimator, self.cases, self.holdout, self.monitor = estimator, cases, holdout, monitor
        self.budgets, self.record = list(budgets), record
        self.tuned: dict[Budget, Candidate] = {}
        self.baselines: list[Candidate] = []
        self.points: list[RelaxedSchedule] = []

    def add_baselines(self, schedules: list[Schedule], progress: bool) -> None:
        times = self.estimator.measure(schedules, again=True, progress=progress)
        self.baselines = [self.judge(schedule, time) for schedule, time in zip(schedules, times)]
        # Starting points, not to end worse than these.
        counts = [self.estimator.table.steps_of(schedule) for schedule in schedules]
        self.points = [RelaxedSchedule.of(steps) for steps in counts if max(steps) <= MOST_STEPS]

    def judge(self, schedule: Schedule, time: Milliseconds) -> Candidate:
        """A schedule with its scores, by the functions that `relight` runs."""
        measured = time if self.estimator.is_timed(schedule) else None
        tuning, held_out = (
            scores(cases, [refined_filter(case, schedule) for case in cases]) if cases else None
            for cases in (self.cases, self.holdout)
        )
        return Candidate(schedule, self.estimator.predict(schedule), measured, tuning, held_out)

    def search(self, search: Search, budget: Budget, effort: Effort) -> None:
        """Tune for a budget: search, time the finalists, and search again where the table was wrong.

        The best whose measured p95 fits is kept. If none fits, the search aims at a smaller time; if there is room
        left, at a larger one.
        """
        limit = aim = budget.milliseconds
        best: tuple[Found, Schedule, Milliseconds] | None = None
        too_slow: set[Steps] = set()
        warm = self.points
        with self.monitor.watching(budget.label):
            for attempt in range(ATTEMPTS):
                # After the first attempt the best are only moved to where the clock says the budget is.
                found = search.run(aim, effort if attempt == 0 else AGAIN, warm)
                if not found:
                    break
                warm = [found[0].point]
                device = f" on {self.estimator.device}" if self.estimator.device else ""
                name = f"tuned-{budget.slug}{device}"
                finalists = [f.point.schedule(search.objective.factors, name) for f in found[:FINALISTS]]
                times = self.estimator.measure(finalists, progress=False)
                for f, schedule, time in zip(found, finalists, times):
                    better = best is None or f.loss < best[0].loss
                    if time.p95 <= limit and better and f.steps not in too_slow:
                        # Timed once more, alone: a lucky time must not win.
                        time = self.estimator.measure([schedule], progress=False, again=True)[0]
                        if time.p95 <= limit:
                            best = f, schedule, time
                            break
                        too_slow.add(f.steps)
                wanted, room = search.cost(found[0].steps), limit / max(times[0].p95, 1e-9)
                if best is not None and (attempt or wanted < 0.9 * aim or room < 1.1):
                    break
                aim = aim * min(room, 1.3) * 0.97 if best is not None else 0.95 * min(aim, wanted) * min(1.0, room)
                if self.monitor.expired():
                    break
        if best is not None:
            self.points.append(best[0].point)
            self.tuned[budget] = self.judge(best[1], best[2])

    def extra_budgets(self) -> list[Budget]:
        """Times at which a comparison is wanted: the paper's schedules', half of that, and below the budgets."""
        paper = [time_of(c).p95 for c in self.baselines if c.name.startswith("paper")]
        least = min(b.milliseconds for b in self.budgets)
        wanted = [*paper, 0.5 * max(paper, default=least), 0.5 * least, 0.25 * least]
        lowest = self.estimator.predict(smallest_schedules(self.estimator)[0]).p95
        taken = [b.milliseconds for b in self.budgets]
        extra = []
        for time in wanted:
            if time > 1.1 * lowest and all(abs(math.log(time / other)) > 0.1 for other in taken):
                taken.append(time)
                extra.append(Budget(f"{time:.2f} ms", time))
        return extra[:MOST_EXTRA]

    def result(self) -> Tuned:
        """Results so far."""
        best = [self.best(budget) for budget in self.budgets]
        self.record["seconds"] = round(self.monitor.clock.seconds, 1)
        self.record["peak memory, MiB"] = round(peak_memory_mib())
        front = _front(list(self.tuned.values()))
        return Tuned(best[0].schedule, best, self.budgets, front, self.baselines, self.monitor.history, self.record)

    def best(self, budget: Budget, *, within_search: bool = False) -> Candidate:
        """The best of all that is measured to fit, whatever budget it was tuned for, the baselines included.

        With `within_search`, only of those that the search could have found: of its form, with few enough steps.
        """
        known = [*self.tuned.values(), *self.baselines]
        if within_search:
            known = [c for c in known if has_searched_form(c.schedule)]
            known = [c for c in known if max(level.steps for level in c.schedule.levels) <= MOST_STEPS]
        fitting = [c for c in known if time_of(c).p95 <= budget.milliseconds]
        if fitting:
            return min(fitting, key=lambda c: c.tuning.loss if c.tuning else math.inf)
        fastest = smallest_schedules(self.estimator)[0]
        return self.judge(fastest, self.estimator.measure([fastest], progress=False)[0])

    def write(self, out: Path | None) -> None:
        if out is not None:
            result = self.result()
            write_schedules(out, result)
            write_front(out / "front", result)
            write_pareto_csv(out / "pareto.csv", result)
            write_pareto_plot(out / "pareto.png", result)


def _front(candidates: list[Candidate]) -> list[Candidate]:
    """Those that no other beats in both median and tuning loss, by time."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (time_of(c).median, c.tuning.loss)):  # type: ignore[union-attr]
        if not front or candidate.tuning.loss < front[-1].tuning.loss:  # type: ignore[union-attr]
            front.append(candidate)
    return front


def _reaches(name: str, factors: Sequence[int]) -> bool:
    return all(factor in factors for factor, _ in PRESETS[name].steps)


def _fingerprint(scene: Scene) -> str:
    return hashlib.sha256(scene.mesh.vertices.tobytes() + scene.mesh.faces.tobytes()).hexdigest()[:16]


def _latency(estimator: LatencyEstimator) -> dict[str, Any]:
    table = estimator.table
    return {
        "table": estimator.source,
        "workload": str(table.workload),
        "median relative error": table.error["median_relative"],
        "worst relative error": table.error["worst_relative"],
        "median ms of other stages": {name: time.median for name, time in table.stages.items()},
    }
