"""Exposure of named set-ups: what their lights throw on the surface that the cameras see."""

import dataclasses
import logging
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, RectLight
from hyjax.light.setup import LightSetup
from hyjax.light.shading import shade_each
from hyjax.util.errors import InputError

BRIGHTEST, BRIGHTEST_IN_SUN = 1.5, 3.0
"""Filter that all but a twentieth of the surface stays below, without the sun and with it."""
OFFSET = 0.02
"""Metres off the surface at which rays to lights start."""
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class SeenSurface:
    """Points of the surface that cameras see, evenly spread over their pictures.

    Attributes:
        caster: the surface.
        points: in world coordinates.
        normals: unit, towards the cameras.
    """

    caster: RayCaster
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]

    @classmethod
    def of(cls, caster: RayCaster, cameras: Sequence[Camera]) -> "tuple[SeenSurface, Float[np.ndarray, '3']]":
        """What at most eight of the cameras see, and their mean position.

        Raises:
            InputError: no camera sees any surface.
        """
        chosen, points, normals = spread(cameras, 8), [], []
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
        return cls(caster, surface, np.concatenate(normals)), np.mean([c.origin for c in chosen], axis=0)

    def sunlit(self, window: Aperture, travel: Float[np.ndarray, "3"]) -> float:
        """Share of the points that parallel light along `travel` reaches through a window."""
        return float(self.reached_through(window, travel).mean())

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
        every = np.ones((1, len(self.points)), bool)
        place, facing = (np.asarray(each[None], np.float32) for each in (self.points, self.normals))
        points = GBuffer(*map(jax.device_put, (place, facing, every.astype(np.float32), every)))
        lux = np.asarray(shade_each(points, tuple(lights)))[0]
        return np.stack([self._reached(light, lux[:, k]) for k, light in enumerate(lights)], axis=-1)

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


def exposed(setup: LightSetup, lux: Float[np.ndarray, "n l"]) -> float:
    """Reference illuminance of a set-up: its own, or more where its lights would burn the pictures out.

    Args:
        setup: lights with their usual reference.
        lux: of each light on what is seen.
    """
    shaded = [not isinstance(light, DirectionalLight) for light in setup.lights]
    shade, every = lux[:, shaded].sum(axis=1), lux.sum(axis=1)
    least = [np.quantile(each, 0.95) / most for each, most in ((shade, BRIGHTEST), (every, BRIGHTEST_IN_SUN))]
    return max(float(setup.reference_lux), *map(float, least))


def warn_of_missing(setup: LightSetup, lux: Float[np.ndarray, "n l"], name: str) -> None:
    """Say so where a light of a set-up reaches nothing that the cameras see."""
    for number, light in enumerate(setup.lights):
        if not light.UNIFORM and float(lux[:, number].max()) <= 0:
            kind = type(light).__name__
            _log.warning("%s: light %d (%s) reaches no surface that the cameras see", name, number, kind)
