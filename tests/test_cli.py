"""The commands as a person runs them: as processes."""

import gc
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from hyjax.cli import main
from hyjax.core.schedule import Schedule
from hyjax.data.frames import fit
from hyjax.data.registry import open_capture
from hyjax.info import InfoSettings
from hyjax.light.color import to_linear
from hyjax.util.images import read_image

HYJAX = str(Path(sys.executable).with_name("hyjax"))
POINT = {"kind": "point", "position": [2.2, 2.6, 1.5], "luminous_flux": 2000}
Done = subprocess.CompletedProcess[str]


def hyjax(*arguments: object) -> Done:
    return subprocess.run([HYJAX, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False)


def relight(*arguments: object) -> None:
    """Relight in this process, where a warning is an error: `first` is the command in one of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["hyjax", "relight", "--quiet", *map(str, arguments)])
        patch.setattr("hyjax.cli.defer_interrupts", lambda: None)
        main()


def opens(out: Path) -> int:
    """Every picture in the folder is whole and nothing temporary is left; how many there are."""
    pictures = [entry for entry in out.iterdir() if entry.suffix in (".png", ".exr")]
    for picture in pictures:
        assert np.isfinite(read_image(picture)).all()
    assert not [entry.name for entry in out.iterdir() if entry.name.startswith(".") or "part" in entry.name]
    return len(pictures)


def record(out: Path) -> dict:
    return json.loads((out / "run.json").read_text())


def closeness(a: Path, b: Path) -> float:
    """Largest relative difference of two EXRs."""
    x, y = read_image(a), read_image(b)
    assert x.shape == y.shape
    return float((np.abs(x - y) / (0.05 + np.abs(x))).max())


@pytest.fixture(scope="session")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small frames of the built-in room with everything written."""
    out = tmp_path_factory.mktemp("first") / "out"
    extras = ("--save-filters", "--save-visibility", "--exr")
    done = hyjax(
        "relight",
        "--quiet",
        "--frames",
        "0:24:12",
        "--size",
        "160x120",
        "--lights",
        "two-colors",
        *extras,
        "--out",
        out,
    )
    assert done.returncode == 0 and done.stderr == ""
    assert "2 frames relit" in done.stdout and str(out / "contact_sheet.png") in done.stdout
    return out


def test_info() -> None:
    done = hyjax("info")
    assert done.returncode == 0 and done.stderr == ""
    for name in ("hyjax", "python", "jax", "numpy", "OpenImageIO", "devices", "cpu cores", "cache"):
        assert re.search(rf"^{name} +\S", done.stdout, re.MULTILINE), name


def test_garbage_is_collected_once_the_modules_are_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    during = []
    monkeypatch.setattr("hyjax.cli.RUNNERS", {InfoSettings: lambda _: during.append(gc.isenabled())})
    monkeypatch.setattr("hyjax.cli.defer_interrupts", lambda: None)
    monkeypatch.setattr(sys, "argv", ["hyjax", "info"])
    threshold = gc.get_threshold()
    gc.disable()
    try:
        main()
    finally:
        gc.enable()
        gc.set_threshold(*threshold)
    assert during == [True]


@pytest.mark.parametrize("frames", [["b", "c"], []])
def test_each_light_tells_of_frames_without_surface(
    frames: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = {"frames": ["a"], "frames_without_surface": frames}
    runs = {Path("out", name): run for name in ("0-point", "1-spot")}
    monkeypatch.setattr("hyjax.cli._keep_for_later", lambda: None)
    monkeypatch.setattr("hyjax.relighting.each_light.relight_each", lambda _: runs)
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight", "--each-light"])
    main()
    told = capsys.readouterr()
    assert told.out == f"2 lights, each by itself; look at {Path('out', '0-point', 'contact_sheet.png')}\n"
    assert told.err == ("hyjax: skipped, no ray met the mesh: b, c\n" if frames else "")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments, hint",
    [
        ((), "relight"),
        (("relite",), "relight"),
        (("relight", "--sice", "512"), "--size"),
        (("relight", "--frames"), "--frames"),
        (("relight", "--guide", "unet"), "rgb"),
        (("relight", "--voxel", "fine"), "--voxel"),
    ],
)
def test_a_wrong_command_line_is_helped(
    arguments: tuple[str, ...], hint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("defer_interrupts", "_keep_for_later"):
        monkeypatch.setattr(f"hyjax.cli.{name}", lambda: None)
    monkeypatch.setattr(sys, "argv", ["hyjax", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and hint in capsys.readouterr().err


def test_a_wrong_command_line_is_refused_before_anything_heavy_is_loaded() -> None:
    code = """
import sys
sys.argv = ["hyjax", "relight", "--voxel", "fine"]
from hyjax.cli import main
try:
    main()
except SystemExit as end:
    print(end.code, *sorted({"trimesh", "OpenImageIO", "skimage", "matplotlib", "optax"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout == "2\n"


def test_help_names_every_option() -> None:
    text = hyjax("relight", "--help").stdout
    for option in ("capture", "mesh", "frames", "lights", "schedule", "size", "guide", "paper-mode", "out", "seed"):
        assert f"--{option}" in text
    for preset in ("noon-window", "evening-lamps", "night-moon", "paper-50", "paper-80"):
        assert preset in text


@pytest.mark.slow
def test_a_run_on_the_built_in_room(first: Path) -> None:
    kinds = ("relit", "filter", "refined", "visibility")
    names = {f"{n}.{kind}.{suffix}" for n in ("000", "012") for kind in kinds for suffix in ("png", "exr")}
    assert {entry.name for entry in first.iterdir()} == names | {"contact_sheet.png", "run.json", "lights.json"}
    assert opens(first) == 17
    for name in names:
        assert read_image(first / name).shape == (120, 160, 3)
    assert read_image(first / "000.relit.png").std() > 0.05
    visible = read_image(first / "000.visibility.exr")
    assert visible.min() >= 0 and visible.max() <= 1 and visible.std() > 0.05


@pytest.mark.slow
def test_the_record_of_a_run(first: Path) -> None:
    run = record(first)
    assert run["frames"] == ["000", "012"] and run["frames_without_surface"] == []
    assert run["size"] == [120, 160] and run["mode"] == "linear" and run["schedule"]["name"] == "hyjax"
    assert run["versions"]["hyjax"] and run["versions"]["jax"] and run["device"] and run["cpu_count"] > 0
    settings = run["settings"]
    assert settings["frames"] == "0:24:12" and settings["lights"] == "two-colors" and settings["save_filters"]
    assert settings["capture"] == "built-in room" and "scan" in settings["mesh"] and settings["out"] == str(first)
    for stage in ("read", "g-buffer", "shading", "visibility", "cascade", "shadow pass", "composite", "write"):
        times = run["milliseconds"][stage]
        assert times["count"] == 1 and times["first_ms"] > 0 and times["median_ms"] > 0


@pytest.mark.slow
def test_a_second_run_replaces_files_and_takes_the_lights_back(first: Path, tmp_path: Path) -> None:
    """The lights that a run wrote give the same picture again; other files in the folder stay."""
    out = tmp_path / "out"
    out.mkdir()
    for name in ("000.relit.exr", "000.relit.png", "run.json", "contact_sheet.png"):
        (out / name).write_text("old")
    (out / "mine.txt").write_text("mine")
    relight("--frames", 0, "--size", "160x120", "--lights", first / "lights.json", "--exr", "--out", out)
    assert opens(out) == 3 and (out / "mine.txt").read_text() == "mine"
    assert record(out)["frames"] == ["000"]
    assert closeness(first / "000.relit.exr", out / "000.relit.exr") < 0.01
    assert (out / "lights.json").read_text() == (first / "lights.json").read_text()


@pytest.mark.slow
def test_paper_mode_schedule_and_lights_from_files(tmp_path: Path) -> None:
    """Paper mode and no shadows show in the picture."""
    schedule = Schedule.uniform([(4, 3), (2, 2)], kappa=0.1, name="mine")
    (tmp_path / "mine.json").write_text(schedule.to_json())
    lights = {"reference_lux": 300, "lights": [POINT, {"kind": "ambient", "illuminance": 20}]}
    (tmp_path / "lights.yaml").write_text(yaml.safe_dump(lights))
    options = ("--paper-mode", "--no-shadows", "--exr", "--save-visibility", "--save-filters", "--frames", "-1")
    files = ("--schedule", tmp_path / "mine.json", "--lights", tmp_path / "lights.yaml")
    out = tmp_path / "out"
    relight(*options, *files, "--size", 64, "--out", out)
    run = record(out)
    assert run["mode"] == "paper" and run["size"] == [64, 64] and run["frames"] == ["023"]
    assert run["schedule"] == json.loads(schedule.to_json()) and run["reference_lux"] == 300
    assert not run["settings"]["shadows"]
    np.testing.assert_array_equal(read_image(out / "023.visibility.exr"), 1.0)
    assert read_image(out / "023.filter.exr").max() <= 1  # display values


@pytest.mark.slow
def test_interrupted_runs_leave_whole_files(tmp_path: Path) -> None:
    # A background job is started with SIGINT ignored, and so would be what it starts.
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "from hyjax.cli import main; main()"
    options = ["--save-filters", "--exr", "--lights", "two-colors", "--out"]
    command = [sys.executable, "-c", code, "relight", *options]
    with subprocess.Popen([*command, str(tmp_path)], stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 240
        while len(list(tmp_path.glob("*.exr"))) < 4 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr.splitlines()[-1] == "hyjax: interrupted; the files written so far are whole"
    assert "Traceback" not in stderr
    assert 4 <= opens(tmp_path) < 24 * 6
    assert not (tmp_path / "run.json").exists()


@pytest.mark.slow
def test_the_kitchen_is_its_photo_times_a_filter_that_follows_the_lamps(kitchen: Path, tmp_path: Path) -> None:
    extras = ("--save-filters", "--save-visibility", "--exr", "--lights", "evening-lamps", "--voxel", 0.05)
    relight("--capture", kitchen, "--frames", "0:300:150", "--size", "160x120", *extras, "--out", tmp_path)
    assert opens(tmp_path) == 17 and record(tmp_path)["mesh_faces"] > 10_000
    assert record(tmp_path)["frames"] == ["frame-000000", "frame-000300"]
    photo = np.asarray(to_linear(jnp.asarray(fit(open_capture(kitchen)[0], (120, 160)).image)))
    relit, refined, visible = (
        read_image(tmp_path / f"frame-000000.{kind}.exr") for kind in ("relit", "refined", "visibility")
    )
    filtered = photo * refined * visible
    shining = (relit > 2 * filtered + 1).any(axis=-1)  # a lamp above the counter, where it is found
    assert shining.mean() < 0.001
    np.testing.assert_allclose(relit[~shining], filtered[~shining], rtol=5e-3, atol=1e-3)  # half floats
    brightness = (refined * visible).mean(axis=-1)
    assert np.percentile(brightness, 95) > 1.5 * np.percentile(brightness, 5) > 0, "lamps light some of it more"
    warm = (refined[..., 0] / refined[..., 2]).mean()
    assert warm > 1.2, "lamps are warmer than the light that the photo was taken under"
