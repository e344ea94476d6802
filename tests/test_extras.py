"""Tests say which extra they need before they import it."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from extras import EXTRAS, advice, bringing, missing, need

HERE = Path(__file__).parent
PROGRAMS = {"fuzz", "kills"}
"""Folders of programs of their own, whose seeds name their extras in a table."""


def imported(node: ast.AST) -> list[str]:
    """Modules that a statement imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else []


def named(node: ast.AST) -> list[str]:
    """Extras that a statement asks for by `need`."""
    call = node.value if isinstance(node, ast.Expr) else node
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "need":
        return [argument.value for argument in call.args if isinstance(argument, ast.Constant)]
    return []


def unannounced(body: list[ast.stmt], known: frozenset[str] = frozenset()) -> Iterator[str]:
    """Modules that are imported where no extra that brings them was asked for, within a module or a function."""
    for node in body:
        known |= set(named(node))
        yield from (module for module in imported(node) if bringing(module) and known.isdisjoint(bringing(module)))
        parts = [getattr(node, part, []) for part in ("body", "orelse", "finalbody", "handlers")]
        for part in filter(None, parts):
            yield from unannounced(part, known)


def test_extras_are_asked_for_before_they_are_imported() -> None:
    paths = [path for path in HERE.rglob("*.py") if path.relative_to(HERE).parts[0] not in PROGRAMS]
    found = {str(path): list(unannounced(ast.parse(path.read_text(encoding="utf-8")).body)) for path in paths}
    assert not {path: modules for path, modules in found.items() if modules}


def test_what_is_not_asked_for_is_found() -> None:
    tree = ast.parse(
        "import numpy, websockets\n"
        "def f():\n    need('tour')\n    import av\n"
        "def g():\n    from av import open\n"
        "with x:\n    import iree.compiler\n"
        "need('tune')\nimport optuna\n"
    )
    assert list(unannounced(tree.body)) == ["websockets", "av", "iree.compiler"]


def test_what_is_missing_is_skipped_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYJAX_EXTRAS", raising=False)
    monkeypatch.setitem(EXTRAS, "tour", {"no_such_package", "numpy"})
    assert missing("tour") == ["no_such_package"] and bringing("numpy.linalg") == {"tour"}
    with pytest.raises(pytest.skip.Exception, match=r"the extra tour: pip install '\.\[tour\]'"):
        need("tour")
    monkeypatch.setenv("HYJAX_EXTRAS", "required")
    with pytest.raises(pytest.fail.Exception, match="the extra tour"):
        need("tour")
    assert not bringing("grain")  # of README's command


def test_advice_on_what_was_skipped() -> None:
    reasons = ["(..., 'Skipped: needs the extra tour: pip')"] * 3 + ["needs torch", "needs the extra nyu: x"]
    assert advice(reasons, 100) == (
        "5 of 100 tests were skipped; for more of them: pip install '.[nyu,tour]' -c constraints.txt"
    )
    assert not advice(reasons, 1000)


WITHOUT_MATPLOTLIB = """
import sys
from pathlib import Path
sys.modules["matplotlib"] = None
from hyjax import InputError
from hyjax.sweep.run import run_sweep
from hyjax.sweep.settings import SweepSettings
from hyjax.training.run import train
from hyjax.training.settings import TrainSettings
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.tune import tune
out = Path("out")
for call in (
    lambda: tune(settings=TuneSettings(fps=(30.0,), out=out)),
    lambda: run_sweep(SweepSettings(Path("spec.yaml"), out=out)),
    lambda: train(TrainSettings(pairs=("random",)), out),
):
    try:
        call()
    except InputError as error:
        print(error, out.exists())
"""


@pytest.mark.slow
def test_without_matplotlib_what_draws_says_so_before_it_begins(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT_MATPLOTLIB]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    said = "{}: needs the package matplotlib; install it with: pip install '.[{}]' False\n"
    expected = "".join(said.format(*names) for names in (("tune", "tune"), ("sweep", "tune"), ("train", "train")))
    assert (done.stdout, done.returncode) == (expected, 0), done.stderr
