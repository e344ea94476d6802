"""Polycam's raw data, on small scans written to its layout."""

from pathlib import Path

import numpy as np
import pytest
from reference.phone_layouts import agree, box_room, edit_json, write_polycam
from refusals import leaves_out_a_frame
from refusals import refuses_capture as refuses

from hyjax.data.registry import open_capture

FRAMES = box_room(4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_polycam(tmp_path / "scan", FRAMES)


def cameras(folder: Path) -> list[Path]:
    return sorted((folder / "keyframes" / "cameras").glob("*.json"))


def test_corrected_cameras_are_preferred_and_what_was_not_corrected_is_told(tmp_path: Path) -> None:
    moved = [box_room(5)[index + 1] for index in range(4)]
    for index, frame in enumerate(moved):
        object.__setattr__(frame, "time", FRAMES[index].time)
    folder = write_polycam(tmp_path / "scan", FRAMES)
    write_polycam(folder, moved[:3], corrected=True)
    capture = open_capture(folder)
    agree(capture, moved[:3])
    assert "1 keyframes were not corrected by the app and are left out" in capture.remarks[0]


def test_corrected_cameras_without_their_pictures_are_not_used(tmp_path: Path) -> None:
    folder = write_polycam(tmp_path / "scan", FRAMES)
    write_polycam(folder, box_room(5)[1:], corrected=True)
    for picture in (folder / "keyframes" / "corrected_images").iterdir():
        picture.unlink()
    np.testing.assert_allclose(open_capture(folder)[0].camera.pose, FRAMES[0].camera.pose, atol=1e-9)


def test_the_three_confidences_of_polycam(folder: Path) -> None:
    assert set(np.unique(open_capture(folder)[0].confidence)) == {0.0, 0.5, 1.0}


def test_without_time_stamps_the_names_tell_the_time(folder: Path) -> None:
    for file in cameras(folder):
        edit_json(file, timestamp=None)
    assert [frame.time for frame in open_capture(folder)] == pytest.approx([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "key, value",
    [("t_23", None), ("t_23", "far"), ("fx", -1), ("fx", None), ("width", 0.5), ("height", 10**18), ("cx", [1])],
)
def test_bad_content_names_file_and_key(folder: Path, key: str, value: object) -> None:
    edit_json(cameras(folder)[2], **{key: value})
    leaves_out_a_frame(folder, 3, cameras(folder)[2].name, key)


def test_pictures_of_another_size_are_refused(folder: Path) -> None:
    edit_json(cameras(folder)[2], width=192, height=144, cx=96, cy=72)
    refuses(folder, "96x72", "192x144")
