"""Clock of whole frames: configurations timed in turns with the default one."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from hyjax.configuration import Configuration
from hyjax.light.color import to_display_bytes
from hyjax.tuning.scene import TuningScene
from hyjax.util.clock import Stopwatch

FRAMES = 6
DEFAULT = "default"
FEWEST_ROUNDS = 10


@dataclasses.dataclass(frozen=True)
class FrameTime:
    """Time of a whole frame.

    Attributes:
        median, p95: milliseconds.
        default: median of the default configuration, in turns with it.
        ratio: median over the rounds of its time over the default's in the same round: other work on the machine
            changes it less than the medians.
        predicted: whether it follows from other times, and was not measured.
    """

    median: float
    p95: float
    default: float
    ratio: float
    predicted: bool = False


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

    def __init__(self, scene: TuningScene, lights: str) -> None:
        self.scene, self.lights = scene, lights
        count = len(scene)
        self._frames = [scene.scene.frame(round(i * (count - 1) / max(FRAMES - 1, 1))) for i in range(FRAMES)]

    def times(
        self, configurations: Sequence[Configuration], repeats: int, *, most_seconds: float | None = None
    ) -> list[FrameTime]:
        """Times of configurations in turns with the default.

        Args:
            configurations: each.
            repeats: frames of each, after as many that warm up as there are frames.
            most_seconds: begin no further round after so long a time, if each has run ten times by then.
        """
        calls = {str(number): self._call(each) for number, each in enumerate(configurations)}
        calls[DEFAULT] = self._call(Configuration())
        for call in calls.values():
            for _ in self._frames:  # what shines is composed by a program of its own, in some frames only
                call()
        rounds = {
            name: 1e3 * np.array(seconds) for name, seconds in rounds_of(calls, repeats, most_seconds).items()
        }
        default = rounds[DEFAULT]
        return [
            FrameTime(
                float(np.median(own)),
                float(np.percentile(own, 95)),
                float(np.median(default)),
                float(np.median(own / default)),
            )
            for own in (rounds[str(number)] for number in range(len(configurations)))
        ]

    def _call(self, configuration: Configuration) -> Callable[[], Any]:
        relighter, frames = self.scene.relighter(self.lights, configuration), itertools.cycle(self._frames)
        return lambda: np.asarray(to_display_bytes(relighter.picture(next(frames))))


def rounds_of(
    calls: Mapping[str, Callable[[], Any]], repeats: int, most_seconds: float | None = None
) -> dict[str, list[float]]:
    """Seconds of each call in each round, A B C A B C ...; arguments as of `FrameClock.times`."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    total = Stopwatch()
    for count in range(repeats):
        if most_seconds is not None and count >= FEWEST_ROUNDS and total.seconds > most_seconds:
            break
        for name, call in calls.items():
            watch = Stopwatch()
            call()
            seconds[name].append(watch.seconds)
    return seconds


def slowest_setup(scene: TuningScene, lights: Sequence[str]) -> str:
    """The set-up under which the default configuration takes longest."""
    if len(lights) == 1:
        return lights[0]
    return max(lights, key=lambda name: FrameClock(scene, name).times([Configuration()], 10)[0].default)
