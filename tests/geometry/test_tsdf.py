"""Fusion against surfaces whose equation is known, and on the kitchen."""

import resource
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_map import clean_depth, view_cosine
from hyjax.geometry.mesh import degenerate_faces, load_mesh, save_mesh
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.tsdf import BLOCK_SIDE, Volume, fuse
from hyjax.util.errors import InputError
from tests.reference.votes import votes

K = Intrinsics(160, 120, 140.0, 140.0, 80.0, 60.0)
RADIUS, CENTRE = 0.5, np.array([0.31, -0.17, 2.03])
View = tuple[np.ndarray, Camera]


def sphere_depth(camera: Camera) -> np.ndarray:
    """Depth of the sphere by the quadratic formula; 0 beside it."""
    rays = camera.rays()
    offset = camera.origin - CENTRE
    a, b, c = (rays * rays).sum(-1), rays @ offset, offset @ offset - RADIUS**2
    discriminant = b * b - a * c
    depth = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / a
    return np.where(discriminant > 0, depth, 0.0)


@pytest.fixture(scope="module")
def views() -> list[View]:
    """The sphere from 42 directions at 1.5 m."""
    directions = trimesh.creation.icosphere(1).vertices
    ups = np.where(np.abs(directions[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    cameras = [Camera(K, look_at(CENTRE + 1.5 * d, CENTRE, up)) for d, up in zip(directions, ups)]
    return [(sphere_depth(camera), camera) for camera in cameras]


def radial_error(mesh: trimesh.Trimesh) -> np.ndarray:
    return np.linalg.norm(mesh.vertices - CENTRE, axis=1) - RADIUS


@pytest.mark.parametrize("voxel", [0.04, 0.02])
def test_sphere(views: list[View], voxel: float) -> None:
    mesh = fuse(views, voxel, progress=False)
    error = radial_error(mesh)
    assert np.abs(error).max() < 0.3 * voxel
    assert abs(error.mean()) < 0.1 * voxel
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)  # > 0: wound outwards
    outward = (mesh.vertices - CENTRE) / np.linalg.norm(mesh.vertices - CENTRE, axis=1, keepdims=True)
    assert np.sum(mesh.vertex_normals * outward, axis=1).min() > 0.98


def test_unobserved_space_has_no_surface(views: list[View]) -> None:
    depth, camera = views[0]
    mesh = fuse([(depth, camera)], 0.02, progress=False)
    # The half of the sphere that faces the camera, and nothing that closes it behind.
    towards = (camera.origin - CENTRE) / np.linalg.norm(camera.origin - CENTRE)
    assert ((mesh.vertices - CENTRE) @ towards).min() > 0.0
    assert np.abs(radial_error(mesh)).max() < 0.02
    assert np.sum(mesh.face_normals @ towards < 0) == 0


def test_plane_has_its_depth_and_faces_the_camera() -> None:
    camera = Camera(K, np.eye(4))
    normal = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
    offset = normal @ [0.0, 0.0, 1.5]
    mesh = fuse([(offset / (camera.rays() @ normal), camera)], 0.02, progress=False)
    assert np.abs(mesh.vertices @ normal - offset).max() < 0.005
    np.testing.assert_allclose(mesh.vertex_normals @ normal, 1.0, atol=0.01)
    assert mesh.area > 0.8 * (1.5 * 160 / 140) * (1.5 * 120 / 140)


def test_order_of_frames_does_not_matter(views: list[View]) -> None:
    one, other = fuse(views, 0.04, progress=False), fuse(views[::-1], 0.04, progress=False)
    assert len(one.faces) == len(other.faces)
    np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-4)


def test_same_frames_give_the_same_bits(views: list[View]) -> None:
    one, other = fuse(views[:9], 0.04, progress=False), fuse(iter(views[:9]), 0.04, progress=False)
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.faces, other.faces)


def test_missing_readings_change_nothing_but_themselves(views: list[View]) -> None:
    rng = np.random.default_rng(3)
    spoilt = []
    for depth, camera in views:
        markers = rng.choice([np.nan, 0.0, 65.535, -1.0, np.inf], size=depth.shape)
        spoilt.append((np.where(rng.random(depth.shape) < 0.2, markers, depth), camera))
    mesh = fuse(spoilt, 0.04, progress=False)
    assert mesh.is_watertight
    assert np.abs(radial_error(mesh)).max() < 0.4 * 0.04


def test_flying_pixels_are_carved_away(views: list[View]) -> None:
    """A patch of false readings in front of the sphere, in one frame, is free space to all others."""
    depth, camera = views[0]
    false = depth.copy()
    false[50:70, 70:90] = 0.6
    mesh = fuse([(false, camera), *views[1:]], 0.04, progress=False)
    assert np.abs(radial_error(mesh)).max() < 0.04


def test_depth_jump_makes_no_sheet() -> None:
    camera = Camera(K, np.eye(4))
    depth = np.full(K.shape, 2.0)
    depth[:, :80] = 1.0
    # Between the two walls some pixels mix both depths, as sensors do.
    depth[:, 80] = 1.5
    mesh = fuse([(depth, camera)], 0.02, progress=False)
    z = mesh.vertices[:, 2]
    assert np.all((np.abs(z - 1.0) < 0.09) | (np.abs(z - 2.0) < 0.09))
    cleaned = clean_depth(depth, camera, 4.0)
    assert not cleaned[:, 79:82].any()
    assert cleaned[:, :78].all() and cleaned[:, 83:].all()


def test_view_cosine_of_a_slanted_plane() -> None:
    camera = Camera(K, np.eye(4))
    normal = np.array([0.6, 0.0, -0.8])
    rays = camera.rays()
    depth = normal @ [0.0, 0.0, 1.0] / (rays @ normal)
    expected = np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)
    inner = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(view_cosine(depth, camera)[inner], expected[inner], atol=0.005)


def test_result_passes_load_mesh(views: list[View], tmp_path: Path) -> None:
    mesh = fuse(views, 0.04, progress=False)
    save_mesh(tmp_path / "sphere.ply", mesh)
    back = load_mesh(tmp_path / "sphere.ply")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)  # already float32
    np.testing.assert_allclose(back.vertex_normals, mesh.vertex_normals, atol=1e-6)


def test_walls_on_the_grid_give_no_degenerate_triangles() -> None:
    """A wall exactly through grid points is marching cubes' worst case."""
    camera = Camera(K, np.eye(4))
    mesh = fuse([(np.full(K.shape, 1.6), camera)], 0.04, progress=False)
    assert not degenerate_faces(np.asarray(mesh.vertices), np.asarray(mesh.faces)).any()
    np.testing.assert_allclose(mesh.vertices[:, 2], 1.6, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"voxel": 0.0}, "0 < voxel"),
        ({"voxel": 0.1, "truncation": 0.05}, "truncation"),
        ({"voxel": 0.02, "max_depth": 0.5}, "not one depth reading"),
        ({"voxel": 0.0005}, "coarser voxel"),
    ],
)
def test_unusable_parameters(views: list[View], options: dict[str, float], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        fuse(views[:1], progress=False, **options)


def test_too_many_blocks_for_memory(views: list[View], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyjax.geometry.tsdf.MAX_BLOCKS", 100)
    with pytest.raises(InputError, match="coarser voxel"):
        fuse(views[:3], 0.02, progress=False)


def test_grid_too_large_for_marching_cubes(views: list[View], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyjax.geometry.surface.MAX_VOXELS", 10_000)
    with pytest.raises(InputError, match="coarser voxel"):
        fuse(views[:3], 0.02, progress=False)


def test_depth_that_does_not_fit_its_camera(views: list[View]) -> None:
    with pytest.raises(InputError, match=r"80x120.*160x120"):
        fuse([(np.ones((120, 80)), views[0][1])], 0.04, progress=False)


def test_frames_without_depth_or_surface(views: list[View]) -> None:
    with pytest.raises(InputError, match="not one depth reading"):
        fuse([], 0.04, progress=False)
    with pytest.raises(InputError, match="no surface"):
        fuse(views[:1], 0.04, min_weight=100.0, progress=False)


def test_all_surface_blocks_are_found(views: list[View]) -> None:
    """Culling by coarse maxima must not lose a block that holds a surface point."""
    depth, camera = views[5]
    volume = Volume(0.02, 0.08)
    with ThreadPoolExecutor(1) as pool:
        volume.integrate(depth, camera, 4.0, pool)
    allocated = set(map(tuple, volume.blocks()[0].tolist()))
    points = camera.unproject(depth)[clean_depth(depth, camera, 4.0) > 0]
    needed = set(map(tuple, np.floor(points / (8 * 0.02)).astype(int).tolist()))
    assert len(needed) > 20
    assert needed <= allocated


@pytest.mark.parametrize("number", [0, 5, 30])
def test_votes_are_those_of_plain_numpy(views: list[View], number: int) -> None:
    depth, camera = views[number]
    volume, voxel, truncation = Volume(0.03, 0.12), 0.03, 0.12
    with ThreadPoolExecutor(2) as pool:
        volume.integrate(depth, camera, 4.0, pool, np.full(depth.shape, 0.5))
    coordinates, mean, weights = volume.blocks()
    cells = np.indices((BLOCK_SIDE,) * 3).reshape(3, -1).T
    places = voxel * (BLOCK_SIDE * coordinates[:, None] + cells).reshape(-1, 3)
    clean = clean_depth(depth, camera, 4.0)
    own = 0.25 * view_cosine(clean, camera) / np.maximum(clean, 0.5) ** 2
    sums, expected = votes(places, clean, own, camera, voxel, truncation)
    close = np.isclose(weights.ravel(), expected, atol=1e-5)
    assert close.mean() > 0.9999 and (expected > 0).sum() > 1000  # one on a pixel's border may fall either way
    known = close & (expected > 1e-3)
    np.testing.assert_allclose(mean.ravel()[known], sums[known] / expected[known] / truncation, atol=1e-3)


def agreement(mesh: trimesh.Trimesh, depth: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Share of the readings that the mesh covers, and the median distance in depth there."""
    seen = RayCaster(mesh).gbuffer(camera)
    valid = (depth > 0.1) & (depth < 3.5)
    both = valid & np.asarray(seen.hit)
    return both.sum() / valid.sum(), float(np.median(np.abs(np.asarray(seen.depth) - depth)[both]))


@pytest.mark.slow
def test_kitchen_at_two_centimetres(kitchen: Path, tmp_path: Path) -> None:
    capture = open_capture(kitchen)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    mesh = fuse((capture.depth_reading(i) for i in range(len(capture))), 0.02, progress=False)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 600 * 2**10  # KiB
    assert 100_000 < len(mesh.faces) < 300_000
    save_mesh(tmp_path / "kitchen.ply", mesh)
    assert len(load_mesh(tmp_path / "kitchen.ply").faces) == len(mesh.faces)
    for i in (0, 130, 290):
        depth, camera, _ = capture.depth_reading(i)
        covered, off = agreement(mesh, depth, camera)
        assert covered > 0.9
        assert off < 0.01
