"""Filling shadow maps by ray casting, on the host. Once for a static scene; a light that moves needs a new map."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture, Light
from hyjax.light.kinds.shadow_views import Projection, RadialViews, ShadowViews
from hyjax.light.shadow_map import ShadowMap, map_rays
from hyjax.util.vectors import orthonormal_frame

RESOLUTION = 1024  # texels a side of a map with one view
VIEW_RESOLUTION = 512  # of each view, where there are several


def cast_shadow_maps(
    caster: RayCaster, lights: Sequence[Light], scale: float = 1.0, slack: float | None = None
) -> tuple[ShadowMap | None, ...]:
    """Shadow maps of all lights; None for a light that casts no shadow.

    Args:
        caster: the mesh that throws the shadows.
        lights: any kinds.
        scale: of the resolution (1 means 1024² for a light without extent, 4 to 32 times 512² for one with).
        slack: see `ShadowMap`.
    """
    maps = tuple(_cast(caster, light.shadow_views(), scale) for light in lights)
    if slack is None:
        return maps
    return tuple(m if m is None else dataclasses.replace(m, slack=jnp.float32(slack)) for m in maps)


def _cast(caster: RayCaster, views: ShadowViews | None, scale: float) -> ShadowMap | None:
    if views is None:
        return None
    size = round((RESOLUTION if views.count == 1 else VIEW_RESOLUTION) * scale)
    if isinstance(views, RadialViews):
        return _cast_radial(caster, views, size)
    if views.aperture is None:
        return _cast_parallel(caster, views.directions, size)
    return _cast_through(caster, views.directions, views.aperture, size)


def _texel_rays(size: int, projection: Projection) -> tuple[np.ndarray, ...]:
    """Origins and directions of the rays through all texel centres in a view's axes, gutter included."""
    ticks = (2.0 * np.arange(-1, size + 1) + 1.0) / size - 1.0
    u, v = np.meshgrid(ticks, ticks)
    origin, direction = map_rays(jnp.asarray(u), jnp.asarray(v), projection)
    return tuple(np.stack([np.asarray(c) for c in vector], axis=-1) for vector in (origin, direction))


def _cast_radial(caster: RayCaster, views: RadialViews, size: int) -> ShadowMap:
    """Maps of rays that start in one point each."""
    origins, axes, near = views.origins, views.axes, views.near
    _, local = _texel_rays(size, views.projection)
    # The rows of `axes` are orthogonal: its inverse is its transpose over their squared lengths.
    directions = (local @ (axes * np.sum(axes**2, axis=1, keepdims=True) ** -1)).reshape(-1, 3)
    starts = near * directions
    depth = near + np.stack([caster.cast(origin + starts, directions).distance for origin in origins])
    axes = np.broadcast_to(axes, (len(origins), 3, 3))
    return _shadow_map(depth, size, origins, axes, views.extent / size, views.projection)


def _cast_parallel(caster: RayCaster, directions: Float[np.ndarray, "v 3"], size: int) -> ShadowMap:
    """Maps of parallel rays that cover the whole mesh."""
    centre = caster.mesh.bounds.mean(axis=0)
    half = 0.5 * float(np.linalg.norm(caster.mesh.extents)) * 1.01
    local, _ = _texel_rays(size, "orthographic")
    frames = orthonormal_frame(directions)
    origins = centre - half * directions
    depth = []
    for origin, frame in zip(origins, frames, strict=True):
        starts = (origin + half * (local @ frame)).reshape(-1, 3)
        depth.append(caster.cast(starts, np.broadcast_to(frame[2], starts.shape)).distance)
    axes = frames / np.array([[half], [half], [1.0]])
    return _shadow_map(np.stack(depth), size, origins, axes, 2 * half / size, "orthographic")


def _cast_through(
    caster: RayCaster, directions: Float[np.ndarray, "v 3"], aperture: Aperture, size: int
) -> ShadowMap:
    """Maps of parallel rays that start in an opening. Beside the opening no light starts: all is dark."""
    centre, right, up = (np.asarray(a, np.float64) for a in (aperture.center, aperture.right, aperture.up))
    normal, half = np.cross(right, up), 1.02 * float(np.hypot(np.linalg.norm(right), np.linalg.norm(up)))
    local, _ = _texel_rays(size, "orthographic")
    frames = orthonormal_frame(directions)
    depth = []
    for frame in frames:
        starts = (half * (local @ frame)).reshape(-1, 3)  # relative to the centre, on a plane across the light
        to_opening = -(starts @ normal) / (frame[2] @ normal)
        starts = starts + to_opening[:, None] * frame[2]
        inside = (np.abs(starts @ right) <= right @ right) & (np.abs(starts @ up) <= up @ up)
        hit = caster.cast(centre + starts, np.broadcast_to(frame[2], starts.shape)).distance
        depth.append(np.where(inside, to_opening + hit, -np.inf))
    axes = frames / np.array([[half], [half], [1.0]])
    origins = np.broadcast_to(centre, (len(directions), 3))
    return _shadow_map(np.stack(depth), size, origins, axes, 2 * half / size, "orthographic")


def _shadow_map(
    depth: np.ndarray, size: int, origins: np.ndarray, axes: np.ndarray, texel: float, projection: Projection
) -> ShadowMap:
    return ShadowMap(
        depth=jnp.asarray(depth.reshape(-1, size + 2, size + 2), jnp.float32),
        origin=jnp.asarray(origins, jnp.float32),
        axes=jnp.asarray(axes, jnp.float32),
        texel=jnp.float32(texel),
        projection=projection,
    )
