"""Scans of phones: what holds for all apps, whose readers share `PhoneScan`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from extras import need
from reference.phone_layouts import (
    agree,
    box_room,
    edit_json,
    seven,
    sideways,
    write_polycam,
    write_record3d,
    write_scanner3d,
    zipped,
)

from hyjax.data.registry import open_capture
from hyjax.util.errors import InputError

FRAMES = box_room(4)


class App(NamedTuple):
    """How an app writes a scan, and how one frame of it is spoiled.

    Attributes:
        write: frames into a folder.
        break_pose: of a frame.
        rewind: give the last frame the earliest time.
        picture: the file of a frame.
    """

    write: Callable[[Path, Any], Path]
    break_pose: Callable[[Path, int], None]
    rewind: Callable[[Path], None]
    picture: Callable[[Path, int], Path]


def camera(folder: Path, index: int) -> Path:
    return sorted((folder / "keyframes" / "cameras").glob("*.json"))[index]


def edit_poses(folder: Path, index: int) -> None:
    poses = [seven(frame.camera) for frame in FRAMES]
    poses[index][0] = float("nan")
    edit_json(folder / "metadata.json", poses=poses)


APPS = {
    "polycam": App(
        write_polycam,
        lambda folder, index: edit_json(camera(folder, index), t_00=float("nan"), t_11=7.0),
        lambda folder: edit_json(camera(folder, 3), timestamp=5),
        lambda folder, index: folder / "keyframes/images" / f"{camera(folder, index).stem}.jpg",
    ),
    "scanner3d": App(
        write_scanner3d,
        lambda folder, i: edit_json(folder / f"frame_{i:05d}.json", cameraPoseARFrame=[float("-inf")] * 16),
        lambda folder: edit_json(folder / "frame_00003.json", time=1.0),
        lambda folder, index: folder / f"frame_{index:05d}.jpg",
    ),
    "record3d": App(
        write_record3d,
        edit_poses,
        lambda folder: edit_json(folder / "metadata.json", frameTimestamps=[0.2, 0.3, 0.4, 0.1]),
        lambda folder, index: folder / f"rgb/{index}.jpg",
    ),
}


@pytest.fixture(params=APPS)
def app(request: pytest.FixtureRequest) -> App:
    if request.param == "record3d":
        need("captures")
    return APPS[request.param]


@pytest.fixture
def folder(app: App, tmp_path: Path) -> Path:
    return app.write(tmp_path / "scan", FRAMES)


@pytest.mark.parametrize("app", ["polycam", "scanner3d"], indirect=True)
@pytest.mark.parametrize("quarters", range(4))
def test_a_scan_is_read_from_folder_and_archive_however_the_phone_was_held(
    app: App, tmp_path: Path, quarters: int
) -> None:
    folder = app.write(tmp_path / "scan", sideways(FRAMES, quarters))
    for path in (folder, zipped(folder, inside="scan/")):
        capture = open_capture(path)
        agree(capture, FRAMES)
        assert capture.quarter_turns == quarters and capture.metric and not capture.faults and not capture.remarks
        assert [frame.time for frame in capture] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_poses_that_are_none_are_left_out_and_counted(app: App, folder: Path) -> None:
    app.break_pose(folder, 1)
    capture = open_capture(folder)
    assert len(capture) == capture.depth_count == 3 and "1 poses are unusable" in capture.faults[0]
    with pytest.raises(InputError, match=r"1 poses are unusable.*--strict"):
        open_capture(folder, strict=True)


def test_a_clock_that_goes_back_is_put_in_order_and_told(app: App, folder: Path) -> None:
    last = open_capture(folder)[3].name
    app.rewind(folder)
    capture = open_capture(folder)
    assert capture[0].name == last and "1 times go back" in capture.remarks[0]


def test_missing_and_damaged_pictures_leave_their_depth(app: App, folder: Path) -> None:
    app.picture(folder, 0).unlink()
    app.picture(folder, 1).write_bytes(b"\xff\xd8 cut off")
    capture = open_capture(folder)
    assert len(capture) == 2 and capture.depth_count == 4
    assert "1 pictures are damaged and left out" in capture.faults[0]
    assert "2 poses have no picture; their depth is used" in capture.remarks[0]
