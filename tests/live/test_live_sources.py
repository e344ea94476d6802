"""Sources of live frames: messages, a folder that grows, a phone that is not there."""

import io
import logging
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from boxes import frames, looking, room
from PIL import Image

from hyjax.data.capture import Frame
from hyjax.live.messages import read_live_frames, write_live_frame
from hyjax.live.source import folder_frames, known_up, live_frames
from hyjax.util.errors import InputError


@pytest.fixture(scope="module")
def seen() -> list[Frame]:
    return frames(room(), looking((0.0, 0.0, 0.2), 4))


def messages(seen: list[Frame]) -> list[bytes]:
    parts = []
    for frame in seen:
        stream = io.BytesIO()
        write_live_frame(stream, frame)
        parts.append(stream.getvalue())
    return parts


def names(content: bytes) -> list[str]:
    return [frame.name for frame in read_live_frames(io.BytesIO(content))]


def test_a_frame_comes_back_from_its_message(seen: list[Frame]) -> None:
    (frame,) = read_live_frames(io.BytesIO(messages(seen)[2]))
    assert frame.name == seen[2].name and frame.time == seen[2].time
    np.testing.assert_allclose(frame.image, seen[2].image, atol=0.01)
    assert frame.depth is not None and seen[2].depth is not None
    np.testing.assert_allclose(frame.depth, seen[2].depth, atol=6e-4)
    np.testing.assert_allclose(frame.camera.pose, seen[2].camera.pose, atol=1e-12)
    assert frame.depth_camera.intrinsics == seen[2].depth_camera.intrinsics


def test_damaged_messages_are_skipped_with_a_line(seen: list[Frame], caplog: pytest.LogCaptureFixture) -> None:
    one, two, three, four = messages(seen)
    line, _, parts = two.partition(b"\n")
    bad_pose = line.replace(b'"pose": [[', b'"pose": [[NaN, ') + b"\n" + parts
    bad_picture = line + b"\n" + b"\0" * len(parts)
    no_time = line.replace(b'"time"', b'"when"') + b"\n" + parts
    short_depth = (
        line.replace(b'"depth_intrinsics": {"width": 96', b'"depth_intrinsics": {"width": 95') + b"\n" + parts
    )
    huge = line.replace(b'"picture_bytes": ', b'"picture_bytes": 99999999') + b"\n" + parts
    endless = line.replace(b'"intrinsics": {"width": 96', b'"intrinsics": {"width": Infinity') + b"\n" + parts
    assert endless != two
    everything = [seen[k].name for k in (0, 2)]
    for bad in (
        bad_pose,
        bad_picture,
        no_time,
        short_depth,
        huge,
        endless,
        b"noise\nand more\n",
        line[:40] + b"\n",
    ):
        caplog.clear()
        assert names(one + bad + three) == everything, bad[:200]
        assert len(caplog.records) == 1
    caplog.clear()
    assert names(one + four[:-10]) == [seen[0].name] and "ends within" in caplog.text
    assert names(b"") == []


def write(folder: Path, number: int, frame: Frame) -> None:
    """Depth and pose first, so that the frame is whole with its picture."""
    stem = folder / f"frame-{number:06d}"
    assert frame.depth is not None
    Image.fromarray(np.round(1000 * frame.depth).astype(np.uint16)).save(f"{stem}.depth.png")
    np.savetxt(f"{stem}.pose.txt", frame.camera.pose)
    Image.fromarray(np.round(255 * frame.image).astype(np.uint8)).save(f"{stem}.color.png")


def test_a_folder_that_grows(seen: list[Frame], tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.savetxt(tmp_path / "camera-intrinsics.txt", seen[0].camera.intrinsics.matrix)
    np.savetxt(tmp_path / "gravity-direction.txt", [0.0, 0.0, -1.0])
    write(tmp_path, 3, seen[0])
    write(tmp_path, 4, seen[1])
    whole = (tmp_path / "frame-000004.color.png").read_bytes()
    (tmp_path / "frame-000004.color.png").write_bytes(whole[:-20])
    arrived = folder_frames(tmp_path, stop_after=1.0)
    first = next(arrived)
    assert first.name == "frame-000003" and first.time == pytest.approx(0.1)
    np.testing.assert_allclose(first.depth, seen[0].depth, atol=6e-4)

    def grow() -> None:
        time.sleep(0.2)
        (tmp_path / "frame-000004.color.png").write_bytes(whole)
        time.sleep(0.3)
        write(tmp_path, 1, seen[2])  # too late
        write(tmp_path, 9, seen[3])
        np.savetxt(tmp_path / "frame-000009.pose.txt", np.full((4, 4), np.nan))
        write(tmp_path, 10, seen[3])

    thread = threading.Thread(target=grow)
    thread.start()
    with caplog.at_level(logging.WARNING):
        assert [frame.name for frame in arrived] == ["frame-000004", "frame-000010"]
    thread.join()
    assert "came after later ones" in caplog.text and "pose" in caplog.text
    up = known_up(str(tmp_path))
    assert up is not None
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0])
    assert known_up("-") is None


def test_sources_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no such folder"):
        live_frames(str(tmp_path / "nowhere"))
    monkeypatch.setitem(sys.modules, "record3d", None)
    with pytest.raises(InputError, match="needs the package record3d"):
        next(live_frames("record3d"))
