"""Pinhole cameras, and the G-buffers that Embree fills for them."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax import GBuffer, InputError
from hyjax.geometry.camera import Camera, Intrinsics, check_pose, look_at
from hyjax.geometry.raycast import RayCaster

seeds = st.integers(0, 2**31)
K = Intrinsics(741, 500, 600.0, 580.0, 371.3, 249.1)


def random_camera(seed: int, k: Intrinsics = K) -> Camera:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    pose[:3, :3] = q * np.sign(np.linalg.det(q))
    pose[:3, 3] = rng.normal(size=3)
    return Camera(k, pose)


@given(seeds)
def test_projection_round_trip(seed: int) -> None:
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.1, 10.0, K.shape)
    points = camera.unproject(depth)
    xy, back = camera.project(points)
    np.testing.assert_allclose(back, depth, rtol=1e-9)
    j, i = np.meshgrid(np.arange(K.width), np.arange(K.height))
    np.testing.assert_allclose(xy[..., 0], j + 0.5, atol=1e-8)  # pixel centres, not corners
    np.testing.assert_allclose(xy[..., 1], i + 0.5, atol=1e-8)


def test_projection_against_the_matrix() -> None:
    """xy = K R⁻¹ (p − t), and the axes are right, down, forward."""
    camera = random_camera(3)
    points = camera.origin + np.random.default_rng(0).normal(size=(50, 3))
    homogeneous = (K.matrix @ np.linalg.inv(camera.pose)[:3] @ np.c_[points, np.ones(50)].T).T
    xy, depth = camera.project(points)
    np.testing.assert_allclose(depth, homogeneous[:, 2], rtol=1e-9)
    np.testing.assert_allclose(xy, homogeneous[:, :2] / homogeneous[:, 2:], rtol=1e-7)
    straight = Camera(K, np.eye(4))
    np.testing.assert_allclose(straight.project(np.array([0.0, 0.0, 2.0]))[0], [K.cx, K.cy])
    right, _ = straight.project(np.array([0.1, 0.0, 2.0]))
    down, _ = straight.project(np.array([0.0, 0.1, 2.0]))
    assert right[0] > K.cx and down[1] > K.cy


@given(st.integers(0, 300), st.integers(0, 400), st.integers(1, 200), st.integers(1, 300))
def test_crop_keeps_rays(top: int, left: int, height: int, width: int) -> None:
    camera = random_camera(1)
    top, left = min(top, 249), min(left, 371)
    height, width = max(height, 250 - top), max(width, 372 - left)  # so that the principal point stays inside
    cropped = dataclasses.replace(camera, intrinsics=K.crop(top, left, height, width))
    whole = np.pad(camera.rays(), ((0, 600), (0, 600), (0, 0)), mode="edge")[
        top : top + height, left : left + width
    ]
    inside = (slice(0, min(height, 500 - top)), slice(0, min(width, 741 - left)))
    np.testing.assert_allclose(cropped.rays()[inside], whole[inside], atol=1e-12)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_resize_keeps_rays_to_half_a_pixel(factor: int) -> None:
    """The ray of a large pixel is the mean of the rays of the small pixels that it covers: no half-pixel drift."""
    k = Intrinsics(30 * factor, 20 * factor, 50.0 * factor, 48.0 * factor, 14.2 * factor, 10.7 * factor)
    camera = random_camera(2, k)
    small = dataclasses.replace(camera, intrinsics=k.resize(20, 30))
    cells = camera.rays().reshape(20, factor, 30, factor, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(small.rays(), cells, atol=1e-12)
    assert small.intrinsics.shape == (20, 30)
    # the corners of the image stay on the same rays, for a change of aspect too
    odd = k.resize(33, 17)
    np.testing.assert_allclose((17 - odd.cx) / odd.fx, (k.width - k.cx) / k.fx, rtol=1e-12)
    np.testing.assert_allclose(-odd.cy / odd.fy, -k.cy / k.fy, rtol=1e-12)


def test_look_at() -> None:
    eye, target, up = np.array([1.0, 2.0, 3.0]), np.array([-1.0, 0.5, 1.0]), np.array([0.0, 0.0, 1.0])
    camera = Camera(K, look_at(eye, target, up))
    np.testing.assert_allclose(camera.project(target)[0], [K.cx, K.cy], atol=1e-9)
    assert camera.project(target + 0.1 * up)[0][1] < K.cy  # up in the world is up in the picture
    np.testing.assert_allclose(camera.origin, eye)
    with pytest.raises(InputError, match=r"^look_at: .* parallel to `up`"):
        look_at(eye, eye + 2 * up, up)


@pytest.mark.parametrize("damage", ["scaled", "sheared", "mirrored", "nan", "row", "shape", "transposed shift"])
def test_poses_that_are_no_rigid_motion_are_refused(damage: str) -> None:
    pose = np.array(random_camera(0).pose)
    if damage == "scaled":
        pose[:3, :3] *= 1.01
    elif damage == "sheared":
        pose[0, 1] += 0.1
    elif damage == "mirrored":
        pose[:3, 0] *= -1
    elif damage == "nan":
        pose[1, 3] = np.nan
    elif damage == "row":
        pose[3, 3] = 2.0
    elif damage == "shape":
        pose = pose[:3]
    else:
        pose = pose.T + 0.0
        pose[3, 0] += 0.5
    with pytest.raises(InputError, match=r"^pose: "):
        Camera(K, pose)
    with pytest.raises(InputError, match=r"^frame 7: "):
        check_pose(pose, "frame 7")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "image size 0x500"),
        ({"fx": 0.0}, "focal lengths"),
        ({"fy": -3.0}, "focal lengths"),
        ({"fx": np.inf}, "focal lengths"),
        ({"cx": np.nan}, "."),
    ],
)
def test_intrinsics_that_do_not_fit_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=rf"^intrinsics: .*{message}"):
        dataclasses.replace(K, **change)


# ---- G-buffers ----


def fields(gbuffer: GBuffer) -> list[np.ndarray]:
    return [np.asarray(a) for a in (gbuffer.position, gbuffer.normal, gbuffer.depth, gbuffer.hit)]


def test_depth_of_a_plane_is_exact() -> None:
    """500×741, odd principal point: depth along the axis (not along the ray), position on the plane, on the ray."""
    quad = trimesh.Trimesh([[-9, -9, 3], [9, -9, 3], [9, 9, 3], [-9, 9, 3]], [[0, 1, 2], [0, 2, 3]], process=False)
    camera = Camera(K, look_at((0.2, 0.1, 0.0), (0.2, 0.1, 1.0), (0, -1, 0)))
    position, normal, depth, hit = fields(RayCaster(quad).gbuffer(camera))
    assert hit.shape == depth.shape == (500, 741) and position.shape == normal.shape == (500, 741, 3)
    assert hit.all()
    np.testing.assert_allclose(depth, 3.0, rtol=1e-6)
    np.testing.assert_allclose(position, camera.unproject(np.full(K.shape, 3.0)), atol=2e-6)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, -1.0], normal.shape), atol=1e-6)


@given(seeds)
def test_gbuffer_agrees_with_itself(seed: int) -> None:
    """From anywhere: position projects to the pixel, depth is its depth, normals are unit and on the side seen."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    k = Intrinsics(61, 45, 50.0, 52.0, 30.2, 22.9)
    rng = np.random.default_rng(seed)
    eye = rng.normal(size=3)
    eye *= rng.choice([0.3, 2.5]) / np.linalg.norm(eye)  # also from inside
    camera = Camera(k, look_at(eye, rng.normal(size=3) * 0.2, rng.normal(size=3)))
    position, normal, depth, hit = fields(RayCaster(mesh).gbuffer(camera))
    xy, z = camera.project(position[hit].astype(np.float64))
    i, j = np.nonzero(hit)
    np.testing.assert_allclose(xy, np.stack([j, i], axis=-1) + 0.5, atol=2e-3)
    np.testing.assert_allclose(z, depth[hit], rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normal[hit], axis=-1), 1.0, rtol=1e-5)
    # Smooth normals of a unit sphere, also at its silhouette, where a few lean away from the camera.
    outwards = np.sum(normal[hit] * position[hit], axis=-1)
    assert np.all(outwards * (1 if np.linalg.norm(eye) > 1 else -1) > 0.98)
    for field in (position, normal, depth):
        assert np.all(field[~hit] == 0)


def wavy_grid(n: int) -> trimesh.Trimesh:
    """A nearly flat sheet of n × n squares over [-1, 1]²."""
    i, j = np.mgrid[: n + 1, : n + 1]
    vertices = np.stack([2 * i / n - 1, 2 * j / n - 1, 0.01 * np.sin(i) * np.cos(j)], axis=-1).reshape(-1, 3)
    k = (i[:-1, :-1] * (n + 1) + j[:-1, :-1]).ravel()
    faces = np.r_[np.c_[k, k + n + 1, k + n + 2], np.c_[k, k + n + 2, k + 1]]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("along", [0.0, 0.25, 0.5], ids=["vertices", "quarters", "middles"])
@pytest.mark.parametrize("kind", ["sphere", "sheet"])
def test_no_pin_holes(kind: str, along: float) -> None:
    """Rays aimed exactly at the vertices, edge middles and edge quarters of fine meshes never slip through."""
    if kind == "sphere":
        mesh, eye = trimesh.creation.icosphere(subdivisions=5), np.array([0.013, -0.2, 0.07])
    else:
        mesh, eye = wavy_grid(64), np.array([0.3, 0.2, 2.0])
    a, b = np.asarray(mesh.vertices)[mesh.edges_unique].transpose(1, 0, 2)
    targets = a + along * (b - a)
    if kind == "sheet":
        targets = targets[np.abs(targets[:, :2]).max(axis=1) < 0.99]
    hits = RayCaster(mesh).cast(eye, targets - eye)
    assert hits.hit.all(), f"{np.sum(~hits.hit)} of {len(targets)} rays slip through"
    np.testing.assert_allclose(hits.distance, 1.0, rtol=1e-5)


def test_a_face_on_picture_has_no_holes() -> None:
    """A fine grid aligned with the pixels, so that rays run through its vertices: every pixel is hit."""
    n = 64
    i, j = np.mgrid[: n + 1, : n + 1]
    vertices = np.stack([(j - n / 2) / n, (i - n / 2) / n, np.ones_like(i)], axis=-1).reshape(-1, 3)
    k = (i[:-1, :-1] * (n + 1) + j[:-1, :-1]).ravel()
    mesh = trimesh.Trimesh(
        vertices, np.r_[np.c_[k, k + n + 1, k + n + 2], np.c_[k, k + n + 2, k + 1]], process=False
    )
    for shift in (0.0, 0.5):
        k = Intrinsics(n - 1, n - 1, n, n, n / 2 - shift, n / 2 - shift)
        assert np.all(RayCaster(mesh).gbuffer(Camera(k, np.eye(4))).hit)


def test_occlusion_distance_and_misses() -> None:
    caster = RayCaster(trimesh.creation.box(extents=(1, 1, 1)))
    ways = np.array([[0.0, 0, -1], [0.0, 0, 1], [0.0, 0, -2]])
    origin = np.array([0.0, 0.0, 3.0])
    hits = caster.cast(origin, ways)
    np.testing.assert_array_equal(hits.hit, [True, False, True])
    np.testing.assert_allclose(hits.distance, [2.5, np.inf, 1.25], rtol=1e-6)
    np.testing.assert_array_equal(caster.occluded(origin, ways), [True, False, True])
    np.testing.assert_array_equal(caster.occluded(origin, ways, 2.4), [False, False, True])
    np.testing.assert_array_equal(caster.interpolated_normals(hits)[1], 0.0)
