"""`hyjax info PATH`: what is damaged is told, not refused."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reference.phone_layouts import box_room, write_scanner3d

from hyjax.cli import main

FRAMES = box_room(3)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_scanner3d(tmp_path / "scan", FRAMES)


def told(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    monkeypatch.setattr(sys, "argv", ["hyjax", "info", str(folder), "--quiet"])
    main()
    assert (folder.parent / "out" / "scan-info.png").is_file()
    return capsys.readouterr().out


def test_a_depth_map_that_is_damaged_within_is_a_doubt(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(np.zeros((36, 48, 3), np.uint8)).save(folder / "depth_00001.png")
    lines = told(folder, monkeypatch, capsys)
    assert lines.count("depth_00001.png: stored as uint8, must be uint16") == 1 and "median" in lines


def test_depth_without_readings_is_a_doubt(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in folder.glob("depth_*.png"):
        Image.fromarray(np.zeros((36, 48), np.uint16)).save(path)
    assert "the depth maps have no readings" in told(folder, monkeypatch, capsys)
