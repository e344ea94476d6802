"""Point clouds as meshes of discs: thinning, normals, and what a camera sees of them."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax import GBuffer
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.point_cloud import disc_mesh, thinned
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.voxels import REACH, voxel_coordinates, voxel_keys
from hyjax.util.errors import InputError

seeds = st.integers(0, 2**31)
K = Intrinsics(120, 90, 100.0, 104.0, 58.7, 46.1)


def fields(g: GBuffer) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(a) for a in (g.position, g.normal, g.depth, g.hit))


def centres(mesh: trimesh.Trimesh) -> np.ndarray:
    """The points that a mesh of discs was made of."""
    return np.asarray(mesh.vertices).reshape(-1, 4, 3).mean(axis=1)


def wall(x: tuple[float, float], y: tuple[float, float], z: float, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(*x, count), rng.uniform(*y, count), np.full(count, z)], axis=-1)


def crossing(camera: Camera) -> np.ndarray:
    """Where the rays meet the plane z = 0."""
    rays = camera.rays()
    return camera.origin + rays * (-camera.origin[2] / rays[..., 2])[..., None]


def grid(n: int, spacing: float) -> np.ndarray:
    i, j = np.mgrid[:n, :n]
    return np.stack([i, j, np.zeros_like(i)], axis=-1).reshape(-1, 3) * spacing


# ---- thinning ----


def test_voxel_keys_are_unique_and_ordered() -> None:
    corners = np.array([-REACH, -1, 0, REACH - 1])
    cells = np.stack(np.meshgrid(corners, corners, corners, indexing="ij"), axis=-1).reshape(-1, 3)
    keys = voxel_keys(cells)
    assert np.all(np.diff(keys) > 0)
    np.testing.assert_array_equal(voxel_coordinates(keys), cells)


@given(seeds)
def test_thinning_is_the_mean_of_each_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, voxel = rng.normal(size=(300, 3)), rng.uniform(0.1, 2.0)
    cells: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / voxel).astype(int)), []).append(point)
    means = [np.mean(cells[cell], axis=0) for cell in sorted(cells)]
    np.testing.assert_allclose(thinned(points, voxel), means, atol=1e-5)


@pytest.mark.parametrize("voxel", [0.0, -1.0, np.nan, np.inf])
def test_a_voxel_that_is_no_length_is_refused(voxel: float) -> None:
    with pytest.raises(InputError, match=r"voxel: must be > 0"):
        thinned(np.ones((1, 3)), voxel)


def test_points_beyond_the_grid_are_refused() -> None:
    thinned(np.full((1, 3), 5000.0), 0.005)
    with pytest.raises(InputError, match="are they in metres"):
        thinned(np.full((1, 3), 1e6), 0.005)


# ---- discs ----


def test_a_plane() -> None:
    mesh = disc_mesh(grid(30, 0.02), progress=False)
    np.testing.assert_allclose(np.abs(mesh.vertex_normals), np.broadcast_to([0, 0, 1.0], (3600, 3)), atol=1e-6)
    points, areas = centres(mesh), mesh.area_faces.reshape(-1, 2).sum(axis=1)
    inner = ((points > 0.03) & (points < 0.55))[:, :2].all(axis=1)
    np.testing.assert_allclose(points, grid(30, 0.02), atol=1e-6)
    radius = 0.02 * np.sqrt(2)  # to the four diagonal neighbours
    np.testing.assert_allclose(areas[inner], np.pi * radius**2, rtol=1e-4)


def test_points_that_come_twice_count_once() -> None:
    points = grid(30, 0.02)
    once, often = (disc_mesh(p, progress=False).area for p in (points, np.tile(points, (7, 1))))
    assert often == pytest.approx(once, rel=1e-3)
    with pytest.raises(InputError, match="9 points make no surface"):
        disc_mesh(np.tile(grid(3, 0.02), (20, 1)), progress=False)


def test_a_sphere_thinned() -> None:
    points, _ = trimesh.sample.sample_surface(trimesh.creation.icosphere(5), 200_000, seed=0)
    mesh = disc_mesh(points, voxel=0.04, progress=False)
    found = centres(mesh)
    assert 3000 < len(found) < 4 * np.pi / 0.04**2 * 2
    normals = np.asarray(mesh.vertex_normals)[::4]
    cosine = np.abs(np.sum(normals * found, axis=1)) / np.linalg.norm(found, axis=1)
    assert np.degrees(np.arccos(np.quantile(cosine, 0.05))) < 4.0


def test_isolated_points_go_and_sparse_parts_stay() -> None:
    """A scanner's points lie a hundred times sparser on a far wall: that is no reason to drop them."""
    dense, sparse = grid(40, 0.005), grid(15, 0.05) + np.array([3.0, 0, 0])
    stray = np.array([[0.1, 0.1, 0.2], [0.102, 0.1, 0.2], [0.05, 0.1, -0.5]])
    mesh = disc_mesh(np.concatenate([dense, sparse, stray]), progress=False)
    np.testing.assert_allclose(centres(mesh), np.concatenate([dense, sparse]), atol=1e-6)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (grid(4, 1.0), r"16 points make no surface; need at least 17"),
        (np.zeros((100, 2)), r"of shape n x 3"),
        (np.full((100, 3), np.nan), "finite"),
    ],
)
def test_points_that_make_no_surface_are_refused(points: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        disc_mesh(points, progress=False)


def test_too_coarse_a_voxel_is_named() -> None:
    with pytest.raises(InputError, match=r"1 points at a voxel of 5 m"):
        disc_mesh(np.random.default_rng(0).uniform(1, 4, (1000, 3)), voxel=5.0, progress=False)


# ---- what a camera sees ----


@given(seeds)
def test_a_sphere_against_its_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    eye = rng.normal(size=3)
    camera = Camera(K, look_at(2.5 * eye / np.linalg.norm(eye), rng.normal(size=3) * 0.2, rng.normal(size=3)))
    truth = fields(RayCaster(trimesh.creation.icosphere(5)).gbuffer(camera))
    _, normal, depth, hit = fields(SPHERE.gbuffer(camera))
    assert np.mean(hit == truth[3]) > 0.97
    assert np.all(hit[truth[3]])  # fatter by half a disc, never thinner, no holes
    both, reach = truth[3], 0.044  # half a diagonal, metres: discs are flat, and the nearest is seen
    assert np.median(np.abs(depth - truth[2])[both]) < reach**2
    cosine = np.clip(np.sum(normal * truth[1], axis=-1)[both], -1, 1)
    assert np.arccos(np.median(cosine)) < reach


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.2])
def test_nothing_shows_through_a_wall(tilt: float) -> None:
    """Points several pixels apart, a dense wall close behind: where a disc of the front is, the back is not."""
    front = disc_mesh(wall((-3, 3), (-2, 2), 0.0, 8000), progress=False)
    back = disc_mesh(wall((-6, 6), (-4, 4), 0.3, 60_000, seed=1), progress=False)
    eye = 2.5 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    camera = Camera(K, look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0])))
    alone, together = (fields(RayCaster(mesh).gbuffer(camera)) for mesh in (front, front + back))
    hit = alone[3]
    x, y, _ = np.moveaxis(crossing(camera), -1, 0)
    assert hit[(np.abs(x) < 2.8) & (np.abs(y) < 1.8)].mean() > 0.99
    np.testing.assert_allclose(together[0][hit], alone[0][hit], atol=1e-5)
    assert np.median(np.abs(alone[0][hit][:, 2])) < 1e-5


def test_a_doorway_stays_open() -> None:
    points = wall((-3, 3), (-1.5, 1.5), 0.0, 200_000)
    inside = (np.abs(points[:, 0]) < 0.5) & (points[:, 1] > -0.5)  # 1 m by 2 m, down to the floor
    caster = RayCaster(disc_mesh(points[~inside], progress=False))
    camera = Camera(K, look_at(np.array([0.4, 0.0, -2.5]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
    _, _, _, hit = fields(caster.gbuffer(camera))
    x, y, _ = np.moveaxis(crossing(camera), -1, 0)
    x = np.abs(x)
    margin = 0.04  # twice the radius of a disc
    opening = (x < 0.5 - margin) & (y > -0.5 + margin) & (y < 1.5 - margin)
    wall_around = ((x > 0.5 + margin) | (y < -0.5 - margin)) & (x < 2.9) & (np.abs(y) < 1.4)
    assert opening.sum() > 1000 and wall_around.sum() > 2000
    assert not hit[opening].any()
    assert hit[wall_around].mean() > 0.995  # points strewn at random leave a gap here and there


def _sphere(count: int = 20_000) -> RayCaster:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return RayCaster(disc_mesh(points / np.linalg.norm(points, axis=1, keepdims=True), progress=False))


SPHERE = _sphere()
