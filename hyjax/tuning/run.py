"""Tuning run: search, refinement of the best, proof on the clock and on held-out frames."""

import contextlib
import dataclasses
import functools
import logging
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
from tqdm import tqdm

from hyjax.configuration import Configuration
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.proof import MOST_SECONDS, ROUNDS, TIMING_SHARE, best_within, effects, front_of, prove_in_time
from hyjax.tuning.report import REPORT_FILE, best_file, text_of, write_results
from hyjax.tuning.report_page import page
from hyjax.tuning.report_text import same
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.search import State, init, search, update, within
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.stage import Stage
from hyjax.tuning.study import Study, check_free, check_installed
from hyjax.tuning.trial import Trial
from hyjax.tuning.unfinished import best_known, best_or_fastest, unfinished
from hyjax.util.claims import claimed
from hyjax.util.clock import Stopwatch
from hyjax.util.environment import cores, environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text

log = logging.getLogger(__name__)
FIRST_PHASES = ("default", "start")
"""Phases of the first candidates, which are there before a budget is refused."""
EXTRA_BUDGETS = (0.35, 0.5, 0.7, 1.0, 1.5)
"""Further points of the front, in times of the default."""
ATTEMPTS = 3
REPORT_SHARE = 20.0
"""A report of an unfinished search is written after so many times as long as it takes to write."""
MORE_TRIALS = 8
"""Trials for a budget that the clock, unlike the prediction, finds exceeded."""


@contextlib.contextmanager
def opened(settings: TuneSettings) -> Iterator[RunMonitor]:
    """The clock of a run whose folder is this process's alone."""
    monitor, out = RunMonitor(settings.limit_seconds, not settings.quiet), settings.out
    if out is not None:
        check_installed()
        make_writable(out)
    with claimed(out):
        if out is not None:
            check_free(out, settings.resume)
        try:
            yield monitor
        except jax.errors.JaxRuntimeError as error:
            kept = f"; what was found so far is in {out}, and --resume goes on from there" if out else ""
            line = [*str(error).splitlines(), type(error).__name__][0]
            raise InputError(f"device: {jax.default_backend()} no longer works ({line}){kept}") from None


class Run:
    """One run, from the search to the files.

    Args:
        budgets: of time; the first one's configuration is the main result.
    """

    def __init__(
        self, stage: Stage, settings: TuneSettings, budgets: Sequence[Budget], monitor: RunMonitor
    ) -> None:
        self.stage, self.settings, self.budgets, self.monitor = stage, settings, list(budgets), monitor
        self._environment, self._kept = environment(), Choices()
        self._further = list(EXTRA_BUDGETS if settings.extra else ())
        self._state: State | None = None
        self._base: FrameTime | None = None
        self._checked = False
        self._since_report, self._report_seconds = Stopwatch(), 0.0
        versions = [f"{name} {self._environment['versions'][name]}" for name in ("jax", "jaxlib")]
        lights = stage.record().get("timed under", stage.name)
        machine = ", ".join([f"{lights}, {self._environment['device']}", f"{cores()} cores", *versions])
        self._study = functools.partial(Study, settings.out, settings=stage.decisive(), machine=machine)

    def run(self) -> Tuned:
        """Search, refine, prove, write."""
        limits, references = len(self.budgets) + len(self._further), len(self.stage.references())
        parts = 1 + self.settings.frame.trial_count + 2 * limits + 2 * references
        try:
            with self.monitor.watching(parts):
                return self._run()
        except KeyboardInterrupt:
            if (out := self.settings.out) is not None:
                self._report_so_far()
                tqdm.write(f"hyjax: stopped; --resume goes on with {out}{self._left()}", file=sys.stderr)
            raise
        except InputError as error:
            if not self._kept:
                raise
            self._report_so_far()
            raise InputError(f"{error}; --resume goes on with {self.settings.out}{self._left()}") from None

    def _left(self) -> str:
        """Words on what an unfinished run leaves."""
        out = self.settings.out
        return f"; {out / best_file(self.stage.name)} is the best so far" if self._kept and out else ""

    def _run(self) -> Tuned:
        study = self._study(self.stage.name, resume=self.settings.resume)
        if not study.trials:
            self._write(self.stage.space.default)  # what there is before anything is timed
        self.monitor.enter("timing the default")
        base = self._base = self.stage.base_time(study)
        if not study.trials and self.stage.space.fixed:
            self._write(self.stage.space.default)  # which the base's time has changed
        self.monitor.done()
        if self.monitor.expired():
            log.warning(
                "time limit: %.0f s of %g have passed before the search, which judges one trial",
                self.monitor.clock.seconds,
                self.monitor.limit,
            )
        limits = [self.stage.limit(budget, base) for budget in self.budgets]
        self._so_far = functools.partial(
            unfinished, base=base, budgets=self.budgets, limits=limits, record=self._record()
        )
        limits = [*limits, *self._further]
        state = self._searched(self.stage.space, study, limits, keep=True)
        candidates, state = self._finalists(state, study, limits)
        self._time_was_up = self.monitor.expired()
        references = self.stage.references()
        if self.settings.frame.paper_form and self.stage.name == "frame":
            paper = Space.of(truth=True, paper=True)
            found = self._searched(paper, self._study("paper", resume=True), [math.inf])
            best = found.best(math.inf, cases=len(self.stage.cases))
            if best is not None:
                references.append(self._polished(paper.configuration(best.choices, "paper-tuned")))
        self.monitor.enter("timing and judging the best")
        tuned, known, self._left_out = prove_in_time(candidates, references, self.stage, self.budgets, self.monitor)
        result = self._result(state, tuned, known, base)
        if self.settings.out is not None:
            self.monitor.enter("writing the report")
            write_results(self.settings.out, result)
        return result

    @functools.cached_property
    def _polish_study(self) -> Study:
        return self._study("polish", resume=True)

    def _searched(self, space: Space, study: Study, limits: Sequence[float], *, keep: bool = False) -> State:
        """A search from its kept trials to its end."""
        count, first = len(self.stage.cases), self.stage.first
        batches = sorted({min(first, count), min(2 * first, count), count})
        # The paper's form has fewer choices.
        trials = self.settings.frame.trial_count // (2 if space.paper else 1)
        evaluator = self.stage.evaluator(space, study, self.monitor.expired)
        # Of few trials, some are left for the search.
        starts = [] if space.paper else self.stage.starts(limits)[: trials // 4]
        seed, cost = self.settings.scene.seed, evaluator.cost
        state = init(
            space,
            batches,
            trials,
            starts=starts,
            relaxes=0 if space.paper else self.stage.relaxes,
            turn=self.stage.turn,
            seed=seed,
            cost=cost,
        )
        evaluator.say = self.monitor.say
        self.monitor.enter(f"searching, {study.name}" if space.paper else "searching")
        for trial in study.trials:
            state = update(state, known := evaluator.known(trial))
            self._note(state, trial.phase, limits[0])
            if trial.time is None:
                study.add(space, known)
        if keep:
            self._keep(state, limits[0])
        return self._go_on(state, evaluator, study, limits, keep=keep)

    def _go_on(
        self,
        state: State,
        evaluator: Callable[[Trial], Trial],
        study: Study,
        limits: Sequence[float],
        *,
        keep: bool = False,
    ) -> State:
        def report(state: State, trial: Trial) -> None:
            study.add(state.space, trial)
            self._note(state, trial.phase, limits[0])
            if keep:
                self._keep(state, limits[0])

        def judged(trial: Trial) -> Trial:
            if keep and trial.phase not in FIRST_PHASES:
                self._check_reachable(state.space, limits)
            return evaluator(trial)

        return search(state, judged, limits, report=report, expired=self.monitor.expired)

    def _note(self, state: State, phase: str, limit: float) -> None:
        best = best_known(state, limit)
        self.monitor.note(phase, None if best is None else best.loss)

    def _check_reachable(self, space: Space, limits: Sequence[float]) -> None:
        """Raise `InputError`, once the first candidates are there, if a budget is out of reach."""
        if not self._checked and self._base is not None:
            self._checked = True
            least = min(limits[: len(self.budgets)])
            if self._state is None or not within(self._state, least):
                self.stage.check_reachable(space, self.budgets, self._base)

    def _keep(self, state: State, limit: float) -> None:
        """Write the best so far, or else the fastest, with a report of it, for runs that are stopped."""
        best = best_or_fastest(state, limit)
        if best is None:
            return
        self._state = state
        if self.settings.out is None:
            return
        if best.choices != self._kept:
            self._write(best.choices)
        if self._since_report.seconds > REPORT_SHARE * self._report_seconds:
            watch = Stopwatch()
            self._report_so_far()
            self._since_report, self._report_seconds = Stopwatch(), watch.seconds

    def _write(self, choices: Choices) -> None:
        """Write choices as the best so far."""
        if self.settings.out is not None:
            own = self.stage.space.configuration(choices, f"tuned-{self.budgets[0].slug}")
            write_text(self.settings.out / best_file(self.stage.name), text_of(own, self.stage.name))
            self._kept = choices

    def _report_so_far(self) -> None:
        """Write a report of the trials so far, as far as the disk allows."""
        if self._state is not None and self.settings.out is not None:
            with contextlib.suppress(InputError):
                write_text(self.settings.out / REPORT_FILE, page(self._so_far(self._state), []))

    def _finalists(self, state: State, study: Study, limits: Sequence[float]) -> tuple[list[Configuration], State]:
        """The best for each limit, refined level by level, and the state after the search for them.

        Where times are predicted and the clock says that a budget is exceeded, the search goes on below it.
        """
        found: dict[str, Configuration] = {}
        self.monitor.enter("refining the best")
        for number, limit in enumerate(limits):
            self.monitor.done()
            budget = self.budgets[number] if number < len(self.budgets) else None
            for _ in range(ATTEMPTS):
                best = state.best(limit, cases=len(self.stage.cases))
                if best is None:
                    break
                name = f"tuned-{best.time:.3f}"
                if name not in found:
                    found[name] = self._polished(self.stage.space.configuration(best.choices, name))
                if budget is None or not self.stage.predicts:
                    break
                (time,) = self.stage.clock.times([found[name]], ROUNDS)
                if time.judged <= budget.milliseconds or self.monitor.expired():
                    break
                limit = 0.98 * min(limit, best.time or limit) * budget.milliseconds / time.judged
                evaluator = self.stage.evaluator(state.space, study, self.monitor.expired)
                state = dataclasses.replace(state, count=len(state.trials) + MORE_TRIALS)
                state = self._go_on(state, evaluator, study, [limit])
        return list(found.values()), state

    def _polished(self, configuration: Configuration) -> Configuration:
        """The configuration with numbers for each level, if they are better on all cases."""
        if self.monitor.expired():
            return configuration
        expired = self.monitor.expired

        def compute() -> str:
            return self.stage.polished(configuration, expired).to_json()

        key = f"polished {configuration.to_json()}"
        return Configuration.from_json(self._polish_study.remember(key, compute, expired=expired))

    def _result(self, state: State, tuned: list[Candidate], known: list[Candidate], base: FrameTime) -> Tuned:
        forms = [c for c in (*tuned, *known) if c.form == "hyjax"]
        usable = self._timed_again([c for c in forms if self.stage.is_followed(c.configuration)])
        best = []
        for budget in self.budgets:
            chosen = best_within(budget, usable)
            best.append(dataclasses.replace(chosen, configuration=self.stage.named(chosen, budget)))
        # One configuration has one name and one time, wherever it stands.
        front = front_of([next((b for b in best if same(b, c)), c) for c in usable])
        known = [next((c for c in usable if same(c, each)), each) for each in known]
        record: dict[str, Any] = self._record() | {
            "trials": len(state.trials),
            "prediction errors": self.stage.prediction_errors(state, tuned),
            "default p95 at the start": base.judged,
            "disturbed": [time.default_p95, time.default_quiet_p95] if (time := best[0].time).disturbed else None,
            "kept": [budget.label for budget, c in zip(self.budgets, best) if c.time.judged <= budget.milliseconds],
            "time was up": self._time_was_up,
            "left out": self._left_out,
            "seconds": round(self.monitor.clock.seconds, 1),
            "peak memory, MiB": round(peak_memory_mib()),
        }
        trials = list(state.trials.values())
        return Tuned(
            best[0].configuration,
            best,
            self.budgets,
            front,
            known,
            trials,
            effects(trials),
            self.stage.examples(front, known),
            record,
        )

    def _record(self) -> dict[str, Any]:
        """Parts of the record that are known before the search."""
        record = {
            "stage": self.stage.name,
            "settings": self.settings.record(),
            "cases": len(self.stage.cases),
            "held-out cases": len(self.stage.held_out),
            "further budgets": self._further,
            "cores": cores(),
        }
        return record | self._environment | self.stage.record()

    def _timed_again(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Candidates, the best for each budget timed once more: of several, one may have fitted by luck."""
        found, again = list(candidates), set[str]()
        for budget in self.budgets:
            for _ in range(ATTEMPTS):
                chosen = best_within(budget, found)
                if chosen.name in again or (again and self.monitor.over()):
                    break
                again.add(chosen.name)
                seconds = min(MOST_SECONDS, TIMING_SHARE * (self.monitor.limit or math.inf))
                (time,) = self.stage.clock.times([chosen.configuration], ROUNDS, most_seconds=seconds)
                found = [dataclasses.replace(c, time=time) if c is chosen else c for c in found]
        return found
