"""Tuning run: search, refinement of the best, proof on the clock and on held-out frames."""

import contextlib
import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
from tqdm import tqdm

from hyjax.configuration import Configuration
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.proof import MOST_SECONDS, ROUNDS, best_within, effects, front_of, prove
from hyjax.tuning.report import best_file, text_of, write_results
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.search import State, init, search, update
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.stage import Stage
from hyjax.tuning.study import Study, check_free, check_installed
from hyjax.tuning.trial import Trial
from hyjax.util.claims import claimed
from hyjax.util.clock import Stopwatch
from hyjax.util.environment import cores, environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text


class RunMonitor:
    """Time limit and progress bar of a run.

    Args:
        limit: seconds that it may take; None for no limit.
        progress: show a bar on stderr.
    """

    def __init__(self, limit: float | None, progress: bool) -> None:
        self.clock, self.limit, self.progress = Stopwatch(), limit, progress
        self.best, self.bar = math.inf, tqdm(disable=True)

    def begin(self) -> None:
        """Count the time from now: opening and calibration before a search do not count."""
        self.clock = Stopwatch()

    def expired(self) -> bool:
        return self.limit is not None and self.clock.seconds > self.limit

    @contextlib.contextmanager
    def watching(self, label: str, trials: int) -> Iterator[None]:
        """A bar of so many trials."""
        self.best = math.inf
        with tqdm(desc=label, total=trials, unit="trial", disable=not self.progress) as self.bar:
            yield

    def note(self, phase: str, loss: float) -> None:
        """Called after each trial with its loss over the default's."""
        self.bar.update()
        self.best = min(self.best, loss)
        self.bar.set_postfix_str(f"{phase}, best loss {self.best:.4f} of the default's", refresh=False)


EXTRA_BUDGETS = (0.35, 0.5, 0.7, 1.0, 1.5)
"""Further points of the front, in times of the default."""
ATTEMPTS = 3
MORE_TRIALS = 8
"""Trials for a budget that the clock, unlike the prediction, finds exceeded."""


@contextlib.contextmanager
def opened(settings: TuneSettings) -> Iterator[RunMonitor]:
    """The clock of a run whose folder is this process's alone."""
    monitor, out = RunMonitor(settings.time_limit, not settings.quiet), settings.out
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
        stage: what is tuned.
        settings: of the search.
        budgets: of time; the first one's configuration is the main result.
        monitor: time limit and progress.
    """

    def __init__(
        self, stage: Stage, settings: TuneSettings, budgets: Sequence[Budget], monitor: RunMonitor
    ) -> None:
        self.stage, self.settings, self.budgets, self.monitor = stage, settings, list(budgets), monitor
        self._environment, self._kept = environment(), Choices()
        versions = [f"{name} {self._environment['versions'][name]}" for name in ("jax", "jaxlib")]
        lights = stage.record().get("timed under", stage.name)
        machine = ", ".join([f"{lights}, {self._environment['device']}", f"{cores()} cores", *versions])
        self._study = functools.partial(Study, settings.out, settings=stage.decisive(), machine=machine)

    def run(self) -> Tuned:
        """Search, refine, prove, write."""
        try:
            return self._run()
        except KeyboardInterrupt:
            if (out := self.settings.out) is not None:
                best = f"; {out / best_file(self.stage.name)} is the best so far" if self._kept else ""
                tqdm.write(f"hyjax: stopped; --resume goes on with {out}{best}", file=sys.stderr)
            raise

    def _run(self) -> Tuned:
        study = self._study(self.stage.name, resume=self.settings.resume)
        base = self.stage.base_time(study, self.budgets)
        self.monitor.begin()
        limits = [self.stage.limit(budget, base) for budget in self.budgets]
        limits += EXTRA_BUDGETS if self.settings.extra else ()
        state = self._searched(self.stage.space, study, limits, keep=True)
        candidates, state = self._finalists(state, study, limits)
        references = self.stage.references()
        if self.settings.frame.paper_form and self.stage.name == "frame":
            paper = Space.of(truth=True, paper=True)
            found = self._searched(paper, self._study("paper", resume=True), [math.inf])
            best = found.best(math.inf, cases=len(self.stage.cases))
            if best is not None:
                references.append(self._polished(paper.configuration(best.choices, "paper-tuned")))
        proven = prove([*candidates, *references], self.stage, progress=not self.settings.quiet)
        result = self._result(state, proven[: len(candidates)], proven[len(candidates) :], base)
        if self.settings.out is not None:
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
        trials = self.settings.frame.trials // (2 if space.paper else 1)
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
        with self.monitor.watching(f"tuning, {study.name}", trials):
            for trial in study.trials:
                state = update(state, known := evaluator.known(trial))
                if trial.time is None:
                    study.add(space, known)
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
            self.monitor.note(trial.phase, trial.loss)
            if keep:
                self._keep(state, limits[0])

        return search(state, evaluator, limits, report=report, expired=self.monitor.expired)

    def _keep(self, state: State, limit: float) -> None:
        """Write the best so far, for runs that are stopped."""
        best, out = state.best(limit), self.settings.out
        if best is not None and out is not None and best.choices != self._kept:
            self._kept = best.choices
            own = self.stage.space.configuration(best.choices, f"tuned-{self.budgets[0].slug}")
            write_text(out / best_file(self.stage.name), text_of(own, self.stage.name))

    def _finalists(self, state: State, study: Study, limits: Sequence[float]) -> tuple[list[Configuration], State]:
        """The best for each limit, refined level by level, and the state after the search for them.

        Where times are predicted and the clock says that a budget is exceeded, the search goes on below it.
        """
        found: dict[str, Configuration] = {}
        for number, limit in enumerate(limits):
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
                if time.p95 <= budget.milliseconds or self.monitor.expired():
                    break
                limit = 0.98 * min(limit, best.time or limit) * budget.milliseconds / time.p95
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
        usable = [c for c in (*tuned, *known) if c.form == "hyjax"]
        best = []
        for budget in self.budgets:
            chosen = self._timed_again(budget, usable)
            best.append(dataclasses.replace(chosen, configuration=self.stage.named(chosen, budget)))
        front = front_of(usable)
        record: dict[str, Any] = {
            "stage": self.stage.name,
            "settings": self.settings.record(),
            "cases": len(self.stage.cases),
            "held-out cases": len(self.stage.held_out),
            "trials": len(state.trials),
            "prediction errors": self.stage.prediction_errors(state, tuned),
            "default p95 at the start": base.p95,
            "kept": [budget.label for budget, c in zip(self.budgets, best) if c.time.p95 <= budget.milliseconds],
            "time was up": self.monitor.expired(),
            "seconds": round(self.monitor.clock.seconds, 1),
            "peak memory, MiB": round(peak_memory_mib()),
            "cores": cores(),
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
            record | self._environment | self.stage.record(),
        )

    def _timed_again(self, budget: Budget, usable: Sequence[Candidate]) -> Candidate:
        """The best within a budget, timed once more: of several, one may have fitted by luck."""
        left = list(usable)
        for _ in range(ATTEMPTS):
            chosen = best_within(budget, left)
            (time,) = self.stage.clock.times([chosen.configuration], ROUNDS, most_seconds=MOST_SECONDS)
            again = dataclasses.replace(chosen, time=time)
            if len(left) == 1 or not time.p95 > budget.milliseconds >= chosen.time.p95:
                break
            left = [c for c in left if c is not chosen]
        return again
