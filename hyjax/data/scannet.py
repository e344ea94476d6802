"""ScanNet's `.sens` files, version 4, little-endian; other recordings of the Structure sensor have them too.

    header    version, name of the sensor; intrinsics and extrinsics of colour and of depth, 4×4 float32 each;
              compressions, sizes, steps a metre of depth, number of frames
    a frame   camera-to-world (4×4 float32, camera x right, y down, z forward; -inf where tracking was lost),
              times of colour and depth in microseconds, bytes of each, the colour picture (JPEG, PNG or raw), the
              depth map (16 bits, zlib or raw)

A file is read in place: opening it reads the 96 bytes before each frame's pictures, a frame reads its own.
Extrinsics lead from a camera to what `camera-to-world` is of; depth of a camera that stands elsewhere is brought to
the picture's. Intrinsics count pixels from the centre of the first one, hence half a pixel is added. Up is z where
the cameras' mean up direction is within 45° of it, as in ScanNet's own scenes, and that direction elsewhere.

Tested on files written to the published layout, not on a real capture.

Source: Dai et al., "ScanNet: richly-annotated 3D reconstructions of indoor scenes", CVPR 2017, and the description
of the format in its repository, SensReader.
"""

import dataclasses
import functools
import struct
import zlib
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import bytes_colour, intrinsics_at
from hyjax.data.file_tree import FileTree
from hyjax.data.kinect import warped
from hyjax.data.recording import Z_UP, DepthAndConfidence, Recording, Shot, mean_up, rigid
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

VERSION = 4
FRAME = struct.Struct("<16f4Q")
COLOUR = {0: "raw", 1: ".png", 2: ".jpg"}
DEPTH = {0: "raw", 1: "zlib", 2: "occi"}
LARGEST_SIDE = 16384
MOST_PIXELS = 1 << 24
"""Most pixels of a picture or depth map; real ones have at most 1.3 million. Zeros pack to nothing."""
LONGEST_NAME = 4096
MOST_STEPS = 1e9
"""Most steps of depth in a metre; a thousand in real files."""
MESHES = ("_vh_clean.ply", "_vh_clean_2.ply")

Matrix = Float[np.ndarray, "4 4"]


@dataclasses.dataclass(frozen=True)
class _Header:
    """Header of a file, valid for all frames; extrinsics are camera-to-rig."""

    colour: Intrinsics
    depth: Intrinsics
    colour_to_rig: Matrix
    depth_to_rig: Matrix
    colour_packing: int
    depth_packing: int
    steps: float
    count: int


@dataclasses.dataclass(frozen=True)
class _Entry:
    """Places of a frame's pictures in the file."""

    number: int
    pose: Matrix
    time: int
    colour_at: int
    colour_bytes: int
    depth_bytes: int


def is_sens(tree: FileTree) -> bool:
    """Whether there is exactly one `.sens` file at the top."""
    return len(tree.below("", ".sens")) == 1


def open_sens(tree: FileTree) -> Recording:
    """Open a `.sens` file, or the folder or archive that has one. An archive's is copied to disk once."""
    name = tree.below("", ".sens")[0]
    where = tree.where(name)
    with tree.stream(name) as file:
        header = _read_header(file, where)
        entries, faults = _index(file, header, where, tree.size(name))
    lost = [entry.number for entry in entries if rigid(entry.pose) is None]
    remarks = []
    if lost:
        remarks.append(f"{len(lost)} of {len(entries)} frames are left out, they have no pose (first: {lost[0]})")
    posed = [entry for entry in entries if rigid(entry.pose) is not None]
    times = _recorded_times(posed, faults)
    seconds = [entry.number / 30 for entry in posed] if times is None else times
    empty = [entry.number for entry in posed if not entry.colour_bytes]
    if empty:
        faults.append(f"{len(empty)} frames have no picture (first: {empty[0]})")
    shots = [_shot(tree, name, header, entry, time) for entry, time in zip(posed, seconds)]
    if not shots:
        raise InputError(f"{where}: none of {len(entries)} frames has a pose{': '.join(['', *faults])}")
    up = mean_up([shot.pose for shot in shots], where)
    mesh = next((n for suffix in MESHES for n in tree.below("", suffix)), None)
    return Recording(
        tree,
        shots,
        up=Z_UP if up @ Z_UP > np.sqrt(0.5) else up,
        mesh=mesh,
        sensor=KINECT,
        faults=faults,
        remarks=remarks,
        times_known=times is not None,
    )


def _read_header(file: BinaryIO, where: str) -> _Header:
    (version,) = _unpack(file, "<I", where)
    if version != VERSION:
        raise InputError(f"{where}: version {version} of the format, only {VERSION} is read")
    (length,) = _unpack(file, "<Q", where)
    if length > LONGEST_NAME:
        raise InputError(f"{where}: the sensor's name has {length} letters; not a .sens file, or damaged")
    file.read(length)
    colour, colour_to_rig, depth, depth_to_rig = (
        np.array(_unpack(file, "<16f", where), np.float64).reshape(4, 4) for _ in range(4)
    )
    colour_packing, depth_packing, cw, ch, dw, dh, steps, count = _unpack(file, "<2i4IfQ", where)
    if colour_packing not in COLOUR:
        raise InputError(f"{where}: colour is packed in way {colour_packing}; read are raw, PNG and JPEG (0, 1, 2)")
    if DEPTH.get(depth_packing) not in ("raw", "zlib"):
        kind = DEPTH.get(depth_packing, depth_packing)
        raise InputError(f"{where}: depth is packed as {kind}; read are raw_ushort and zlib_ushort (0, 1)")
    if not 1e-3 <= steps <= MOST_STEPS:
        raise InputError(f"{where}: has {steps:g} steps of depth a metre, must be > 0 and at most {MOST_STEPS:g}")
    return _Header(
        _lens(colour, cw, ch, f"{where}: colour"),
        _lens(depth, dw, dh, f"{where}: depth"),
        _extrinsics(colour_to_rig, f"{where}: colour"),
        _extrinsics(depth_to_rig, f"{where}: depth"),
        colour_packing,
        depth_packing,
        steps,
        count,
    )


def _unpack(file: BinaryIO, layout: str, where: str) -> tuple:
    content = file.read(struct.calcsize(layout))
    if len(content) < struct.calcsize(layout):
        raise InputError(f"{where}: ends within its header; truncated")
    return struct.unpack(layout, content)


def _lens(k: Matrix, width: int, height: int, where: str) -> Intrinsics:
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise InputError(f"{where}: pictures of {width}x{height} pixels; a side has 1 to {LARGEST_SIDE}")
    if width * height > MOST_PIXELS:
        raise InputError(f"{where}: pictures of {width}x{height} pixels; at most {MOST_PIXELS} are read")
    return intrinsics_at(where, width, height, k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5)


def _extrinsics(matrix: Matrix, where: str) -> Matrix:
    pose = rigid(matrix)
    if pose is None:
        raise InputError(f"{where}: the extrinsics are no rigid motion")
    return pose


def _index(file: BinaryIO, header: _Header, where: str, size: int) -> tuple[list[_Entry], list[str]]:
    """Place of each frame, and a line if the file ends before the last."""
    entries: list[_Entry] = []
    at = file.tell()
    for number in range(header.count):
        content = file.read(FRAME.size)
        if len(content) < FRAME.size:
            break
        *pose, time, _, colour_bytes, depth_bytes = FRAME.unpack(content)
        at += FRAME.size
        if at + colour_bytes + depth_bytes > size:
            break
        matrix = np.array(pose, np.float64).reshape(4, 4)
        entries.append(_Entry(number, matrix, time, at, colour_bytes, depth_bytes))
        at += colour_bytes + depth_bytes
        file.seek(at)
    if len(entries) == header.count:
        return entries, []
    return entries, [f"{where} is truncated: {len(entries)} of {header.count} frames are whole"]


def _recorded_times(entries: list[_Entry], faults: list[str]) -> list[float] | None:
    """Seconds of each frame; None where the clock stands still, or goes back: thirty a second are taken there."""
    stamps = [entry.time for entry in entries]
    backwards = [entry.number for entry, before in zip(entries[1:], stamps) if entry.time < before]
    if backwards:
        faults.append(
            f"the clock goes back {len(backwards)} times (first: frame {backwards[0]}); 30 a second taken"
        )
    if backwards or len(set(stamps)) < len(stamps):
        return None
    return [(stamp - stamps[0]) * 1e-6 for stamp in stamps]


def _shot(tree: FileTree, name: str, header: _Header, entry: _Entry, time: float) -> Shot:
    rig = rigid(entry.pose)
    assert rig is not None
    # From depth's camera to the picture's; poses are of the picture's.
    apart = np.linalg.inv(header.colour_to_rig) @ header.depth_to_rig
    together = np.allclose(apart, np.eye(4), atol=1e-4)
    seen_through = header.depth if together else header.colour.resize(*header.depth.shape)
    return Shot(
        f"{entry.number:06d}",
        time,
        rig @ header.colour_to_rig,
        header.colour,
        functools.partial(_read_colour, tree, name, header, entry) if entry.colour_bytes else None,
        functools.partial(_read_depth, tree, name, header, entry, None if together else apart)
        if entry.depth_bytes
        else None,
        depth_intrinsics=seen_through,
    )


def _content(tree: FileTree, name: str, at: int, count: int) -> bytes:
    with tree.stream(name) as file:
        file.seek(at)
        return file.read(count)


def _read_colour(tree: FileTree, name: str, header: _Header, entry: _Entry) -> Float[np.ndarray, "h w 3"]:
    where = f"{tree.where(name)}: frame {entry.number}"
    content = _content(tree, name, entry.colour_at, entry.colour_bytes)
    packing, (height, width) = COLOUR[header.colour_packing], header.colour.shape
    if packing != "raw":
        return bytes_colour(content, packing, where)
    if len(content) != 3 * height * width:
        raise InputError(f"{where}: {len(content)} bytes of colour, need {3 * height * width}")
    return np.frombuffer(content, np.uint8).reshape(height, width, 3).astype(np.float32) / np.float32(255)


def _read_depth(
    tree: FileTree, name: str, header: _Header, entry: _Entry, apart: Matrix | None
) -> DepthAndConfidence:
    where = f"{tree.where(name)}: frame {entry.number}"
    content = _content(tree, name, entry.colour_at + entry.colour_bytes, entry.depth_bytes)
    needed = 2 * header.depth.width * header.depth.height
    if DEPTH[header.depth_packing] == "zlib":
        try:
            content = zlib.decompressobj().decompress(content, needed + 1)
        except zlib.error as error:
            raise InputError(f"{where}: depth is damaged ({error})") from None
    if len(content) != needed:
        raise InputError(f"{where}: depth of another size than {header.depth.width}x{header.depth.height}")
    raw = np.frombuffer(content, "<u2").reshape(header.depth.shape)
    depth = np.where(raw == 65535, 0, raw / header.steps).astype(np.float32)
    if apart is not None:
        target = Camera(header.colour.resize(*header.depth.shape), np.eye(4))
        depth = warped(depth, Camera(header.depth, apart), target)
    return depth, None


FORMAT = CaptureFormat("ScanNet", is_sens, open_sens, "*.sens")
