"""Intrinsics of ARKitScenes, and files that are found by the time in their name."""

from pathlib import Path

import pytest
from reference.arkit_export import write_pincam

from hyjax.data.arkit_scenes import NAME_TOLERANCE, read_pincam
from hyjax.data.capture_files import timed_files
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError


def test_numbers_are_taken_as_they_are(tmp_path: Path) -> None:
    file = tmp_path / "41000000_6845.210.pincam"
    file.write_text("640 480 529.872 530.125 319.833 239.917\n")
    assert read_pincam(open_tree(file), file.name) == Intrinsics(640, 480, 529.872, 530.125, 319.833, 239.917)
    lens = Intrinsics(256, 192, 212.5, 211.25, 127.125, 95.0625)
    write_pincam(file, lens)
    assert read_pincam(open_tree(file), file.name) == lens


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "0 numbers"),
        ("640 480 530 530 320", "5 numbers, need 6: width height fx fy cx cy"),
        ("640 480 530 530 320 240 0", "7 numbers"),
        ("640 480 530 530 320 middle", "plain numbers"),
        ("640.5 480 530 530 320 240", "640.5x480 is not whole"),
        ("inf 480 530 530 320 240", "not whole"),
        ("0 480 530 530 320 240", "at least 1x1"),
        ("640 480 -530 530 320 240", "focal lengths"),
        ("640 480 530 530 nan 240", "finite"),
    ],
)
def test_malformed_files_are_named(tmp_path: Path, content: str, problem: str) -> None:
    file = tmp_path / "41000000_6845.210.pincam"
    file.write_text(content)
    with pytest.raises(InputError) as caught:
        read_pincam(open_tree(file), file.name)
    message = str(caught.value)
    assert str(file) in message and problem in message and "\n" not in message


def test_a_binary_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "41000000_6845.210.pincam"
    file.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match=r"41000000_6845\.210\.pincam"):
        read_pincam(open_tree(file), file.name)


def test_names_may_differ_by_a_millisecond(tmp_path: Path) -> None:
    for time in ("6845.209", "6845.243", "6845.276"):
        (tmp_path / f"41000000_{time}.pincam").touch()
    for other in ("._41000000_6845.210.pincam", "41000000_6845.242.png", "41000000_end.pincam"):
        (tmp_path / other).touch()
    files = timed_files(open_tree(tmp_path), "", ".pincam")
    assert [file.time for file in files] == [6845.209, 6845.243, 6845.276]
    for time, found in ((6845.21, 6845.209), (6845.208, 6845.209), (6845.243, 6845.243), (6845.277, 6845.276)):
        file = files.nearest(time, NAME_TOLERANCE)
        assert file is not None and file.time == found and file.name == f"41000000_{found:.3f}.pincam"
    for time in (6845.207, 6845.211, 6845.241, 6845.278, 0.0):
        assert files.nearest(time, NAME_TOLERANCE) is None
    assert files.nearest(6845.25, 1.0) == files.nearest(6845.243, 0.0)
    assert timed_files(open_tree(tmp_path), "none", ".pincam").nearest(6845.21, 1.0) is None


def test_two_files_of_one_time(tmp_path: Path) -> None:
    for name in ("41000000_6845.210.png", "41000001_6845.210.png"):
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=r"41000001_6845\.210\.png: time 6845\.210 is also 41000000"):
        timed_files(open_tree(tmp_path), "", ".png")
