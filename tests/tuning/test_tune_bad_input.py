"""Bad input to `hyjax tune`: exit status 2, one clear line, nothing half-written."""

import logging
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import pytest
from clocks import steady_clock
from extras import need
from reference.seven_scenes_export import export_seven_scenes

from hyjax import cli
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.tuning.cascade import CascadeStage
from hyjax.tuning.descent import Objective
from hyjax.util import clock as latency

need("tune")

ROOT = logging.getLogger()


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def given(room: RoomCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture without depth, a mesh, and an empty cache that is filled along the way."""
    folder = tmp_path_factory.mktemp("given")
    export_seven_scenes([room[i] for i in range(4)], room.up, folder / "capture")
    room.reference().export(folder / "true.ply")
    (folder / "far.obj").write_text("v 900 0 0\nv 901 0 0\nv 901 1 0\nf 1 2 3\n")
    (folder / "lights.yaml").write_text("lights: [{kind: point, position: [2.2, 2.6, 1.5], luminous_flux: 2000}]\n")
    (folder / "bad.yaml").write_text("lights: [{kind: pint}]\n")
    return folder


@pytest.fixture(scope="module", autouse=True)
def quick(given: Path) -> Iterator[None]:
    """A steady clock, and whatever tests set up for logging undone."""
    handlers = ROOT.handlers[:]
    with pytest.MonkeyPatch.context() as patch:
        steady_clock(patch)
        patch.setenv("HYJAX_CACHE", str(given / "cache"))
        patch.setattr(cli, "_keep_for_later", lambda: None)
        yield
    for handler in set(ROOT.handlers) - set(handlers):
        ROOT.removeHandler(handler)


Tune = Callable[..., tuple[int, str, str]]


@pytest.fixture
def tune(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, given: Path, tmp_path: Path) -> Tune:
    """`hyjax tune` in this process: exit status, stdout and stderr. Later options win over those that all have."""

    def command(*options: object) -> tuple[int, str, str]:
        usual: dict[str, object] = {
            "--capture": given / "capture",
            "--mesh": given / "true.ply",
            "--target": "converged",
            "--lights": given / "lights.yaml",
            "--frames": "0",
            "--holdout": "3",
            "--size": "48",
            "--stage": "cascade",
            "--budget-ms": "5",
            "--trials": "4",
            "--out": tmp_path / "out",
        }
        names = [option for option in options if str(option).startswith("--")]
        for name in names:
            usual.pop(str(name), None)
        if "--fps" in names:
            usual.pop("--budget-ms", None)
        usual = {name: value for name, value in usual.items() if f"no {name}" not in options}
        given_options = [str(o) for o in options if not str(o).startswith("no ")]
        line = ["--quiet", "--no-extra", "--repair-mesh", *(str(x) for pair in usual.items() for x in pair)]
        monkeypatch.setattr(sys, "argv", ["hyjax", "tune", *line, *given_options])
        status = 0
        try:
            cli.main()
        except SystemExit as exit_:
            status = exit_.code if isinstance(exit_.code, int) else 1
        return (status, *capsys.readouterr())

    return command


def refused(done: tuple[int, str, str], *parts: str) -> str:
    status, out, err = done
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("hyjax: "), err
    assert status == 2 and out == ""
    for part in parts:
        assert part in lines[0]
    return lines[0]


BEFORE_ANYTHING: dict[str, tuple[tuple[object, ...], tuple[str, ...]]] = {
    "fps 0": (("--fps", 0), ("fps", "> 0", "got 0")),
    "fps negative": (("--fps=-5",), ("fps", "> 0", "got -5")),
    "fps nan": (("--fps", "nan"), ("fps", "finite", "nan")),
    "fps inf": (("--fps", "inf"), ("fps", "finite", "inf")),
    "one bad among good": (("--fps", 60, 0), ("fps", "got 0")),
    "budget 0": (("--budget-ms", 0), ("ms", "> 0", "got 0")),
    "budget nan": (("--budget-ms", "nan"), ("ms", "finite", "nan")),
    "no budget": (("no --budget-ms",), ("budget", "--fps 60", "--budget-ms")),
    "lights": (("--lights", "noon-windw"), ("'noon-windw'", "noon-window")),
    "mesh": (("--mesh", "scann"), ("scann",)),
    "mesh file": (("--mesh", "none.ply"), ("none.ply",)),
    "target": (("--target", "convergd"), ("convergd",)),
    "target file": (("--target", "none.ply"), ("none.ply",)),
    "size": (("--size", "0"), ("size", "'0'")),
    "capture": (("--capture", "nowhere"), ("nowhere", "no such folder")),
    "time limit": (("--time-limit", "0"), ("time limit", "> 0")),
    "seed": (("--seed=-1",), ("seed",)),
    "voxel": (("--voxel", "0"), ("voxel",)),
}


@pytest.mark.parametrize("name", BEFORE_ANYTHING)
def test_bad_input_is_one_line(name: str, tune: Tune, tmp_path: Path) -> None:
    options, parts = BEFORE_ANYTHING[name]
    refused(tune(*options), *parts)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


AFTER_READING: dict[str, tuple[tuple[object, ...], tuple[str, ...]]] = {
    "all held out": (("--holdout", "all"), ("held out", "none is left to tune on")),
    "tuned on what is held out": (("--frames", "0:2", "--holdout", "0:2"), ("held out", "none is left to tune on")),
    "frames past the end": (("--frames", "0:9"), ("past the end", "0 to 3")),
    "holdout past the end": (("--holdout", "4"), ("past the end", "0 to 3")),
    "target without depth": (("--target", "fused"), ("depth",)),
    "true mesh of a capture": (("--target", "true"), ("true",)),
}


@pytest.mark.parametrize("name", AFTER_READING)
def test_bad_choices_are_one_line(name: str, tune: Tune, tmp_path: Path) -> None:
    options, parts = AFTER_READING[name]
    refused(tune(*options), *parts)
    assert not list((tmp_path / "out").iterdir())


def test_bad_lights_file(tune: Tune, given: Path, tmp_path: Path) -> None:
    refused(tune("--lights", given / "bad.yaml"), "bad.yaml", "'pint'")
    assert not (tmp_path / "out").exists()


def test_a_mesh_far_away(tune: Tune, given: Path, tmp_path: Path) -> None:
    parts = ("no ray of any of 1 tuning frames met the mesh", "poses", "coordinates")
    refused(tune("--mesh", given / "far.obj"), *parts)
    assert not list((tmp_path / "out").iterdir())
    refused(tune("--target", given / "far.obj", "--out", tmp_path / "other"), *parts)


def test_the_same_folder_after_a_refusal(tune: Tune, given: Path, tmp_path: Path) -> None:
    """What was refused before anything was found is no run that would have to be resumed."""
    refused(tune("--mesh", given / "far.obj"))
    assert tune()[0] == 0


def test_an_output_folder_that_cannot_be_made(tune: Tune, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    refused(tune("--out", tmp_path / "file"), "file", "cannot write")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_budget_below_the_smallest(tune: Tune, tmp_path: Path) -> None:
    line = refused(
        tune("--budget-ms", "0.0001"), "budget 0.0001 ms", "out of reach", "smallest reachable time (p95)"
    )
    assert "--budget-ms" in line and "--size" in line
    assert not list((tmp_path / "out").iterdir())
    advised = float(line.split("give at least --budget-ms ")[1].split(",")[0])
    assert tune("--budget-ms", advised, "--out", tmp_path / "other")[0] == 0, "what it advises is possible"


# ---- after another run ----


@pytest.fixture
def done(tune: Tune, tmp_path: Path) -> dict[str, bytes]:
    status, out, err = tune()
    assert status == 0, err
    assert "report.html" in out and err == ""
    return content(tmp_path / "out")


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_other_runs_are_not_overwritten(done: dict[str, bytes], tune: Tune, tmp_path: Path) -> None:
    refused(tune(), "out", "another run", "--resume")
    refused(tune("--resume", "--seed", 1), "cannot resume", "seed 0", "has 1")
    refused(tune("--resume", "--frames", "1"), "cannot resume", "frames [0]", "[1]")
    refused(tune("--resume", "--size", 64), "cannot resume", "size [48, 48]", "[64, 64]")
    assert content(tmp_path / "out") == done
    Schedule.from_json((tmp_path / "out" / "schedule.json").read_text()).check()
    assert tune("--resume")[0] == 0


# ---- the device ----


@pytest.fixture
def tables(tune: Tune, given: Path) -> list[Path]:
    """The latency tables in the cache; where no test has made any yet, that of a run."""

    def cached() -> list[Path]:
        return list((given / "cache").glob("latency-*.json"))

    if not cached():
        assert tune()[0] == 0
    return cached()


@pytest.mark.slow
def test_a_broken_table_in_the_cache_is_made_anew(tables: list[Path], tune: Tune, tmp_path: Path) -> None:
    assert tables
    for table in tables:
        table.write_bytes(b"\xff\xfe")
    status, _, err = tune("--out", tmp_path / "again")
    assert status == 0 and err == ""
    report = (tmp_path / "again" / "report.html").read_text()
    assert "calibrated anew" in report and ("is broken" in report or "cannot be read" in report)
    assert any(table.read_bytes() != b"\xff\xfe" for table in tables)


def fails(*_: object, **__: object) -> None:
    raise jax.errors.JaxRuntimeError("INTERNAL: the device fell off\nand a long trace")


@pytest.mark.slow
def test_a_device_that_fails_amid_the_search(tune: Tune, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Objective, "gradient", fails)
        refused(tune(), "device", "cpu", "INTERNAL: the device fell off", "--resume", str(tmp_path / "out"))
    Schedule.from_json((tmp_path / "out" / "schedule.json").read_text()).check()
    assert not [path for path in (tmp_path / "out").rglob("*") if ".part" in path.name]
    assert tune("--resume")[0] == 0


def test_a_device_that_fails_for_good(tune: Tune, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Then what was found cannot be timed and judged either."""
    monkeypatch.setattr(Objective, "gradient", fails)
    monkeypatch.setattr(CascadeStage, "examples", fails)
    refused(tune(), "device", "INTERNAL: the device fell off", "--resume")
    Schedule.from_json((tmp_path / "out" / "schedule.json").read_text()).check()


def test_a_device_that_fails_while_calibrating(tune: Tune, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def failing(calls: Mapping[str, Any], *_: object, **__: object) -> None:
        fails()

    monkeypatch.setattr(latency, "measure_each", failing)
    refused(tune("--recalibrate"), "device", "INTERNAL: the device fell off")
    assert not list((tmp_path / "out").iterdir())


# ---- as a process ----


@pytest.mark.slow
def test_as_a_person_runs_it(given: Path, tmp_path: Path) -> None:
    hyjax = str(Path(sys.executable).with_name("hyjax"))
    command = [hyjax, "tune", "--quiet", "--fps", "0", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    refused((done.returncode, done.stdout, done.stderr), "fps", "> 0")
    assert not (tmp_path / "out").exists()
