"""Proof of configurations: whole frames timed in turns, and judged on all cases, the held-out ones among them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from hyjax.configuration import Configuration
from hyjax.data.frames import spread
from hyjax.light.color import to_display
from hyjax.tuning.frame.bench import FrameBench
from hyjax.tuning.frame.clock import Clock, FrameTime
from hyjax.tuning.frame.evaluation import mean_scores
from hyjax.tuning.frame.result import Candidate, Effect
from hyjax.tuning.frame.space import Space
from hyjax.tuning.frame.trial import Trial
from hyjax.tuning.result import Budget
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    from hyjax.tuning.frame.stage import Stage

ROUNDS = 100
MOST_SECONDS = 20.0
"""Of timing, for each configuration."""
BASE_ROUNDS = 60
EXAMPLE_CASES = 3
LEAST = 1e-9
"""Loss that is told from none."""


def prove(configurations: Sequence[Configuration], stage: "Stage", *, progress: bool) -> list[Candidate]:
    """Configurations with times in turns, and scores on all cases.

    Args:
        configurations: each.
        stage: that they are of: its cases, and those held out, its judge and its clock.
        progress: show a bar on stderr.
    """
    times = stage.clock.times(configurations, ROUNDS, most_seconds=MOST_SECONDS * len(configurations))
    cases, count, judge = [*stage.cases, *stage.held_out], len(stage.cases), stage.judge
    default, found = judge.scores(stage.base, cases), []
    bar = tqdm(configurations, "judging", unit="configuration", disable=not progress)
    for configuration, time in zip(bar, times, strict=True):
        rows = judge.scores(configuration, cases)
        own, base = (np.log([max(row["loss"], LEAST) for row in several]) for several in (rows, default))
        logs = own - base
        tuning, held_out = (
            mean_scores(rows[part]) | {"relative": float(np.exp(np.mean(logs[part])))} if rows[part] else None
            for part in (slice(0, count), slice(count, None))
        )
        assert tuning is not None
        form = "paper" if configuration.mode == "paper" else "hyjax"
        found.append(Candidate(configuration, tuning, held_out, time, form))
    return found


def check_reachable(budgets: Sequence[Budget], base: FrameTime, space: Space, clock: Clock) -> None:
    """Raise `InputError` if even the cheapest configurations, on the clock, take longer than a budget.

    Args:
        budgets: each.
        base: time of the default.
        space: of the choices.
        clock: times them.
    """
    least = min(budgets, key=lambda budget: budget.milliseconds)
    if least.milliseconds >= base.p95:
        return
    cheap = [
        space.complete({"scale": 4, "cascade": "8:4", "shadow_pass": "none", "guide": "none"}),
        space.complete({"scale": 4, "cascade": "4:6", "shadow_pass": "none", "sampling": 4}),
    ]
    fastest = [space.configuration(each, "fastest") for each in cheap]
    time, configuration = min(
        zip(clock.times(fastest, BASE_ROUNDS), fastest, strict=True), key=lambda pair: pair[0].p95
    )
    if time.p95 > least.milliseconds:
        busy = "; other work on the machine disturbs the clock" if time.p95 >= base.p95 else ""
        steps = " ".join(f"{level.factor}:{level.steps}" for level in configuration.schedule.levels)
        raise InputError(
            f"budget {least.milliseconds:.3g} ms: out of reach on this device; the fastest that was found takes "
            f"{time.p95:.2f} ms (p95; scale {configuration.scale}, cascade {steps}, no shadow pass), the default "
            f"{base.p95:.2f}; give at least --budget-ms {1.1 * time.p95:.3g}, or a smaller --size{busy}"
        )


def front_of(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that no other beats in both median time and tuning loss, by time."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (c.time.median, c.tuning["relative"])):
        if not front or candidate.tuning["relative"] < front[-1].tuning["relative"]:
            front.append(candidate)
    return front


def best_within(budget: Budget, candidates: Sequence[Candidate]) -> Candidate:
    """The best of those whose p95 is within a budget, or else the fastest."""
    fitting = [c for c in candidates if c.time.p95 <= budget.milliseconds]
    if not fitting:
        return min(candidates, key=lambda c: c.time.p95)
    return min(fitting, key=lambda c: c.tuning["relative"])


def examples(bench: FrameBench, front: Sequence[Candidate]) -> list[tuple[str, dict[str, Any]]]:
    """Pictures of some cases, held out where there are any, at three points of the front beside the target.

    Returns:
        (name of the case, pictures by heading).
    """
    rows = []
    for place, lights, index in spread(bench.held_out or bench.cases, EXAMPLE_CASES):
        scene = bench.scenes[place]
        frame = scene.scene.frame(index)
        pictures: dict[str, Any] = {"photo": frame.image}
        for candidate in spread(list(front), 3):
            own = scene.judged(candidate.configuration)
            image = jnp.asarray(scene.relighter(lights, own).picture(frame))
            pictures[f"{candidate.name}, {candidate.time.median:.1f} ms"] = np.asarray(to_display(image))
        pictures["target"] = scene.target(lights, index).picture
        rows.append((f"{scene.name}, {lights}, frame {index}", pictures))
    return rows


def effects(trials: Sequence[Trial]) -> list[Effect]:
    """What each choice that was tried by itself costs and brings."""
    starts = [t for t in trials if t.phase in ("default", "ranges")] or list(trials[:1])
    screened = [t for t in trials if t.phase == "screening"]

    def changed_from(base: Trial, trial: Trial) -> list[str]:
        shared = base.choices.keys() & trial.choices.keys()
        return [name for name in shared if base.choices[name] != trial.choices[name]]

    base = max(starts, key=lambda start: sum(len(changed_from(start, t)) == 1 for t in screened))
    found = []
    for trial in screened:
        changed = changed_from(base, trial)
        if len(changed) == 1:
            (name,) = changed
            first = len(min(trial.losses, base.losses, key=len))
            ratio = float(np.exp(np.mean(np.log(trial.losses[:first])) - np.mean(np.log(base.losses[:first]))))
            time = (trial.time or 1.0) / (base.time or 1.0)
            found.append(Effect(name, trial.choices[name], base.choices[name], ratio, time))
    return found
