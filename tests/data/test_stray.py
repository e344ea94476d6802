"""Stray Scanner's recordings: written and read back, and with one thing wrong."""

import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from extras import need
from reference.listed_frames import ListedFrames
from reference.phone_layouts import DEPTH_SHAPE, LENS, UP, agree, box_room, sideways, zipped
from refusals import refuses_capture as refuses
from scipy.spatial.transform import Rotation

from hyjax.data.builtin_room import load_room
from hyjax.data.capture import ChosenFrames, Frame
from hyjax.data.convert import write_capture
from hyjax.data.registry import open_capture
from hyjax.data.trees import open_tree
from hyjax.data.video_frames import VideoFrames
from hyjax.geometry.camera import Camera
from hyjax.util.errors import InputError

need("captures")
import av

FRAMES = box_room(6)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_capture(ListedFrames(FRAMES, UP), "stray", tmp_path / "scan", progress=False)
    return tmp_path / "scan"


def edit_lines(folder: Path, edit: object) -> None:
    """Change the lines of odometry.csv by a function of them."""
    file = folder / "odometry.csv"
    file.write_text("\n".join(edit(file.read_text().splitlines())) + "\n")


def psnr(image: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((image - other) ** 2)))


def test_what_is_written_is_read_back_from_folder_and_archive(folder: Path) -> None:
    for path in (folder, zipped(folder, inside="scan/")):
        capture = open_capture(path)
        agree(capture, FRAMES)
        assert not capture.faults and not capture.remarks
        for frame, original in zip(capture, FRAMES):
            np.testing.assert_allclose(frame.depth, original.depth, atol=5.1e-4)
            assert psnr(frame.image, original.image) > 35 and frame.time == pytest.approx(original.time)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_pictures_are_turned_upright_however_the_phone_was_held(tmp_path: Path, quarters: int) -> None:
    write_capture(ListedFrames(sideways(FRAMES, quarters), UP), "stray", tmp_path / "scan", progress=False)
    capture = open_capture(tmp_path / "scan")
    assert capture.quarter_turns == quarters
    agree(capture, FRAMES)


def test_the_quaternion_is_of_a_camera_that_looks_along_z(folder: Path) -> None:
    """As the app turns ARKit's camera before it writes: (q_WA · q_AC) with q_AC half a turn about x."""
    line = (folder / "odometry.csv").read_text().splitlines()[1].split(", ")
    arkit = Rotation.from_matrix(FRAMES[0].camera.pose[:3, :3] @ np.diag([1.0, -1.0, -1.0]))
    written = (arkit * Rotation.from_quat([1.0, 0.0, 0.0, 0.0])).as_quat()
    found = np.array([float(cell) for cell in line[5:9]])
    np.testing.assert_allclose(found * np.sign(found @ written), written, atol=1e-9)


def test_any_capture_can_be_written_and_its_world_becomes_y_up(tmp_path: Path) -> None:
    room = load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)
    write_capture(room, "stray", tmp_path / "scan", progress=False)
    capture = open_capture(tmp_path / "scan")
    turn = capture[0].camera.pose @ np.linalg.inv(room[0].camera.pose)
    np.testing.assert_allclose(turn[:3, :3] @ room.up, UP, atol=1e-6)
    for frame, original in zip(capture, room):
        np.testing.assert_allclose(frame.camera.pose, turn @ original.camera.pose, atol=1e-6)
        np.testing.assert_allclose(frame.depth, original.depth, atol=5.1e-4)
        assert psnr(frame.image, original.image) > 35 and frame.confidence is None


def test_depth_of_another_lens_is_sampled_anew(tmp_path: Path) -> None:
    narrow = LENS.resize(*DEPTH_SHAPE).crop(6, 8, 24, 32)
    frames = [
        Frame(f.name, f.image, f.camera, f.time, f.depth[6:30, 8:40], narrow, f.confidence[6:30, 8:40])
        for f in FRAMES
    ]
    write_capture(ListedFrames(frames, UP), "stray", tmp_path / "scan", progress=False)
    capture = open_capture(tmp_path / "scan")
    for frame, original in zip(capture, FRAMES):
        points = frame.depth_camera.unproject(frame.depth)[frame.depth > 0]
        xy, depth = original.depth_camera.project(points)
        column, row = np.floor(xy).astype(int).T
        assert np.quantile(np.abs(original.depth[row, column] - depth), 0.9) < 0.05
        assert (frame.depth == 0).any() and (frame.depth > 0).mean() > 0.3


def test_frames_of_a_real_scan_are_written_and_read_back(scanner3d_chair: Path, tmp_path: Path) -> None:
    chosen = ChosenFrames(open_capture(scanner3d_chair), [0, 12])
    write_capture(chosen, "stray", tmp_path / "scan", progress=False)
    for frame, original in zip(open_capture(tmp_path / "scan"), chosen, strict=True):
        np.testing.assert_allclose(frame.camera.pose, original.camera.pose, atol=1e-6)
        np.testing.assert_allclose(frame.depth, original.depth, atol=5e-4)
        np.testing.assert_array_equal(frame.confidence, original.confidence)
        assert psnr(frame.image, original.image) > 40


def test_a_folder_in_use_is_refused_and_nothing_is_left_by_a_failure(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="is there already"):
        write_capture(ListedFrames(FRAMES, UP), "stray", tmp_path / "used", progress=False)
    small = Frame("small", FRAMES[0].image[:36, :48], Camera(LENS.crop(0, 0, 36, 48), FRAMES[0].camera.pose), 1.0)
    with pytest.raises(InputError, match="frame 1 is 48x36, the first is 96x72"):
        write_capture(ListedFrames([FRAMES[0], small], UP), "stray", tmp_path / "new", progress=False)
    assert [file.name for file in tmp_path.iterdir()] == ["used"]
    (tmp_path / "empty").mkdir()
    write_capture(ListedFrames(FRAMES[:2], UP), "stray", tmp_path / "empty", progress=False)
    assert len(open_capture(tmp_path / "empty")) == 2


# ---- the video ----


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty pictures that tell their number, in HEVC with pictures that refer to later ones."""
    path = tmp_path_factory.mktemp("video") / "rgb.mp4"
    with av.open(str(path), "w") as container:
        options = {"crf": "10", "x265-params": "log-level=none:bframes=3:keyint=10:open-gop=1"}
        stream = container.add_stream("libx265", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(40):
            pixels = np.full((48, 64, 3), 20 + 5 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    return path


def numbers_read(video: VideoFrames, order: list[int]) -> list[int]:
    return [round(float((255 * video.read(index).mean() - 20) / 5)) for index in order]


def test_pictures_are_read_in_any_order(video: Path) -> None:
    frames = VideoFrames(open_tree(video.parent), "rgb.mp4")
    assert len(frames) == 40 and frames.shape == (48, 64)
    order = np.random.default_rng(0).permutation(40).tolist()
    for some in (list(range(40)), order, [39, 39, 0, 10, 9, 11, 38, 39]):
        assert numbers_read(frames, some) == some
    with pytest.raises(InputError, match="has 40 pictures, none at position 40"):
        frames.read(40)


def test_in_order_each_picture_is_decoded_once(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = VideoFrames(open_tree(video.parent), "rgb.mp4")
    seeks = []
    container = frames._container

    class Counting:
        def seek(self, *args: object, **options: object) -> None:
            seeks.append(args)
            container.seek(*args, **options)

        def decode(self, stream: object) -> Iterator[object]:
            return container.decode(stream)

    monkeypatch.setattr(frames, "_container", Counting())
    numbers_read(frames, list(range(9)))
    assert len(seeks) == 1
    numbers_read(frames, list(range(40)))
    assert len(seeks) <= 2 + 4  # at most once more for each group of pictures


def test_threads_may_read_at_the_same_time(video: Path) -> None:
    frames, found = VideoFrames(open_tree(video.parent), "rgb.mp4"), {}

    def read(first: int) -> None:
        found[first] = numbers_read(frames, list(range(first, 40, 4)))

    threads = [threading.Thread(target=read, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {first: list(range(first, 40, 4)) for first in range(4)}


def test_the_copy_of_an_archives_video_goes_with_the_recording(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "copies").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "copies"))
    capture = open_capture(zipped(folder))
    assert len(list((tmp_path / "copies").rglob("rgb.mp4"))) == 1
    assert capture[3].image.shape == (72, 96, 3)
    del capture
    assert not list((tmp_path / "copies").iterdir())


def test_a_video_that_is_none_is_named(folder: Path) -> None:
    (folder / "rgb.mp4").write_bytes(b"no video at all")
    refuses(folder, "rgb.mp4", "not a readable video")


def test_without_av_one_line_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    refuses(folder, "rgb.mp4: needs the package av", "pip install '.[captures]'")


# ---- the table ----


def test_blanks_after_commas_and_empty_columns_do_not_matter(folder: Path) -> None:
    edit_lines(folder, lambda lines: [f"{line}, , ," for line in lines] + ["", ",,,"])
    agree(open_capture(folder), FRAMES)
    edit_lines(folder, lambda lines: [line.replace(" ", "") for line in lines])
    agree(open_capture(folder), FRAMES)


def test_older_tables_have_one_lens_for_all(folder: Path) -> None:
    edit_lines(folder, lambda lines: [",".join(line.split(",")[:9]) for line in lines])
    agree(open_capture(folder), FRAMES)
    (folder / "camera_matrix.csv").unlink()
    refuses(folder, "camera_matrix.csv: missing")


def test_a_video_shorter_than_its_table_is_told(folder: Path) -> None:
    edit_lines(folder, lambda lines: [*lines, lines[-1].replace(" 000005,", " 000006,").replace("0.5,", "0.6,", 1)])
    capture = open_capture(folder)
    assert len(capture) == 6
    assert capture.remarks == ("1 poses have no picture and no depth (first: frame 000006)",)


def test_a_video_longer_than_its_table_is_told(folder: Path) -> None:
    edit_lines(folder, lambda lines: lines[:-2])
    capture = open_capture(folder)
    agree(capture, FRAMES[:4])
    assert "video has 2 more pictures" in capture.remarks[0]


def test_rows_that_were_taken_out_do_not_move_the_others(folder: Path) -> None:
    edit_lines(folder, lambda lines: [lines[0], *lines[2::2]])
    agree(open_capture(folder), FRAMES[1::2])


def test_a_table_numbered_by_the_sensor_is_taken_by_order(folder: Path) -> None:
    """The app can keep every sixth picture only; old versions numbered them 0, 6, 12, …"""
    renumber = [f"{number:06d}" for number in range(0, 36, 6)]
    for index in range(5, 0, -1):
        for kind in ("depth", "confidence"):
            (folder / kind / f"{index:06d}.png").rename(folder / kind / f"{renumber[index]}.png")
    edit_lines(
        folder,
        lambda lines: (
            [lines[0]] + [line.replace(f" {i:06d},", f" {renumber[i]},", 1) for i, line in enumerate(lines[1:])]
        ),
    )
    agree(open_capture(folder), FRAMES)


def test_missing_and_damaged_depth(folder: Path) -> None:
    (folder / "depth" / "000001.png").unlink()
    (folder / "depth" / "000002.png").write_bytes(b"\x89PNG")
    (folder / "confidence" / "000003.png").unlink()
    capture = open_capture(folder)
    assert len(capture) == 6 and capture.depth_count == 4 and capture[3].confidence is None
    assert "1 depth maps are damaged" in capture.faults[0] and "2 pictures have no depth" in capture.remarks[0]


def test_poses_that_are_none_are_left_out_and_counted(folder: Path) -> None:
    def spoil(lines: list[str]) -> list[str]:
        cells = lines[2].split(", ")
        return [lines[0], lines[1], ", ".join([*cells[:2], "nan", "-inf", *cells[4:]]), *lines[3:]]

    edit_lines(folder, spoil)
    capture = open_capture(folder)
    assert len(capture) == 5 and "1 poses are unusable" in capture.faults[0] and "000001" in capture.faults[0]


def test_clocks_that_go_back_are_put_in_order_and_told(folder: Path) -> None:
    edit_lines(folder, lambda lines: [lines[0], *reversed(lines[1:])])
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == [frame.name for frame in FRAMES]
    assert "5 times go back" in capture.remarks[0]


def test_a_last_row_that_was_cut_off_is_left_out(folder: Path) -> None:
    file = folder / "odometry.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:-1], lines[-1][:30]]))
    capture = open_capture(folder)
    assert len(capture) == 5 and "cut off" in capture.faults[0]


@pytest.mark.parametrize(
    "row, column, text, problem",
    [
        (2, 2, "far", "line 3: x: need a number, got 'far'"),
        (2, 1, "1.5", "line 3: frame: need a whole number"),
        (2, 1, "1e99", "line 3: frame: need a whole number"),
        (2, 0, "nan", "line 3: timestamp: need a finite number"),
        (2, 9, "-5", "focal lengths"),
        (2, 9, "1e6", "do not belong to 96x72"),
        (0, 4, "height", "has no column z"),
    ],
)
def test_bad_cells_are_named(folder: Path, row: int, column: int, text: str, problem: str) -> None:
    def spoil(lines: list[str]) -> list[str]:
        cells = lines[row].split(", ")
        cells[column] = text
        return [*lines[:row], ", ".join(cells), *lines[row + 1 :]]

    edit_lines(folder, spoil)
    refuses(folder, "odometry.csv", problem)
