"""Visible-surface splatting: point cloud + camera → G-buffer."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax import GBuffer
from hyjax.geometry import splatting
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.point_cloud import PointCloud, make_point_cloud
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.splatting import PointSplatter

seeds = st.integers(0, 2**31)
K = Intrinsics(120, 90, 100.0, 104.0, 58.7, 46.1)
Z_UP = np.array([0.0, 0.0, 1.0])


def fields(g: GBuffer) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(a) for a in (g.position, g.normal, g.depth, g.hit))


def random_camera(rng: np.random.Generator, distance: float, k: Intrinsics = K) -> Camera:
    eye = rng.normal(size=3)
    eye *= distance / np.linalg.norm(eye)
    return Camera(k, look_at(eye, rng.normal(size=3) * 0.2, rng.normal(size=3)))


def sphere_cloud(count: int = 20_000) -> PointCloud:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return make_point_cloud(points / np.linalg.norm(points, axis=1, keepdims=True), progress=False)


def wall(x: tuple[float, float], y: tuple[float, float], z: float, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(*x, count), rng.uniform(*y, count), np.full(count, z)], axis=-1)


def crossing(camera: Camera) -> np.ndarray:
    """Where the rays meet the plane z = 0."""
    rays = camera.rays()
    return camera.origin + rays * (-camera.origin[2] / rays[..., 2])[..., None]


@given(seeds)
def test_one_disc_is_where_rays_meet_it(seed: int) -> None:
    """Any tilt and place, larger than the picture or smaller than a pixel; against all rays in double precision."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 1.0)
    centre = camera.unproject(np.full(K.shape, rng.uniform(0.3, 3.0)))[rng.integers(90), rng.integers(120)]
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    radius = 10 ** rng.uniform(-2.5, -0.3)
    facing = normal @ (centre - camera.origin) < 0
    disc = PointCloud(*(np.array(a, np.float32) for a in ([centre], [normal], [radius])))
    _, seen_normal, depth, hit = fields(PointSplatter(disc).gbuffer(camera))
    rays = camera.rays()
    expected = (normal @ (centre - camera.origin)) / (rays @ normal)
    away = np.linalg.norm(camera.origin + rays * expected[..., None] - centre, axis=-1) / radius
    if camera.project(centre)[1] - radius < splatting.NEAR:
        return  # too near to be drawn
    # At the rim, and for a disc seen on edge, rounding decides.
    on_edge = abs(normal @ (centre - camera.origin)) < 1e-2
    clear = np.abs(away - 1.0) > (0.05 if on_edge else 2e-3)
    np.testing.assert_array_equal(hit[clear], (away < 1.0)[clear])
    if not on_edge:
        np.testing.assert_allclose(depth[hit], expected[hit], rtol=1e-3)
        np.testing.assert_allclose(
            seen_normal[hit], np.broadcast_to(normal if facing else -normal, (hit.sum(), 3)), atol=1e-5
        )


@given(seeds)
def test_the_contract_of_a_gbuffer(seed: int) -> None:
    """Position projects to the pixel, depth is its depth, normals are unit and face the camera; from inside too."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, rng.choice([0.3, 2.5]))
    position, normal, depth, hit = fields(PointSplatter(SPHERE).gbuffer(camera))
    xy, z = camera.project(position[hit].astype(np.float64))
    i, j = np.nonzero(hit)
    np.testing.assert_allclose(xy, np.stack([j, i], axis=-1) + 0.5, atol=2e-3)
    np.testing.assert_allclose(z, depth[hit], rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normal[hit], axis=-1), 1.0, rtol=1e-5)
    assert np.all(np.sum(normal[hit] * camera.rays()[hit], axis=-1) < 0)
    for field in (position, normal, depth):
        assert np.all(field[~hit] == 0)


@given(seeds)
def test_a_sphere_against_its_mesh(seed: int) -> None:
    camera = random_camera(np.random.default_rng(seed), 2.5)
    truth = fields(RayCaster(trimesh.creation.icosphere(5)).gbuffer(camera))
    _, normal, depth, hit = fields(PointSplatter(SPHERE).gbuffer(camera))
    assert np.mean(hit == truth[3]) > 0.97
    assert np.all(hit[truth[3]])  # fatter by half a disc, never thinner, no holes
    both = truth[3]
    assert np.median(np.abs(depth - truth[2])[both]) < 0.001
    cosine = np.clip(np.sum(normal * truth[1], axis=-1)[both], -1, 1)
    assert np.degrees(np.arccos(np.median(cosine))) < 0.5


@given(seeds)
def test_moving_the_world_with_the_camera_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 2.5)
    motion = np.array(random_camera(rng, rng.uniform(0, 20)).pose)
    rotation = motion[:3, :3]
    moved = PointCloud(
        (SPHERE.points @ rotation.T + motion[:3, 3]).astype(np.float32),
        (SPHERE.normals @ rotation.T).astype(np.float32),
        SPHERE.radius,
    )
    position, normal, depth, hit = fields(PointSplatter(SPHERE).gbuffer(camera))
    position2, normal2, depth2, hit2 = fields(PointSplatter(moved).gbuffer(Camera(K, motion @ camera.pose)))
    assert np.mean(hit != hit2) < 1e-3  # a pixel at the very rim
    both = hit & hit2
    # Which discs are blended is a matter of more or less than a radius: here and there rounding decides.
    assert np.quantile(np.abs(depth - depth2)[both], 0.99) < 2e-5
    assert np.quantile(np.abs(normal @ rotation.T - normal2)[both], 0.99) < 1e-3
    assert np.quantile(np.abs(position @ rotation.T + motion[:3, 3] - position2)[both], 0.99) < 5e-5


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.2])
def test_nothing_shows_through_a_wall(tilt: float) -> None:
    """Points several pixels apart, a dense wall close behind: where a disc of the front is, the back is not."""
    front = make_point_cloud(wall((-3, 3), (-2, 2), 0.0, 8000), progress=False)
    back = make_point_cloud(wall((-6, 6), (-4, 4), 0.3, 60_000, seed=1), progress=False)
    both = PointCloud(
        *(np.concatenate([getattr(front, name), getattr(back, name)]) for name in ("points", "normals", "radius"))
    )
    eye = 2.5 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    camera = Camera(K, look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0])))
    alone, together = (fields(PointSplatter(cloud).gbuffer(camera)) for cloud in (front, both))
    hit = alone[3]
    x, y, _ = np.moveaxis(crossing(camera), -1, 0)
    assert hit[(np.abs(x) < 2.8) & (np.abs(y) < 1.8)].mean() > 0.99
    for before, after in zip(alone, together, strict=True):
        np.testing.assert_array_equal(after[hit], before[hit])
    assert np.median(np.abs(alone[0][hit][:, 2])) < 1e-5


def test_a_doorway_stays_open() -> None:
    points = wall((-3, 3), (-1.5, 1.5), 0.0, 200_000)
    inside = (np.abs(points[:, 0]) < 0.5) & (points[:, 1] > -0.5)  # 1 m by 2 m, down to the floor
    splatter = PointSplatter(make_point_cloud(points[~inside], progress=False))
    camera = Camera(K, look_at(np.array([0.4, 0.0, -2.5]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
    _, _, _, hit = fields(splatter.gbuffer(camera))
    x, y, _ = np.moveaxis(crossing(camera), -1, 0)
    x = np.abs(x)
    margin = 0.04  # twice the radius of a disc
    opening = (x < 0.5 - margin) & (y > -0.5 + margin) & (y < 1.5 - margin)
    wall_around = ((x > 0.5 + margin) | (y < -0.5 - margin)) & (x < 2.9) & (np.abs(y) < 1.4)
    assert opening.sum() > 1000 and wall_around.sum() > 2000
    assert not hit[opening].any()
    assert hit[wall_around].mean() > 0.995  # points strewn at random leave a gap here and there


def test_far_points_of_less_than_a_pixel_make_a_closed_surface() -> None:
    cloud = make_point_cloud(wall((-2, 2), (-2, 2), 0.0, 100_000), progress=False)
    camera = Camera(K, look_at(np.array([0.0, 0.0, -20.0]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
    _, _, depth, hit = fields(PointSplatter(cloud).gbuffer(camera))
    i, j = np.nonzero(hit)
    assert hit[i.min() : i.max() + 1, j.min() : j.max() + 1].mean() > 0.98
    assert abs(np.count_nonzero(hit) - (4 / 20) ** 2 * K.fx * K.fy) < 0.05 * np.count_nonzero(hit)
    np.testing.assert_allclose(depth[hit], 20.0, atol=1e-3)


def test_points_beside_and_behind_the_camera_do_not_matter() -> None:
    """A camera in the midst of points, some nearer than a disc is wide, some in the plane of the camera."""
    front = sphere_cloud(2000)
    rng = np.random.default_rng(3)
    camera = Camera(K, look_at(np.array([0.0, -0.2, 0.0]), np.array([0.0, 5.0, 0.1]), Z_UP))
    stray = rng.uniform(-0.5, 0.5, (500, 3))
    stray[:, 1] = -0.2 - np.abs(stray[:, 1]) * (rng.uniform(size=500) < 0.8)  # in or behind the plane
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    both = PointCloud(
        np.concatenate([front.points, stray.astype(np.float32)]),
        np.concatenate([front.normals, normals.astype(np.float32)]),
        np.concatenate([front.radius, np.full(500, 0.2, np.float32)]),
    )
    for one, other in zip(*(fields(PointSplatter(cloud).gbuffer(camera)) for cloud in (front, both)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_camera_that_sees_nothing() -> None:
    camera = Camera(K, look_at(np.array([3.0, 0.0, 0.0]), np.array([9.0, 0.0, 0.0]), Z_UP))
    for field in fields(PointSplatter(SPHERE).gbuffer(camera)):
        assert not field.any()


def test_work_in_pieces_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = random_camera(np.random.default_rng(5), 1.5)
    at_once = fields(PointSplatter(SPHERE).gbuffer(camera))
    monkeypatch.setattr(splatting, "FRAGMENTS", 1000)
    for one, other in zip(at_once, fields(PointSplatter(SPHERE).gbuffer(camera)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


SPHERE = sphere_cloud()
