"""Illuminance of lights on points of a surface."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.shading import shade_each
from hyjax.util.programs import run_kept

POINTS_AT_ONCE = 4096
"""Number of points that are shaded at a time: a program for each kind of light, however many points there are."""


def point_lux(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], lights: Sequence[Light]
) -> Float[np.ndarray, "n l"]:
    """Lux of each light on points, without shadows and before its colour."""
    lux = np.zeros((len(points), len(lights)), np.float32)
    every = np.ones((1, POINTS_AT_ONCE), bool)
    confidence, hit = jax.device_put((every.astype(np.float32), every))
    for start in range(0, len(points), POINTS_AT_ONCE):
        part = slice(start, start + POINTS_AT_ONCE)
        missing = POINTS_AT_ONCE - len(points[part])
        place, facing = (
            np.pad(np.asarray(vectors[part], np.float32), [(0, missing), (0, 0)], mode="edge")[None]
            for vectors in (points, normals)
        )
        block = GBuffer(jax.device_put(place), jax.device_put(facing), confidence, hit)
        for number, light in enumerate(lights):
            lux[part, number] = np.asarray(run_kept(shade_each, block, (light,)))[0, : len(points[part]), 0]
    return lux
