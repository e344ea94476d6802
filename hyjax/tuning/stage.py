"""Stage that a run tunes for: space, frames, judge and clock; and that of the whole frame."""

import abc
import dataclasses
import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from hyjax.choices.table import CHOICES
from hyjax.configuration import PRESETS, Configuration, Measured
from hyjax.data.frames import spread
from hyjax.light.color import to_display
from hyjax.tuning.bench import FrameBench
from hyjax.tuning.clock import Clock, FrameClock, FrameTime
from hyjax.tuning.evaluation import Judge, Scorer
from hyjax.tuning.evaluator import Evaluator, StudyEvaluator
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.refinement import refine_numbers
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate
from hyjax.tuning.search import GRADIENT_TURN, State
from hyjax.tuning.settings import BudgetStage, TuneSettings
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.study import Study
from hyjax.util.environment import cores, environment
from hyjax.util.errors import InputError
from hyjax.util.files import digest

log = logging.getLogger(__name__)
FEWEST_CASES = 6
"""Cases of the first batch, at least."""
POLISH_CASES = 12
BASE_ROUNDS = 60
CHECK_ROUNDS = 30
EXAMPLE_CASES = 3
QUICK_PRESET = "balanced"
"""Preset whose values are taken where all budgets are less than the default's time and no true picture can judge
others."""
BUDGET_SHARE = 0.98
"""Share of a budget that is aimed at: a p95 is a noisy number."""


class Stage(abc.ABC):
    """Stage that a run tunes for.

    Attributes:
        space: that is searched.
        cases: frames to tune on, in the order of batches.
        held_out: frames on which nothing is chosen.
        judge: of them.
        clock: of configurations.
        base: configuration that losses and times are relative to.
        predicts: whether times of trials are predicted, so that the clock may correct the search.
        first: cases of the first batch.
        relaxes, turn: of the search, see `State`.
    """

    name: BudgetStage
    space: Space
    cases: Sequence[Any]
    held_out: Sequence[Any]
    judge: Scorer
    clock: Clock
    base: Configuration
    predicts: bool
    first: int
    relaxes: int
    turn: int

    @abc.abstractmethod
    def base_time(self, study: Study) -> FrameTime:
        """Time of the base."""

    @abc.abstractmethod
    def limit(self, budget: Budget, base: FrameTime) -> float:
        """Time over the base's that trials for a budget may take."""

    @abc.abstractmethod
    def starts(self, limits: Sequence[float]) -> list[Choices]:
        """Choices that are tried first."""

    def check_reachable(self, space: Space, budgets: Sequence[Budget], base: FrameTime) -> None:
        """Raise `InputError` if no configuration of a space is fast enough, where no trial was."""
        return

    def is_followed(self, configuration: Configuration) -> bool:
        """Whether the renderer that is tuned for follows all choices, and those that are held have their value."""
        return True

    @abc.abstractmethod
    def references(self) -> list[Configuration]:
        """Configurations to compare the tuned ones with, the base first."""

    @abc.abstractmethod
    def evaluator(self, space: Space, study: Study, expired: Callable[[], bool]) -> Evaluator:
        """Judge of trials."""

    @abc.abstractmethod
    def polished(self, configuration: Configuration, expired: Callable[[], bool]) -> Configuration:
        """The configuration with better numbers for each level, or as it is."""

    @abc.abstractmethod
    def examples(
        self, front: Sequence[Candidate], references: Sequence[Candidate]
    ) -> list[tuple[str, dict[str, Any]]]:
        """Pictures of some frames by heading."""

    @abc.abstractmethod
    def named(self, candidate: Candidate, budget: Budget) -> Configuration:
        """Configuration of a candidate as the best for a budget."""

    @abc.abstractmethod
    def decisive(self) -> dict[str, Any]:
        """All that decides the losses, for the study."""

    @abc.abstractmethod
    def record(self) -> dict[str, Any]:
        """Parts of the run's record, as JSON's types."""

    @abc.abstractmethod
    def prediction_errors(self, state: State, tuned: Sequence[Candidate]) -> list[float]:
        """Relative errors of predicted times."""


class FrameStage(Stage):
    """The whole frame on this machine."""

    name: BudgetStage = "frame"
    predicts, relaxes, turn = False, 1, GRADIENT_TURN

    def __init__(self, bench: FrameBench, settings: TuneSettings) -> None:
        self.bench, self.settings = bench, settings
        self.cases, self.held_out = bench.cases, bench.held_out
        self.judge = self._judge = Judge(bench.scenes, PictureLoss.of(settings.frame.lpips))
        self.clock = FrameClock(bench.scenes[0], bench.lights, not settings.quiet)
        truth = all(bench.scenes[place].has_truth for place, *_ in bench.cases)
        self.space = Space.of(truth=truth, renderer=settings.renderer, held=settings.frame.held)
        self.base = Configuration()
        self.first = max(FEWEST_CASES, len(bench.scenes))
        self._environment = environment()

    def base_time(self, study: Study) -> FrameTime:
        def timed() -> dict[str, float]:
            (base,) = self.clock.times([self.base], BASE_ROUNDS)
            return dataclasses.asdict(base)

        base = FrameTime(**study.remember(study.timed("default"), timed))
        # A search that is gone on with keeps what its trials were timed with, whatever the budgets are then.
        less = all(self.limit(budget, base) < 1 for budget in self.settings.budgets())
        if study.remember("less than the default's time", lambda: less):
            values = Configuration.preset(QUICK_PRESET).values()
            unjudged = {name: values[name] for name in self._unjudged() if name in values}
            self.space = dataclasses.replace(self.space, fixed={**unjudged, **self.space.fixed})
        return base

    def _unjudged(self) -> list[str]:
        """Choices that are not searched for want of true pictures."""
        of_renderer = Space.of(truth=True, renderer=self.settings.renderer, held=self.settings.frame.held)
        return [name for name in of_renderer.named if name not in self.space.named]

    def check_reachable(self, space: Space, budgets: Sequence[Budget], base: FrameTime) -> None:
        check_reachable(budgets, base, space, self.clock)

    def limit(self, budget: Budget, base: FrameTime) -> float:
        return BUDGET_SHARE * budget.milliseconds / base.judged

    def starts(self, limits: Sequence[float]) -> list[Choices]:
        return [self.space.choices_of(Configuration.preset(name)) for name in PRESETS]

    def is_followed(self, configuration: Configuration) -> bool:
        renderer, values = self.settings.renderer, configuration.values()
        if any(values.get(name, value) != value for name, value in self.settings.frame.held.items()):
            return False
        return renderer is None or all(
            CHOICES[n].followed_by(renderer) or value == CHOICES[n].usual_value for n, value in values.items()
        )

    def references(self) -> list[Configuration]:
        paper = [Configuration.paper()] if self.settings.frame.paper_form else []
        known = [self.base, *map(Configuration.preset, PRESETS)]
        held = [own for own in map(self._holding, known) if own != self.base]
        return [self.base, *held, *paper]

    def _holding(self, known: Configuration) -> Configuration:
        """A configuration that comes with hyjax, with the choices that are held, as the renderer follows it."""
        own, renderer = known.with_choices(self.settings.frame.held), self.settings.renderer
        own = own if renderer is None else own.followed_by(renderer, say=False)
        same = dataclasses.replace(own, name=known.name) == known
        return known if same else dataclasses.replace(own, name=f"{known.name}-held")

    def evaluator(self, space: Space, study: Study, expired: Callable[[], bool]) -> StudyEvaluator:
        seed = self.settings.scene.seed
        return StudyEvaluator(space, self._judge, self.cases, self.clock, study, seed=seed, expired=expired)

    def polished(self, configuration: Configuration, expired: Callable[[], bool]) -> Configuration:
        cases = self.cases[:POLISH_CASES]
        held = self.space.fixed.keys()
        better = refine_numbers(configuration, self._judge, cases, levels=True, held=held, expired=expired)
        before, after = (
            np.mean([math.log(row["loss"]) for row in self.judge.scores(candidate, self.cases)])
            for candidate in (configuration, better)
        )
        return better if after < before else configuration

    def examples(
        self, front: Sequence[Candidate], references: Sequence[Candidate]
    ) -> list[tuple[str, dict[str, Any]]]:
        return examples(self.bench, front)

    def named(self, candidate: Candidate, budget: Budget) -> Configuration:
        time, scene = candidate.time, self.bench.scenes[0].scene
        size = scene.frame(0).camera.intrinsics.shape
        measured = Measured(
            device=self._environment["device"],
            cores=cores(),
            size=(int(size[0]), int(size[1])),
            median_ms=round(time.median, 3),
            p95_ms=round(time.judged, 3),
            default_ms=round(time.default, 3),
        )
        name = f"tuned-{budget.slug}" if candidate.name.startswith("tuned-") else candidate.name
        return dataclasses.replace(candidate.configuration, name=name, measured=measured)

    def decisive(self) -> dict[str, Any]:
        scenes = self.bench.scenes
        pairs = [(scene.scene, scene.accurate) for scene in scenes]
        keys = [[None if surface is None else surface.caster.arrays.key for surface in pair] for pair in pairs]
        names = self.settings.set_ups()
        setups = {name: [digest([str(scene.setup(name))]) for scene in scenes] for name in names}
        return {
            "scenes": [[scene.name, scene.scene.capture.fingerprint] for scene in scenes],
            "surfaces": keys,
            "sizes": [None if rough.size is None else list(rough.size) for rough, _ in pairs],
            "lights": setups,
            "cases": [list(case) for case in self.cases],
            "lpips": self.settings.frame.lpips,
            **({"for": self.settings.renderer} if self.settings.renderer else {}),
            **({"held": self.settings.frame.held} if self.settings.frame.held else {}),
            "seed": self.settings.scene.seed,
            "hyjax": self._environment["versions"]["hyjax"],
        }

    def record(self) -> dict[str, Any]:
        scenes, unjudged = [scene.name for scene in self.bench.scenes], self._unjudged()
        return {
            "scenes": scenes,
            "timed under": self.bench.lights,
            "not searched": unjudged,
            "not searched, as in": QUICK_PRESET if self.space.fixed.keys() & unjudged else "default",
        }

    def prediction_errors(self, state: State, tuned: Sequence[Candidate]) -> list[float]:
        return [abs(guess / true - 1) for guess, true in state.predictions]


def check_reachable(budgets: Sequence[Budget], base: FrameTime, space: Space, clock: Clock) -> None:
    """Raise `InputError` if even the cheapest configurations, on the clock, take longer than a budget."""
    least = min(budgets, key=lambda budget: budget.milliseconds)
    if least.milliseconds >= base.judged:
        return
    smallest: list[Choices] = [
        {"scale": 4, "cascade": "8:4", "shadow_pass": "none", "guide": "none"},
        {"scale": 4, "cascade": "4:6", "shadow_pass": "none", "sampling": 4},
    ]
    found: list[tuple[FrameTime, Configuration]] = []
    for choices in smallest:
        choices = space.complete({name: value for name, value in choices.items() if name not in space.fixed})
        configuration = space.configuration(choices, "fastest")
        found += zip(clock.times([configuration], CHECK_ROUNDS), [configuration], strict=True)
        if found[-1][0].judged <= least.milliseconds:
            return
    time, configuration = min(found, key=lambda pair: pair[0].judged)
    if time.disturbed or base.disturbed or time.judged >= base.judged:
        log.warning(
            "other work disturbs the clock: whether %.3g ms are in reach shows in the end", least.milliseconds
        )
        return
    steps = " ".join(f"{level.factor}:{level.steps}" for level in configuration.schedule.levels)
    raise InputError(
        f"budget {least.milliseconds:.3g} ms: out of reach on this device; the fastest that was found takes "
        f"{time.judged:.2f} ms (p95; scale {configuration.scale}, cascade {steps}, no shadow pass), the "
        f"default {base.judged:.2f}; give at least --budget-ms {1.1 * time.judged:.3g}, or a smaller --size"
        f"{', or --choices light_edges=false' * configuration.light.edges}"
    )


def examples(bench: FrameBench, front: Sequence[Candidate]) -> list[tuple[str, dict[str, Any]]]:
    """Pictures of some cases, held out where there are any, at three points of the front, and the target.

    They are shown with the gains that the loss fits.

    Returns:
        (name of the case, pictures by heading).
    """
    rows = []
    for place, lights, index in spread(bench.held_out or bench.cases, EXAMPLE_CASES):
        scene = bench.scenes[place]
        frame, target = scene.scene.frame(index), scene.target(lights, index)
        pictures: dict[str, Any] = {"photo": frame.image}
        for candidate in spread(list(front), 3):
            judged = scene.judged(candidate.configuration)
            image = np.asarray(scene.relighter(lights, judged).picture(frame))
            shown = to_display(jnp.asarray(image * PictureLoss().gains(image, target)))
            pictures[f"{candidate.name}, {candidate.time.median:.1f} ms"] = np.asarray(shown)
        pictures["target"] = target.picture
        rows.append((f"{scene.name}, {lights}, frame {index}", pictures))
    return rows
