import csv
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import standins
import yaml

from hyjax import cli
from hyjax.configuration import Configuration, ShadowOptions
from hyjax.sweep import run, spec
from hyjax.sweep.settings import SweepSettings
from hyjax.sweep.summary import draw, lines_of
from hyjax.util.errors import InputError

SPEC: dict[str, Any] = {
    "scenes": ["room:builtin-0", "room:random-5-2-both"],
    "lights": ["evening-lamps", "night-moon"],
    "configurations": ["default", "paper"],
    "seeds": [0, 1],
}


def write(folder: Path, **values: Any) -> Path:
    path = folder / "spec.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in (SPEC | values).items() if value is not None}))
    return path


def sweep(path: Path, out: Path, **options: Any) -> run.SweepResult:
    settings = SweepSettings(path, workers=0, out=out, quiet=True, **options)
    return run.run_sweep(settings, evaluate=standins.loss, time_frames=standins.milliseconds)


def test_a_sweep_of_everything(tmp_path: Path) -> None:
    swept = sweep(write(tmp_path, time=True), out := tmp_path / "out")
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    assert swept.tasks == len(rows) == 2 * 2 * 2 * (2 + 1) and swept.repeated == 0
    assert len({row["key"] for row in rows}) == len(rows)
    assert rows[0]["frames"] == [0, 4, 7, 11] and rows[0]["size"] == "320x240" and rows[0]["name"] == "default"
    assert len(swept.errors) == 4 and swept.errors[0].endswith("lights: too dark for the paper")
    default, paper = lines_of(rows)
    assert (default.count, default.errors, paper.count, paper.errors) == (12, 0, 8, 4)
    assert default.means["median_ms"] == 5.0 and len(default.losses) == 2
    first, second = csv.DictReader((out / "summary.csv").read_text().splitlines())
    assert (first["configuration"], second["configuration"]) == ("default", "paper")
    assert float(first["loss"]) == pytest.approx(default.means["loss"], 1e-5) and first["psnr"] == "30"
    assert (out / "sweep.png").stat().st_size > 1000
    with pytest.raises(InputError, match="holds the rows of a sweep; add --resume"):
        sweep(write(tmp_path), out)


def test_parts_are_put_together(tmp_path: Path) -> None:
    path, out = write(tmp_path), tmp_path / "out"
    parts = [sweep(path, out, task=f"{number}/3") for number in (1, 2, 3)]
    assert [part.tasks for part in parts] == [6, 5, 5] and parts[0].out == out / "part-1-of-3"
    file = next(parts[1].out.glob("rows-*.jsonl"))
    with file.open("ab") as appended:
        appended.write(b'{"key": "cut of')
    whole = sweep(path, out, resume=True)
    assert whole.tasks == 16 and whole.repeated == 0 and whole.damaged == 1
    own = [line for rows in out.glob("rows-*.jsonl") for line in rows.read_text().splitlines()]
    assert {json.loads(line)["kind"] for line in own} == {"error"}, "failed tasks alone are tried again"
    with pytest.raises(InputError, match="holds the rows of a sweep"):
        sweep(path, out, task="1/3")
    assert sweep(path, out, task="1/3", resume=True).tasks == 6


@pytest.mark.parametrize("task", ["0/3", "4/3", "3", "1/0", "-1/3", "1/3/5", ""])
def test_parts_that_there_are_not(task: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="task: must be a part of all, such as 3/16"):
        sweep(write(tmp_path), tmp_path / "out", task=task)


def test_a_sweep_goes_on_with_more_of_a_spec(tmp_path: Path) -> None:
    done = []

    def count(payload: dict[str, Any]) -> dict[str, Any]:
        done.append(payload)
        return standins.loss(payload)

    standins.count = count  # type: ignore[attr-defined]
    count.__module__, count.__qualname__ = "standins", "count"
    settings = SweepSettings(
        write(tmp_path, configurations=["default"]), workers=0, out=tmp_path / "out", quiet=True
    )
    assert run.run_sweep(settings, evaluate=count).tasks == len(done) == 8
    again = SweepSettings(write(tmp_path), workers=0, out=tmp_path / "out", quiet=True, resume=True)
    assert run.run_sweep(again, evaluate=count).tasks == 16 and len(done) == 16


def test_draws_and_files_of_configurations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(count: int, seed: int) -> Sequence[Configuration]:
        return [Configuration(name=str(k), shadows=ShadowOptions(views=seed + k + 1)) for k in range(count)]

    monkeypatch.setattr(spec, "random_configurations", drawn)
    read = spec.read_spec(write(tmp_path, configurations={"space": "default", "count": 3, "seed": 2}))
    found = spec.configurations_of(read)
    assert [found[f"default-2-{k}"]["shadows"]["views"] for k in range(3)] == [3, 4, 5]
    (tmp_path / "mine.json").write_text(drawn(1, 6)[0].to_json())
    found = spec.configurations_of(spec.read_spec(write(tmp_path, configurations=["default", "mine.json"])))
    assert found["mine"]["shadows"]["views"] == 7 and found["default"]["shadows"]["views"] is None


def test_a_figure_of_many_names_none(tmp_path: Path) -> None:
    rows = [{"key": str(k), "kind": "result", "scene": "a", "loss": k, "name": f"n{k}"} for k in range(50)]
    (axes,) = draw(lines_of(rows)).axes
    assert axes.get_xlabel() == "configurations, least loss first"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scene": ["x"]}, r"unknown key 'scene' \(did you mean 'scenes'"),
        ({"lights": None}, r"key 'lights' is missing"),
        ({"scenes": []}, r"'scenes' must be a list of at least one text, got \[\]"),
        ({"scenes": ["room:bultin-0"]}, r"no room 'bultin-0' \(did you mean 'builtin-0'"),
        ({"scenes": ["nowhere"]}, "no capture .*nowhere; a room of known truth is called room:NAME"),
        ({"lights": ["noon-windo"]}, r"no set-up 'noon-windo' \(did you mean 'noon-window'"),
        ({"lights": ["two-colors", "two-colors"]}, r"'lights' must not repeat a name"),
        ({"lights": ["none.yaml"]}, "no such file"),
        ({"configurations": ["defualt"]}, r"no preset 'defualt' \(did you mean 'default'"),
        ({"configurations": ["none.json"]}, r"none\.json: no such file"),
        ({"configurations": {"space": "default", "conut": 3}}, r"did you mean 'count'"),
        ({"configurations": {"space": "default", "count": 0}}, r"'count' must be a whole number >= 1, got 0"),
        ({"configurations": {"space": "defualt", "count": 3}}, r"no space 'defualt' \(did you mean"),
        ({"configurations": 3}, r"'configurations' must be a list of names and files, or a mapping"),
        ({"frames": 0}, r"'frames' must be a number >= 1"),
        ({"frames": [0, 12]}, "frames: 12 is past the end of room:builtin-0, which has 12"),
        ({"size": "big"}, "size: 'big' must be"),
        ({"seeds": [-1]}, r"'seeds' must be a list of whole numbers >= 0"),
        ({"time": "often"}, r"'time' must be true or false, got 'often'"),
    ],
)
def test_bad_specs(values: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message) as caught:
        sweep(write(tmp_path, **values), tmp_path / "out")
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("hyjax.tuning.evaluation.evaluate", standins.loss)
    monkeypatch.setattr(run.work, "_start", lambda: None)
    path, out = write(tmp_path), tmp_path / "out"
    monkeypatch.setattr("sys.argv", ["hyjax", "sweep", str(path), "--workers", "0", "--out", str(out), "--quiet"])
    cli.main()
    printed = capsys.readouterr()
    assert printed.out.startswith("16 tasks of 2 configurations; look at")
    assert "4 tasks have no result; the first: paper on room:builtin-0: lights: too dark" in printed.err
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2 and "add --resume" in capsys.readouterr().err
    with next(out.glob("rows-*.jsonl")).open("a") as file:
        file.write('{"key": "cut off')
    monkeypatch.setattr("sys.argv", [*sys.argv, "--resume"])
    cli.main()
    assert "1 damaged line of rows left out" in capsys.readouterr().err
