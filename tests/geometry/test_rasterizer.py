"""The rasteriser against rays: pictures, shadow maps in all projections, closed surfaces."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax.geometry import rasterizer
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.rasterizer import Rasterizer, camera_view
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, RectLight, SkyLight, SpotLight
from hyjax.util.errors import InputError
from tests.reference.texel_rays import texel_distances

seeds = st.integers(0, 2**31)
WHITE = np.ones(3, np.float32)
FIELDS = "position", "normal", "depth", "hit", "face", "barycentric"


def rotation(rng: np.random.Generator) -> np.ndarray:
    return trimesh.transformations.random_rotation_matrix(rng.random(3))


def clutter(rng: np.random.Generator, centre: np.ndarray | float = 0.0) -> trimesh.Trimesh:
    """A room with balls, boxes and loose triangles of all sizes, also across the eye's plane."""
    parts = [trimesh.creation.box(extents=(6.0, 5.0, 4.0), transform=rotation(rng))]
    parts += [
        trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.05, 0.6)).apply_translation(
            rng.uniform(-2.0, 2.0, 3)
        )
        for _ in range(4)
    ]
    triangles = rng.uniform(-2.5, 2.5, (40, 1, 3)) + rng.normal(size=(40, 3, 3)) * rng.choice([0.02, 0.3, 2.0])
    parts.append(trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(120).reshape(-1, 3), process=False))
    whole: trimesh.Trimesh = trimesh.util.concatenate(parts)
    whole.apply_translation(np.zeros(3) + centre)
    return trimesh.Trimesh(whole.vertices, whole.faces, process=False)


def camera_in(rng: np.random.Generator, centre: np.ndarray | float = 0.0) -> Camera:
    width, height = rng.integers(1, 130, 2)
    k = Intrinsics(
        int(width), int(height), *rng.uniform(20.0, 200.0, 2), *(rng.uniform(-0.5, 1.5, 2) * (width, height))
    )
    pose = rotation(rng)
    pose[:3, 3] = rng.uniform(-1.5, 1.5, 3) + centre
    return Camera(k, pose)


def beside_edges(mesh: trimesh.Trimesh, camera: Camera, pixels: float) -> np.ndarray:
    """Pixels around whose centres, so near, rays do not all meet the same triangle."""
    k, caster = camera.intrinsics, RayCaster(mesh)
    shifts = pixels * np.array([(0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)])
    found = []
    for dx, dy in shifts:
        lens = Intrinsics(k.width, k.height, k.fx, k.fy, k.cx + dx, k.cy + dy)
        rays = Camera(lens, camera.pose).rays().reshape(-1, 3)
        found.append(caster.cast(camera.origin, rays).face.reshape(k.shape))
    return np.ptp(found, axis=0) > 0


@given(seeds, st.sampled_from([0.0, 1000.0]), st.sampled_from([RayCaster.gbuffer, RayCaster.gbuffer_by_rays]))
@settings(max_examples=40)
def test_pictures_are_those_of_rays(seed: int, away: float, method: Callable[..., GBuffer]) -> None:
    rng = np.random.default_rng(seed)
    centre = np.full(3, away)
    mesh, camera = clutter(rng, centre), camera_in(rng, centre)
    caster = RayCaster(mesh)
    gbuffer = method(caster, camera)
    seen = {name: np.asarray(getattr(gbuffer, name)) for name in FIELDS}
    rays = camera.rays()
    hits = caster.cast(camera.origin, rays.reshape(-1, 3))
    # Float32 of a ray of Embree and of a mesh far from the origin is what these compare to.
    sure = ~beside_edges(mesh, camera, 1e-3) & (hits.face == seen["face"].reshape(-1)).reshape(rays.shape[:2])
    differ = ~beside_edges(mesh, camera, 1e-3) & (hits.face != seen["face"].reshape(-1)).reshape(rays.shape[:2])
    assert differ.sum() <= 1e-3 * differ.size + 1, "where two triangles cross"
    hit = sure & seen["hit"]
    assert np.array_equal(seen["hit"], seen["face"] >= 0)
    distance = hits.distance.reshape(hit.shape)[hit]
    np.testing.assert_allclose(seen["depth"][hit], distance, rtol=2e-4)
    reached = (camera.origin + rays * seen["depth"][..., None])[hit]
    np.testing.assert_allclose(seen["position"][hit], reached, atol=1e-5 + 1e-6 * away)
    corners = mesh.triangles[seen["face"][hit]]
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", seen["barycentric"][hit], corners), reached, atol=2e-4)
    assert np.all(seen["barycentric"] >= 0)
    normal = np.einsum("nk,nkd->nd", seen["barycentric"][hit], mesh.vertex_normals[mesh.faces[seen["face"][hit]]])
    long = np.linalg.norm(normal, axis=1) > 1e-3
    normal = normal[long] / np.linalg.norm(normal[long], axis=1, keepdims=True)
    plane = mesh.face_normals[seen["face"][hit][long]]
    away_from = (np.sum(plane * rays[hit][long], axis=1) > 0) != (np.sum(plane * normal, axis=1) < 0)
    clear = np.abs(np.sum(plane * normal, axis=1)) > 1e-4
    expected = np.where(away_from[:, None], -normal, normal)
    np.testing.assert_allclose(seen["normal"][hit][long][clear], expected[clear], atol=1e-4)
    for name in ("position", "normal", "depth", "barycentric"):
        assert not seen[name][~seen["hit"]].any()


@given(seeds)
@settings(max_examples=30)
def test_a_closed_surface_has_no_hole(seed: int) -> None:
    """Also where edges and vertices lie exactly on pixels' centres, and from a vertex' very neighbourhood."""
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    mesh = box.subdivide_loop(int(rng.integers(0, 3))) if seed % 2 else box.subdivide().subdivide()
    k = Intrinsics(64, 64, 32.0, 32.0, 32.5, 32.5)
    eyes = [np.zeros(3), rng.uniform(-0.6, 0.6, 3), np.array([0.5, 0.5, 0.0]), np.array([0.999, 0.0, 0.0])]
    for eye in eyes[: 3 if seed % 2 else 4]:
        for towards in (np.eye(3)[0], -np.eye(3)[1], rng.normal(size=3)):
            gbuffer = RayCaster(mesh).gbuffer(Camera(k, look_at(eye, eye + towards, (0.1, 0.2, 1.0))))
            assert np.all(gbuffer.hit)
        lamp = PointLight(eye.astype(np.float32), np.float32(1.0), WHITE)
        layout = MapLayout.of(lamp.shadow_views(), 0.0625, mesh.bounds)
        assert np.isfinite(layout.cast(RayCaster(mesh)).depth).all()


def test_empty_views_and_triangles_without_area() -> None:
    flat = np.array([[0, 0, 2], [1, 0, 2], [2, 0, 2], [0, 0, 2], [0.0, 1.0, 2.0]])
    camera = Camera(Intrinsics(9, 7, 5.0, 5.0, 4.5, 3.5), np.eye(4))
    rasterizer_ = Rasterizer(flat, np.array([[0, 1, 2], [0, 3, 4], [1, 1, 1]]))
    assert not np.asarray(rasterizer_.gbuffer(camera, np.zeros((5, 3), np.float32)).hit).any()
    behind = Rasterizer(flat * [1, 1, -1], np.array([[0, 1, 4]]))
    assert np.isinf(behind.distances(camera_view(camera))).all()
    assert np.isfinite(Rasterizer(flat, np.array([[0, 1, 4]])).distances(camera_view(camera))).any()


def test_a_table_seen_edge_on_leaves_no_pixel_without_a_number() -> None:
    """A level camera at the height of a table's top, in whose plane pixel centres lie."""
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 5), np.linspace(0.9, 2.6, 6), indexing="ij")
    corners = (np.arange(4)[:, None] * 6 + np.arange(5)).reshape(-1, 1)
    faces = (corners + np.array([[0, 1, 6, 1, 7, 6]])).reshape(-1, 3)
    rng, lens = np.random.default_rng(0), Intrinsics(161, 121, 150.0, 150.0, 80.5, 60.5)
    for _ in range(60):
        height = round(float(rng.uniform(-0.5, 0.5)), 2)
        top = trimesh.Trimesh(np.stack([x, y, np.full_like(x, height)], -1).reshape(-1, 3), faces, process=False)
        mesh = trimesh.util.concatenate([trimesh.creation.box((8, 8, 3)), top])
        eye = np.array([rng.uniform(-0.3, 0.3), -1.0, height])
        toward = eye + np.array([rng.uniform(-0.2, 0.2), 1.0, 0.0])
        found = RayCaster(mesh).gbuffer(Camera(lens, look_at(eye, toward, np.array([0.0, 0.0, 1.0]))))
        for part in (found.depth, found.position, found.normal, found.barycentric):
            assert np.isfinite(np.asarray(part)).all()
        np.testing.assert_array_equal(np.asarray(found.face) >= 0, np.asarray(found.hit))


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    mesh, camera = clutter(rng), camera_in(rng)
    mesh = trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[::-1]]), process=False)
    caster = RayCaster(mesh)
    found = []
    for count in (1, 2, 5):
        monkeypatch.setattr(rasterizer, "cores", lambda count=count: count)
        found.append(caster.gbuffer(camera))
    for other in found[1:]:
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found[0], name), getattr(other, name))
    assert np.asarray(found[0].face).max() < len(mesh.faces) // 2, "the lower number where two are equally near"


INWARDS = np.array([0.2, 1.0, -0.4])
WINDOW = Aperture.facing(np.array([0.1, -1.2, 0.4]), INWARDS, np.array([0.0, 0.0, 1.0]), 1.2, 0.8)
HERE, DOWN = np.array([0.3, -0.2, 0.5], np.float32), np.array([-0.3, 0.6, -1.0], np.float32)
FLUX = np.asarray(800.0, np.float32)
LIGHTS: dict[str, Light] = {
    "octahedral": PointLight(HERE, FLUX, WHITE, np.asarray(0.1, np.float32)),
    "octahedral with clearance": PointLight(HERE, FLUX, WHITE, clearance=np.asarray(0.8, np.float32)),
    "hemisphere": RectLight.filling(WINDOW, FLUX, WHITE),
    "hemisphere with clearance": SpotLight(
        HERE, DOWN, FLUX, WHITE, 0.4, 1.4, clearance=np.asarray(0.5, np.float32)
    ),
    "perspective": SpotLight(HERE, DOWN, FLUX, WHITE, 0.4, 0.7),
    "orthographic": SkyLight(np.array([0.0, 0.0, 1.0], np.float32), FLUX, WHITE),
    "orthographic with aperture": DirectionalLight(
        np.array([0.1, 0.8, -0.6], np.float32), FLUX, WHITE, np.asarray(0.01, np.float32), WINDOW
    ),
}


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("scale", [0.25, 0.1230])
def test_shadow_maps_are_those_of_rays(name: str, scale: float) -> None:
    """All texels, gutter included, but for a few at silhouettes."""
    mesh = clutter(np.random.default_rng(5))
    views = LIGHTS[name].shadow_views()
    assert views is not None
    layout = MapLayout.of(views, scale, mesh.bounds)
    assert name.startswith(layout.projection)
    caster = RayCaster(mesh)
    depth = np.asarray(layout.cast(caster).depth)
    rays = np.stack([texel_distances(layout, view, caster) for view in range(layout.count)]).reshape(depth.shape)
    with np.errstate(invalid="ignore"):
        same = (depth == rays) | (np.abs(depth - rays) < 1e-4 * np.maximum(np.abs(rays), 1.0))
    assert (~same).mean() < 1e-3
    for border in (same[:, 0], same[:, -1], same[:, :, 0], same[:, :, -1]):
        assert (~border).mean() < 0.02
    assert np.isfinite(depth).mean() > 0.0


def test_a_tree_is_built_once_and_by_the_first_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    from hyjax.geometry import raycast

    built: list[int] = []
    make = raycast.rtcore_scene.EmbreeScene
    monkeypatch.setattr(raycast.rtcore_scene, "EmbreeScene", lambda **options: built.append(1) or make(**options))
    mesh = clutter(np.random.default_rng(1))
    caster = RayCaster(mesh)
    caster.gbuffer(camera_in(np.random.default_rng(2)))
    assert not built
    rays = np.eye(3)
    threads = [threading.Thread(target=caster.cast, args=(np.zeros(3), rays)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(built) == 1


@pytest.mark.slow
def test_a_damaged_or_refused_cache_of_kernels_costs_only_time(tmp_path: Path) -> None:
    code = """if True:
        import numpy as np
        from hyjax.geometry.camera import Camera, Intrinsics
        from hyjax.geometry.rasterizer import Rasterizer, camera_view
        corners = np.array([[0, 0, 2], [1, 0, 2], [0, 1.0, 2.0]])
        view = camera_view(Camera(Intrinsics(9, 7, 5.0, 5.0, 4.5, 3.5), np.eye(4)))
        print(np.isfinite(Rasterizer(corners, np.array([[0, 1, 2]])).distances(view)).sum())
    """

    def drawn(cache: Path) -> str:
        environment = {**os.environ, "HYJAX_CACHE": str(cache)}
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=200
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    whole = drawn(tmp_path)
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert int(whole) > 2 and files
    for file in files:
        file.write_bytes(file.read_bytes()[:7])
    assert drawn(tmp_path) == whole
    (tmp_path / "file").write_text("no folder")
    assert drawn(tmp_path / "file") == whole


def test_whoever_keeps_depth_keeps_nothing_else() -> None:
    """Arrays of a G-buffer share no memory: depth maps of a walk may be kept by the hundred."""
    mesh = trimesh.creation.icosphere(2)
    seen = RayCaster(mesh).gbuffer(Camera(Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0), np.eye(4)))
    for part in (seen.position, seen.normal, seen.depth, seen.hit, seen.face):
        owner = np.asarray(part)
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        assert owner.nbytes < 1.1 * np.asarray(part).nbytes + 128


def test_a_mesh_is_checked_and_copied() -> None:
    sphere, camera = trimesh.creation.icosphere(2), Camera(Intrinsics(32, 24, 25.0, 25.0, 16.0, 12.0), np.eye(4))
    vertices, faces = np.array(sphere.vertices), np.array(sphere.faces)
    for bad in (-1, len(vertices)):
        wrong = faces.copy()
        wrong[3, 1] = bad
        with pytest.raises(InputError, match="triangles name vertices"):
            Rasterizer(vertices, wrong)
    with pytest.raises(InputError, match="no triangles"):
        RayCaster(trimesh.Trimesh())
    for part in (vertices, faces):
        part.flags.writeable = False
    drawn = Rasterizer(vertices, faces)
    vertices.flags.writeable = True
    normals = np.array(sphere.vertex_normals)
    before = np.asarray(drawn.gbuffer(camera, normals).depth)
    vertices[:] += 100.0
    assert np.array_equal(drawn.gbuffer(camera, normals).depth, before) and (before > 0).any()
