"""Shadow maps: the visibility of a light from surface points.

A shadow map holds distances from a light to the nearest surface, over a square of directions (or of parallel rays).
A surface point is lit if it is no farther than the map says. A light with an extent has a map for each of several
of its points, and the answers are averaged: that makes the penumbra.

The maps are drawn on the host (`hyjax.geometry.shadow_caster`), once for a static scene.
Looking them up is JAX. Both sides use `map_rays` and `map_coordinates` below, each the other's inverse.

Map coordinates (u, v) run over [-1, 1]²; maps carry one texel of gutter on each side, so that bilinear filtering
needs no special case at the border.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.kinds.shadow_views import Projection
from hyjax.light.setup import check_lights
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.geometry import inner
from hyjax.util.tracing import Run, call

Vector = tuple[Array, Array, Array]  # by components: see `hyjax.util.geometry` for why

NORMAL_OFFSET = 2.0
"""Offset of receivers off their surface, in texels times the sine of the angle of incidence (normal offset, Holbert
2011), which covers the footprint of the 2×2 filter."""
DEPTH_BIAS = 1.0
"""Slack of the depth comparison, in texels."""
LEAST_COSINE = 0.35
"""Cosine whose inverse bounds how much the error of a surface with slack counts along a ray."""
LEAST_VIEWS = 2
"""Fewest views of a light that each pixel looks up itself, where pixels share them."""
NORMAL_COSINE, PLANE_SINE = 0.8, 0.3
"""Least cosine between normals, and largest sine between a normal's plane and the way to another point, within
one surface."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["depth", "origin", "axes", "texel", "slack"],
    meta_fields=["projection"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class ShadowMap:
    """Distances from a light to the nearest surface, from `v` points of it.

    Attributes:
        depth: metres along the map's rays, infinite where nothing is hit, −infinite where no light starts; s texels
            a side, gutter included.
        origin: where each view looks from (orthographic: the centre of its plane), world metres.
        axes: rows are the view's axes in world coordinates. The last row is the unit viewing direction; for
            perspective and orthographic views the first two are scaled so that the map spans [-1, 1].
        texel: width of a texel; metres for orthographic maps, else metres at one metre's distance.
        projection: how directions map to the square (static).
        slack: metres, across the surface, that it may be wrong by: what is nearer than this to a surface point
            throws no shadow on it. None for a surface that is exact.
    """

    depth: Float[Array, "v s s"]
    origin: Float[Array, "v 3"]
    axes: Float[Array, "v 3 3"]
    texel: Float[Array, ""]
    projection: Projection
    slack: Float[Array, ""] | None = None


def map_coordinates(local: Vector, projection: Projection) -> tuple[Array, Array, Array]:
    """A point in a view's axes, by components → its map coordinates u, v and its distance along the map's rays."""
    x, y, z = local
    if projection == "orthographic":
        return x, y, z
    if projection == "perspective":
        depth = jnp.maximum(z, 1e-6)
        return x / depth, y / depth, depth
    distance = jnp.sqrt(x * x + y * y + z * z + 1e-12)
    scale = 1.0 / (jnp.abs(x) + jnp.abs(y) + jnp.abs(z) + 1e-12)
    x, y = x * scale, y * scale
    if projection == "hemisphere":
        return x + y, x - y, distance
    folded_x, folded_y = _fold(x, y)
    return jnp.where(z < 0, folded_x, x), jnp.where(z < 0, folded_y, y), distance


@functools.partial(jax.jit, static_argnames="projection")
def map_rays(u: Array, v: Array, projection: Projection) -> tuple[Vector, Vector]:
    """Map coordinates → origin and direction of the ray in a view's axes; inverse of `map_coordinates`.

    The ray parameter is the map's distance. Coordinates outside [-1, 1]² (the gutter) continue the map.
    Octahedral maps: Engelhardt and Dachsbacher, *Octahedron environment maps*, 2008.
    """
    zero, one = jnp.zeros_like(u), jnp.ones_like(u)
    if projection == "orthographic":
        return (u, v, zero), (zero, zero, one)
    if projection == "perspective":
        return (zero, zero, zero), (u, v, one)
    if projection == "hemisphere":
        x, y = 0.5 * (u + v), 0.5 * (u - v)
        z = 1.0 - jnp.abs(x) - jnp.abs(y)
    else:
        # Beyond an edge of the square the octahedron continues on the same edge, mirrored about its middle.
        x, y = jnp.where(jnp.abs(u) > 1, 2 * jnp.sign(u) - u, u), jnp.where(jnp.abs(u) > 1, -v, v)
        x, y = jnp.where(jnp.abs(y) > 1, -x, x), jnp.where(jnp.abs(y) > 1, 2 * jnp.sign(y) - y, y)
        z = 1.0 - jnp.abs(x) - jnp.abs(y)
        folded_x, folded_y = _fold(x, y)
        x, y = jnp.where(z < 0, folded_x, x), jnp.where(z < 0, folded_y, y)
    length = jnp.sqrt(x * x + y * y + z * z)
    return (zero, zero, zero), (x / length, y / length, z / length)


def _fold(x: Array, y: Array) -> tuple[Array, Array]:
    """Lower half of the octahedron to the corners of the square, and back."""
    return (1.0 - jnp.abs(y)) * jnp.where(x < 0, -1.0, 1.0), (1.0 - jnp.abs(x)) * jnp.where(y < 0, -1.0, 1.0)


@checked_arguments
@functools.partial(jax.jit, static_argnames="interleave")
def visibility(
    gbuffer: GBuffer, light: Light, shadow_map: ShadowMap | None, *, interleave: int = 1
) -> Float[Array, "h w"]:
    """Share of a light that reaches each visible surface point, in [0, 1].

    The views of an extended light are weighted by what each contributes, `Light.view_weight`.

    Args:
        gbuffer: what the camera sees.
        light: the light that the map was made for.
        shadow_map: None for a light that casts no shadow.
        interleave: each pixel of a block of so many by so many looks up its share of the views, and takes on what
            the block's other pixels found on the same surface. For what averages over blocks anyway, and for lights
            of many views alone: others are looked up whole.

    Returns:
        1 lit, 0 in full shadow; 1 where nothing is known: where the camera's ray missed the mesh, and on surfaces
        turned away from the light.

    Source of the interleaving: Keller and Heidrich, *Interleaved sampling*, 2001.
    """
    if shadow_map is None:
        return jnp.ones_like(gbuffer.depth)
    count = shadow_map.depth.shape[0]
    # Groups of pixels, and as many of views: a common divisor, so that all groups are of one size.
    shared = count % interleave**2 == 0 and count >= LEAST_VIEWS * interleave**2
    cell, (h, w) = interleave if shared else 1, gbuffer.depth.shape
    groups = cell**2
    # Component by component: interleaved they keep the CPU's vector units from being used.
    place, facing = (_in_groups(jnp.moveaxis(v, -1, 0), cell) for v in (gbuffer.position, gbuffer.normal))
    views = (shadow_map.depth, shadow_map.origin, shadow_map.axes)
    depth, origin, axes = (view.reshape(count // groups, groups, *view.shape[1:]) for view in views)

    def add_view(total: tuple[Array, Array], view: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], None]:
        lit, weight = _view_visibility(place, facing, light, shadow_map, *view)
        sums = total[0] + lit * weight, total[1] + weight
        return (sums[0].astype(place.dtype), sums[1].astype(place.dtype)), None

    zero = jnp.zeros_like(place[0])
    sums, _ = jax.lax.scan(add_view, (zero, zero), (depth, origin, axes))
    sums = jax.lax.optimization_barrier(sums)  # else a scan over one view is repeated for each of their uses
    lit, weight = _shared(sums, place, facing)
    if groups > 1:  # a pixel without a valid view takes the sums of its whole block
        valid, totals = weight > 0, [jnp.sum(part, axis=0) for part in sums]
        lit, weight = (jnp.where(valid, x, total) for x, total in zip((lit, weight), totals))
    lit, weight = (_from_groups(part, cell, (h, w)) for part in (lit, weight))
    lit = light.mask_visibility(lit, gbuffer.position)
    return jnp.where(gbuffer.hit & (weight > 0), lit / jnp.where(weight > 0, weight, 1.0), 1.0)


def _shared(
    sums: tuple[Float[Array, "g n"], Float[Array, "g n"]],
    place: Float[Array, "3 g n"],
    facing: Float[Array, "3 g n"],
) -> list[Float[Array, "g n"]]:
    """Sums over the pixels of a block on the same surface, for each of its pixels."""
    groups = range(place.shape[1])
    pairs = [(i, j) for i in groups for j in groups if i < j]
    if not pairs:
        return list(sums)
    same = jnp.stack([_same_surface(place[:, i], place[:, j], facing[:, i], facing[:, j]) for i, j in pairs])
    same = jax.lax.optimization_barrier(same)  # else found anew for each sum
    number = {pair: k for k, pair in enumerate(pairs)} | {(j, i): k for k, (i, j) in enumerate(pairs)}
    return [
        jnp.stack([sum((same[number[k, j]] * values[j] for j in groups if j != k), values[k]) for k in groups])
        for values in sums
    ]


def _same_surface(
    a: Float[Array, "3 n"], b: Float[Array, "3 n"], normal_a: Float[Array, "3 n"], normal_b: Float[Array, "3 n"]
) -> Float[Array, "n"]:
    """1 where two points with their normals lie on one surface, else 0."""
    away = b - a
    near = PLANE_SINE * jnp.sqrt(inner(away, away))
    flat = (jnp.abs(inner(away, normal_a)) <= near) & (jnp.abs(inner(away, normal_b)) <= near)
    return (flat & (inner(normal_a, normal_b) > NORMAL_COSINE)).astype(a.dtype)


def _in_groups(x: Float[Array, "3 h w"], cell: int) -> Float[Array, "3 g n"]:
    """Group pixels by their place in blocks of `cell` × `cell`; the last rows and columns are padded."""
    h, w = x.shape[1:]
    x = jnp.pad(x, [(0, 0), (0, -h % cell), (0, -w % cell)], mode="edge") if cell > 1 else x
    rows, columns = x.shape[1] // cell, x.shape[2] // cell
    blocks = x.reshape(3, rows, cell, columns, cell).transpose(0, 2, 4, 1, 3)
    return blocks.reshape(3, cell * cell, rows * columns)


def _from_groups(x: Float[Array, "g n"], cell: int, shape: tuple[int, int]) -> Float[Array, "h w"]:
    """Inverse of `_in_groups` for one component."""
    rows, columns = (-(-n // cell) for n in shape)
    blocks = x.reshape(cell, cell, rows, columns).transpose(2, 0, 3, 1)
    return blocks.reshape(rows * cell, columns * cell)[: shape[0], : shape[1]]


def _view_visibility(
    position: Float[Array, "3 g n"],
    normal: Float[Array, "3 g n"],
    light: Light,
    shadow_map: ShadowMap,
    depth: Float[Array, "g s s"],
    origin: Float[Array, "g 3"],
    axes: Float[Array, "g 3 3"],
) -> tuple[Float[Array, "g n"], Float[Array, "g n"]]:
    """Lit fraction and weight of one view of each group."""
    offset = [origin[:, k, None] - position[k] for k in range(3)]
    if shadow_map.projection == "orthographic":
        to_light = [-axes[:, 2, k, None] for k in range(3)]
        squared, texel = jnp.ones(()), shadow_map.texel
    else:
        squared = inner(offset, offset) + 1e-12
        to_light = [component * jax.lax.rsqrt(squared) for component in offset]
        texel = shadow_map.texel * jnp.sqrt(squared)
    cosine = jnp.clip(inner(normal, to_light), 0.0, 1.0)
    weight = light.view_weight(cosine, squared, to_light)

    sine = jnp.sqrt(jnp.maximum(1.0 - cosine**2, 1e-12))
    bias = DEPTH_BIAS * texel
    if shadow_map.slack is not None:
        bias = bias + shadow_map.slack / jnp.maximum(cosine, LEAST_COSINE)
    moved = [normal[k] * (NORMAL_OFFSET * texel * sine) - offset[k] for k in range(3)]
    x, y, z = (inner(moved, [axes[:, row, k, None] for k in range(3)]) for row in range(3))
    u, v, distance = map_coordinates((x, y, z), shadow_map.projection)
    return _filtered_comparison(depth, u, v, distance - bias), weight


def _filtered_comparison(
    depth: Float[Array, "g s s"], u: Float[Array, "g n"], v: Float[Array, "g n"], distance: Float[Array, "g n"]
) -> Float[Array, "g n"]:
    """Fraction of the 2×2 nearest texels, bilinearly weighted, that are no nearer than `distance` (PCF)."""
    groups, size, _ = depth.shape
    # Texel k's centre lies at u = (2(k − 1) + 1)/(size − 2) − 1, the first texel being gutter.
    x, y = (jnp.clip((c + 1.0) * (0.5 * (size - 2)) + 0.5, 0.0, size - 1.001) for c in (u, v))
    column, row = x.astype(jnp.int32), y.astype(jnp.int32)
    corner = (jnp.arange(groups, dtype=jnp.int32)[:, None] * size + row) * size + column
    flat = depth.reshape(-1)
    lit = [(distance <= flat[corner + shift]).astype(distance.dtype) for shift in (0, 1, size, size + 1)]
    upper = lit[0] + (x - column) * (lit[1] - lit[0])
    lower = lit[2] + (x - column) * (lit[3] - lit[2])
    return upper + (y - row) * (lower - upper)


@checked_arguments
def visibilities(
    gbuffer: GBuffer,
    lights: Sequence[Light],
    shadow_maps: Sequence[ShadowMap | None],
    *,
    interleave: int = 1,
    run: Run = call,
) -> Float[Array, "h w l"]:
    """Visibility of each light, one channel per light.

    Args:
        gbuffer: what the camera sees.
        lights: of any kinds.
        shadow_maps: one for each light; None for one that casts no shadow.
        interleave: see `visibility`.
        run: runs the function of each light.

    Raises:
        InputError: no lights, or another number of shadow maps.
    """
    check_lights(lights)
    if len(lights) != len(shadow_maps):
        raise InputError(f"shadow_maps: {len(shadow_maps)} for {len(lights)} lights; give one for each")
    pairs = zip(lights, shadow_maps, strict=True)
    channels = [run(visibility, gbuffer, light, shadow_map, interleave=interleave) for light, shadow_map in pairs]
    return run(_stacked, channels)


@jax.jit
def _stacked(each: Sequence[Float[Array, "h w"]]) -> Float[Array, "h w l"]:
    return jnp.stack(each, axis=-1)
