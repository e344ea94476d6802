"""Filling shadow maps, on the host. Once for a static scene; a light that moves needs a new map."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.geometry.rasterizer import RasterView, constant, share_out
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Light
from hyjax.light.kinds.shadow_views import Projection, RadialViews, ShadowViews
from hyjax.light.shadow_map import ShadowMap, map_rays
from hyjax.util.cache import cached_arrays, remove_oldest, touch
from hyjax.util.errors import InputError
from hyjax.util.files import digest
from hyjax.util.vectors import orthonormal_frame

RESOLUTION = 1024  # texels a side of a map with one view
VIEW_RESOLUTION = 512  # of each view, where there are several
LARGEST_SCALE = 16.0
"""Largest factor of the resolution: maps of a gigabyte."""
VERSION = 1
"""Version of the drawn maps. Add one whenever they come out differently."""
MOST_BYTES = 400_000_000
"""Most bytes of shadow maps in a folder: some twenty soft lights."""


def cast_shadow_maps(
    caster: RayCaster,
    lights: Sequence[Light],
    scale: float = 1.0,
    slack: float | None = None,
    most_views: int | None = None,
    *,
    folder: Path | None = None,
) -> tuple[ShadowMap | None, ...]:
    """Shadow maps of all lights; None for a light that casts no shadow.

    Args:
        caster: the mesh that throws the shadows.
        lights: any kinds.
        scale: of the resolution (1 means 1024² for a light without extent, 4 to 32 times 512² for one with).
        slack: see `ShadowMap`.
        most_views: of each light, at most; None for all that it has.
        folder: to keep maps in, under mesh and light, and to find them in again; None to draw them anew.
    """
    if not 0 < scale <= LARGEST_SCALE:
        raise InputError(f"scale: must be > 0 and at most {LARGEST_SCALE:g}, got {scale:g}")
    maps = tuple(_cast(caster, light.shadow_views(), scale, most_views, folder) for light in lights)
    if slack is None:
        return maps
    error = jax.device_put(np.float32(slack))
    return tuple(m if m is None else dataclasses.replace(m, slack=error) for m in maps)


def _cast(
    caster: RayCaster, views: ShadowViews | None, scale: float, most_views: int | None, folder: Path | None
) -> ShadowMap | None:
    if views is None:
        return None
    layout = MapLayout.of(views if most_views is None else views.thinned(most_views), scale, caster.bounds)
    if folder is None:
        return layout.cast(caster)
    file = folder / f"{digest([str(VERSION), caster.arrays.key, layout.key])}.npz"
    found = file.is_file()
    depth = cached_arrays(file, lambda arrays: arrays["depth"], lambda: {"depth": layout.distances(caster)})
    if found:
        touch(file)
    else:
        remove_oldest(folder, "*.npz", MOST_BYTES)
    return layout.shadow_map(depth)


@dataclasses.dataclass(frozen=True, eq=False)
class MapLayout:
    """Layout of a light's texels in its shadow map, before anything is cast.

    Attributes:
        views: as the light declares them.
        size: texels a side, without the gutter.
        half: half a parallel view's width, metres; 0 for other views.
    """

    views: ShadowViews
    size: int
    origins: Float[np.ndarray, "v 3"]
    axes: Float[np.ndarray, "v 3 3"]
    texel: float
    projection: Projection
    half: float = 0.0

    @classmethod
    def of(cls, views: ShadowViews, scale: float, bounds: Float[np.ndarray, "2 3"]) -> "MapLayout":
        """Layout for views of a light.

        Args:
            bounds: least and largest coordinates of the mesh, which parallel rays without an opening cover.
        """
        size = max(1, round((RESOLUTION if views.count == 1 else VIEW_RESOLUTION) * scale))
        if isinstance(views, RadialViews):
            axes = np.broadcast_to(views.axes, (views.count, 3, 3))
            return cls(views, size, views.origins, axes, views.extent / size, views.projection)
        frames = orthonormal_frame(views.directions)
        if views.aperture is None:
            half = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0])) * 1.01
            origins = bounds.mean(axis=0) - half * views.directions
        else:
            centre, right, up = (
                np.asarray(a, np.float64) for a in (views.aperture.center, views.aperture.right, views.aperture.up)
            )
            half = 1.02 * float(np.hypot(np.linalg.norm(right), np.linalg.norm(up)))
            origins = np.broadcast_to(centre, (views.count, 3))
        axes = frames / np.array([[half], [half], [1.0]])
        return cls(views, size, origins, axes, 2 * half / size, "orthographic", half)

    @property
    def count(self) -> int:
        """Views."""
        return self.views.count

    def raster_view(self, view: int) -> RasterView:
        """View whose rays run through the texels; the gutter of an octahedral map stays empty."""
        pieces, spans, norm = _raster_map(self.size, self.projection)
        axes, origin = self.axes[view], self.origins[view]
        if isinstance(self.views, RadialViews):
            near = np.float32(self.views.near)
            limit = norm / near if near > 0 else constant(norm.shape, np.inf)
            return RasterView(axes, origin, pieces, spans, norm, limit)
        if self.views.aperture is None:
            return RasterView(axes, origin, pieces, spans, norm, constant(norm.shape, 0.0), True)
        # Rays start in an opening. How far from the plane's points it lies, and whether there at all, is affine.
        right, up = (np.asarray(a, np.float64) for a in (self.views.aperture.right, self.views.aperture.up))
        normal = np.cross(right, up)
        frame = orthonormal_frame(self.views.directions[view])
        ticks = self.half * _ticks(self.size)

        def along(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "s s"]:
            """Coordinate of the starts, once moved along the rays into the opening's plane."""
            slope = frame @ vector
            return (slope[0] * ticks)[None] + (slope[1] * ticks)[:, None]

        lead = along(normal) / -(frame[2] @ normal)
        inside = np.abs(along(right) + lead * (frame[2] @ right)) <= right @ right
        inside &= np.abs(along(up) + lead * (frame[2] @ up)) <= up @ up
        limit = np.where(inside, -lead, -np.inf).astype(np.float32)
        return RasterView(axes, origin, pieces, spans, norm, limit, True)

    @property
    def key(self) -> str:
        """Key of all that decides on the rays."""
        views, arrays = self.views, [self.origins, self.axes]
        if isinstance(views, RadialViews):
            arrays.append(np.array(views.near))
        elif views.aperture is not None:
            arrays += [np.asarray(v) for v in (views.aperture.center, views.aperture.right, views.aperture.up)]
        numbers = [np.ascontiguousarray(each, np.float64).tobytes().hex() for each in arrays]
        return digest([self.projection, str(self.size), *numbers])

    def cast(self, caster: RayCaster) -> ShadowMap:
        """Shadow map of a mesh."""
        return self.shadow_map(self.distances(caster))

    def distances(self, caster: RayCaster) -> Float[np.ndarray, "v s s"]:
        """Distances of the texels to a mesh, gutter included; several views are drawn at once."""

        def draw(part: slice) -> None:
            for view in range(part.start, part.stop):
                depth[view] = caster.distances(self.raster_view(view))

        side = self.size + 2
        depth = np.empty((self.count, side, side), np.float32)
        self.raster_view(0)  # what all views have in common is made once
        share_out(draw, self.count, self.count)
        if self.projection == "octahedral":  # beyond an edge it continues on the same edge, mirrored
            depth[:, :, 0], depth[:, :, -1] = depth[:, ::-1, 1], depth[:, ::-1, -2]
            depth[:, 0], depth[:, -1] = depth[:, 1, ::-1], depth[:, -2, ::-1]
        return depth

    def shadow_map(self, depth: Float[np.ndarray, "v n"]) -> ShadowMap:
        """Shadow map of these texels' distances."""
        # Converted by NumPy: every conversion of JAX's is a program of its own.
        texels = depth.reshape(-1, self.size + 2, self.size + 2)
        arrays = (np.asarray(each, np.float32) for each in (texels, self.origins, self.axes, self.texel))
        distance, origin, axes, texel = map(jax.device_put, arrays)
        return ShadowMap(distance, origin, axes, texel, self.projection)


def _ticks(size: int) -> Float[np.ndarray, "s"]:
    """Map coordinates of texel centres along a side, gutter included."""
    return (2.0 * np.arange(-1, size + 1) + 1.0) / size - 1.0


@functools.lru_cache(maxsize=8)
def _texel_rays(size: int, projection: Projection) -> tuple[np.ndarray, ...]:
    """Origins and directions of the rays through all texel centres in a view's axes, gutter included."""
    u, v = np.meshgrid(_ticks(size), _ticks(size))
    origin, direction = map_rays(jnp.asarray(u), jnp.asarray(v), projection)
    vectors = (np.stack([np.asarray(c) for c in vector], axis=-1) for vector in (origin, direction))
    return tuple(vector.reshape(-1, 3) for vector in vectors)


@functools.lru_cache(maxsize=8)
def _raster_map(size: int, projection: Projection) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pieces, spans and norm, as in `RasterView`, of a view in axes that `map_rays` is in.

    In each quadrant or octant, where |x| + |y| + |z| is a sum of three coordinates with fixed signs, a map of
    directions is projective.
    """
    side = size + 2
    ticks = 2 * np.arange(-1, size + 1) + 1 - size  # times the size: exact
    u, v = np.meshgrid(ticks, ticks)
    norm = np.ones((side, side), np.float32)
    if projection in ("perspective", "orthographic"):
        number, local = np.zeros((side, side), int), np.eye(3)[None]
    else:
        _, direction = _texel_rays(size, projection)
        if projection == "hemisphere":
            number = (u + v < 0) + 2 * (u - v < 0)
            local = np.stack([[[1, 1, 0], [1, -1, 0], [x, y, 1]] for y in (1, -1) for x in (1, -1)])
            x, y = 0.5 * (u + v) / size, 0.5 * (u - v) / size
            vectors = np.stack([x, y, 1.0 - np.abs(x) - np.abs(y)], axis=-1)
            norm = np.linalg.norm(vectors, axis=-1)
        else:
            number = (u < 0) + 2 * (v < 0) + 4 * (np.abs(u) + np.abs(v) > size)
            number[[0, -1]] = number[:, [0, -1]] = -1
            local = np.stack(
                [
                    [[1, 0, -x * (z < 0)], [0, 1, -y * (z < 0)], [x, y, z]]
                    for z in (1, -1)
                    for y in (1, -1)
                    for x in (1, -1)
                ]
            )
            norm = 1.0 / np.abs(direction).sum(axis=-1).reshape(side, side)
    texels = np.array([[0.5 * size, 0, 0.5 * size + 0.5], [0, 0.5 * size, 0.5 * size + 0.5], [0, 0, 1]])
    belongs = number == np.arange(len(local))[:, None, None]
    first, last = belongs.argmax(axis=-1), side - 1 - belongs[..., ::-1].argmax(axis=-1)
    last = np.where(belongs.any(axis=-1), last, -1)
    return texels @ local, np.stack([first, last], axis=1).astype(np.int32), norm.astype(np.float32)
