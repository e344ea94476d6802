"""Shadow maps that follow a changing surface: only texels whose rays pass where it has changed are cast again.

Texels are looked at in tiles: the rays of a tile lie in a cone (or, where they are parallel, in a cylinder), which
is compared with spheres around the changes.
"""

import dataclasses
from collections.abc import Hashable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout, TexelRays
from hyjax.light.kinds import Light
from hyjax.light.kinds.shadow_views import ShadowViews
from hyjax.light.shadow_map import ShadowMap

TILE = 16
"""Texels a side."""
MOST_SPHERES = 400
"""Beyond so many they are joined into larger ones."""
MOST_MAPS = 24
"""Lights, at each resolution, whose maps are kept."""
HISTORY = 64
"""Renewals that are remembered; a map that has missed more is cast as a whole."""


@dataclasses.dataclass(frozen=True, eq=False)
class Spheres:
    """Places where a surface has changed: each triangle that came or went lies in one of the spheres.

    Attributes:
        centres: metres.
        radius: metres.
    """

    centres: Float[np.ndarray, "b 3"]
    radius: float

    def joined(self, other: "Spheres") -> "Spheres":
        """Both."""
        centres = np.unique(np.concatenate([self.centres, other.centres]), axis=0)
        return Spheres(centres, max(self.radius, other.radius))

    def few(self, most: int = MOST_SPHERES) -> "Spheres":
        """The same places in no more than so many spheres, larger ones if need be."""
        spheres = self
        while len(spheres.centres) > most:
            edge = 2.0 * spheres.radius
            cells = (np.floor(spheres.centres / edge) + 0.5) * edge
            grown = spheres.radius + 0.5 * float(np.sqrt(3.0)) * edge
            spheres = Spheres(np.unique(cells, axis=0), grown)
        return spheres


@dataclasses.dataclass(frozen=True, eq=False)
class LiveSurface:
    """Surface at one moment.

    Attributes:
        caster: of its mesh.
        revision: number of the moment.
        changes: of each of the last revisions, with its number.
        bounds: least and largest coordinates, rounded outwards so that they seldom change.
    """

    caster: RayCaster
    revision: int
    changes: tuple[tuple[int, Spheres], ...]
    bounds: Float[np.ndarray, "2 3"]

    def since(self, revision: int) -> Spheres | None:
        """Where it has changed since an earlier revision; None if that was too long ago to be known."""
        later = [spheres for number, spheres in self.changes if number > revision]
        if len(later) < self.revision - revision:
            return None
        joined = Spheres(np.zeros((0, 3)), 0.0)
        for spheres in later:
            joined = joined.joined(spheres)
        return joined


@dataclasses.dataclass(eq=False)
class _Kept:
    layout: MapLayout
    depth: Float[np.ndarray, "v n"]
    map: ShadowMap
    revision: int
    bounds: Float[np.ndarray, "2 3"]


class LiveShadowMaps:
    """Shadow maps of lights, brought up to date when they are asked for.

    Attributes:
        cast: texels that were cast for the last answer, and how many its map has.

    Args:
        slack: see `ShadowMap`.
    """

    def __init__(self, slack: float | None = None) -> None:
        self._slack = slack
        self._kept: dict[Hashable, _Kept] = {}
        self.cast = (0, 0)

    def __call__(self, key: Hashable, light: Light, surface: LiveSurface, scale: float = 1.0) -> ShadowMap | None:
        """Shadow map of a light on a surface; None if it casts no shadow.

        Args:
            key: of the light's geometry.
            light: any kind.
            surface: as it is now.
            scale: of the resolution, see `cast_shadow_maps`.
        """
        views = light.shadow_views()
        if views is None:
            return None
        key = key, scale
        kept = self._kept.pop(key, None)
        if kept is None:
            kept = self._cast_anew(views, surface, scale)
        else:
            kept = self._renewed(kept, views, surface, scale)
        self._kept[key] = kept  # the latest last
        while len(self._kept) > MOST_MAPS:
            self._kept.pop(next(iter(self._kept)))
        return kept.map

    def _cast_anew(self, views: ShadowViews, surface: LiveSurface, scale: float) -> _Kept:
        layout = MapLayout.of(views, scale, surface.bounds)
        depth = np.stack([layout.rays(k).depth(surface.caster) for k in range(layout.count)], dtype=np.float32)
        self.cast = depth.size, depth.size
        return _Kept(layout, depth, self._shadow_map(layout, depth), surface.revision, surface.bounds)

    def _renewed(self, kept: _Kept, views: ShadowViews, surface: LiveSurface, scale: float) -> _Kept:
        self.cast = 0, kept.depth.size
        if surface.revision <= kept.revision:  # an older surface, as of a picture that was begun before
            return kept
        changes = surface.since(kept.revision)
        whole = kept.layout.half > 0 and getattr(views, "aperture", None) is None  # rays that cover the whole mesh
        moved = whole and not np.array_equal(kept.bounds, surface.bounds)
        if changes is None or moved:
            return self._cast_anew(views, surface, scale)
        kept.revision = surface.revision
        changes = changes.few()
        if not len(changes.centres):
            return kept
        cast = 0
        for view in range(kept.layout.count):
            texels = np.flatnonzero(texels_reached(kept.layout, view, changes))
            if len(texels):
                kept.depth[view, texels] = kept.layout.rays(view, texels).depth(surface.caster)
                cast += len(texels)
        self.cast = cast, kept.depth.size
        if cast:
            kept.map = self._shadow_map(kept.layout, kept.depth)
        return kept

    def _shadow_map(self, layout: MapLayout, depth: Float[np.ndarray, "v n"]) -> ShadowMap:
        made = layout.shadow_map(depth.copy())  # what the device holds may be this very memory
        return made if self._slack is None else dataclasses.replace(made, slack=jnp.float32(self._slack))


def texels_reached(layout: MapLayout, view: int, changes: Spheres) -> Bool[np.ndarray, "n"]:
    """Mask of a view's texels, gutter included, in tiles whose rays may pass through one of the spheres."""
    side = layout.size + 2
    count = -(-side // TILE)
    first = np.minimum(np.arange(count) * TILE, side - 1)
    last = np.minimum(first + TILE - 1, side - 1)
    middle = (first + last) // 2
    rays = [_tile_rays(layout, view, rows, columns) for rows in (first, middle, last) for columns in
            (first, middle, last)]  # fmt: skip
    starts, directions = (np.stack([getattr(r, name) for r in rays]) for name in ("starts", "directions"))
    if layout.half:
        reached = _through_cylinders(starts, directions[0, 0], changes)
    else:
        reached = _through_cones(layout.origins[view], directions, changes)
    whole = np.repeat(np.repeat(reached.reshape(count, count), TILE, axis=0), TILE, axis=1)
    return whole[:side, :side].reshape(-1)


def _tile_rays(
    layout: MapLayout, view: int, rows: Int[np.ndarray, "t"], columns: Int[np.ndarray, "t"]
) -> TexelRays:
    return layout.rays(view, (rows[:, None] * (layout.size + 2) + columns[None]).reshape(-1))


def _through_cones(
    origin: Float[np.ndarray, "3"], directions: Float[np.ndarray, "k t 3"], changes: Spheres
) -> Bool[np.ndarray, "t"]:
    """Which of t cones from one point, each around k directions, meet a sphere."""
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    axis = directions.mean(axis=0)
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
    # One part in ten more: between the directions looked at a tile may bulge a little.
    half = 1.1 * np.arccos(np.clip((directions * axis).sum(axis=-1), -1.0, 1.0)).max(axis=0) + 1e-3
    toward = changes.centres - origin
    distance = np.linalg.norm(toward, axis=1)
    within = distance <= changes.radius
    if within.any():
        return np.ones(len(axis), bool)
    subtended = np.arcsin(changes.radius / distance)
    between = np.arccos(np.clip(axis @ (toward / distance[:, None]).T, -1.0, 1.0))
    return (between <= half[:, None] + subtended[None]).any(axis=1)


def _through_cylinders(
    starts: Float[np.ndarray, "k t 3"], direction: Float[np.ndarray, "3"], changes: Spheres
) -> Bool[np.ndarray, "t"]:
    """Which of t cylinders along one direction, each around k points, meet a sphere."""
    along = starts - (starts @ direction)[..., None] * direction
    middle = along.mean(axis=0)
    half = np.linalg.norm(along - middle, axis=-1).max(axis=0)
    centres = changes.centres - (changes.centres @ direction)[:, None] * direction
    squared = (middle**2).sum(axis=1)[:, None] - 2.0 * middle @ centres.T + (centres**2).sum(axis=1)[None]
    return (squared <= (1e-6 + half[:, None] + changes.radius) ** 2).any(axis=1)
