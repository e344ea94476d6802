"""Two runs of the benchmarks compared on the frames that both have judged."""

from pathlib import Path

import pytest

from experiments.paper_bench import BENCHMARKS, METHODS, OWN_GROUP
from experiments.paper_difference import Config, main
from experiments.records import FILE, Results, of_kind, read_rows
from hyjax.metrics import METRICS
from hyjax.util.errors import InputError


def write_run(folder: Path, frames: dict[int, float], name: str = "paper_table", **settings: object) -> Path:
    """A run whose scores are all one number in a frame; the settings stand for a configuration."""
    results = Results(folder, name, Config(first=folder, second=folder))
    results._stamp["settings"] = {"capture": None, "size": 512, "seed": 1} | settings
    for index, score in frames.items():
        methods = {
            group: {METHODS[mode]: {"all": dict.fromkeys(METRICS, score)}} for mode, group in OWN_GROUP.items()
        }
        results.add(kind="frame", index=index, scores=dict.fromkeys(BENCHMARKS, methods))
    results.finish()
    return folder


def test_differences_are_of_the_same_frames(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    first = write_run(tmp_path / "a", {0: 10.0, 1: 30.0, 5: 99.0})
    second = write_run(tmp_path / "b", {1: 31.0, 0: 11.0, 7: 0.0})
    main(Config(first=first, second=second, out=tmp_path / "out"))
    rows = of_kind(read_rows(tmp_path / "out" / FILE), "pair")
    assert {row["index"] for row in rows} == {0, 1}
    assert {row["second"] - row["first"] for row in rows} == {1.0}
    told = capsys.readouterr().out
    assert "mean over 2 frames" in told and "| relighting fidelity, ours | +1.0000 ±0.0000 | +1.00 ±0.00 |" in told


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": {9: 1.0}}, "has judged no frame that"),
        ({"frames": {0: 1.0}, "size": 256}, "had size 256 and .* 512; compare runs on the same pictures"),
        ({"frames": {0: 1.0}, "name": "kappa_sweep"}, "holds no finished run of paper_table"),
    ],
)
def test_runs_that_cannot_be_compared(change: dict, message: str, tmp_path: Path) -> None:
    first, second = write_run(tmp_path / "a", {0: 1.0}), write_run(tmp_path / "b", **change)
    with pytest.raises(InputError, match=message):
        main(Config(first=first, second=second, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
