"""Examples in docstrings and the README run as shown; every public function of `core` and `metrics` has one."""

import doctest
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest
from reference.arkit_export import export_arkit_scan

import hyjax
from hyjax.data.builtin_room import load_room
from hyjax.metrics import LpipsWeights
from hyjax.util.errors import InputError

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
    except (ImportError, InputError) as error:
        pytest.skip(f"needs an optional package: {error}")
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


@pytest.mark.slow
def test_the_snippets_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder that holds the reader's scan."""
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    (tmp_path / "my_scan").symlink_to(export_arkit_scan(tmp_path, room, room.reference()))
    monkeypatch.chdir(tmp_path)
    snippets = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(snippet, {})
    assert (tmp_path / "relit.png").stat().st_size > 1000
