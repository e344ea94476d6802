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
    compiled._end()
    for name in made:
        sys.modules.pop(name, None)


def kept(folder: Path) -> list[Path]:
    return sorted((folder / "cache" / "numba").glob("*/*.nbc"))


def test_another_process_compiles_and_whoever_imports_waits(tmp_path: Path, module: Callable[[], str]) -> None:
    names = module(), module()
    compile_beside(names)
    first = importlib.import_module(names[0])
    assert first.twice(3.0) == 6.0
    assert first.twice.stats.cache_hits and not first.twice.stats.cache_misses, "that process compiled it"
    assert importlib.import_module(names[1]).twice.stats.cache_hits
    assert len(kept(tmp_path)) == 2
    compiled._end()
    for name in names:
        del sys.modules[name]
    compile_beside(names)
    assert not compiled._beside, "nothing is left to compile"


def test_a_changed_source_is_compiled_anew(tmp_path: Path, module: Callable[[], str]) -> None:
    name = module()
    importlib.import_module(name)
    source, later = tmp_path / f"{name}.py", time.time() + 60
    os.utime(source, (later, later))
    del sys.modules[name]
    compile_beside([name])
    assert compiled._beside


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


def test_the_process_ends_when_its_parent_has_ended(tmp_path: Path, module: Callable[[], str]) -> None:
    """A command that is refused at once leaves nothing running."""
    fcntl = pytest.importorskip("fcntl")
    lock, name = tmp_path / "lock", module()
    (tmp_path / f"{name}.py").write_text(
        f"import fcntl, time\nfile = open({str(lock)!r}, 'w')\n"
        "fcntl.flock(file, fcntl.LOCK_EX)\nprint('locked', file=file, flush=True)\ntime.sleep(600)",
        encoding="utf-8",
    )
    called = (
        f"import pathlib, sys, time; sys.path.insert(0, {str(tmp_path)!r})\n"
        f"from hyjax.util.compiled import compile_beside; compile_beside([{name!r}])\n"
        f"lock = pathlib.Path({str(lock)!r})\n"
        "while not (lock.is_file() and lock.read_text()): time.sleep(0.01)"
    )
    subprocess.run([sys.executable, "-c", called], check=True, timeout=60)
    with lock.open() as file:
        for _ in range(200):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                time.sleep(0.05)
            else:
                return
    pytest.fail("it still runs")


def test_files_of_the_folder_that_it_is_begun_in_are_not_run(
    tmp_path: Path, module: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    name, folder = module(), tmp_path / "of a stranger"
    folder.mkdir()
    for stranger in ("importlib", "json", "numba", "hyjax"):
        (folder / f"{stranger}.py").write_text("open('ran', 'w')", encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    compile_beside([name])
    assert importlib.import_module(name).twice.stats.cache_hits, "compiled all the same"
    assert not (folder / "ran").exists()


def test_one_process_at_a_time(module: Callable[[], str]) -> None:
    first, second = module(), module()
    compile_beside([first])
    compile_beside([second])
    assert len(compiled._beside) == 1
    importlib.import_module(first)
    compiled._end()
    compile_beside([first])
    assert not compiled._beside, "it is loaded"
