"""Filling shadow maps by ray casting, on the host. Once for a static scene; a light that moves needs a new map."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.lights import AmbientLight, Aperture, DirectionalLight, Light, PointLight, RectLight, SkyLight, SpotLight
from hyjax.scene.raycast import RayCaster
from hyjax.shadow import Projection, ShadowMap, map_rays

RESOLUTION = 1024  # texels a side of a map with one view
VIEW_RESOLUTION = 512  # of each view, where there are several
BULB_VIEWS, SUN_VIEWS, WINDOW_VIEWS, SKY_VIEWS = 8, 4, 16, 32  # of lights with an extent
WIDEST_PERSPECTIVE = np.deg2rad(60.0)  # beyond, a perspective map wastes its texels on the rim


def cast_shadow_maps(
    caster: RayCaster, lights: Sequence[Light], scale: float = 1.0
) -> tuple[ShadowMap | None, ...]:
    """Shadow maps of all lights; None for ambient light, which casts no shadow.

    Args:
        caster: the mesh that throws the shadows.
        lights: any kinds.
        scale: of the resolution (1 means 1024² for a light without extent, 4 to 32 times 512² for one with).
    """
    return tuple(_cast(caster, light, scale) for light in lights)


def _cast(caster: RayCaster, light: Light, scale: float) -> ShadowMap | None:
    single, many = round(RESOLUTION * scale), round(VIEW_RESOLUTION * scale)
    if isinstance(light, AmbientLight):
        return None
    if isinstance(light, PointLight | SpotLight):
        position, radius = np.asarray(light.position, np.float64), float(light.radius)
        origins = position + radius * fibonacci_sphere(BULB_VIEWS) if radius > 0 else position[None]
        size, near = many if radius > 0 else single, float(light.clearance)
        if isinstance(light, PointLight):
            return _cast_radial(caster, origins, np.eye(3), "octahedral", np.sqrt(4 * np.pi), size, near)
        axes, angle = _frame(light.direction), float(light.outer_angle)
        if angle > WIDEST_PERSPECTIVE:
            return _cast_radial(caster, origins, axes, "hemisphere", np.sqrt(2 * np.pi), size, near)
        # The sources of a wide lamp see the rim of the cone from aside: a margin on the cone's angle.
        spread = np.tan(angle) * 1.05
        axes = axes / [[spread], [spread], [1.0]]
        return _cast_radial(caster, origins, axes, "perspective", 2 * spread, size, near)
    if isinstance(light, RectLight):
        right, up = np.asarray(light.right, np.float64), np.asarray(light.up, np.float64)
        s, t = r2_sequence(WINDOW_VIEWS).T[..., None] * 2.0 - 1.0
        origins = np.asarray(light.center, np.float64) + s * right + t * up
        return _cast_radial(caster, origins, _frame(np.cross(right, up)), "hemisphere", np.sqrt(2 * np.pi), many)
    if isinstance(light, DirectionalLight):
        directions, spread, size = _unit(light.direction)[None], float(light.angular_radius), single
        if spread > 0:
            disc, size = fibonacci_disc(SUN_VIEWS) * spread, many
            directions = _unit(directions + disc @ _frame(directions[0])[:2])
        if light.aperture is not None:
            return _cast_through(caster, directions, light.aperture, size)
        return _cast_parallel(caster, directions, size)
    assert isinstance(light, SkyLight)
    dome = fibonacci_sphere(2 * SKY_VIEWS)[:SKY_VIEWS]  # its first half has z > 0
    return _cast_parallel(caster, -dome @ _frame(light.up), many)


def _texel_rays(size: int, projection: Projection) -> tuple[np.ndarray, ...]:
    """Origins and directions of the rays through all texel centres in a view's axes, gutter included."""
    ticks = (2.0 * np.arange(-1, size + 1) + 1.0) / size - 1.0
    u, v = np.meshgrid(ticks, ticks)
    origin, direction = map_rays(jnp.asarray(u), jnp.asarray(v), projection)
    return tuple(np.stack([np.asarray(c) for c in vector], axis=-1) for vector in (origin, direction))


def _cast_radial(
    caster: RayCaster,
    origins: Float[np.ndarray, "v 3"],
    axes: Float[np.ndarray, "3 3"],
    projection: Projection,
    extent: float,
    size: int,
    near: float = 0.0,
) -> ShadowMap:
    """Maps of rays that start in one point each, `near` away from it.

    `extent` is the map's width in radians, or in tangents.
    """
    _, local = _texel_rays(size, projection)
    # The rows of `axes` are orthogonal: its inverse is its transpose over their squared lengths.
    directions = (local @ (axes * np.sum(axes**2, axis=1, keepdims=True) ** -1)).reshape(-1, 3)
    starts = near * directions
    depth = near + np.stack([caster.cast(origin + starts, directions).distance for origin in origins])
    return _shadow_map(depth, size, origins, np.broadcast_to(axes, (len(origins), 3, 3)), extent / size, projection)


def _cast_parallel(caster: RayCaster, directions: Float[np.ndarray, "v 3"], size: int) -> ShadowMap:
    """Maps of parallel rays that cover the whole mesh."""
    centre = caster.mesh.bounds.mean(axis=0)
    half = 0.5 * float(np.linalg.norm(caster.mesh.extents)) * 1.01
    local, _ = _texel_rays(size, "orthographic")
    frames = np.stack([_frame(d) for d in directions])
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
    frames = np.stack([_frame(d) for d in directions])
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


def fibonacci_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spread unit vectors, from +z down to −z."""
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    angle = k * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)


def fibonacci_disc(count: int) -> Float[np.ndarray, "n 2"]:
    """Evenly spread points of the unit disc."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def r2_sequence(count: int) -> Float[np.ndarray, "n 2"]:
    """Evenly spread points of the unit square, no two in a row or column (Roberts 2018).

    On a grid the views' shadows of a straight edge fall on top of each other: few broad bands in the penumbra.
    """
    plastic = 1.32471795724474602596
    return (0.5 + np.arange(count)[:, None] * [1.0 / plastic, 1.0 / plastic**2]) % 1.0


def _unit(vector: object) -> np.ndarray:
    v = np.asarray(vector, np.float64)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _frame(direction: object) -> Float[np.ndarray, "3 3"]:
    """A right-handed orthonormal frame whose last row is `direction`."""
    z = _unit(direction)
    x = _unit(np.cross(np.eye(3)[np.argmin(np.abs(z))], z))
    return np.stack([x, np.cross(z, x), z])
