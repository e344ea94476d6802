"""Functions that another process compiles: waited for, kept, and compiled here where it could not."""

import importlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hyjax.util import compiled
from hyjax.util.compiled import compile_beside

SOURCE = """
from hyjax.util.compiled import compiled

@compiled("f8(f8)")
def twice(x):
    return 2.0 * x
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], str]]:
    """New modules with a compiled function, and an empty cache."""
    made: list[str] = []

    def make() -> str:
        made.append(f"doubling_{len(made)}")
        (tmp_path / f"{made[-1]}.py").write_text(SOURCE, encoding="utf-8")
        importlib.invalidate_caches()
        return made[-1]

    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled, "_beside", [])
    monkeypatch.setattr(compiled, "_done", set())
    yield make
    for name in made:
        sys.modules.pop(name, None)


def kept(folder: Path) -> list[Path]:
    return sorted((folder / "cache" / "numba").glob("*/*.nbc"))


def test_another_process_compiles_and_whoever_imports_waits(tmp_path: Path, module: Callable[[], str]) -> None:
    names = module(), module()
    compile_beside(names)
    (process,) = compiled._beside
    first = importlib.import_module(names[0])
    assert first.twice(3.0) == 6.0
    assert first.twice.stats.cache_hits and not first.twice.stats.cache_misses, "that process compiled it"
    assert importlib.import_module(names[1]).twice.stats.cache_hits
    process.wait(timeout=60)
    files = kept(tmp_path)
    assert len(files) == 2
    compiled._beside.clear()
    compile_beside(names)
    assert not compiled._beside, "nothing is left to compile"


def test_a_changed_source_is_compiled_anew(tmp_path: Path, module: Callable[[], str]) -> None:
    name = module()
    importlib.import_module(name)
    source, later = tmp_path / f"{name}.py", time.time() + 60
    os.utime(source, (later, later))
    compile_beside([name])
    assert compiled._beside
    compiled._beside[0].wait(timeout=60)


def test_a_process_that_dies_costs_only_time(module: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = module()
    monkeypatch.setattr(compiled, "IMPORTS", "raise SystemExit(3)")
    compile_beside([name])
    assert compiled._beside
    own = importlib.import_module(name).twice
    assert own(3.0) == 6.0 and own.stats.cache_misses and not compiled._beside


def test_a_folder_that_cannot_be_used_begins_nothing(tmp_path: Path, module: Callable[[], str]) -> None:
    name = module()
    (tmp_path / "cache").write_text("a file", encoding="utf-8")
    compile_beside([name])
    assert not compiled._beside


def test_the_process_ends_with_its_parent(tmp_path: Path, module: Callable[[], str]) -> None:
    """A command that is refused at once leaves nothing running."""
    called = (
        "from hyjax.util.compiled import compile_beside, _beside\ncompile_beside(['this'])\nprint(_beside[0].pid)"
    )
    (tmp_path / "this.py").write_text("import time; time.sleep(600)", encoding="utf-8")
    ended = subprocess.run([sys.executable, "-c", called], capture_output=True, text=True, check=True, cwd=tmp_path)
    for _ in range(100):
        if not Path(f"/proc/{ended.stdout.strip()}").exists():
            return
        time.sleep(0.05)
    pytest.fail("it still runs")
