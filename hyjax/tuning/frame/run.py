"""Tuning run of the whole frame: search, refinement of the best, proof on the clock and on held-out scenes."""

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from hyjax.configuration import PRESETS, Configuration, Measured
from hyjax.data.capture import Capture
from hyjax.tuning.frame.bench import FrameBench, open_frame_bench
from hyjax.tuning.frame.clock import FrameClock, FrameTime
from hyjax.tuning.frame.evaluation import Judge
from hyjax.tuning.frame.evaluator import StudyEvaluator
from hyjax.tuning.frame.loss import PictureLoss
from hyjax.tuning.frame.proof import (
    BASE_ROUNDS,
    MOST_SECONDS,
    ROUNDS,
    best_within,
    check_reachable,
    effects,
    examples,
    front_of,
    prove,
)
from hyjax.tuning.frame.refinement import refine_numbers
from hyjax.tuning.frame.result import FrameCandidate, FrameTuned
from hyjax.tuning.frame.search import State, init, search, update
from hyjax.tuning.frame.space import Choices, Space
from hyjax.tuning.frame.study import Study, check_installed
from hyjax.tuning.frame.trial import Trial
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.result import Budget
from hyjax.tuning.settings import TuneSettings
from hyjax.util.claims import claimed
from hyjax.util.environment import cores, environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import digest, make_writable, write_text

EXTRA = (0.35, 0.5, 0.7, 1.0, 1.5)
"""Further points of the front, in times of the default."""
FEWEST = 6
"""Cases of the first batch, at least."""
POLISH_CASES = 12
ATTEMPTS = 3
ROOM = 0.98
"""Share of a budget that is aimed at: a p95 is a noisy number."""


def tune_frame(settings: TuneSettings, *, capture: Capture | None = None) -> FrameTuned:
    """The configuration with the best pictures within each time budget.

    Args:
        settings: what to tune for and on.
        capture: frames that were opened before, in the place of those that the settings name.

    Raises:
        InputError: any of these cannot be used, or a budget is out of reach on this device.
    """
    if not settings.tunes_frame:
        raise InputError(
            "stage: `tune` is for the whole frame on this machine; for the rest there is `tune_schedule`"
        )
    settings.check()
    budgets, monitor = settings.budgets(), RunMonitor(settings.time_limit, not settings.quiet)
    check_installed()
    if settings.out is not None:
        make_writable(settings.out)
    with claimed(settings.out):
        bench = open_frame_bench(settings, capture)
        return FrameRun(bench, settings, budgets, monitor).run()


class FrameRun:
    """One run, from the search to the files.

    Args:
        bench: what is tuned on.
        settings: of the search.
        budgets: of time.
        monitor: time limit and progress.
    """

    def __init__(
        self, bench: FrameBench, settings: TuneSettings, budgets: Sequence[Budget], monitor: RunMonitor
    ) -> None:
        self.bench, self.settings, self.budgets, self.monitor = bench, settings, list(budgets), monitor
        self.judge = Judge(bench.scenes, PictureLoss.of(settings.frame.lpips))
        self.clock = FrameClock(bench.scenes[0], bench.lights)
        truth = all(bench.scenes[place].has_truth for place, *_ in bench.cases)
        self.space = Space.of(truth=truth)
        self.machine, self._kept = environment(), Choices()
        told = {name: self.machine["versions"][name] for name in ("jax", "jaxlib")}
        machine = ", ".join(
            [
                f"{bench.lights}, {self.machine['device']}",
                f"{cores()} cores",
                *(f"{n} {v}" for n, v in told.items()),
            ]
        )
        self._study = functools.partial(Study, settings.out, settings=self._decisive(), machine=machine)

    def run(self) -> FrameTuned:
        """Search, refine, prove, write."""
        from hyjax.tuning.frame.report import write_results

        study = self._study("frame", resume=self.settings.resume)

        def timed() -> dict[str, float]:
            (base,) = self.clock.times([Configuration()], BASE_ROUNDS)
            if not study.trials:
                check_reachable(self.budgets, base, self.space, self.clock)
            return dataclasses.asdict(base)

        base = FrameTime(**study.remember(study.timed("default"), timed))
        state = self._search(self.space, study, self._limits(base), keep=self._keep)
        candidates = self._finalists(state, base)
        references = [Configuration(), *map(Configuration.preset, PRESETS)]
        if self.settings.frame.paper_form:
            references.append(Configuration.paper())
            paper = Space.of(truth=True, paper=True)
            found = self._search(paper, self._study("paper", resume=True), [math.inf])
            best = found.best(math.inf, cases=len(self.bench.cases))
            if best is not None:
                references.append(self._polished(paper.configuration(best.choices, "paper-tuned")))
        told = prove(
            [*candidates, *references], self.bench, self.judge, self.clock, progress=not self.settings.quiet
        )
        tuned, known = told[: len(candidates)], told[len(candidates) :]
        result = self._result(state, tuned, known, base)
        if self.settings.out is not None:
            write_results(self.settings.out, result)
        return result

    @functools.cached_property
    def _polish_study(self) -> Study:
        return self._study("polish", resume=True)

    def _search(
        self,
        space: Space,
        study: Study,
        limits: Sequence[float],
        *,
        keep: Callable[[State, float], None] | None = None,
    ) -> State:
        count, first = len(self.bench.cases), max(FEWEST, len(self.bench.scenes))
        batches = sorted({min(first, count), min(2 * first, count), count})
        # The paper's form has fewer choices.
        count_of_trials = self.settings.frame.trials // (2 if space.paper else 1)
        seed, expired = self.settings.scene.seed, self.monitor.expired
        starts = [] if space.paper else [space.choices_of(Configuration.preset(name)) for name in PRESETS]
        starts = starts[: count_of_trials // 4]  # of few trials, some are left for the search
        state = init(space, batches, count_of_trials, starts=starts, relaxes=not space.paper, seed=seed)
        with self.monitor.watching(f"{study.name}, {count_of_trials} trials"):
            evaluator = StudyEvaluator(
                space, self.judge, self.bench.cases, self.clock, study, seed=seed, expired=expired
            )
            for trial in study.trials:
                state = update(state, known := evaluator.known(trial))
                if trial.time is None:
                    study.add(space, known)

            def report(state: State, trial: Trial) -> None:
                study.add(space, trial)
                self.monitor.note(trial.phase, trial.loss)
                if keep is not None:
                    keep(state, limits[0])

            try:
                return search(state, evaluator, limits, report=report, expired=expired)
            except KeyboardInterrupt:
                if (out := self.settings.out) is not None:
                    best = f"; {out / 'configuration.json'} is the best so far" if self._kept else ""
                    tqdm.write(f"hyjax: stopped; --resume goes on with {out}{best}", file=sys.stderr)
                raise

    def _keep(self, state: State, limit: float) -> None:
        """Write the best so far, so that whoever stops the run has it."""
        best, out = state.best(limit), self.settings.out
        if best is not None and out is not None and best.choices != self._kept:
            self._kept = best.choices
            own = self.space.configuration(best.choices, f"tuned-{self.budgets[0].slug}")
            write_text(out / "configuration.json", own.to_json() + "\n")

    def _limits(self, base: FrameTime) -> list[float]:
        """Budgets in times of the default, by its p95; further points of the front if they are asked for."""
        asked = [ROOM * budget.milliseconds / base.p95 for budget in self.budgets]
        return [*asked, *(EXTRA if self.settings.extra else ())]

    def _finalists(self, state: State, base: FrameTime) -> list[Configuration]:
        """The best of each budget, refined level by level."""
        found: dict[str, Configuration] = {}
        for limit in self._limits(base):
            best = state.best(limit, cases=len(self.bench.cases))
            if best is not None and (name := f"tuned-{best.time:.3f}") not in found:
                found[name] = self._polished(self.space.configuration(best.choices, name))
        return list(found.values())

    def _polished(self, configuration: Configuration) -> Configuration:
        """The configuration with numbers for each level, if they are better on all cases."""
        if self.monitor.expired():
            return configuration
        study_key = f"polished {configuration.to_json()}"

        def compute() -> str:
            better = refine_numbers(
                configuration,
                self.judge,
                self.bench.cases[:POLISH_CASES],
                levels=True,
                expired=self.monitor.expired,
            )
            before, after = (
                np.mean(np.log([row["loss"] for row in self.judge.scores(each, self.bench.cases)]))
                for each in (configuration, better)
            )
            return (better if after < before else configuration).to_json()

        study = self._polish_study
        return Configuration.from_json(study.remember(study_key, compute, expired=self.monitor.expired))

    def _result(
        self, state: State, tuned: list[FrameCandidate], known: list[FrameCandidate], base: FrameTime
    ) -> FrameTuned:
        usable = [c for c in (*tuned, *known) if c.form == "hyjax"]
        best = []
        for budget in self.budgets:
            chosen = self._timed_again(budget, usable)
            best.append(dataclasses.replace(chosen, configuration=self._measured(chosen, budget)))
        front = front_of(usable)
        errors = [abs(guess / true - 1) for guess, true in state.predictions]
        record = {
            "settings": self.settings.record(),
            "scenes": [scene.name for scene in self.bench.scenes],
            "cases": len(self.bench.cases),
            "held-out cases": len(self.bench.held_out),
            "timed under": self.bench.lights,
            "trials": len(state.trials),
            "prediction errors": errors,
            "default p95 at the start": base.p95,
            "kept": [budget.label for budget, c in zip(self.budgets, best) if c.time.p95 <= budget.milliseconds],
            "seconds": round(self.monitor.clock.seconds, 1),
            "peak memory, MiB": round(peak_memory_mib()),
            "cores": cores(),
        } | self.machine
        return FrameTuned(
            best[0].configuration,
            best,
            self.budgets,
            front,
            known,
            list(state.trials.values()),
            effects(list(state.trials.values())),
            examples(self.bench, front),
            record,
        )

    def _timed_again(self, budget: Budget, usable: Sequence[FrameCandidate]) -> FrameCandidate:
        """The best within a budget, timed once more: of several, one may have fitted by luck."""
        left = list(usable)
        for _ in range(ATTEMPTS):
            chosen = best_within(budget, left)
            (time,) = self.clock.times([chosen.configuration], ROUNDS, most_seconds=MOST_SECONDS)
            again = dataclasses.replace(chosen, time=time)
            if len(left) == 1 or not time.p95 > budget.milliseconds >= chosen.time.p95:
                break
            left = [c for c in left if c is not chosen]
        return again

    def _measured(self, candidate: FrameCandidate, budget: Budget) -> Configuration:
        time, scene = candidate.time, self.bench.scenes[0].scene
        size = scene.frame(0).camera.intrinsics.shape
        told = Measured(
            device=self.machine["device"],
            cores=cores(),
            size=(int(size[0]), int(size[1])),
            median_ms=round(time.median, 3),
            p95_ms=round(time.p95, 3),
            default_ms=round(time.default, 3),
        )
        name = f"tuned-{budget.slug}" if candidate.name.startswith("tuned-") else candidate.name
        return dataclasses.replace(candidate.configuration, name=name, measured=told)

    def _decisive(self) -> dict[str, Any]:
        """All that decides the losses, for the study; the machine decides on the times."""
        scenes = self.bench.scenes
        surfaces = [
            [each.scene.caster.arrays.key, None if each.accurate is None else each.accurate.caster.arrays.key]
            for each in scenes
        ]
        setups = {name: [digest([str(each.setup(name))]) for each in scenes] for name in self.settings.set_ups()}
        return {
            "scenes": [[scene.name, scene.scene.capture.fingerprint] for scene in scenes],
            "surfaces": surfaces,
            "sizes": [None if each.scene.size is None else list(each.scene.size) for each in scenes],
            "lights": setups,
            "cases": [list(case) for case in self.bench.cases],
            "lpips": self.settings.frame.lpips,
            "seed": self.settings.scene.seed,
            "hyjax": self.machine["versions"]["hyjax"],
        }
