"""Exposure of named set-ups, by the illuminance of their lights on the visible surface."""

import dataclasses
import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, RectLight
from hyjax.light.setup import LightSetup
from hyjax.scene.point_lux import point_lux
from hyjax.util.errors import InputError

LARGEST_FILTER, LARGEST_FILTER_IN_SUN = 1.6, 3.5
"""Largest filter on all but a twentieth of the surface, without the sun and with it."""
REFLECTED_SHARE = 0.3
"""Ratio of bounced light to the mean direct light."""
DIMMINGS = 4
"""Number of times that sun and exposure are brought in line with each other."""
OFFSET = 0.02
"""Distance from the surface, in metres, where rays to lights start."""
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Exposure:
    """Exposure of a set-up.

    Attributes:
        share: of its brightness that the median picture keeps, in linear light.
        ambient: illuminance of ambient lights over the reference; bounces are filled up to a share of it.
        sun: most of parallel light over the reference, where it falls on a surface that is seen.
    """

    share: float
    ambient: float
    sun: float


@dataclasses.dataclass(frozen=True)
class SeenSurface:
    """Points of the visible surface, evenly spread over the cameras' pictures.

    Attributes:
        caster: the surface.
        points: in world coordinates.
        normals: unit, towards the cameras.
        camera: which camera sees each.
    """

    caster: RayCaster
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    camera: Int[np.ndarray, "n"]

    @classmethod
    def of(
        cls, caster: RayCaster, cameras: Sequence[Camera], most: int = 8
    ) -> "tuple[SeenSurface, Float[np.ndarray, 'c 3']]":
        """Surface seen by at most `most` of the cameras, and the positions of these cameras.

        Raises:
            InputError: no camera sees any surface.
        """
        chosen, points, normals = spread(cameras, most), [], []
        for camera in chosen:
            small = camera.intrinsics.resize(24, 32)
            rays = Camera(small, camera.pose).rays().reshape(-1, 3)
            hits = caster.cast(camera.origin, rays)
            points.append(camera.origin + rays[hits.hit] * hits.distance[hits.hit, None])
            normal = caster.arrays.face_normals[hits.face[hits.hit]]
            away = np.einsum("nk,nk->n", normal, rays[hits.hit]) > 0
            normals.append(np.where(away[:, None], -normal, normal))
        surface = np.concatenate(points)
        if not len(surface):
            raise InputError(
                "no camera sees the mesh; are the mesh and the poses in the same coordinates (metres)?"
            )
        numbers = np.repeat(np.arange(len(chosen)), [len(seen) for seen in points])
        return cls(caster, surface, np.concatenate(normals), numbers), np.stack([c.origin for c in chosen])

    def chosen(self, which: Bool[np.ndarray, "n"]) -> "SeenSurface":
        """Some of the points."""
        return SeenSurface(self.caster, self.points[which], self.normals[which], self.camera[which])

    def of_cameras(self, values: Float[np.ndarray, "n"], quantile: float = 0.5) -> Float[np.ndarray, "c"]:
        """Quantile of values at the points that each camera sees, of the cameras that see any."""
        return np.array([np.quantile(values[self.camera == c], quantile) for c in np.unique(self.camera)])

    def reached_through(self, window: Aperture, travel: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "n"]:
        """Points that parallel light along `travel` reaches through a window."""
        center, right, up = (np.asarray(v, float) for v in (window.center, window.right, window.up))
        normal = np.cross(right, up)
        t = ((self.points - center) @ normal) / (travel @ normal)
        offset = self.points - t[:, None] * travel - center
        inside = (np.abs(offset @ right) <= right @ right) & (np.abs(offset @ up) <= up @ up)
        lit = (t > 0) & inside & (self.normals @ travel < -0.05)
        lit[lit] = ~self._blocked(lit, -travel[None] * np.maximum(t[lit] - OFFSET, 0.0)[:, None])
        return lit

    def lux(self, lights: Sequence[Light]) -> Float[np.ndarray, "n l"]:
        """Illuminance of lights on the points, with shadows; times the strongest channels of their colours."""
        lux = point_lux(self.points, self.normals, lights)
        return np.stack([self._reached(light, lux[:, number]) for number, light in enumerate(lights)], axis=-1)

    def _reached(self, light: Light, lux: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        every = np.ones(len(self.points), bool)
        if isinstance(light, DirectionalLight) and light.aperture is not None:
            free = self.reached_through(light.aperture, np.asarray(light.direction, float))
        elif isinstance(light, PointLight):
            to = np.asarray(light.position, float) - self.points
            length = np.linalg.norm(to, axis=1, keepdims=True)
            clear = float(light.clearance) + float(light.radius)
            free = ~self._blocked(every, to * np.maximum(1.0 - clear / np.maximum(length, 1e-6), 0.0))
        elif isinstance(light, RectLight):
            free = ~self._blocked(every, 0.97 * (np.asarray(light.center, float) - self.points))
        else:
            free = every
        return np.where(free, lux, 0.0) * float(np.asarray(light.color).max())

    def _blocked(self, chosen: Bool[np.ndarray, "n"], to: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, "m"]:
        start = self.points[chosen] + OFFSET * self.normals[chosen]
        return self.caster.occluded(start, to, 1.0)


def exposed(setup: LightSetup, lux: Float[np.ndarray, "n l"], seen: SeenSurface, exposure: Exposure) -> LightSetup:
    """Set-up with the reference illuminance, and the ambient light, of an exposure.

    Dimmer where lights would burn the pictures out.

    Args:
        setup: lights.
        lux: of each light on the visible surface.
        seen: visible surface.
        exposure: of the set-up.
    """
    parallel = np.array([isinstance(light, DirectionalLight) for light in setup.lights])
    near = np.array([not light.UNIFORM for light in setup.lights]) & ~parallel
    sun, reference = np.ones(len(setup.lights)), 0.0
    strengths = [float(getattr(light, light.STRENGTH)) for light in setup.lights]
    pale = np.array([np.mean(light.color) / np.max(light.color) for light in setup.lights])
    brightest = np.array(
        [np.quantile(column[column > 0], 0.9) if (column > 0).any() else np.inf for column in lux.T]
    )
    for _ in range(DIMMINGS):
        shade, light = lux[:, near].sum(axis=1), (lux * sun)[:, near | parallel].sum(axis=1)
        bright, bounced = (lux * sun * pale)[:, near | parallel].sum(axis=1), np.zeros(len(light))
        for camera in np.unique(seen.camera):
            bounced[seen.camera == camera] = REFLECTED_SHARE * bright[seen.camera == camera].mean()
        bounds = [(shade, LARGEST_FILTER), (light, LARGEST_FILTER_IN_SUN)]
        least = max(float(np.quantile(values + bounced, 0.95)) / most for values, most in bounds)
        reference = max(float(np.median(seen.of_cameras(bright + bounced))) / exposure.share, least, 1e-3)
        sun = np.where(parallel, np.minimum(1.0, exposure.sun * reference / brightest), 1.0)

    # Ambient light fills bounces up, to a share of the reference that depends on nothing else.
    lights: list[Any] = list(setup.lights)
    for number, light in enumerate(lights):
        strength = exposure.ambient * reference if light.UNIFORM else sun[number] * strengths[number]
        lights[number] = dataclasses.replace(light, **{light.STRENGTH: float(strength)})
    return LightSetup(tuple(lights), reference)


def warn_of_missing(setup: LightSetup, lux: Float[np.ndarray, "n l"], name: str) -> None:
    """Warn of lights of a set-up that reach no visible surface."""
    for number, light in enumerate(setup.lights):
        if not light.UNIFORM and float(lux[:, number].max()) <= 0:
            kind = type(light).__name__
            _log.warning("%s: light %d (%s) reaches no surface that the cameras see", name, number, kind)
