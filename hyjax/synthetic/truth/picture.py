"""Pictures of a room under any light by the built-in room's camera."""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.geometry.raycast import Hits, RayCaster
from hyjax.light.kinds import Light
from hyjax.light.kinds.emitter import Emitter
from hyjax.synthetic.room.lightmap import Texels, at_hits
from hyjax.synthetic.room.render import Lit, Paints, garden
from hyjax.synthetic.surface import Surface, rows
from hyjax.synthetic.truth.opening import Opening, Radiance, leaving
from hyjax.synthetic.truth.source import OFFSET, direct
from hyjax.synthetic.truth.transport import Maps
from hyjax.util.vectors import unit

PANEL_DEPTH = 0.03
"""Largest depth, in metres, of shining surfaces behind a panel light's rectangle."""


@dataclasses.dataclass(frozen=True)
class Bulb:
    """Bulb: a lamp's ball of glass, which shines when a point light is lit inside it."""

    centre: Float[np.ndarray, "3"]
    radius: float


@dataclasses.dataclass(frozen=True)
class LitPicture(Lit):
    """Room under baked light, with hard light traced to every pixel.

    Attributes:
        hard, soft: lights whose shadows are traced, and rectangles.
        bulbs: lamps that shine if they are lit.
        panes: factor of the view's texture in each window.
        sky: radiance through the windows in mirror images.
        leaf: material of the leaves outside.
        turn: generator of the samples' shifts.
    """

    texels: Texels
    maps: Maps
    hard: list[Light]
    soft: list[Light]
    openings: list[Opening]
    bulbs: list[Bulb]
    panes: Float[np.ndarray, "w 3"]
    sky: Radiance
    leaf: int
    turn: np.random.Generator

    def irradiance(
        self, origin: np.ndarray, rays: np.ndarray, nearest: Hits, st: np.ndarray, samples: int
    ) -> Float[np.ndarray, "n 3"]:
        chart = rows(self.surface.chart, nearest.face)
        smooth = self.maps.soft + self.maps.bounce
        if not samples or not self.hard:
            return self.texels.lookup(smooth + self.maps.hard, chart, st)
        light = self.texels.lookup(smooth, chart, st)
        position, normal, start = smooth_places(self.surface, self.caster, nearest)
        for source in self.hard:
            shift = self.turn.random((len(position), 2))
            light += direct(source, self.caster, position, normal, samples, shift, start)
        return light

    def emitted(self, origin: np.ndarray, rays: np.ndarray, nearest: Hits) -> Float[np.ndarray, "n 3"] | None:
        lamps = [*self._lit_bulbs(), *((light, None) for light in self.soft)]
        if not lamps:
            return None
        position = origin + rays * nearest.distance[:, None]
        normal = rows(self.surface.mesh.face_normals, nearest.face)
        total = np.zeros((len(rays), 3), np.float32)
        for light, bulb in lamps:
            emitter = light.emitter()
            assert emitter is not None
            if bulb is None:
                where, radiance = _on_panel(position, normal, emitter)
            else:
                where, radiance = _on_bulb(position, normal, emitter, bulb)
            total[where] += np.asarray(light.color, np.float32) * np.float32(radiance)
        return total

    def _lit_bulbs(self) -> list[tuple[Light, Bulb | None]]:
        """Point lights with their bulbs."""
        points = [
            (light, e.position) for light in self.hard if (e := light.emitter()) is not None and e.kind == "point"
        ]
        return [
            (light, bulb)
            for light, position in points
            for bulb in self.bulbs
            if np.linalg.norm(position - bulb.centre) < bulb.radius
        ]

    def outside(self, origin: np.ndarray, rays: np.ndarray) -> Float[np.ndarray, "n 3"]:
        def view(k: int, direction: np.ndarray) -> np.ndarray:
            return garden(self.textures, self.openings[k].to_sky(direction), self.leaf) * self.panes[k]

        return self._through_openings(origin, unit(rays), view)

    def mirrored_outside(self, origin: np.ndarray, rays: np.ndarray) -> Float[np.ndarray, "n 3"]:
        return self._through_openings(origin, unit(rays).astype(np.float32), self.sky)

    def _through_openings(self, origin: np.ndarray, direction: np.ndarray, radiance: Radiance) -> np.ndarray:
        total = np.zeros((len(direction), 3), np.float32)
        through = leaving(self.openings, origin, direction)
        for k in np.unique(through[through >= 0]):
            total[through == k] = radiance(k, direction[through == k])
        return total


def mean_garden(textures: Paints, leaf: int) -> Float[np.ndarray, "3"]:
    """Mean of the view's texture over its visible part."""
    azimuth, height = np.meshgrid(np.linspace(-1.0, 1.0, 64), np.linspace(-0.45, 0.45, 48))
    rays = np.stack([-np.cos(azimuth), np.sin(azimuth), height], axis=-1).reshape(-1, 3)
    return garden(textures, rays, leaf).mean(axis=0)


def smooth_places(
    surface: Surface, caster: RayCaster, hits: Hits
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Positions and smooth normals at hits, and the starts of shadow rays there.

    Rays start on the round surface that the triangles approximate, so that these cast no shadow on themselves
    (Hanika, "Hacking the shadow terminator", Ray Tracing Gems II, 2021).
    """
    corners = np.asarray(surface.mesh.vertices)[np.asarray(surface.mesh.faces)[hits.face]]
    around = np.asarray(surface.mesh.vertex_normals)[np.asarray(surface.mesh.faces)[hits.face]]
    position = np.einsum("nk,nkd->nd", hits.barycentric, corners)
    normal = caster.interpolated_normals(hits)
    below = np.minimum(np.einsum("nkd,nkd->nk", position[:, None] - corners, around), 0)
    lift = np.einsum("nk,nk,nkd->nd", hits.barycentric, below, around)
    return position, normal, position - lift + OFFSET * normal


def texel_light(texels: Texels, values: Float[np.ndarray, "t 3"], surface: Surface, hits: Hits) -> np.ndarray:
    """Look up a light map at hits, all of which must have hit."""
    return texels.lookup(values, rows(surface.chart, hits.face), at_hits(surface.st, hits))


def _on_panel(position: np.ndarray, normal: np.ndarray, emitter: Emitter) -> tuple[np.ndarray, float]:
    """Mask of places on the panel behind a rectangle light, and its radiance."""
    right, up = np.asarray(emitter.right), np.asarray(emitter.up)
    across = np.cross(right, up)
    axis = unit(across)
    at = position - emitter.position
    where = (np.abs(at @ axis + PANEL_DEPTH / 2) < PANEL_DEPTH / 2 + 2e-3) & (normal @ axis > 0.95)
    for side in (right, up):
        where &= np.abs(at @ side) <= side @ side
    return where, emitter.strength / (4 * float(np.linalg.norm(across)) * np.pi)


def _on_bulb(position: np.ndarray, normal: np.ndarray, emitter: Emitter, bulb: Bulb) -> tuple[np.ndarray, float]:
    """Mask of places on a bulb, and its radiance."""
    out = position - bulb.centre
    distance = np.linalg.norm(out, axis=1)
    where = (distance < 1.1 * bulb.radius) & (np.einsum("nk,nk->n", out, normal) > 0.7 * distance)
    return where, emitter.strength / (2 * np.pi * bulb.radius) ** 2
