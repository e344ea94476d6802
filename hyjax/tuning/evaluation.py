"""Quality of configurations on frames with known pictures, and as tasks of plain data."""

import dataclasses
import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from hyjax.configuration import Configuration
from hyjax.light.emission import Emission
from hyjax.scene.relighter import LitFrame, refined_picture
from hyjax.tuning.clock import FrameClock
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.scene import TuningScene, open_tuning_scene

FrameCase = tuple[int, str, int]
"""Scene by position, light set-up, frame."""
Scores = dict[str, float]
TIMED_FRAMES = 60
LIGHT_MULTIPLE = 4
"""Frames are padded to a multiple of so many lights, see `padded`."""
KEPT_SCENES = 8


class Scorer(Protocol):
    """Scores of configurations on cases."""

    def scores(self, configuration: Configuration, cases: Sequence[Any]) -> list[Scores]:
        """Scores of each case, in their order."""
        ...


class Judge:
    """Scores of configurations on cases."""

    def __init__(self, scenes: Sequence[TuningScene], loss: PictureLoss) -> None:
        self.scenes, self.loss = scenes, loss

    def scores(self, configuration: Configuration, cases: Sequence[FrameCase]) -> list[Scores]:
        found: dict[FrameCase, Scores] = {}
        most = max(len(self.scenes[place].setup(lights).lights) for place, lights, _ in cases)
        most = -(-most // LIGHT_MULTIPLE) * LIGHT_MULTIPLE
        for place, lights in dict.fromkeys((case[0], case[1]) for case in cases):
            scene = self.scenes[place]
            relighter = scene.relighter(lights, scene.judged(configuration))
            for case in cases:
                if case[:2] == (place, lights) and case not in found:
                    lit = padded(relighter.lit(case[2]), most)
                    image = np.asarray(refined_picture(lit, relighter.configuration))
                    found[case] = self.loss.scores(image, scene.target(lights, case[2]))
        return [found[case] for case in cases]


def mean_scores(rows: Sequence[Mapping[str, float]]) -> Scores:
    """Mean of each score."""
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def evaluate(payload: Mapping[str, Any]) -> Scores:
    """Mean scores of a configuration, as a task of plain data.

    Args:
        payload: `scene`, `size` and `seed` (see `open_tuning_scene`), `lights`, `configuration` (as JSON's types),
            `frames`.
    """
    scene, configuration = _opened(payload)
    cases = [(0, payload["lights"], int(index)) for index in payload["frames"]]
    return mean_scores(Judge([scene], PictureLoss()).scores(configuration, cases))


def time_frames(payload: Mapping[str, Any]) -> Scores:
    """Milliseconds of a whole frame, as a task of plain data: the same payload as of `evaluate`."""
    scene, configuration = _opened(payload)
    (time,) = FrameClock(scene, payload["lights"]).times([configuration], TIMED_FRAMES, most_seconds=30)
    return {"median_ms": time.median, "p95_ms": time.p95, "default_ms": time.default}


def _opened(payload: Mapping[str, Any]) -> tuple[TuningScene, Configuration]:
    configuration = Configuration.from_json(json.dumps(payload["configuration"]))
    return _scene(payload["scene"], payload.get("size"), payload.get("seed", 0)), configuration


_scene = functools.lru_cache(maxsize=KEPT_SCENES)(open_tuning_scene)


def padded(lit: LitFrame, most: int) -> LitFrame:
    """A frame with lights that give nothing, up to so many, and with pixels that may shine.

    Its picture is the same. Compiling a cascade for each number of lights would take longer than running it.
    """
    shaded, view = lit.shaded, lit.view
    more, emission = most - shaded.illuminance.shape[-1], shaded.emission
    beside = ((0, 0), (0, 0), (0, more))
    if emission is None and shaded.photo_light is not None:
        none = jnp.zeros_like(view.source_frame())
        emission = Emission(none[..., :1], none, none, none)
    shaded = dataclasses.replace(
        shaded,
        illuminance=jnp.pad(shaded.illuminance, beside),
        visibility=jnp.pad(shaded.visibility, beside, constant_values=1.0),
        colors=jnp.pad(shaded.colors, ((0, more), (0, 0))),
        emission=emission,
    )
    return dataclasses.replace(lit, shaded=shaded)
