"""Clock of whole frames: configurations timed in turns with the default one."""

import dataclasses
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import jax
import numpy as np
from jaxtyping import Bool, Float
from tqdm import tqdm

from hyjax.configuration import Configuration
from hyjax.light.color import to_display_bytes
from hyjax.tuning.scene import TuningScene
from hyjax.util.clock import Stopwatch

FRAMES = 6
DEFAULT = "default"
BAR_DELAY = 2.0
"""Seconds of timing before a bar is shown."""
FEWEST_ROUNDS = 10
DISTURBED_RATIO = 1.2
"""p95 of all rounds over that of the quieter half, above which other work is said to disturb the clock."""
Milliseconds = Float[np.ndarray, "r"]


@dataclasses.dataclass(frozen=True)
class Rounds:
    """Times of a call in rounds.

    Attributes:
        wall: milliseconds by the clock on the wall.
        undisturbed: the same, or those of the processor where they are less: then the process waited for others.
            Of devices that processors wait for, those by the clock on the wall.
    """

    wall: Milliseconds
    undisturbed: Milliseconds


@dataclasses.dataclass(frozen=True)
class FrameTime:
    """Time of a whole frame.

    Attributes:
        median: milliseconds, without those that the process waited for other work.
        p95: milliseconds by the clock on the wall, in all rounds.
        default: median of the default configuration, in turns with it.
        ratio: median over the rounds of its time over the default's in the same round: other work on the machine
            changes it less than the medians.
        predicted: whether it follows from other times, and was not measured.
        quiet_p95: p95 in the quieter half of the rounds, without waiting; None where rounds are not known.
        default_p95, default_quiet_p95: likewise of the default.
    """

    median: float
    p95: float
    default: float
    ratio: float
    predicted: bool = False
    quiet_p95: float | None = None
    default_p95: float | None = None
    default_quiet_p95: float | None = None

    @classmethod
    def of_rounds(cls, own: "Rounds", default: "Rounds", quiet: Bool[np.ndarray, "r"]) -> "FrameTime":
        """Time of rounds, of which some were quiet."""
        ratio = float(np.median(own.undisturbed / default.undisturbed))
        return cls(
            float(np.median(own.undisturbed)),
            float(np.percentile(own.wall, 95)),
            float(np.median(default.undisturbed)),
            ratio,
            False,
            float(np.percentile(own.undisturbed[quiet], 95)),
            float(np.percentile(default.wall, 95)),
            float(np.percentile(default.undisturbed[quiet], 95)),
        )

    @property
    def by_default(self) -> float | None:
        """The default's p95 in quiet rounds, times the ratio."""
        return None if self.default_quiet_p95 is None else self.ratio * self.default_quiet_p95

    @property
    def judged(self) -> float:
        """Milliseconds that budgets are judged by: p95 in quiet rounds, or that by the default if it is longer."""
        known = [time for time in (self.quiet_p95, self.by_default) if time is not None]
        return min(self.p95, max(known)) if known else self.p95

    @property
    def disturbed(self) -> bool:
        """Whether other work made the default's p95 longer than in quiet rounds."""
        if self.default_p95 is None or self.default_quiet_p95 is None:
            return False
        return self.default_p95 > DISTURBED_RATIO * self.default_quiet_p95


class Clock(Protocol):
    """Times of configurations, on this machine or another device."""

    def times(
        self, configurations: Sequence[Configuration], repeats: int, *, most_seconds: float | None = None
    ) -> list[FrameTime]:
        """Times of configurations in turns with the default; see `FrameClock.times`."""
        ...


class FrameClock:
    """Times of whole frames, from the picture in memory to the relit picture's bytes, one after the other.

    G-buffer, light, guide, both cascades, composite and bytes count; reading, and what there is once a scene, does
    not.
    """

    def __init__(self, scene: TuningScene, lights: str, progress: bool = False) -> None:
        self.scene, self.lights, self.progress = scene, lights, progress
        count = len(scene)
        self._frames = [scene.scene.frame(round(i * (count - 1) / max(FRAMES - 1, 1))) for i in range(FRAMES)]

    def times(
        self, configurations: Sequence[Configuration], repeats: int, *, most_seconds: float | None = None
    ) -> list[FrameTime]:
        """Times of configurations in turns with the default.

        Args:
            repeats: frames of each, after as many that warm up as there are frames.
            most_seconds: begin no further round after so long a time, if each has run ten times by then.
        """
        names = [DEFAULT if each == Configuration() else str(number) for number, each in enumerate(configurations)]
        calls = {name: self._call(each) for name, each in zip(names, configurations, strict=True)}
        calls.setdefault(DEFAULT, self._call(Configuration()))
        hidden, parts = not self.progress, len(calls) + repeats
        with tqdm(desc="timing", total=parts, delay=BAR_DELAY, leave=False, disable=hidden) as bar:
            for call in calls.values():
                for _ in self._frames:  # what shines is composed by a program of its own, in some frames only
                    call()
                bar.update()
            rounds = rounds_of(calls, repeats, most_seconds, bar.update)
        quiet = quiet_rounds([own.wall for own in rounds.values()])
        return [FrameTime.of_rounds(rounds[name], rounds[DEFAULT], quiet) for name in names]

    def _call(self, configuration: Configuration) -> Callable[[], Any]:
        relighter, frames = self.scene.relighter(self.lights, configuration), itertools.cycle(self._frames)
        return lambda: np.asarray(to_display_bytes(relighter.picture(next(frames))))


def rounds_of(
    calls: Mapping[str, Callable[[], Any]],
    repeats: int,
    most_seconds: float | None = None,
    done: Callable[[], Any] = lambda: None,
) -> dict[str, Rounds]:
    """Times of each call in each round, A B C A B C ...; see `FrameClock.times`; `done` comes after each."""
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    total = Stopwatch()
    for count in range(repeats):
        if most_seconds is not None and count >= FEWEST_ROUNDS and total.seconds > most_seconds:
            break
        for name, call in calls.items():
            watch, processor = Stopwatch(), time.process_time()
            call()
            seconds[name].append((watch.seconds, time.process_time() - processor))
        done()
    on_processor = jax.default_backend() == "cpu"
    found = {}
    for name, own in seconds.items():
        wall, processor_times = 1e3 * np.array(own).T
        found[name] = Rounds(wall, np.minimum(wall, processor_times) if on_processor else wall)
    return found


def quiet_rounds(rounds: Sequence[Milliseconds]) -> Bool[np.ndarray, "r"]:
    """Which rounds are of the quieter half: those of the least time in all, each call over its own median.

    >>> quiet_rounds([np.array([1.0, 1.1, 9.0, 1.2]), np.array([2.0, 2.0, 2.0, 8.0])]).tolist()
    [True, True, False, False]
    """
    total = sum(own / np.median(own) for own in rounds)
    chosen = np.zeros(len(total), bool)
    chosen[np.argsort(total, kind="stable")[: -(-len(total) // 2)]] = True
    return chosen


def slowest_setup(scene: TuningScene, lights: Sequence[str]) -> str:
    """The set-up of the most lights, under which a frame takes longest: timing all compiles programs for each."""
    return max(lights, key=lambda name: len(scene.setup(name).lights))
