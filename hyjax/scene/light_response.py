"""Response of a place to a light set-up, as far as its exposure needs it: bounces, and the photo's own light."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from hyjax.light.kinds import DirectionalLight, Light
from hyjax.light.photo_light import FILLED_SHARE, LEAST_PHOTO_LIGHT, PhotoLight
from hyjax.light.transport import bounce
from hyjax.scene.seen_surface import SeenSurface
from hyjax.util.programs import run_kept

REFLECTED_SHARE = 0.3
"""Ratio of bounced light to the mean direct light."""
BOUNCE_RAY_STEP = 8
"""Step between the rays of a point that are followed for an exposure: a median needs few."""


@dataclasses.dataclass(frozen=True)
class Response:
    """Response of a place to a set-up at the points of its seen surface.

    Attributes:
        photo_light: light of the photo over its mean.
        near, parallel: bounced illuminance, in lux, of the lights near by and of the parallel ones, see `kinds_of`.
        filled_share: of ambient light that bounces are filled up to.
        brightness: median linear value of the photos; 1 where it is not known.
        measured: whether the light is that of the place's own estimate.
        photo_value: linear value of the photos' strongest channel; None where it is not known.
    """

    photo_light: Float[np.ndarray, "n"]
    near: Float[np.ndarray, "n"]
    parallel: Float[np.ndarray, "n"]
    filled_share: float
    brightness: float = 1.0
    measured: bool = True
    photo_value: Float[np.ndarray, "n"] | None = None


def kinds_of(lights: Sequence[Light]) -> tuple[Bool[np.ndarray, "l"], Bool[np.ndarray, "l"]]:
    """Masks of the lights near by, and of the parallel ones."""
    parallel = np.array([isinstance(light, DirectionalLight) for light in lights])
    return np.array([not light.UNIFORM for light in lights]) & ~parallel, parallel


def paleness(lights: Sequence[Light]) -> Float[np.ndarray, "l"]:
    """Mean of each light's colour over its strongest channel."""
    colors = [np.asarray(light.color) for light in lights]  # as JAX's, each operation would be a program of its own
    return np.array([color.mean() / color.max() for color in colors])


def assumed_response(lights: Sequence[Light], lux: Float[np.ndarray, "n l"], seen: SeenSurface) -> Response:
    """Response of a place of which nothing is known: an evenly lit photo, bounces in proportion."""
    bounced = []
    for chosen in kinds_of(lights):
        bright, mean = (lux * paleness(lights))[:, chosen].sum(axis=1), np.zeros(len(lux))
        for camera in np.unique(seen.camera):
            mean[seen.camera == camera] = REFLECTED_SHARE * bright[seen.camera == camera].mean()
        bounced.append(mean)
    near, parallel = bounced
    return Response(np.ones(len(lux)), near, parallel, FILLED_SHARE, measured=False)


def measured_response(lights: Sequence[Light], seen: SeenSurface, photo: PhotoLight) -> Response:
    """Response of a place whose photo's light was estimated, by its own bounces."""
    whole, albedo = photo.transport, np.asarray(photo.albedo).mean(axis=1, keepdims=True)
    position, normal = np.asarray(whole.position, float), np.asarray(whole.normal, float)
    nowhere = np.zeros(len(position), int)
    lux = SeenSurface(seen.caster, position, normal, nowhere, nowhere).lux(lights) * paleness(lights)
    direct = np.stack([lux[:, chosen].sum(axis=1) for chosen in kinds_of(lights)] + [np.zeros(len(lux))], axis=1)
    hits: Any = np.asarray(whole.hits)[::BOUNCE_RAY_STEP]
    transport = dataclasses.replace(whole, hits=hits)
    arrays = (jax.device_put(np.asarray(a, np.float32)) for a in (np.tile(albedo, 3), direct))
    bounced = seen.of_vertices(np.asarray(run_kept(bounce, transport, *arrays))[: whole.vertices])
    light = np.maximum(np.asarray(photo.illuminance), LEAST_PHOTO_LIGHT)
    pictured = seen.of_vertices(light * np.asarray(photo.albedo)[: whole.vertices] * np.asarray(photo.mean))
    even = np.exp(seen.of_vertices(np.log(light).mean(axis=1, keepdims=True))[:, 0])
    brightness = float(np.median(pictured.mean(axis=1)))
    value = pictured.max(axis=1)
    return Response(even, bounced[:, 0], bounced[:, 1], photo.filled_share, brightness, photo_value=value)
