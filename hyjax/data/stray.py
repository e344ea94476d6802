"""Stray Scanner: an iPhone's or iPad's LiDAR video.

    rgb.mp4             the pictures, HEVC (H.264 of old versions), sideways as the sensor sees them
    odometry.csv        timestamp, frame, x, y, z, qx, qy, qz, qw and, of newer versions, fx, fy, cx, cy
    camera_matrix.csv   3×3 intrinsics of the last picture
    depth/000012.png    16-bit millimetres, 256×192, one a row of odometry.csv
    confidence/000012.png   0 to 2
    imu.csv             not read

Poses are camera-to-world in metres, the world is y-up. The camera's axes are x right, y down, z forward: the app
turns ARKit's by half a turn about x before it writes the quaternion (`q_WA * q_AC` in its `OdometryEncoder.swift`).

Tested on small files written to this layout, on no real recording.

Source: github.com/strayrobots/scanner, `docs/format.md` and the app's source.
"""

import csv
import functools
import io
import math

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import parse_numbers
from hyjax.data.file_tree import FileTree
from hyjax.data.phone_captures import (
    PIXEL_CENTRE,
    PhoneScan,
    lens_of,
)
from hyjax.data.recording import Recording, Shot, pose_from_quaternion
from hyjax.data.video_frames import VideoFrames
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError

VIDEO, ODOMETRY, MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
NEEDED_COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
LENS = ("fx", "fy", "cx", "cy")
MOST_FRAMES = 10_000_000


def is_stray(tree: FileTree) -> bool:
    """Whether there are `odometry.csv` and `rgb.mp4`."""
    return ODOMETRY in tree and VIDEO in tree


def open_stray(tree: FileTree) -> Recording:
    """Open a recording. Poses are read and checked now, pictures and depth when asked for."""
    scan = PhoneScan(tree)
    rows = _read_odometry(scan)
    video = VideoFrames(tree, VIDEO)
    numbers = [int(row["frame"]) for row in rows]
    # The video has a picture a row. Where rows were taken out of the table, their numbers still tell which.
    by_number = len(numbers) < len(video) and max(numbers) < len(video)
    shared = _read_matrix(tree, video.shape) if not all(_has_lens(row) for row in rows) else None
    shots = [
        _read_row(scan, row, number, number if by_number else place, video, shared)
        for place, (row, number) in enumerate(zip(rows, numbers))
    ]
    extra = len(video) - len(rows)
    if extra > 0:
        scan.remarks.add(f"video has {extra} more pictures than {ODOMETRY} has rows; they are not used", VIDEO)
    return scan.recording([shot for shot in shots if shot is not None])


Row = dict[str, float]


def _read_odometry(scan: PhoneScan) -> list[Row]:
    """Rows by column, without blank columns; all that is needed is there, and numbers."""
    tree = scan.tree
    where = tree.where(ODOMETRY)
    try:
        lines = list(csv.reader(io.StringIO(tree.text(ODOMETRY)), skipinitialspace=True))
    except csv.Error as error:
        raise InputError(f"{where}: not a table ({error})") from None
    header = [name.strip() for name in lines[0]] if lines else []
    if missing := [name for name in NEEDED_COLUMNS if name not in header]:
        raise InputError(f"{where}: has no column {', '.join(missing)}; need {', '.join(NEEDED_COLUMNS)}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        cells = dict(zip(header, (cell.strip() for cell in line)))
        if not any(cells.values()):
            continue
        if number == len(lines) and any(not cells.get(name) for name in NEEDED_COLUMNS):
            scan.faults.add("row was cut off at the end of the file and left out", f"{ODOMETRY} line {number}")
            continue
        names = [name for name in (*NEEDED_COLUMNS, *LENS) if name in NEEDED_COLUMNS or cells.get(name)]
        rows.append({name: _cell(cells.get(name, ""), name, f"{where}: line {number}") for name in names})
    if not rows:
        raise InputError(f"{where}: has no rows")
    return rows


def _cell(text: str, column: str, where: str) -> float:
    """A number, NaN for one that is not finite; `timestamp` and `frame` must be."""
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{where}: {column}: need a number, got {text[:40]!r}") from None
    if column == "frame" and not (number.is_integer() and 0 <= number < MOST_FRAMES):
        raise InputError(f"{where}: {column}: need a whole number from 0, got {text[:40]!r}")
    if not math.isfinite(number) and column in ("timestamp", *LENS):
        raise InputError(f"{where}: {column}: need a finite number, got {text[:40]!r}")
    return number if math.isfinite(number) else math.nan


def _has_lens(row: Row) -> bool:
    return all(name in row for name in LENS)


def _read_matrix(tree: FileTree, shape: tuple[int, int]) -> Intrinsics:
    if MATRIX not in tree:
        raise InputError(f"{tree.where(MATRIX)}: missing, and {ODOMETRY} has no columns {', '.join(LENS)}")
    where = tree.where(MATRIX)
    k = parse_numbers(tree.text(MATRIX).replace(",", " "), where, (3, 3), "fx 0 cx / 0 fy cy / 0 0 1, with commas")
    return lens_of(shape, k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), where, shift=PIXEL_CENTRE)


def _read_row(
    scan: PhoneScan, row: Row, number: int, place: int, video: VideoFrames, shared: Intrinsics | None
) -> Shot | None:
    lens = shared
    if _has_lens(row):
        values = [row[name] for name in LENS]
        lens = lens_of(video.shape, values, f"{scan.tree.where(ODOMETRY)}: frame {number}", shift=PIXEL_CENTRE)
    assert lens is not None
    pose = pose_from_quaternion(_numbers(row, "qx", "qy", "qz", "qw"), _numbers(row, "x", "y", "z"))
    return scan.shot(
        f"frame {number:06d}",
        f"frame_{number:06d}",
        row["timestamp"],
        pose,
        lens,
        functools.partial(video.read, place) if place < len(video) else None,
        scan.depth(f"depth/{number:06d}.png", f"confidence/{number:06d}.png"),
    )


def _numbers(row: Row, *names: str) -> Float[np.ndarray, "n"]:
    return np.array([row[name] for name in names])


FORMAT = CaptureFormat("Stray Scanner", is_stray, open_stray, "rgb.mp4, odometry.csv, depth/NNNNNN.png")
