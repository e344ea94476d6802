"""Points of the surface that the cameras of a capture see, and the illuminance of lights on them."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, RectLight, SkyLight
from hyjax.scene.point_lux import point_lux
from hyjax.util.errors import InputError
from hyjax.util.vectors import unit

OFFSET = 0.02
"""Distance from the surface, in metres, where rays to lights start."""
FAR = 1000.0
"""Distance, in metres, beyond which nothing stands before the sky."""


@dataclasses.dataclass(frozen=True)
class SeenSurface:
    """Points of the visible surface, evenly spread over the cameras' pictures.

    Attributes:
        caster: the surface.
        points: in world coordinates.
        normals: unit, towards the cameras.
        camera: which camera sees each; in rising order.
        face: triangle that each lies on.
    """

    caster: RayCaster
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    camera: Int[np.ndarray, "n"]
    face: Int[np.ndarray, "n"]

    @classmethod
    def of(
        cls, caster: RayCaster, cameras: Sequence[Camera], most: int = 8
    ) -> "tuple[SeenSurface, Float[np.ndarray, 'c 3']]":
        """Surface seen by at most `most` of the cameras, and the positions of these cameras."""
        chosen, points, normals, faces = spread(cameras, most), [], [], []
        for camera in chosen:
            small = camera.intrinsics.resize(24, 32)
            rays = Camera(small, camera.pose).rays().reshape(-1, 3)
            hits = caster.cast(camera.origin, rays)
            points.append(camera.origin + rays[hits.hit] * hits.distance[hits.hit, None])
            normal = caster.arrays.face_normals[hits.face[hits.hit]]
            away = np.einsum("nk,nk->n", normal, rays[hits.hit]) > 0
            normals.append(np.where(away[:, None], -normal, normal))
            faces.append(hits.face[hits.hit])
        surface = np.concatenate(points)
        if not len(surface):
            raise InputError(
                "no camera sees the mesh; are the mesh and the poses in the same coordinates (metres)?"
            )
        numbers = np.repeat(np.arange(len(chosen)), [len(seen) for seen in points])
        seen = cls(caster, surface, np.concatenate(normals), numbers, np.concatenate(faces))
        return seen, np.stack([c.origin for c in chosen])

    def chosen(self, which: Bool[np.ndarray, "n"]) -> "SeenSurface":
        """Some of the points."""
        parts = (array[which] for array in (self.points, self.normals, self.camera, self.face))
        return SeenSurface(self.caster, *parts)

    def of_vertices(self, values: Float[np.ndarray, "v c"]) -> Float[np.ndarray, "n c"]:
        """Values of the vertices at the points: the mean of each triangle's corners."""
        return values[self.caster.arrays.faces[self.face]].mean(axis=1)

    def of_cameras(self, values: Float[np.ndarray, "n"], quantile: float = 0.5) -> Float[np.ndarray, "c"]:
        """Quantile of values at the points that each camera sees, of the cameras that see any."""
        if not len(values):
            return np.zeros(0)
        parts = np.split(values, np.flatnonzero(np.diff(self.camera)) + 1)
        return np.array([_quantile(part, quantile) for part in parts])

    def reached_through(self, window: Aperture, travel: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "n"]:
        """Points that parallel light along `travel` reaches through a window."""
        center, right, up = (np.asarray(v, float) for v in (window.center, window.right, window.up))
        normal = np.cross(right, up)
        t = ((self.points - center) @ normal) / (travel @ normal)
        offset = self.points - t[:, None] * travel - center
        inside = (np.abs(offset @ right) <= right @ right) & (np.abs(offset @ up) <= up @ up)
        lit = (t > 0) & inside & (self.normals @ travel < -0.05)
        lit[lit] = ~self.chosen(lit)._blocked(-travel[None] * np.maximum(t[lit] - OFFSET, 0.0)[:, None])
        return lit

    def reached_along(self, travel: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "n"]:
        """Points that parallel light along `travel` reaches from anywhere."""
        lit = self.normals @ travel < -0.05
        lit[lit] = self.chosen(lit)._open(-travel)
        return lit

    def under_open_sky(self, up: Float[np.ndarray, "3"]) -> float:
        """Share of the points that have nothing above them."""
        return float(self._open(up).mean())

    def lux(self, lights: Sequence[Light]) -> Float[np.ndarray, "n l"]:
        """Illuminance of lights on the points, with shadows; times the strongest channels of their colours."""
        lux = np.zeros((len(self.points), len(lights)), np.float32)
        for number, light in enumerate(lights):
            strongest = float(np.asarray(light.color).max())
            share = self._sky_share(light) if isinstance(light, SkyLight) else self._reached(light)
            free = share > 0
            lit = point_lux(self.points[free], self.normals[free], [light])[:, 0]
            lux[free, number] = lit * share[free] * strongest
        return lux

    def _sky_share(self, sky: SkyLight) -> Float[np.ndarray, "n"]:
        """Share of a sky's light that reaches each point."""
        free = given = np.zeros(len(self.points))
        for travel in sky.shadow_views().directions:
            cosine = np.maximum(self.normals @ -travel, 0.0)
            given = given + cosine
            free = free + np.where(self.reached_along(travel), cosine, 0.0)
        return free / np.maximum(given, 1e-9)

    def _reached(self, light: Light) -> Bool[np.ndarray, "n"]:
        if isinstance(light, DirectionalLight) and light.aperture is not None:
            return self.reached_through(light.aperture, np.asarray(light.direction, float))
        if isinstance(light, DirectionalLight):
            return self.reached_along(unit(np.asarray(light.direction, float)))
        if isinstance(light, PointLight):
            to = np.asarray(light.position, float) - self.points
            length = np.linalg.norm(to, axis=1, keepdims=True)
            clear = float(light.clearance) + float(light.radius)
            return ~self._blocked(to * np.maximum(1.0 - clear / np.maximum(length, 1e-6), 0.0))
        if isinstance(light, RectLight):
            return ~self._blocked(0.97 * (np.asarray(light.center, float) - self.points))
        return np.ones(len(self.points), bool)

    def _open(self, toward: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "n"]:
        """Whether nothing stands before the points in a direction."""
        return ~self._blocked(np.tile(FAR * toward, (len(self.points), 1)))

    def _blocked(self, to: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        return self.caster.occluded(self.points + OFFSET * self.normals, to, 1.0)


def _quantile(values: Float[np.ndarray, "n"], quantile: float) -> Any:
    """`numpy.quantile` to the last digit, in a tenth of its time for a few hundred values; not for NaN."""
    low, share = divmod(quantile * (len(values) - 1), 1.0)
    places = int(low), min(int(low) + 1, len(values) - 1)
    lower, upper = np.partition(values, places)[list(places)]
    step = upper - lower
    return upper - step * (1.0 - share) if share >= 0.5 else lower + step * share
