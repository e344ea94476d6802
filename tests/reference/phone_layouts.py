"""A small room seen by a phone with a LiDAR, written as apps write their recordings."""

import dataclasses
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from extras import need
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, Frame
from hyjax.data.orientation import turn_frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at

LOW, HIGH = np.array([-2.0, -1.2, -1.5]), np.array([2.0, 1.3, 1.5])
UP = np.array([0.0, 1.0, 0.0])
LENS = Intrinsics(96, 72, 80.0, 80.5, 47.3, 36.9)
DEPTH_SHAPE = (36, 48)
ARKIT_CENTRE = 0.5
"""What ARKit's principal point lacks, as its pixel centres are at whole numbers."""
START = 402896.25


def box_room(count: int = 6) -> list[Frame]:
    """Upright pictures of a box, y-up, whose depth and colours are known in closed form."""
    return [_frame(index) for index in range(count)]


def _frame(index: int) -> Frame:
    angle = 0.15 * index
    eye = np.array([0.6 - 0.1 * index, 0.2 + 0.05 * index, -0.3])
    pose = look_at(eye, eye + np.array([np.sin(angle), -0.25, np.cos(angle)]), UP)
    camera, depth_camera = Camera(LENS, pose), Camera(LENS.resize(*DEPTH_SHAPE), pose)
    points = camera.unproject(_box_depth(camera))
    image = 0.5 + 0.35 * np.sin(1.7 * points + [0.0, 1.0, 2.0])
    depth = _box_depth(depth_camera)
    confidence = np.ones(DEPTH_SHAPE, np.float32)
    confidence[:, :10], confidence[:, 10:20] = 0.0, 0.5
    return Frame(
        f"frame_{index:06d}",
        image.astype(np.float32),
        camera,
        index / 10,
        depth.astype(np.float32),
        depth_camera.intrinsics,
        confidence,
    )


def _box_depth(camera: Camera) -> Float[np.ndarray, "h w"]:
    rays = camera.rays()
    with np.errstate(divide="ignore"):
        return (np.where(rays > 0, HIGH - camera.origin, LOW - camera.origin) / rays).min(axis=-1)


def sideways(frames: Sequence[Frame], quarters: int = 1) -> list[Frame]:
    """The same from a phone that is held so that pictures need `quarters` clockwise turns to be upright."""
    return [turn_frame(frame, -quarters) for frame in frames]


def agree(capture: Capture, frames: Sequence[Frame], *, confidence: bool = True, blur: float = 0.01) -> None:
    """Fail unless the capture has these frames: poses, lenses, depth, pictures."""
    assert len(capture) == len(frames)
    np.testing.assert_allclose(capture.up, UP, atol=1e-9)
    assert capture.sensor.name == "phone LiDAR"
    for frame, expected in zip(capture, frames):
        np.testing.assert_allclose(frame.camera.pose, expected.camera.pose, atol=1e-6)
        for lens, other in (
            (frame.camera.intrinsics, expected.camera.intrinsics),
            (frame.depth_camera.intrinsics, expected.depth_camera.intrinsics),
        ):
            np.testing.assert_allclose(dataclasses.astuple(lens), dataclasses.astuple(other), atol=1e-6)
        assert np.sqrt(np.mean((frame.image - expected.image) ** 2)) < blur
        assert frame.depth is not None and expected.depth is not None
        np.testing.assert_allclose(frame.depth, expected.depth, atol=2e-3)
        if confidence:
            np.testing.assert_array_equal(frame.confidence, expected.confidence)


def zipped(folder: Path, suffix: str = "zip", inside: str = "") -> Path:
    """The folder's files as an archive beside it, in a folder `inside` it."""
    archive = folder.with_name(f"{folder.name}.{suffix}")
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                file.write(path, f"{inside}{path.relative_to(folder).as_posix()}")
    return archive


def arkit_pose(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world with y up and z backward."""
    return camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0])


def seven(camera: Camera) -> list[float]:
    """qx qy qz qw tx ty tz in ARKit's axes."""
    pose = arkit_pose(camera)
    return [*Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), *pose[:3, 3].tolist()]


def write_pixels(path: Path, pixels: np.ndarray, kind: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = pixels if pixels.ndim == 3 else pixels[..., None]
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec.attribute("CompressionQuality", 98)
    if path.suffix == ".exr":
        spec.channelnames = ("R",)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(np.ascontiguousarray(pixels)) and target.close()


def write_jpeg(path: Path, frame: Frame) -> None:
    write_pixels(path, np.uint8(np.round(frame.image * 255)), "uint8")


def write_millimetres(path: Path, frame: Frame) -> None:
    write_pixels(path, np.uint16(np.round(frame.depth * 1000)), "uint16")


def write_levels(path: Path, frame: Frame, levels: Sequence[int] = (0, 1, 2)) -> None:
    write_pixels(path, np.uint8(np.asarray(levels)[np.int64(frame.confidence * 2)]), "uint8")


def edit_json(path: Path, **fields: Any) -> None:
    """Set fields of a JSON file; None removes one."""
    content = {**json.loads(path.read_text()), **fields}
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))


def write_scanner3d(folder: Path, frames: Sequence[Frame], picture_every: int = 1) -> Path:
    """3D Scanner App's raw export, with the place and the date that it may hold."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(frames):
        k = frame.camera.intrinsics
        centre = [k.cx - ARKIT_CENTRE, k.cy - ARKIT_CENTRE]
        fields = {
            "cameraPoseARFrame": arkit_pose(frame.camera).ravel().tolist(),
            "intrinsics": [k.fx, 0, centre[0], 0, k.fy, centre[1], 0, 0, 1],
            "time": START + frame.time,
            "exposureDuration": 0.0125,
            "motionQuality": 0.95,
            "frame_index": index,
            "latitude": 48.137,
            "date": "2024-05-01",
        }
        (folder / f"frame_{index:05d}.json").write_text(json.dumps(fields))
        if index % picture_every == 0:
            write_jpeg(folder / f"frame_{index:05d}.jpg", frame)
        write_millimetres(folder / f"depth_{index:05d}.png", frame)
        write_levels(folder / f"conf_{index:05d}.png", frame)
    (folder / "info.json").write_text(json.dumps({"title": "Untitled Scan", "latitude": 48.137}))
    return folder


def write_record3d(
    folder: Path, frames: Sequence[Frame], numbers: Sequence[int] | None = None, r3d: bool = False
) -> Path:
    """Record3D's EXR + RGB export, or the content of an .r3d; `numbers` of the frames, 0, 1, … if None."""
    numbers = range(len(frames)) if numbers is None else numbers
    k = frames[0].camera.intrinsics
    by_number = dict(zip(numbers, frames))
    rows = [by_number.get(number, frames[0]) for number in range(max(numbers) + 1)]
    metadata = {
        "w": k.width,
        "h": k.height,
        "dw": DEPTH_SHAPE[1] if k.width > k.height else DEPTH_SHAPE[0],
        "dh": DEPTH_SHAPE[0] if k.width > k.height else DEPTH_SHAPE[1],
        "fps": 10,
        "K": [k.fx, 0, 0, 0, k.fy, 0, k.cx, k.cy, 1],
        "poses": [seven(frame.camera) for frame in rows],
        "perFrameIntrinsicCoeffs": [[k.fx, k.fy, k.cx, k.cy] for _ in rows],
        "frameTimestamps": [START + frame.time for frame in rows],
        "initPose": [0, 0, 0, 1, 0, 0, 0],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ("metadata" if r3d else "metadata.json")).write_text(json.dumps(metadata))
    for number, frame in by_number.items():
        if r3d:
            need("captures")
            import lzfse

            write_jpeg(folder / f"rgbd/{number}.jpg", frame)
            levels = np.uint8(frame.confidence * 2)
            (folder / f"rgbd/{number}.depth").write_bytes(lzfse.compress(frame.depth.tobytes()))
            (folder / f"rgbd/{number}.conf").write_bytes(lzfse.compress(levels.tobytes()))
        else:
            write_jpeg(folder / f"rgb/{number}.jpg", frame)
            write_pixels(folder / f"depth/{number}.exr", np.float16(frame.depth), "half")
    return folder


def write_polycam(folder: Path, frames: Sequence[Frame], corrected: bool = False) -> Path:
    """Polycam's raw data; `corrected` adds to what the app has adjusted, and leaves the raw cameras as they are."""
    top, prefix = folder / "keyframes", "corrected_" if corrected else ""
    for frame in frames:
        pose, k = arkit_pose(frame.camera), frame.camera.intrinsics
        name = f"{18331487046 + round(frame.time * 1e6)}"
        fields = {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
        fields |= {"fx": k.fx, "fy": k.fy, "cx": k.cx - ARKIT_CENTRE, "cy": k.cy - ARKIT_CENTRE}
        fields |= {"width": k.width, "height": k.height, "blur_score": 120.5, "timestamp": int(name)}
        (top / f"{prefix}cameras").mkdir(parents=True, exist_ok=True)
        (top / f"{prefix}cameras" / f"{name}.json").write_text(json.dumps(fields))
        write_jpeg(top / f"{prefix}images" / f"{name}.jpg", frame)
        write_millimetres(top / "depth" / f"{name}.png", frame)
        write_levels(top / "confidence" / f"{name}.png", frame, (0, 54, 255))
    (folder / "mesh_info.json").write_text(json.dumps({"latitude": 48.137}))
    return folder
