"""The guide's speed: one run from its command to table and figure, with torch or without."""

from pathlib import Path

import pytest

from experiments import guide_speed
from experiments.blocks import Plot, Table
from experiments.guide_speed import Config, blocks, main
from experiments.records import FILE, read_rows
from hyjax.util.errors import InputError


@pytest.mark.slow
def test_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(guide_speed, "torch_network", lambda encoder, seed, features: None)
    monkeypatch.setattr(guide_speed, "onnx_call", lambda guide, picture: {})
    main(Config(encoders=("small",), sizes=(32,), repeats=2, out=tmp_path))
    rows = read_rows(tmp_path / FILE)
    row, half = [row for row in rows if row["kind"] == "time"]
    assert (
        half["who"] == "ours, half"
        and row["who"] == "ours"
        and row["processor_ms"] > 0
        and row["difference"] is None
        and row["first_ms"] > row["median_ms"] > 0
    )
    table, plot = blocks(rows, tmp_path)
    assert isinstance(table, Table) and isinstance(plot, Plot)
    assert table.rows[0][:2] == ["small, 32²", "ours"] and (tmp_path / "guide_speed.png").is_file()
    assert "| small, 32² | ours |" in capsys.readouterr().out


@pytest.mark.slow
def test_against_torch(tmp_path: Path) -> None:
    from reference.torch_unet import torch_unet

    torch_unet("mobilenetv4_conv_small")
    main(Config(encoders=("small",), sizes=(32,), repeats=2, out=tmp_path))
    rows = [row for row in read_rows(tmp_path / FILE) if row["kind"] == "time"]
    others = {row["who"] for row in rows}
    assert {"ours", "torch", "torch, channels last"} <= others
    assert 0 < rows[0]["difference"] < 1e-4


def test_pictures_that_are_too_small(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sizes: a picture must be at least 32 pixels wide, got 16"):
        main(Config(sizes=(256, 16), out=tmp_path))


def test_nothing_timed_yet(tmp_path: Path) -> None:
    assert blocks([], tmp_path) == ["Nothing has been timed yet."]
