"""Alignment of a capture: a phone's drift is taken out where held-out depth says so."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import small_frame, spread
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import KINECT, PHONE_LIDAR
from hyjax.geometry.raycast import RayCaster
from hyjax.scene import alignment, surfaces
from hyjax.scene.alignment import AlignedCapture, aligned
from hyjax.scene.fusion import coverage_of, fuse_capture, plan_fusion
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.photo_light import FRAME_COUNT
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings

LENS = Intrinsics(96, 72, 80.0, 80.0, 48.0, 36.0)
UP = np.array([0.0, 0.0, 1.0])


class Drifting(Capture):
    """A walk in a corner of a room; the told poses drift away from the true ones by `metres`.

    Its pictures are grey, or show a pattern on the walls.
    """

    name, up, fingerprint, sensor = "walk", UP, "", PHONE_LIDAR

    def __init__(self, metres: float, count: int = 16, *, pattern: bool = False) -> None:
        room = trimesh.creation.box((4, 4, 3)).subdivide()
        room.invert()
        box = trimesh.creation.box((0.5, 0.5, 1.2))
        box.apply_translation([1.1, 0.9, -0.9])
        self._caster, self._metres, self._count = RayCaster(trimesh.util.concatenate([room, box])), metres, count
        self.fingerprint, self._pattern = f"{metres} {count} {pattern}", pattern

    def __len__(self) -> int:
        return self._count

    def true(self, index: int) -> Camera:
        turn = index / (self._count - 1)
        return Camera(LENS, look_at(np.array([turn - 1.0, -0.8, 0.2]), np.array([1.5, 0.5 + turn / 2, -0.8]), UP))

    def camera(self, index: int) -> Camera:
        pose = self.true(index).pose.copy()
        pose[:3, 3] += self._metres * np.array([1.0, -0.6, 0.3]) * (index / (self._count - 1) - 0.5)
        return Camera(LENS, pose)

    def __getitem__(self, index: int) -> Frame:
        if not 0 <= index < self._count:
            raise IndexError
        seen = self._caster.gbuffer(self.true(index))
        depth, picture = np.asarray(seen.depth), np.full((*LENS.shape, 3), 0.5, np.float32)
        if self._pattern:
            x, y, z = np.moveaxis(np.asarray(seen.position), -1, 0)
            picture += (0.4 * np.sin(17 * x + 3 * np.sin(4 * y)) * np.sin(15 * y + 5 * z))[..., None]
        return Frame(f"{index}", picture, self.camera(index), index / 10, depth)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def covered(capture: Capture) -> float:
    return coverage_of(
        capture, fuse_capture(capture, plan_fusion(capture, FusionSettings()), progress=False)
    ).covered


def test_drift_is_taken_out(cache: Path) -> None:
    capture = Drifting(0.12)
    found = aligned(capture, FusionSettings(), progress=False)
    assert isinstance(found, AlignedCapture) and covered(found) > covered(capture) + 0.005
    steps = [np.linalg.norm(c.camera(15).origin - c.camera(0).origin) for c in (capture, found)]
    true = np.linalg.norm(capture.true(15).origin - capture.true(0).origin)
    assert abs(steps[1] - true) < 0.5 * abs(steps[0] - true)
    assert found.fingerprint != capture.fingerprint and 0.005 < np.median(found.moved) < 0.1
    for index in (0, 7):
        np.testing.assert_allclose(found[index].camera.pose, found.camera(index).pose)
        np.testing.assert_allclose(found.depth_reading(index).camera.pose, found.camera(index).pose)
    (file,) = cache.glob("alignment-*.npz")
    stamp = file.stat().st_mtime_ns
    assert aligned(found, FusionSettings(), progress=False) is found  # once is enough
    again = aligned(capture, FusionSettings(), progress=False)
    assert file.stat().st_mtime_ns == stamp and again.fingerprint == found.fingerprint


def test_pictures_agree_better_by_aligned_poses() -> None:
    capture = Drifting(0.12, pattern=True)
    found = aligned(capture, FusionSettings(), progress=False)
    assert isinstance(found, AlignedCapture)
    with alignment.posed_pictures(capture, 5.0) as pictures:
        tracked, corrected = alignment.agreements(pictures(), [capture, found]).mean(axis=0)
    assert corrected > max(tracked + 0.01, 0.99)


def test_pictures_that_judged_poses_are_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    read, frame = list[int](), Drifting.__getitem__

    def counted(self: Drifting, index: int) -> Frame:
        read.append(index)
        return frame(self, index)

    capture = Drifting(0.12, pattern=True)
    found = aligned(capture, FusionSettings(), progress=False)
    expected = [found[index] for index in range(len(capture))]
    monkeypatch.setattr(Drifting, "__getitem__", counted)
    small = [small_frame(found, index) for index in range(len(capture))]
    assert not read and not capture.__dict__["_small_frames"]
    for count in (30, 95, 300, 1001):  # of any walk
        assert set(spread(range(count), FRAME_COUNT)) <= set(spread(range(count), alignment.MOST_PICTURES))
    for mine, whole in zip(small, expected, strict=True):
        np.testing.assert_array_equal(mine.image, whole.image)
        np.testing.assert_array_equal(mine.camera.pose, whole.camera.pose)
        assert mine.depth is None


@pytest.mark.parametrize("pattern", [False, True])
def test_poses_without_drift_stay(pattern: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = Drifting(0.0, pattern=pattern)
    assert aligned(capture, FusionSettings(), progress=False) is capture
    monkeypatch.setattr(alignment, "_align", lambda *_: pytest.fail("that they stay is kept"))
    assert aligned(capture, FusionSettings(), progress=False) is capture


def test_a_better_surface_alone_does_not_move_poses(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Maps that are registered to each other, and pictures that then agree less."""

    def pushed(readings: list[DepthReading], *_: object, **__: object) -> list[DepthReading]:
        shifts = 0.08 * np.random.default_rng(0).standard_normal((len(readings), 3)) * (1, 1, 0)
        poses = [
            reading.camera.pose + np.pad(shift[:, None], ((0, 1), (3, 0)))
            for reading, shift in zip(readings, shifts)
        ]
        return [reading._replace(camera=Camera(LENS, pose)) for reading, pose in zip(readings, poses, strict=True)]

    monkeypatch.setattr(alignment, "register", pushed)
    monkeypatch.setattr(alignment.Coverage, "of", lambda *_: pytest.fail("is not asked"))
    capture = Drifting(0.0, pattern=True)
    assert aligned(capture, FusionSettings(align="yes"), progress=False) is capture
    assert "poses are taken as they are: neighbouring pictures" in caplog.text


def test_corrections_are_smoothed_along_the_walk() -> None:
    motions, origins = np.tile(np.eye(4), (9, 1, 1)), np.random.default_rng(0).uniform(-3, 3, (9, 3))
    motions[4, :3, 3] = 0.0, 0.0, 0.1
    found = alignment.smoothed(motions, origins, 4.0)
    assert 0.01 < found[4, 2, 3] < 0.03 and found[:, 2, 3].sum() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(
        alignment.smoothed(np.tile(found[4], (9, 1, 1)), origins, 4.0)[0], found[4], atol=1e-9
    )


def test_only_phones_are_aligned_unless_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    asked: list[str] = []
    nothing = {"corrections": np.zeros((0, 4, 4))}
    monkeypatch.setattr(alignment, "_align", lambda capture, *_: asked.append(capture.sensor.name) or nothing)
    capture = Drifting(0.1)
    assert aligned(capture, FusionSettings(align="no"), progress=False) is capture and not asked
    capture.sensor = KINECT
    assert aligned(capture, FusionSettings(), progress=False) is capture and not asked
    assert aligned(capture, FusionSettings(align="yes"), progress=False) is capture and asked == ["Kinect"]
    few = Drifting(0.1, count=4)
    assert aligned(few, FusionSettings(align="yes"), progress=False) is few and len(asked) == 1
    assert "needs 8 depth maps, there are 4" in caplog.text


def test_corrections_are_interpolated_between_depth_maps() -> None:
    capture, corrections = Drifting(0.1), np.tile(np.eye(4), (3, 1, 1))
    corrections[:, 0, 3] = 0.0, 0.04, 0.1
    found = AlignedCapture(capture, np.array([0, 5, 10]), corrections)
    moved = [(found.camera(k).origin - capture.camera(k).origin)[0] for k in (0, 2, 5, 10, 15)]
    np.testing.assert_allclose(moved, [0.0, 0.016, 0.04, 0.1, 0.1], atol=1e-12)


@pytest.mark.slow
def test_a_real_scan_is_fused_better(scanner3d_chair: Path) -> None:
    capture = open_capture(scanner3d_chair)
    found = aligned(capture, FusionSettings(), progress=False)
    assert isinstance(found, AlignedCapture) and len(found) == 24 and found.depth_count == 70
    assert covered(found) > covered(capture) + 0.02
    assert 0.01 < np.median(found.moved) < 0.1


class WithMesh(Drifting):
    """A walk with the device's mesh of a part of the room, where the told poses put it."""

    has_mesh = True

    def mesh(self) -> trimesh.Trimesh:
        floor = trimesh.creation.box((4, 4, 0.1))
        floor.apply_translation([0.0, 0.0, -1.55])
        return floor


@pytest.mark.parametrize("gain", [0.03, 2.0])
def test_a_devices_mesh_keeps_the_devices_poses(gain: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was made with them: only a fusion goes with aligned ones."""
    monkeypatch.setattr(surfaces, "LEAST_GAIN", gain)
    shift = np.eye(4)
    shift[0, 3] = 0.05
    monkeypatch.setattr(alignment, "_align", lambda *_: {"corrections": np.tile(shift, (4, 1, 1))})
    capture = WithMesh(0.0, count=8)
    scene = Scene.open(SceneSettings(fusion=FusionSettings(voxel=0.1)), capture=capture)
    fused = scene.source.startswith("fusion")
    assert fused == (gain < 1)
    moved = np.linalg.norm(scene.frame(0).camera.origin - capture.camera(0).origin)
    assert moved == pytest.approx(0.05 if fused else 0.0)
    assert fused or scene.source == "captured mesh"
