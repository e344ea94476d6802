"""Shadow maps against exact outlines and rays; no acne, no gap at the contact."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from hyjax import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    GBuffer,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
    visibility,
)
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps

WHITE = jnp.ones(3)
SCALE = 0.25  # of the shadow maps: texels of one to three centimetres, a few times the grid's spacing
HEIGHT, HALF = 0.5, 0.2  # of the square occluder over the floor z = 0
GRID = 200


def vec(*values: float) -> jnp.ndarray:
    return jnp.array(values, jnp.float32)


def point(position: jnp.ndarray, radius: float = 0.0) -> PointLight:
    return PointLight(position, vec(800.0)[0], WHITE, vec(radius)[0])


def spot(outer: float) -> SpotLight:
    return SpotLight(
        vec(0.3, -0.2, 2.0), vec(-0.2, 0.15, -2.0), vec(8.0)[0], WHITE, vec(0.1)[0], vec(outer)[0], vec(0)[0]
    )


def sun(*direction: float) -> DirectionalLight:
    return DirectionalLight(vec(*direction), vec(5e4)[0], WHITE, vec(0.0)[0])


def square_mesh(half: float, height: float) -> trimesh.Trimesh:
    corners = [[s * half, t * half, height] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def floor_gbuffer(size: float = 1.0) -> GBuffer:
    """A grid of points on the floor, looked at from nowhere, so that nothing hides it."""
    x, y = np.meshgrid(*[(np.arange(GRID) + 0.5) / GRID * 2 * size - size] * 2)
    position = np.stack([x, y, 0 * x], axis=-1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    return GBuffer(*(jnp.asarray(a, jnp.float32) for a in (position, normal, 1 + x * 0)), jnp.ones(x.shape, bool))


def see(mesh: trimesh.Trimesh, light: Light, gbuffer: GBuffer, scale: float = SCALE) -> np.ndarray:
    return np.asarray(visibility(gbuffer, light, cast_shadow_maps(RayCaster(mesh), [light], scale)[0]))


# ---- outlines ----


def shadowed(light_at: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    """Exactly: does the segment from p on the floor to the light cross the square?"""
    way = light_at(p) - p
    crossing = p + way * (HEIGHT / way[..., 2:])
    return np.all(np.abs(crossing[..., :2]) < HALF, axis=-1)


OUTLINES = {
    "point": point(vec(0.3, -0.2, 2.0)),
    "spot": spot(0.7),
    "wide spot": spot(1.3),
    "sun": sun(0.4, 0.3, -1.0),
}


@pytest.mark.parametrize("kind", OUTLINES)
def test_outline_of_a_square(kind: str) -> None:
    light, gbuffer = OUTLINES[kind], floor_gbuffer()
    p = np.asarray(gbuffer.position, np.float64)
    if isinstance(light, DirectionalLight):
        light_at = lambda p: p - np.asarray(light.direction, np.float64)  # noqa: E731
        distance = 1.0
    else:
        light_at = lambda p: np.broadcast_to(np.asarray(light.position, np.float64), p.shape)  # noqa: E731
        distance = 2.2
    exact = shadowed(light_at, p)
    caster = RayCaster(trimesh.util.concatenate([square_mesh(1.5, 0.0), square_mesh(HALF, HEIGHT)]))
    (shadow_map,) = cast_shadow_maps(caster, [light], SCALE)
    got = np.asarray(visibility(gbuffer, light, shadow_map))
    assert got.min() >= 0 and got.max() <= 1
    dark = got < 0.5
    if isinstance(light, SpotLight):  # outside the cone there is no map and no light
        inside = np.linalg.norm(p[..., :2] - [0.1, -0.05], axis=-1) < 1.2
        dark, exact = dark & inside, exact & inside
    assert np.sum(dark & exact) / np.sum(dark | exact) > 0.93
    # Points judged wrongly lie within two texels of the outline, at this distance from the light.
    texel = float(shadow_map.texel) * distance
    steps = [
        2 * texel * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ]
    near = [shadowed(light_at, p + step) for step in steps]
    np.testing.assert_array_equal(dark[np.all(near, axis=0) & exact], True)
    np.testing.assert_array_equal(dark[~np.any(near, axis=0) & ~exact], False)


@pytest.mark.parametrize("kind", ["rect", "ball"])
def test_penumbra_against_many_rays(kind: str) -> None:
    gbuffer = floor_gbuffer()
    p = np.asarray(gbuffer.position, np.float64)[::8, ::8]
    rng = np.random.default_rng(0)
    if kind == "rect":
        light = RectLight(vec(0.1, 0.0, 2.0), vec(0.0, 0.3, 0.0), vec(0.4, 0.0, 0.0), vec(800.0)[0], WHITE)
        a, b = rng.uniform(-1, 1, (2, 3000, 1))
        samples = np.array([0.1, 0, 2.0]) + a * [0, 0.3, 0] + b * [0.4, 0, 0]
    else:
        light = point(vec(0.1, 0.0, 2.0), radius=0.3)
        ball = rng.normal(size=(3000, 3))
        samples = np.array([0.1, 0, 2.0]) + 0.3 * ball / np.linalg.norm(ball, axis=-1, keepdims=True)
    lit = total = np.zeros(p.shape[:2])
    for sample in samples:
        way = sample - p
        weight = way[..., 2] ** (2 if kind == "rect" else 1) / np.linalg.norm(way, axis=-1) ** (
            4 if kind == "rect" else 3
        )
        lit, total = lit + weight * ~shadowed(lambda q, s=sample: np.broadcast_to(s, q.shape), p), total + weight
    mesh = trimesh.util.concatenate([square_mesh(1.5, 0.0), square_mesh(HALF, HEIGHT)])
    (shadow_map,) = cast_shadow_maps(RayCaster(mesh), [light], 0.5)
    error = np.asarray(visibility(gbuffer, light, shadow_map))[::8, ::8] - lit / total
    soft = (lit / total > 0.05) & (lit / total < 0.95)
    # A straight edge may split the light's views by three more or fewer than its share.
    views = shadow_map.depth.shape[0]
    assert soft.sum() > 40 and np.abs(error).max() < 3.5 / views
    assert np.abs(error[soft]).mean() < 1.3 / views and abs(error[soft].mean()) < 0.03
    assert np.abs(error[~soft]).mean() < 0.005


def test_sun_through_a_window_alone() -> None:
    """An aperture one metre up: its outline, moved along the light, is lit; all else is dark, whatever the mesh."""
    window = Aperture(vec(-0.3, 0.1, 1.0), vec(0.0, 0.3, 0.0), vec(0.1, 0.0, 0.25))
    light = dataclasses.replace(sun(0.6, -0.2, -1.0), aperture=window)
    gbuffer = floor_gbuffer()
    for mesh in (square_mesh(1.5, 0.0), trimesh.util.concatenate([square_mesh(1.5, 0.0), square_mesh(9.0, 3.0)])):
        (shadow_map,) = cast_shadow_maps(RayCaster(mesh), [light], SCALE)
        got = np.asarray(visibility(gbuffer, light, shadow_map)) > 0.5
        # p + t·(−direction) = centre + a·right + b·up
        columns = np.stack([np.asarray(window.right), np.asarray(window.up), np.asarray(light.direction)], axis=1)
        offset = np.asarray(gbuffer.position, np.float64) - np.asarray(window.center)
        exact = np.all(np.abs(offset @ np.linalg.inv(columns).T)[..., :2] < 1, axis=-1)
        assert exact.sum() > 500 and np.sum(got & exact) / np.sum(got | exact) > 0.9
        assert abs(got.sum() / exact.sum() - 1) < 0.05


def test_sky_beside_a_wall_is_half() -> None:
    wall = trimesh.Trimesh(
        [[0, -50, -1], [0, 50, -1], [0, 50, 60], [0, -50, 60]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    light = SkyLight(vec(0.0, 0.0, 1.0), vec(1e4)[0], WHITE)
    got = see(wall, light, floor_gbuffer(), 1.0)
    away = np.abs(np.asarray(floor_gbuffer().position)[..., 0]) > 0.8  # the map's texels are coarse here
    np.testing.assert_allclose(got[away], 0.5, atol=0.06)
    np.testing.assert_allclose(see(square_mesh(1.5, 0.0), light, floor_gbuffer()), 1.0)


# ---- what shadow maps get wrong ----


def acne(gbuffer: GBuffer, light: Light, mesh: trimesh.Trimesh, facing: np.ndarray, scale: float = SCALE) -> float:
    """Share of the points that the light must reach and that are darkened all the same."""
    got = see(mesh, light, gbuffer, scale)[facing & np.asarray(gbuffer.hit)]
    assert got.size > 500
    return float(np.mean(got < 0.98))


GRAZING = [sun(1.0, 0.3, -0.1), sun(1.0, 0.0, -0.03), point(vec(-0.9, 0.1, 0.08)), point(vec(0.0, 0.0, 0.3), 0.05)]


@pytest.mark.parametrize("light", GRAZING)
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_no_acne_on_a_plane(light: Light, tilt: float) -> None:
    """Turned about the vertical too, so that rows of texels and rows of pixels beat."""
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    mesh = square_mesh(1.2, 0.0).apply_transform(np.block([[turn, np.zeros((3, 1))], [0, 0, 0, 1]]))
    assert acne(floor_gbuffer(), light, mesh, np.ones((GRID, GRID), bool)) < 0.005


@pytest.mark.parametrize("light", [sun(1.0, 0.3, -0.2), point(vec(-2.0, 1.0, 2.0))])
def test_no_acne_on_a_sphere(light: Light) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=5)
    k = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)
    gbuffer = RayCaster(mesh).gbuffer(Camera(k, look_at((-3.0, -1.0, 1.0), (0, 0, 0), (0, 0, 1))))
    p, n = np.asarray(gbuffer.position), np.asarray(gbuffer.normal)
    to = -np.asarray(light.direction) if isinstance(light, DirectionalLight) else np.asarray(light.position) - p
    cosine = np.sum(n * to, axis=-1) / np.linalg.norm(to, axis=-1)
    assert acne(gbuffer, light, mesh, cosine > 0.06) < 0.005


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (1.4, -0.9, 0.95), (-1.45, 0.2, -0.9)])
def test_no_acne_inside_a_box(position: tuple[float, float, float]) -> None:
    """A convex room is lit everywhere, also by a lamp five centimetres from a wall.

    At full resolution: beside a wall that the lamp grazes, a line one texel wide along the corner is half lit.
    """
    mesh = trimesh.creation.box(extents=(3.0, 2.0, 2.0))
    mesh.unmerge_vertices()
    k = Intrinsics(160, 120, 70.0, 70.0, 80.0, 60.0)
    gbuffer = RayCaster(mesh).gbuffer(Camera(k, look_at((-1.3, -0.8, 0.5), (1.0, 0.6, -0.4), (0, 0, 1))))
    assert np.all(gbuffer.hit)
    assert acne(gbuffer, point(vec(*position)), mesh, np.ones((120, 160), bool), 1.0) < 0.005


@pytest.mark.parametrize("light", [sun(1.0, 0.0, -1.0), point(vec(-2.0, 0.0, 2.0))])
def test_contact_shadows_reach_the_contact(light: Light) -> None:
    """A box stands on the floor at x ∈ [−0.2, 0]; the floor right behind it, x > 0, is dark."""
    box = trimesh.creation.box(extents=(0.2, 1.6, 0.5)).apply_translation((-0.1, 0.0, 0.25))
    mesh, gbuffer = trimesh.util.concatenate([square_mesh(1.5, 0.0), box]), floor_gbuffer()
    (shadow_map,) = cast_shadow_maps(RayCaster(mesh), [light], SCALE)
    got = np.asarray(visibility(gbuffer, light, shadow_map))
    texel = float(shadow_map.texel) * (1.0 if isinstance(light, DirectionalLight) else 2.9)
    x, y = np.moveaxis(np.asarray(gbuffer.position)[..., :2], -1, 0)
    behind = (x > 0) & (x < 0.3) & (np.abs(y) < 0.5)
    lit_gap = x[behind & (got > 0.5)]
    assert lit_gap.size == 0 or lit_gap.max() < 3 * texel
    assert np.mean(got[behind & (x > 4 * texel)]) < 0.005


# ---- bookkeeping ----


def test_ambient_light_casts_none_and_misses_are_lit() -> None:
    gbuffer, caster = floor_gbuffer(), RayCaster(square_mesh(5.0, HEIGHT))
    lights = [AmbientLight(vec(100.0)[0], WHITE), point(vec(0.0, 0.0, 2.0))]
    maps = cast_shadow_maps(caster, lights, 0.1)
    assert maps[0] is None and maps[1] is not None
    assert np.all(np.asarray(visibility(gbuffer, lights[0], None)) == 1)
    hit = np.arange(GRID * GRID).reshape(GRID, GRID) % 3 > 0
    zeros = {k: jnp.where(hit[..., None], getattr(gbuffer, k), 0.0) for k in ("position", "normal")}
    got = np.asarray(visibility(GBuffer(**zeros, depth=gbuffer.depth, hit=jnp.asarray(hit)), lights[1], maps[1]))
    assert np.all(got[~hit] == 1) and np.all(got[hit] == 0)
