"""Pairs of pictures of one place under two lights, in files written to Middlebury's layouts."""

from pathlib import Path

import numpy as np
import pytest

from hyjax.data.relit_pairs import open_relit_pairs
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

CALIBRATION = """cam0=[40.0 0 20; 0 40.0 15; 0 0 1]
cam1=[40.0 0 22 ; 0 40.0 15; 0 0 1 ]
doffs= 2
 baseline=100
width=40
height=30
"""


def write_pfm(path: Path, values: np.ndarray) -> None:
    height, width = values.shape
    path.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + values[::-1].astype("<f4").tobytes())


def picture(path: Path, level: float, shape: tuple[int, int] = (30, 40)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.full((*shape, 3), level, np.float32))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    picture(tmp_path / "Desk" / "im1.png", 0.25, (40, 53))  # as the scenes of 2005, of another size
    picture(tmp_path / "Desk" / "im0.png", 0.25)
    picture(tmp_path / "DeskL" / "im1.png", 0.5)
    (tmp_path / "DeskL" / "calib.txt").write_text(CALIBRATION)
    disparity = np.full((30, 40), 6.0)
    disparity[0, 0] = np.inf
    write_pfm(tmp_path / "Desk" / "disp0GT.pfm", disparity)
    return tmp_path


def test_a_pair_of_the_evaluation(folder: Path) -> None:
    (pair,) = open_relit_pairs(folder, width=20)
    assert pair.name == "Desk" and pair.partner is not None and pair.depth is not None
    assert [p.shape for p in pair.pictures] == [(15, 20, 3)] * 2
    assert pair.pictures[0].mean() == pytest.approx(0.25, abs=0.01)
    assert pair.pictures[1].mean() == pytest.approx(0.5, abs=0.01)
    assert pair.baseline == pytest.approx(0.1) and pair.camera.intrinsics.cx == pytest.approx(11)
    assert pair.depth[0, 0] == 0 and pair.depth[1, 1] == pytest.approx(40 * 0.1 / (6 + 2))


def test_an_archive_with_several_lights(tmp_path: Path) -> None:
    scene = tmp_path / "Shelf"
    for light, level in (("L1", 0.2), ("L2", 0.4), ("L3", 0.6)):
        for exposure in range(3):
            picture(scene / "ambient" / light / f"im0e{exposure}.png", level + 0.1 * (exposure - 1))
    (scene / "calib.txt").write_text(CALIBRATION)
    write_pfm(scene / "disp0.pfm", np.full((30, 40), 6.0))
    pairs = open_relit_pairs(tmp_path, width=40)
    assert [pair.name for pair in pairs] == ["Shelf L1 L2", "Shelf L1 L3", "Shelf L2 L3"]
    assert pairs[1].pictures[1].mean() == pytest.approx(0.6, abs=0.01)  # the middle exposure
    assert pairs[0].baseline == 0


@pytest.mark.parametrize(
    "file, content, message",
    [
        ("DeskL/calib.txt", "cam0=[1 2]", "need 1 number"),
        ("DeskL/calib.txt", CALIBRATION.replace("40.0 0 22", "x 0 22"), "cam1: need 9 numbers"),
        ("Desk/disp0GT.pfm", "P5", "not a one-channel PFM"),
    ],
)
def test_damaged_files_are_one_line(folder: Path, file: str, content: str, message: str) -> None:
    (folder / file).write_text(content)
    with pytest.raises(InputError, match=message) as error:
        open_relit_pairs(folder)
    assert "\n" not in str(error.value)


def test_folders_without_pairs(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "empty").mkdir()
    for place, message in ((tmp_path / "empty", "no folder NAME/"), (tmp_path / "nothing", "no such folder")):
        with pytest.raises(InputError, match=message):
            open_relit_pairs(place)
    write_pfm(folder / "Desk" / "disp0GT.pfm", np.full((15, 20), 6.0))
    with pytest.raises(InputError, match="is 20x15, but"):
        open_relit_pairs(folder)
