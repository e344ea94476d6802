"""Fusion of a capture: what follows from its sensor and place, damaged depth maps, interruptions."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax.data.capture import Capture, Frame
from hyjax.data.registry import open_capture
from hyjax.geometry import tsdf
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import KINECT, PHONE_LIDAR, UNKNOWN, DepthSensor
from hyjax.geometry.mesh import submesh
from hyjax.scene.fusion import Readings, coverage_of, fuse_capture, plan_fusion, tell_coverage
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.surfaces import surface_of
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)


class Walls(Capture):
    """Views of a wall at some distance; all but the lower half of a depth map is uncertain."""

    name, up, fingerprint = "walls", UP, ""

    def __init__(self, distance: float, sensor: DepthSensor = UNKNOWN, count: int = 8) -> None:
        self.sensor, self._distance, self._count, self.broken = sensor, distance, count, -1
        self.fingerprint = f"{distance} {sensor} {count}"  # type: ignore[misc]

    def __len__(self) -> int:
        return self._count

    def camera(self, index: int) -> Camera:
        eye = np.array([0.0, 0.05 * index, 0.0])
        return Camera(LENS, look_at(eye, eye + np.eye(3)[0], UP))

    def __getitem__(self, index: int) -> Frame:
        if index >= self._count:
            raise IndexError
        if index == self.broken:
            raise InputError("depth_3.png: damaged or truncated picture")
        depth, confidence = np.full(LENS.shape, self._distance, np.float32), np.ones(LENS.shape)
        confidence[:24] = 0.25
        picture = np.full((*LENS.shape, 3), 0.5, np.float32)
        return Frame(f"{index}", picture, self.camera(index), index / 30, depth, None, confidence)


@pytest.mark.parametrize(
    ("distance", "sensor", "far", "voxel"),
    [
        (2.0, KINECT, 4.0, 0.03),
        (2.0, PHONE_LIDAR, 5.0, 0.03),
        (1.2, PHONE_LIDAR, 5.0, 0.02),
        (4.9, KINECT, 5.5, 0.04),  # where most is beyond the sensor's range, it is not dropped in silence
        (9.0, KINECT, 8.0, 0.04),  # but twice the range is enough
        (1.9, UNKNOWN, 2.5, 0.03),
    ],
)
def test_range_and_voxel_follow_from_sensor_and_place(
    distance: float, sensor: DepthSensor, far: float, voxel: float
) -> None:
    plan = plan_fusion(Walls(distance, sensor), FusionSettings())
    assert (plan.far, plan.voxel) == (far, voxel)
    assert plan.truncation == pytest.approx(sensor.truncation * voxel)


def test_what_is_set_is_taken() -> None:
    settings = FusionSettings(voxel=0.05, depth_range=3.0, confidence=0.0, min_weight=0.2, fuse_frames=4)
    plan = plan_fusion(Walls(2.0, KINECT), settings)
    assert (plan.voxel, plan.far, plan.confidence, plan.min_weight) == (0.05, 3.0, 0.0, 0.2)
    assert plan.indices == (0, 2, 4, 6)
    assert len(plan_fusion(Walls(2.0, count=400), FusionSettings()).indices) <= 150
    assert len(plan_fusion(Walls(2.0, count=400), FusionSettings(fuse_frames=0)).indices) == 400


@pytest.mark.parametrize(
    "settings",
    [{"voxel": 0.0}, {"depth_range": 0.05}, {"confidence": 2.0}, {"min_weight": -1.0}, {"fuse_frames": -1}],
)
def test_settings_out_of_range_are_named(settings: dict[str, float]) -> None:
    name = next(iter(settings)).replace("_", " ")
    with pytest.raises(InputError, match=f"^{name}: must "):
        FusionSettings(**settings).check()  # type: ignore[arg-type]


def test_uncertain_readings_are_left_out() -> None:
    capture = Walls(2.0, PHONE_LIDAR)
    sure = fuse_capture(capture, plan_fusion(capture, FusionSettings()), progress=False)
    every = fuse_capture(capture, plan_fusion(capture, FusionSettings(confidence=0.2)), progress=False)
    assert sure.vertices[:, 2].max() < 0.1 < 0.8 < every.vertices[:, 2].max()  # the upper half


def test_confidence_weighs_by_its_square() -> None:
    camera = Camera(LENS, np.eye(4))

    def fused(confidence: float) -> float:
        near, far = (np.full(LENS.shape, d, np.float32) for d in (2.0, 2.03))
        frames = [
            DepthReading(near, camera, np.full(LENS.shape, 1.0)),
            DepthReading(far, camera, np.full(LENS.shape, confidence)),
        ]
        return float(np.median(tsdf.fuse(frames, 0.02, min_weight=0.0, progress=False).vertices[:, 2]))

    assert fused(1.0) == pytest.approx(2.015, abs=0.002)
    assert fused(0.5) == pytest.approx(2.0 + 0.03 * 0.25 / 1.25, abs=0.002)


def test_damaged_depth_maps_are_left_out_with_a_line(caplog: pytest.LogCaptureFixture) -> None:
    capture = Walls(2.0, KINECT)
    plan, capture.broken = plan_fusion(capture, FusionSettings()), 3
    assert len(fuse_capture(capture, plan, progress=False).faces) > 100
    assert caplog.messages == ["depth_3.png: damaged or truncated picture; left out of the fusion"]
    capture.strict = True
    with pytest.raises(InputError, match=r"depth_3\.png: damaged"):
        fuse_capture(capture, plan, progress=False)


def test_a_fusion_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same result, bit by bit, and without reading again what it had."""
    monkeypatch.setattr(tsdf, "SAVE_INTERVAL", -1.0)
    capture, checkpoint = Walls(2.0, KINECT, count=6), tmp_path / "cache" / "fusion.npz"
    plan = plan_fusion(capture, FusionSettings())
    whole = fuse_capture(capture, plan, progress=False)
    capture.broken, capture.strict = 4, True
    with pytest.raises(InputError):
        fuse_capture(capture, plan, checkpoint=checkpoint, progress=False)
    assert checkpoint.is_file()
    read: list[int] = []
    capture.broken = -1
    monkeypatch.setattr(
        Walls, "depth_reading", lambda self, index: read.append(index) or Capture.depth_reading(self, index)
    )
    again = fuse_capture(capture, plan, checkpoint=checkpoint, progress=False)
    assert read[0] >= 2 and read[-1] == 5 and not checkpoint.exists()
    np.testing.assert_array_equal(again.vertices, whole.vertices)
    np.testing.assert_array_equal(again.faces, whole.faces)


def test_frames_in_a_checkpoint_are_not_fused_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tsdf, "SAVE_INTERVAL", -1.0)
    checkpoint, frames = tmp_path / "fusion.npz", list(Walls(2.0, KINECT, count=6))

    def stopped() -> Iterator[Frame]:
        yield from frames[:4]
        raise InputError("stopped")

    with pytest.raises(InputError, match="stopped"):
        tsdf.fuse(stopped(), 0.03, progress=False, checkpoint=checkpoint)
    whole = tsdf.fuse(frames, 0.03, min_weight=0.3, progress=False)
    again = tsdf.fuse(iter(frames), 0.03, min_weight=0.3, progress=False, checkpoint=checkpoint)
    np.testing.assert_array_equal(again.vertices, whole.vertices)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"x" * 999])
def test_a_damaged_checkpoint_is_told_and_made_anew(
    tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    capture, checkpoint = Walls(2.0, KINECT), tmp_path / "fusion.npz"
    checkpoint.write_bytes(content)
    assert len(
        fuse_capture(capture, plan_fusion(capture, FusionSettings()), checkpoint=checkpoint, progress=False).faces
    )
    assert "the fusion begins anew" in caplog.text


def test_little_coverage_and_other_axes_are_told(caplog: pytest.LogCaptureFixture) -> None:
    capture = Walls(2.0, KINECT)
    mesh = fuse_capture(capture, plan_fusion(capture, FusionSettings(confidence=0.0)), progress=False)
    tell_coverage(capture, "fusion", coverage_of(capture, mesh))
    assert not caplog.messages
    half = submesh(mesh, mesh.triangles_center[:, 1] > 0.15)
    tell_coverage(capture, "half", coverage_of(capture, half))
    assert "walls: the half agrees with" in caplog.text and "% of the depth readings" in caplog.text
    caplog.clear()
    aside = mesh.copy()
    aside.apply_translation([0, 100, 0])
    tell_coverage(capture, "mesh", coverage_of(capture, aside))
    assert "same axes and units?" in caplog.text


class WithMesh(Walls):
    """A device's mesh that has half of the wall."""

    has_mesh = True

    def mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.box((0.1, 4, 2), transform=trimesh.transformations.translation_matrix((2, 0, 1)))


@pytest.mark.parametrize(
    ("distance", "fusion"), [(0.0, FusionSettings()), (2.0, FusionSettings(voxel=1e-5, depth_range=4.0))]
)
def test_the_devices_mesh_stays_where_its_depth_cannot_be_fused(
    distance: float, fusion: FusionSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    assert surface_of(WithMesh(distance), fusion=fusion, progress=False)[0] == "captured mesh"


def test_a_first_frame_that_is_damaged_hides_no_depth() -> None:
    capture = Walls(2.0)
    capture.broken = 0
    assert capture.depth_count == 8
    broken = Broken(2.0)
    assert broken.depth_count == 0 and not plan_readings(broken)


class Broken(Walls):
    """All frames are damaged, and so cameras cannot be told."""

    def __getitem__(self, index: int) -> Frame:
        raise InputError("damaged")

    camera = Capture.camera


def plan_readings(capture: Capture) -> bool:
    return any(reading.depth.any() for reading in Readings(capture, range(3), 0.5))


def test_depth_maps_without_a_picture_are_scanned_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Mixed(Walls):
        """Every other frame has no depth, and there are other depth maps."""

        depth_count = 9

        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            return dataclasses.replace(frame, depth=None, confidence=None) if index % 2 else frame

        def depth_reading(self, index: int) -> DepthReading:
            return Capture.depth_reading(self, 2 * (index // 3))

    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    assert len(surface_of(Mixed(2.0), "scan", progress=False)[1].faces) > 10


def test_depth_without_a_reading_is_refused() -> None:
    with pytest.raises(InputError, match="its depth maps have no readings"):
        plan_fusion(Walls(0.0), FusionSettings())


@pytest.mark.parametrize("indices", [range(5), range(0, 150, 30), range(100, 300, 40)])
def test_five_frames_of_a_kinect_are_covered(
    indices: range, kitchen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most of the depth readings, although it was seen once."""
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    files = sorted(kitchen.glob("frame-*.color.jpg"))
    folder = tmp_path / "five"
    folder.mkdir()
    for color in (files[index] for index in indices):
        stem = color.name.split(".")[0]
        for name in (color.name, f"{stem}.depth.png", f"{stem}.pose.txt"):
            (folder / name).symlink_to(kitchen / name)
    for name in ("camera-intrinsics.txt", "gravity-direction.txt"):
        (folder / name).symlink_to(kitchen / name)
    capture = open_capture(folder)
    mesh = surface_of(capture, progress=False)[1]
    assert coverage_of(capture, mesh).covered > 0.65
