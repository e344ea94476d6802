"""Examples in docstrings, README and docs run as shown; every public function of `core` and `metrics` has one."""

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
from hyjax.data.registry import CAPTURE_FORMATS
from hyjax.guide.network import ENCODERS
from hyjax.light.kinds import LIGHT_KINDS
from hyjax.metrics import METRICS, LpipsWeights
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


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the reader's scan."""
    folder = tmp_path_factory.mktemp("reader")
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    (folder / "my_scan").symlink_to(export_arkit_scan(folder, room, room.reference()))
    return folder


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


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_snippets(page: str, reader: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the reader's folder; what they register is forgotten again."""
    monkeypatch.chdir(reader)
    monkeypatch.setattr("hyjax.data.registry.CAPTURE_FORMATS", [*CAPTURE_FORMATS])
    known = [dict(registry) for registry in (LIGHT_KINDS, METRICS, ENCODERS)]
    try:
        for snippet in snippets_of(page):
            exec(snippet, {"__name__": "snippet"})
    finally:
        for registry, before in zip((LIGHT_KINDS, METRICS, ENCODERS), known):
            registry.clear()
            registry.update(before)
    if "relit.png" in "".join(snippets_of(page)):
        assert (reader / "relit.png").stat().st_size > 1000
