"""One tuning run: calibrate, search, time the finalists, keep what fits, write it down."""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from hyjax.environment import environment, peak_memory_mib
from hyjax.errors import InputError
from hyjax.files import make_writable
from hyjax.scene.raycast import RayCaster
from hyjax.schedule import PRESETS, Schedule
from hyjax.tuning.bench import Workbench
from hyjax.tuning.budget import MOST_STEPS, Steps
from hyjax.tuning.cases import Case, refined_filter, scores
from hyjax.tuning.clocked import (
    CascadeClock,
    Clocked,
    FrameClock,
    Stage,
    check_reachable,
    searchable,
    smallest_schedules,
)
from hyjax.tuning.descent import Found, Objective
from hyjax.tuning.examples import write_report_with_pictures
from hyjax.tuning.journal import Journal
from hyjax.tuning.relaxation import Plan, prepare
from hyjax.tuning.report import write_front, write_pareto_csv, write_pareto_plot, write_schedules
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Tuned
from hyjax.tuning.search import AGAIN, QUICK, Effort, Search
from hyjax.tuning.watch import Watch

BASELINES = ("hyjax", "paper-50", "paper-80", "naive-50", "naive-1000")
MOST_EXTRA = 3
ATTEMPTS = 4
FINALISTS = 3


def tune_bench(
    bench: Workbench,
    budgets: Sequence[Budget],
    *,
    frames: Sequence[int],
    holdout: Sequence[int] = (),
    stage: Stage = "cascade",
    seed: int = 0,
    time_limit: float | None = None,
    effort: Effort | None = None,
    extra: bool = True,
    joint: bool = False,
    recalibrate: bool = False,
    out: Path | None = None,
    resume: bool = False,
    settings: dict[str, Any] | None = None,
    progress: bool = True,
) -> Tuned:
    """Find the schedule whose relit frames are closest to the target's within each budget.

    Args:
        bench: the capture, its meshes and lights.
        budgets: see `parse_budgets`; the first one's schedule is the main result.
        frames: indices to tune on.
        holdout: indices that are only reported on.
        stage: whether the budget is for the diffusion or for the whole frame.
        seed: of the search. The same seed on the same latency table makes the same search (unless a time limit cuts
            it short); the clock has the last word on what fits.
        time_limit: seconds after which the search only finishes what it has; None for no limit.
        effort: how long to look at each budget.
        extra: also tune for a few more budgets, which draw the curve of quality against time.
        joint: at the end, tune the last layer of the bench's guide together with κ, λ and α of the best schedule
            for the first budget; needs `out`, where `guide.safetensors` and `joint.json` are then.
        recalibrate: make the latency table anew.
        out: folder for the results, written as they are found; None writes nothing.
        resume: go on with what an interrupted run left in `out`.
        settings: recorded as they are.
        progress: show bars on stderr.

    Raises:
        InputError: no frame left to tune on or none that sees the mesh, a budget that cannot be reached, an `out`
            that cannot be used, or a device that failed.
    """
    chosen = [index for index in frames if index not in holdout]
    if not chosen:
        raise InputError("frames: none is left to tune on; give frames that are not held out")
    if not budgets:
        raise InputError("budget: none given; see parse_budgets")
    watch = Watch(time_limit, progress)
    if out is not None:
        make_writable(out)
    capture, machine = bench.capture, environment()
    record: dict[str, Any] = {
        "capture": capture.name,
        "guide": bench.guide.name,
        "stage": stage,
        "seed": seed,
        "settings": settings or {},
    }
    decisive = {
        "capture": capture.fingerprint,
        "meshes": [_fingerprint(caster) for caster in (bench.rough, bench.accurate)],
        "lights": str(bench.setup),
        "guide": bench.guide.fingerprint,
        "frames": [int(index) for index in chosen],
        "size": None if bench.size is None else list(bench.size),
        "seed": seed,
        "device": machine["device"],
        "versions": {name: machine["versions"][name] for name in ("hyjax", "jax", "jaxlib")},
    }
    try:
        journal = Journal(out, decisive, resume)
        cases, blind = bench.cases(chosen, "tuning", progress)
        held, held_blind = bench.cases(list(holdout), "held-out", progress)
        cascade = CascadeClock(cases[0], recalibrate=recalibrate, progress=progress)
        seeing = next(i for i in chosen if bench.name(i) not in blind)
        frame_clock = FrameClock(cascade, bench, seeing)  # also tells what the other stages cost
        clock: Clocked = frame_clock if stage == "frame" else cascade
        for budget in budgets:
            check_reachable(clock, budget.milliseconds)
        ladder = cascade.table.ladder
        record |= {
            "frames": {"tuned on": [*map(bench.name, chosen)], "held out": [*map(bench.name, holdout)]},
            "frames without surface": blind + held_blind,
            "latency": _latency(cascade),
        } | machine
        run = _Run(clock, cases, held, watch, budgets, record)
        run.add_baselines([Schedule.preset(name) for name in BASELINES if _reaches(name, ladder)], progress)
        search = Search(
            Objective([prepare(case, ladder) for case in cases], ladder),
            clock.cost,
            seed=seed,
            remember=journal.remember,
            report=watch.note,
            expired=watch.expired,
        )
        try:
            run.write(out)  # the best baseline that fits, until there is better
            for budget in budgets:
                run.search(search, budget, effort or Effort())
                run.write(out)
            if joint and out is not None:
                from hyjax.tuning.joint import tune_and_save  # with flax, which only learned guides need

                seeing_held = [i for i in holdout if bench.name(i) not in held_blind]
                best = run.best(budgets[0], within_search=True).schedule
                record["joint"] = tune_and_save(bench, best, clock, chosen, seeing_held, out, watch, seed=seed)
            for budget in run.extra_budgets() if extra else ():
                if not watch.expired():
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


class _Run:
    """What has been found so far."""

    def __init__(
        self,
        clock: Clocked,
        cases: list[Case],
        held: list[Case],
        watch: Watch,
        budgets: Sequence[Budget],
        record: dict[str, Any],
    ) -> None:
        self.clock, self.cases, self.held, self.watch = clock, cases, held, watch
        self.budgets, self.record = list(budgets), record
        self.tuned: dict[Budget, Candidate] = {}
        self.baselines: list[Candidate] = []
        self.plans: list[Plan] = []

    def add_baselines(self, schedules: list[Schedule], progress: bool) -> None:
        times = self.clock.measure(schedules, again=True, progress=progress)
        self.baselines = [self.judge(schedule, time) for schedule, time in zip(schedules, times)]
        counts = [self.clock.table.steps_of(schedule) for schedule in schedules]
        self.plans = [Plan.of(steps) for steps in counts if max(steps) <= MOST_STEPS]  # not to end worse than these

    def judge(self, schedule: Schedule, measured: Milliseconds) -> Candidate:
        """A schedule with its scores, by the functions that `relight` runs."""
        tuning, held = (
            scores(cases, [refined_filter(case, schedule) for case in cases]) if cases else None
            for cases in (self.cases, self.held)
        )
        return Candidate(schedule, self.clock.predict(schedule), measured, tuning, held)

    def search(self, search: Search, budget: Budget, effort: Effort) -> None:
        """Tune for a budget: search, time the finalists, and search again where the table was wrong.

        The best whose measured p95 fits is kept. If none fits, the search aims at a smaller time; if there is room
        left, at a larger one.
        """
        limit = aim = budget.milliseconds
        best: tuple[Found, Schedule, Milliseconds] | None = None
        too_slow: set[Steps] = set()
        warm = self.plans
        with self.watch.watching(budget.label):
            for attempt in range(ATTEMPTS):
                # After the first attempt the best are only moved to where the clock says the budget is.
                found = search.run(aim, effort if attempt == 0 else AGAIN, warm)
                if not found:
                    break
                warm = [found[0].plan]
                name = f"tuned-{budget.slug}"
                finalists = [f.plan.schedule(search.objective.ladder, name) for f in found[:FINALISTS]]
                times = self.clock.measure(finalists, progress=False)
                for f, schedule, time in zip(found, finalists, times):
                    better = best is None or f.loss < best[0].loss
                    if time.p95 <= limit and better and f.steps not in too_slow:
                        # Timed once more, alone: a lucky time must not win.
                        time = self.clock.measure([schedule], progress=False, again=True)[0]
                        if time.p95 <= limit:
                            best = f, schedule, time
                            break
                        too_slow.add(f.steps)
                wanted, room = search.cost(found[0].steps), limit / max(times[0].p95, 1e-9)
                if best is not None and (attempt or wanted < 0.9 * aim or room < 1.1):
                    break
                aim = aim * min(room, 1.3) * 0.97 if best is not None else 0.95 * min(aim, wanted) * min(1.0, room)
                if self.watch.expired():
                    break
        if best is not None:
            self.plans.append(best[0].plan)
            self.tuned[budget] = self.judge(best[1], best[2])

    def extra_budgets(self) -> list[Budget]:
        """Times at which a comparison is wanted: the paper's schedules', half of that, and below the budgets."""
        paper = [c.measured.p95 for c in self.baselines if c.name.startswith("paper") and c.measured]
        least = min(b.milliseconds for b in self.budgets)
        wanted = [*paper, 0.5 * max(paper, default=least), 0.5 * least, 0.25 * least]
        lowest = self.clock.predict(smallest_schedules(self.clock)[0]).p95
        taken = [b.milliseconds for b in self.budgets]
        extra = []
        for time in wanted:
            if time > 1.1 * lowest and all(abs(math.log(time / other)) > 0.1 for other in taken):
                taken.append(time)
                extra.append(Budget(f"{time:.2f} ms", time))
        return extra[:MOST_EXTRA]

    def result(self) -> Tuned:
        """All of it so far."""
        best = [self.best(budget) for budget in self.budgets]
        self.record["seconds"] = round(self.watch.clock.seconds, 1)
        self.record["peak memory, MiB"] = round(peak_memory_mib())
        front = _front(list(self.tuned.values()))
        return Tuned(best[0].schedule, best, self.budgets, front, self.baselines, self.watch.history, self.record)

    def best(self, budget: Budget, *, within_search: bool = False) -> Candidate:
        """The best of all that is measured to fit, whatever budget it was tuned for, the baselines included.

        With `within_search`, only of those that the search could have found: of its form, with few enough steps.
        """
        known = [*self.tuned.values(), *self.baselines]
        if within_search:
            known = [c for c in known if searchable(c.schedule)]
            known = [c for c in known if max(level.steps for level in c.schedule.levels) <= MOST_STEPS]
        fitting = [c for c in known if c.measured and c.measured.p95 <= budget.milliseconds]
        if fitting:
            return min(fitting, key=lambda c: c.tuning.loss if c.tuning else math.inf)
        fastest = smallest_schedules(self.clock)[0]
        return self.judge(fastest, self.clock.measure([fastest], progress=False)[0])

    def write(self, out: Path | None) -> None:
        if out is not None:
            result = self.result()
            write_schedules(out, result)
            write_front(out / "front", result)
            write_pareto_csv(out / "pareto.csv", result)
            write_pareto_plot(out / "pareto.png", result)


def _front(candidates: list[Candidate]) -> list[Candidate]:
    """Those that no other beats in both measured median and tuning loss, by time."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (c.measured.median, c.tuning.loss)):  # type: ignore[union-attr]
        if not front or candidate.tuning.loss < front[-1].tuning.loss:  # type: ignore[union-attr]
            front.append(candidate)
    return front


def _reaches(name: str, ladder: Sequence[int]) -> bool:
    return all(factor in ladder for factor, _ in PRESETS[name].steps)


def _fingerprint(caster: RayCaster | None) -> str | None:
    if caster is None:
        return None
    mesh = caster.mesh
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()[:16]


def _latency(cascade: CascadeClock) -> dict[str, Any]:
    table = cascade.table
    return {
        "table": cascade.source,
        "workload": str(table.workload),
        "median relative error": table.error["median_relative"],
        "worst relative error": table.error["worst_relative"],
        "median ms of other stages": {name: time.median for name, time in table.stages.items()},
    }
