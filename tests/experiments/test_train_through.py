"""The comparison of the two ways to train, on a toy network and a handful of updates."""

from pathlib import Path

import pytest
from reference.toy_encoder import ToyEncoder
from test_depth_sr import write_pairs

from experiments import train_through
from experiments.records import FILE, of_kind, read_rows
from experiments.train_through import THROUGH, Config, main
from hyjax.guide import ENCODERS


@pytest.mark.slow
def test_both_ways_are_trained_and_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENCODERS, "toy", ToyEncoder)
    specs = [(f"folder:{write_pairs(tmp_path / name, 2, seed)}",) for seed, name in enumerate("abc")]
    config = Config(
        *specs,
        encoder="toy",
        updates=20,
        batch=2,
        features=2,
        size=32,
        factors=(8,),
        steps=20,
        out=tmp_path / "out",
    )
    main(config)
    rows = read_rows(config.out / FILE)
    runs = of_kind(rows, "run")
    assert [row["through"] for row in runs] == list(THROUGH)
    assert all(len(row["losses"]) == 20 and row["seconds"] > 0 for row in runs)
    assert runs[0]["losses"] != runs[1]["losses"]
    methods = {row["method"] for row in of_kind(rows, "score")}
    assert {f"{through}.safetensors, 20 steps" for through in THROUGH} < methods
    text = (config.out / f"{train_through.main.name}.md").read_text()
    assert "cascade.safetensors, paper-80" in text and (config.out / "loss.png").stat().st_size > 1000
