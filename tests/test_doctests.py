"""Examples in docstrings, README and docs run as shown; every public function of `core` and `metrics` has one."""

import doctest
import importlib
import inspect
import json
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from extras import bringing, need
from PIL import Image
from reference.arkit_export import export_arkit_scan

import hyjax
from experiments.records import FILE, of_kind, read_rows
from hyjax.choices.table import CHOICES
from hyjax.data.builtin_room import load_room
from hyjax.data.registry import CAPTURE_FORMATS
from hyjax.guide.network import ENCODERS
from hyjax.light.kinds import LIGHT_KINDS
from hyjax.metrics import METRICS, LpipsWeights
from hyjax.util.errors import InputError
from hyjax.util.images import read_image, write_png

ROOT = Path(__file__).parents[1]
MODULES = sorted(module.name for module in pkgutil.walk_packages(hyjax.__path__, "hyjax."))
SCRIPTS = {"hyjax.__main__": "starts the command line", "hyjax.scene.blender_worker": "runs inside Blender"}
SHOWN = [name for name in MODULES if name.startswith(("hyjax.core.", "hyjax.metrics."))]


def examples_of(name: str) -> list[doctest.DocTest]:
    """The examples of a module, none left out."""
    if name in SCRIPTS:
        pytest.skip(SCRIPTS[name])
    try:
        module = importlib.import_module(name)
    except (ModuleNotFoundError, InputError) as error:
        named = re.findall(r"\.\[([\w-]+)\]", str(error)) or sorted(bringing(getattr(error, "name", None) or ""))
        assert named, error
        need(named[0])
        raise
    return [test for test in doctest.DocTestFinder().find(module, name) if test.examples]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str, request: pytest.FixtureRequest) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for test in examples_of(name):
        if "load_lpips()" in test.docstring:
            weights: LpipsWeights = request.getfixturevalue("lpips_weights")
            test.globs["load_lpips"] = lambda weights=weights: weights
        runner.run(test)
    assert runner.failures == 0


@pytest.mark.parametrize("name", SHOWN)
def test_every_public_function_shows_itself(name: str) -> None:
    module = importlib.import_module(name)
    public = {
        f"{name}.{key}"
        for key, thing in vars(module).items()
        if not key.startswith("_") and inspect.isroutine(inspect.unwrap(thing)) and thing.__module__ == name
    }
    assert public <= {test.name for test in examples_of(name)}


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the reader's scan."""
    folder = tmp_path_factory.mktemp("reader")
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    mesh = hyjax.Scene.open(hyjax.SceneSettings(), capture=room).mesh
    (folder / "my_scan").symlink_to(export_arkit_scan(folder, room, mesh))
    return folder


SMALLER = "640x480", "160x120"
"""Size of pictures in snippets, and that in which they are run."""


def snippets_of(page: str) -> list[str]:
    """Python blocks of a page; those that include an example's file are run as examples."""
    found = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    return [snippet for snippet in found if "--8<--" not in snippet]


PAGES = [
    page
    for page in ("README.md", *sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob("docs/**/*.md")))
    if snippets_of(page)
]


def test_pages_have_snippets() -> None:
    """Else the test below could not fail."""
    assert {"README.md", "docs/extend.md", "docs/python.md", "docs/live_frames.md"} <= set(PAGES)


def run_script(folder: Path, text: str, *arguments: str) -> None:
    """Run a script as its reader does, in a folder of its own."""
    (folder / "spread.py").write_text(text)
    command = [sys.executable, "spread.py", *arguments]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, cwd=folder, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_parts_of_ones_own_are_in_the_command(tmp_path: Path) -> None:
    """The page's lamp, capture format, metric, encoder and choice in one script that ends with the command."""
    parts = [part.split("scene = ")[0] for part in snippets_of("docs/extend.md") if "register_" in part]
    shots = tmp_path / "scan" / "shots"
    shots.mkdir(parents=True)
    write_png(tmp_path / "picture.png", np.random.default_rng(0).random((48, 64, 3)))
    Image.open(tmp_path / "picture.png").save(shots / "0.jpg")
    np.savetxt(shots / "0.txt", np.eye(4))
    trimesh.creation.box((4.0, 3.0, 4.0)).export(tmp_path / "room.ply")
    lamp = {"kind": "lantern", "position": [0.5, 1.0, 0.5], "front": [0, 0, 1], "luminous_flux": 600}
    (tmp_path / "lamp.json").write_text(json.dumps({"lights": [lamp]}))
    text = "\n".join([*parts, "from hyjax.cli import main", "main()"])
    options = (
        "--lights",
        "lamp.json",
        "--mesh",
        "room.ply",
        "--no-shadows",
        "--quiet",
        "--choices",
        "bounce_tint=0.5",
    )
    run_script(tmp_path, text, "relight", "--capture", "scan", *options)
    assert read_image(tmp_path / "out" / "0.relit.png").mean() > 0.01
    assert json.loads((tmp_path / "out" / "lights.json").read_text())["lights"][0]["kind"] == "lantern"


def test_an_experiment_of_ones_own_runs(tmp_path: Path) -> None:
    (text,) = (part for part in snippets_of("docs/extend.md") if "@experiment" in part)
    run_script(tmp_path, text, "--steps", "1", "3")
    rows = of_kind(read_rows(tmp_path / "results" / "spread" / FILE), "spread")
    assert [row["steps"] for row in rows] == [1, 3] and rows[0]["left"] > rows[1]["left"] > 0
    assert "| 3 |" in (tmp_path / "results" / "spread" / "spread.md").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_snippets(page: str, reader: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the reader's folder; what they register is forgotten again."""
    monkeypatch.chdir(reader)
    monkeypatch.setattr("hyjax.data.registry.CAPTURE_FORMATS", [*CAPTURE_FORMATS])
    known = [dict(registry) for registry in (LIGHT_KINDS, METRICS, ENCODERS, CHOICES)]
    try:
        for snippet in snippets_of(page):
            exec(snippet.replace(*SMALLER), {"__name__": "snippet"})
    finally:
        for registry, before in zip((LIGHT_KINDS, METRICS, ENCODERS, CHOICES), known):
            registry.clear()
            registry.update(before)
    if "relit.png" in "".join(snippets_of(page)):
        assert (reader / "relit.png").stat().st_size > 1000
