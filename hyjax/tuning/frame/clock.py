"""Clock of whole frames: configurations timed in turns with the default one."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hyjax.configuration import Configuration
from hyjax.light.color import to_display_bytes
from hyjax.tuning.frame.scene import TuningScene
from hyjax.util.clock import measure_each

FRAMES = 6
DEFAULT = "default"


@dataclasses.dataclass(frozen=True)
class FrameTime:
    """How long a whole frame takes.

    Attributes:
        median, p95: milliseconds.
        default: median of the default configuration, in turns with it.
    """

    median: float
    p95: float
    default: float

    @property
    def ratio(self) -> float:
        """Median over the default's: other work on the machine changes it less than the median."""
        return self.median / self.default


class FrameClock:
    """Times of whole frames, from the picture in memory to the relit picture's bytes, one after the other.

    G-buffer, light, guide, both cascades, composite and bytes count; reading, and what there is once a scene, does
    not.

    Args:
        scene: whose frames they are.
        lights: the set-up.
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
            most_seconds: see `hyjax.util.clock.measure_each`.
        """
        calls = {str(number): self._call(each) for number, each in enumerate(configurations)}
        calls[DEFAULT] = self._call(Configuration())
        for call in calls.values():
            for _ in self._frames:  # what shines is composed by a program of its own, in some frames only
                call()
        found = measure_each(calls, repeats, most_seconds=most_seconds)
        default = found[DEFAULT]["median_ms"]
        return [
            FrameTime(found[str(n)]["median_ms"], found[str(n)]["p95_ms"], default)
            for n in range(len(configurations))
        ]

    def _call(self, configuration: Configuration) -> Callable[[], Any]:
        relighter, frames = self.scene.relighter(self.lights, configuration), itertools.cycle(self._frames)
        return lambda: np.asarray(to_display_bytes(relighter.picture(0, next(frames))))


def slowest_setup(scene: TuningScene, lights: Sequence[str]) -> str:
    """The set-up under which the default configuration takes longest."""
    if len(lights) == 1:
        return lights[0]
    return max(lights, key=lambda name: FrameClock(scene, name).times([Configuration()], 10)[0].default)
