"""The simulated scan: repeatable, worse than the truth in the ways it says, and no worse."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.mesh import degenerate_faces, load_mesh, save_mesh
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.scan import RenderedDepths, ScanConfig, simulate_scan, simulate_sensor
from hyjax.util.errors import InputError

K = Intrinsics(160, 120, 140.0, 140.0, 80.0, 60.0)
PERFECT = ScanConfig(
    width=160, noise=0, jitter=0, step=0, border_dropout=0, grazing_cosine=0, dark=0, drift=0, turn=0, missing=0
)


@pytest.fixture(scope="module")
def room() -> RenderedDepths:
    """A 4×3×2.5 m box with a smaller one on its floor, seen from its middle in 24 directions."""
    walls = trimesh.creation.box((4.0, 3.0, 2.5))
    walls.invert()
    chest = trimesh.creation.box((0.8, 0.6, 0.7))
    chest.apply_translation((1.2, 0.0, -0.9))
    mesh = trimesh.util.concatenate([walls, chest])
    up = np.array([0.0, 0.0, 1.0])
    targets = [(np.cos(a), np.sin(a), z) for z in (-0.5, 0.3) for a in np.arange(12) * np.pi / 6]
    return RenderedDepths(mesh, [Camera(K, look_at(np.zeros(3), np.array(t), up)) for t in targets])


def test_same_seed_same_mesh_other_seed_another(room: RenderedDepths) -> None:
    first, again, other = (simulate_scan(room, seed=seed, progress=False) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert first.vertices.shape != other.vertices.shape or not np.array_equal(first.vertices, other.vertices)


def test_scan_is_coarse_near_the_truth_and_passes_load_mesh(room: RenderedDepths, tmp_path: Path) -> None:
    config = ScanConfig()
    mesh = simulate_scan(room, config, seed=4, progress=False)
    assert 0.6 * config.edge < mesh.edges_unique_length.mean() < 1.6 * config.edge
    assert not degenerate_faces(np.asarray(mesh.vertices), np.asarray(mesh.faces)).any()
    depth, camera = room[3]
    seen = RayCaster(mesh).gbuffer(camera)
    assert np.mean(seen.hit) > 0.75
    error = np.abs(np.asarray(seen.depth) - depth)[np.asarray(seen.hit)]
    assert 0.001 < np.median(error) < 0.05
    save_mesh(tmp_path / "scan.ply", mesh)
    assert len(load_mesh(tmp_path / "scan.ply").faces) == len(mesh.faces)


def test_normals_face_the_inside_of_the_room(room: RenderedDepths) -> None:
    mesh = simulate_scan(room, progress=False)
    inwards = np.sum(mesh.face_normals * -mesh.triangles_center, axis=1) > 0
    assert mesh.area_faces[inwards].sum() > 0.95 * mesh.area


def test_missing_share_is_torn_out(room: RenderedDepths) -> None:
    whole = simulate_scan(room, PERFECT, progress=False)
    torn = simulate_scan(room, dataclasses.replace(PERFECT, missing=0.2), progress=False)
    assert 0.7 < torn.area / whole.area < 0.82


def test_perfect_sensor_returns_the_depth_and_pose(room: RenderedDepths) -> None:
    depth, camera = room[3]
    read, believed = simulate_sensor(room[3], PERFECT, np.random.default_rng(0))
    np.testing.assert_allclose(read, depth, rtol=1e-6)
    np.testing.assert_allclose(believed.pose, camera.pose, atol=1e-12)


def flat(distance: float) -> tuple[np.ndarray, Camera]:
    return np.full(K.shape, distance), Camera(K, np.eye(4))


def test_noise_grows_with_the_square_of_depth() -> None:
    config = dataclasses.replace(PERFECT, noise=0.01)
    spread = [simulate_sensor(flat(z), config, np.random.default_rng(0))[0].std() for z in (1.0, 3.0)]
    assert spread[0] == pytest.approx(0.01, rel=0.1)
    assert spread[1] == pytest.approx(0.09, rel=0.1)


def test_values_come_in_steps() -> None:
    config = dataclasses.replace(PERFECT, noise=0.01, step=0.005)
    values = np.unique(simulate_sensor(flat(2.0), config, np.random.default_rng(0))[0])
    assert 3 < len(values) < 40
    multiple = 1.0 / values / 0.005
    np.testing.assert_allclose(multiple, np.round(multiple), atol=1e-3)


def test_grazing_border_and_range_are_lost() -> None:
    camera = Camera(K, np.eye(4))
    normal = np.array([0.0, np.cos(0.1), -np.sin(0.1)])  # 6° from edge-on
    slant = normal @ [0.0, 0.0, 2.0] / (camera.rays() @ normal)
    config = dataclasses.replace(PERFECT, grazing_cosine=0.5)
    readable = (slant > 0) & (slant < 4)
    lost = (simulate_sensor((slant, camera), config, np.random.default_rng(0))[0] == 0) & readable
    kept = simulate_sensor((slant, camera), PERFECT, np.random.default_rng(0))[0] > 0
    assert lost.sum() > 0.3 * readable.sum()
    np.testing.assert_array_equal(kept, readable)
    step = np.where(np.arange(K.width) < 80, 1.0, 2.0) * np.ones(K.shape)
    config = dataclasses.replace(PERFECT, border_dropout=0.9)
    columns = np.flatnonzero(
        (simulate_sensor((step, camera), config, np.random.default_rng(0))[0] == 0).any(axis=0)
    )
    assert 78 in columns and set(columns) <= set(range(77, 83))


@dataclasses.dataclass(frozen=True)
class Pictured:
    """A frame with a picture, as `hyjax.data.Frame` has one."""

    image: np.ndarray
    depth: np.ndarray
    depth_camera: Camera
    confidence: None = None


def test_dark_surfaces_are_lost_in_half_the_pixels() -> None:
    depth, camera = flat(2.0)
    image = np.ones((240, 320, 3))
    image[:, :160] = 0.0
    config = dataclasses.replace(PERFECT, dark=0.1)
    read, _ = simulate_sensor(Pictured(image, depth, camera), config, np.random.default_rng(0))
    assert np.mean(read[:, :80] == 0) == pytest.approx(0.5, abs=0.05)
    assert np.all(read[:, 80:] > 0)


def test_few_frames_are_taken_evenly() -> None:
    asked: list[int] = []

    class Recorder:
        def __len__(self) -> int:
            return 100

        def __getitem__(self, index: int) -> tuple[np.ndarray, Camera]:
            asked.append(index)
            return flat(1.5)

    simulate_scan(Recorder(), dataclasses.replace(PERFECT, frames=4), progress=False)
    assert asked == [0, 33, 66, 99]


@pytest.mark.parametrize(("name", "value"), [("voxel", 0.0), ("noise", -1.0), ("missing", 1.0), ("frames", 0)])
def test_unusable_configuration_is_named(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"scan: {name} is {value}"):
        dataclasses.replace(ScanConfig(), **{name: value})


def test_depth_is_rendered_once_for_all_scans_of_it(room: RenderedDepths, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = RenderedDepths(room._caster.mesh, room._cameras[:2])
    first = [np.asarray(depth) for depth, _ in frames]
    monkeypatch.setattr(frames._caster, "gbuffer", None)
    for depth, (again, _) in zip(first, frames, strict=True):
        np.testing.assert_array_equal(depth, again)


def test_nothing_to_scan(room: RenderedDepths) -> None:
    with pytest.raises(InputError, match="no frames"):
        simulate_scan([], progress=False)


@pytest.mark.slow
def test_kitchen_scan_is_recognisable(kitchen: Path) -> None:
    capture = open_capture(kitchen)
    mesh = simulate_scan(capture, seed=1, progress=False)
    assert 2_000 < len(mesh.faces) < 12_000
    frame = capture[130]
    assert frame.depth is not None
    seen = RayCaster(mesh).gbuffer(frame.camera)
    both = np.asarray(seen.hit) & (frame.depth > 0)
    assert both.sum() > 0.75 * (frame.depth > 0).sum()
    # Worse than its voxel nowhere on average, and visibly worse than the sensor.
    assert 0.005 < np.median(np.abs(np.asarray(seen.depth) - frame.depth)[both]) < 0.06
