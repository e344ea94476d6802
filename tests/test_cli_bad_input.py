"""Bad input on the command line: exit status 2, one clear line, nothing half-written."""

import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio
import pytest
import trimesh
import yaml
from common import coarse_surface
from reference.seven_scenes_export import export_seven_scenes

from hyjax.cli import main, parse
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.util.errors import InputError

HYJAX = str(Path(sys.executable).with_name("hyjax"))
POINT = {"kind": "point", "position": [2.2, 2.6, 1.5], "luminous_flux": 2000}
Done = subprocess.CompletedProcess[str]


def relight(*arguments: object, **environment: str) -> Done:
    command = [HYJAX, "relight", "--quiet", *map(str, arguments)]
    env = os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, env=env, timeout=300, check=False)


def refuses(out: Path, done: Done, *parts: str) -> None:
    """Exit 2, one line on stderr that holds all `parts`, no half-written file."""
    lines = done.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("hyjax: "), done.stderr
    assert done.returncode == 2 and done.stdout == ""
    for part in parts:
        assert part in lines[0]
    assert not out.is_dir() or not list(out.iterdir())


@pytest.fixture(scope="session")
def room() -> RoomCapture:
    return load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="session")
def true_mesh(room: RoomCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mesh") / "true.ply"
    coarse_surface(room).export(path)
    return path


@pytest.fixture
def capture(room: RoomCapture, tmp_path: Path) -> Path:
    """Two frames of the room in the 7-Scenes layout, without depth."""
    return export_seven_scenes(room, room.up, tmp_path / "capture")


# Each spoils a capture or writes a file, and returns the options to give.
Spoil = Callable[[Path], list[object]]


def spoil(name: str, content: Callable[[Path], bytes]) -> Spoil:
    def apply(folder: Path) -> list[object]:
        (folder / name).write_bytes(content(folder / name))
        return ["--capture", folder]

    return apply


def strictly(apply: Spoil) -> Spoil:
    return lambda folder: [*apply(folder), "--strict"]


def cut(path: Path) -> bytes:
    return path.read_bytes()[: path.stat().st_size // 2]


def truncated_jpegs(folder: Path) -> list[object]:
    for png in folder.glob("*.color.png"):
        oiio.ImageBuf(str(png)).write(str(png.with_suffix(".jpg")))
        png.unlink()
        png.with_suffix(".jpg").write_bytes(cut(png.with_suffix(".jpg")))
    return ["--capture", folder]


def option(name: str, suffix: str, text: str) -> Spoil:
    def apply(folder: Path) -> list[object]:
        (folder / f"given{suffix}").write_text(text)
        return [name, folder / f"given{suffix}", "--capture", folder]

    return apply


def lights(**changes: object) -> Spoil:
    return option("--lights", ".yaml", yaml.safe_dump({"lights": [POINT | changes]}))


def schedule(*levels: dict[str, object]) -> Spoil:
    full = [{"factor": 2, "steps": 2, "kappa": 0.1, "lam": 0.2} | level for level in levels]
    return option("--schedule", ".json", json.dumps({"levels": full}))


def plain(*options: object) -> Spoil:
    return lambda folder: ["--capture", folder, *options]


THIN = "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"
NAN = "v 0 0 0\nv nan 0 0\nv 1 1 0\nf 1 2 3\n"
FIRST = "frame-000000.color.png"
COLOR, POSE = "frame-000001.color.png", "frame-000001.pose.txt"


def mesh(text: str) -> Spoil:
    return option("--mesh", ".obj", text)


def truncated_ply(folder: Path) -> list[object]:
    file = folder / "given.ply"
    trimesh.creation.icosphere(3).export(file)
    file.write_bytes(cut(file))
    return ["--mesh", file, "--capture", folder]


def empty(folder: Path) -> list[object]:
    for entry in folder.iterdir():
        entry.unlink()
    return ["--capture", folder]


SPOILT: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "missing capture": (lambda folder: ["--capture", folder / "none"], ("none", "no such folder")),
    "empty capture": (empty, ("capture", "7-Scenes")),
    "truncated PNG": (
        strictly(spoil(COLOR.replace("1", "0"), cut)),
        ("frame-000000.color.png", "damaged", "--strict"),
    ),
    "truncated JPEGs": (truncated_jpegs, ("frame-000000.color.jpg", "none of 2 pictures can be used")),
    "pose not rigid": (
        strictly(spoil(POSE, lambda p: b"2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")),
        (POSE, "rigid", "--strict"),
    ),
    "intrinsics of another size": (
        spoil("camera-intrinsics.txt", lambda p: b"600 0 320 0 600 240 0 0 1"),
        ("camera-intrinsics.txt", "160x120"),
    ),
    "no depth and no mesh": (plain(), ("no depth", "--mesh")),
    "truncated PLY": (truncated_ply, ("given.ply", "truncated")),
    "mesh without faces": (mesh("v 0 0 0\nv 1 0 0\nv 1 1 0\n"), ("given.obj", "no faces")),
    "mesh with NaN": (mesh(NAN), ("given.obj", "--repair-mesh")),
    "degenerate triangle": (mesh(THIN), ("given.obj", "--repair-mesh")),
    "all rays missing": (mesh("v 900 0 0\nv 901 0 0\nv 901 1 0\nf 1 2 3\n"), ("poses", "coordinates")),
    "kappa 0": (schedule({"kappa": 0}), ("given.json", "kappa")),
    "lambda 1/4": (schedule({"lam": 0.25}), ("given.json", "lam")),
    "factor 0": (schedule({"factor": 0}), ("given.json", "factor", ">= 1")),
    "fine to coarse": (schedule({}, {"factor": 4}), ("given.json", "coarse to fine")),
    "schedule not JSON": (option("--schedule", ".json", "{"), ("given.json", "not JSON")),
    "light kind": (lights(kind="pint"), ("given.yaml", "'pint'", "'point'")),
    "luminous flux": (lights(luminous_flux=-5), ("given.yaml", "'luminous_flux'", "-5")),
    "light key": (lights(postion=1), ("given.yaml", "'postion'", "'position'")),
    "lights of another ending": (option("--lights", ".txt", "lights: []"), ("given.txt", ".yaml or .json")),
    "lights no file can be": (plain("--lights", "b" * 300), ("no set-up", "noon-window")),
    "lights unknown": (plain("--lights", "noon-windows"), ("'noon-windows'", "noon-window")),
    "frames past the end": (plain("--frames", "0:3"), ("past the end", "0 to 1")),
    "frames misspelt": (plain("--frames", "five"), ("'five'", "0:300:30")),
    "frames from and to": (plain("--frames", "0-1"), ("'0-1'", "written 0:2")),
    "frames of many digits": (plain("--frames", "0-" + "9" * 5000), ("frames: ", "0:300:30")),
    "no photo sources": (plain("--photo-sources", "none.yaml"), ("none.yaml", "no such file")),
    "size superscript": (plain("--size", "64²"), ("64²",)),
    "size gigantic": (plain("--size", "99999999"), ("99999999",)),
    "seed": (plain("--seed", "-1"), ("seed",)),
    "voxel": (plain("--voxel", "0"), ("voxel",)),
}
IN_A_PROCESS = {"missing capture", "truncated PNG", "kappa 0"}
"""As a user's, with all of its start and its end; the others share this process."""
NEEDS_MESH = {"truncated PNG", "truncated JPEGs", "seed", "voxel", "frames past the end", "size gigantic"} | {
    name for name in SPOILT if name.startswith(("light", "schedule", "kappa", "lambda", "factor", "fine"))
}


@pytest.fixture
def relight_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """`hyjax relight` in this process, which has everything imported, with its own log handlers."""
    monkeypatch.setattr("hyjax.cli._keep_for_later", lambda: None)
    monkeypatch.setattr("hyjax.cli.defer_interrupts", lambda: None)
    monkeypatch.setattr(logging.getLogger(), "handlers", [])

    def call(*arguments: object) -> Done:
        command = ["hyjax", "relight", "--quiet", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", command)
        status = 0
        try:
            main()
        except SystemExit as ended:
            status = int(ended.code or 0)
        written = capsys.readouterr()
        return Done(command, status, written.out, written.err)

    return call


@pytest.mark.parametrize("name", SPOILT)
def test_bad_input_is_one_line(
    name: str, capture: Path, true_mesh: Path, tmp_path: Path, relight_here: Callable[..., Done]
) -> None:
    apply, parts = SPOILT[name]
    options = apply(capture) + (["--mesh", true_mesh] if name in NEEDS_MESH else [])
    run = relight if name in IN_A_PROCESS else relight_here
    refuses(tmp_path / "out", run("--out", tmp_path / "out", *options), *parts)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("given", [("--out", ""), ("--out=",), ("--configuration", " "), ("--capture", "")])
def test_an_option_that_is_given_nothing(given: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a variable of the shell that is not set."""
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight", *given])
    with pytest.raises(InputError, match=f"{given[0].rstrip('=')}: is given an empty text"):
        parse()


def test_a_capture_without_its_option(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `hyjax info` takes it."""
    for command in ("relight", "tour"):
        monkeypatch.setattr(sys, "argv", ["hyjax", command, "my_scan"])
        with pytest.raises(InputError, match="--capture my_scan"):
            parse()


@pytest.mark.slow
@pytest.mark.parametrize("out", ["file", "file/below"])
def test_an_output_folder_that_cannot_be_made(out: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    refuses(tmp_path / out, relight("--out", tmp_path / out), str(tmp_path / out), "cannot write")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.slow
def test_a_damaged_frame_amid_a_run_is_left_out(capture: Path, true_mesh: Path, tmp_path: Path) -> None:
    options = lights()(capture)  # a file: nothing has to be looked at in order to place them
    content = (capture / COLOR).read_bytes()
    # Its end is there, so that it is found out only when it is read.
    (capture / COLOR).write_bytes(content[: len(content) // 2] + content[-20:])
    out = tmp_path / "out"
    done = relight(*options, "--mesh", true_mesh, "--no-shadows", "--out", out)
    assert done.returncode == 0 and COLOR in done.stderr and "left out" in done.stderr
    assert "light of the photos: no window and no lamp was found; it stays in the pictures: " in done.stderr
    names = {entry.name for entry in out.iterdir()}
    assert {"frame-000000.relit.png", "contact_sheet.png", "run.json"} <= names and len(names) == 4
    done = relight(*options, "--mesh", true_mesh, "--no-shadows", "--keep-photo-light", "--strict", "--out", out)
    assert done.returncode == 2 and COLOR in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_is_no_obstacle(capture: Path, true_mesh: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    options = ("--mesh", true_mesh, "--lights", "center-point", "--no-shadows", "--keep-photo-light", "--frames", 0)
    done = relight(
        "--capture", capture, *options, "--out", tmp_path / "out", HYJAX_CACHE=str(tmp_path / "file" / "cache")
    )
    assert done.returncode == 0, done.stderr
    (line,) = done.stderr.splitlines()
    assert "cannot keep files there for the next start (Not a directory)" in line
