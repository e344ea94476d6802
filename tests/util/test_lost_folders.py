"""Folders that vanish while they are written to, or that are files; clocks that jump."""

import ast
import itertools
import logging
import shutil
import time
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

import hyjax
from hyjax.sweep.rows import RowWriter
from hyjax.tuning.monitor import RunMonitor
from hyjax.util.cache import cached_arrays
from hyjax.util.claims import claimed
from hyjax.util.clock import Stopwatch, measure_each
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, new_folder, remove_stale, write_text
from hyjax.util.images import write_exr, write_png
from hyjax.util.run_log import RunLog

PICTURE = np.zeros((4, 5, 3), np.float32)
YEAR = 365 * 86400.0
TELLS_THE_DATE = {"device/certificate.py", "util/clock.py"}


def fill(out: Path) -> None:
    with new_folder(out / "inner") as folder:
        write_png(folder / "a.png", PICTURE)


def claim(out: Path) -> None:
    with claimed(out):
        pass


WRITES: dict[str, Callable[[Path], object]] = {
    "text": lambda out: write_text(out / "a.json", "{}"),
    "picture": lambda out: write_png(out / "a.png", PICTURE),
    "log": lambda out: RunLog(out / "log.jsonl").add({"a": 1}),
    "rows": RowWriter,
    "claim": claim,
}


@pytest.mark.parametrize("name", WRITES)
def test_a_folder_that_is_not_there_is_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone.*cannot write") as caught:
        WRITES[name](tmp_path / "gone")
    assert "\n" not in str(caught.value) and ".part" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", sorted(WRITES.keys() - {"claim"} | {"folder", "make writable"}))
def test_a_file_in_the_place_of_a_folder_is_one_line(name: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    write = (WRITES | {"folder": fill, "make writable": make_writable})[name]
    with pytest.raises(InputError, match=r"file.*(cannot write|not a directory)"):
        write(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1


def test_a_log_whose_folder_vanishes_is_one_line_and_makes_no_other(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    log = RunLog(out / "log.jsonl")
    log.add({"a": 1})
    shutil.rmtree(out)
    with pytest.raises(InputError, match=r"log\.jsonl: cannot write \(No such file"):
        log.add({"a": 2})
    out.mkdir()
    with pytest.raises(InputError, match=r"log\.jsonl: cannot write"):  # it would lack its first lines
        log.add({"a": 3})
    assert not list(out.iterdir())


def test_a_folder_that_vanishes_while_it_is_filled_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"out.*cannot write"), new_folder(tmp_path / "out") as folder:
        shutil.rmtree(folder)
        write_text(folder / "a.txt", "text")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write, suffix", [(write_png, "png"), (write_exr, "exr")])
@pytest.mark.parametrize("before", ["open", "close"])
def test_a_folder_that_vanishes_under_a_picture_is_one_line(
    tmp_path: Path, write: Callable, suffix: str, before: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    create = oiio.ImageOutput.create

    def created(path: str) -> object:
        target = create(path)
        real = getattr(target, before)

        def late(*arguments: object) -> object:
            shutil.rmtree(out)
            return real(*arguments)

        names = ("open", "write_image", "close", "geterror")
        return types.SimpleNamespace(**{name: getattr(target, name) for name in names} | {before: late})

    monkeypatch.setattr(oiio, "ImageOutput", types.SimpleNamespace(create=created))
    with pytest.raises(InputError, match=r"out.*cannot write \(No such file or directory\)$") as caught:
        write(out / f"a.{suffix}", PICTURE)
    assert ".part" not in str(caught.value) and not out.exists()


def test_a_cache_that_is_a_file_costs_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "cache").write_text("mine")
    with caplog.at_level(logging.WARNING):
        for number in range(2):
            file = tmp_path / "cache" / f"{number}.npz"
            assert cached_arrays(file, lambda arrays: arrays["a"].sum(), lambda: {"a": np.ones(3)}) == 3
    assert len(caplog.records) == 1


def test_a_folder_that_was_being_replaced_gets_its_name_back(tmp_path: Path) -> None:
    """As it is left by a process that is killed between the two renames."""
    for number, name in enumerate((".page.{}.old", ".page.{}.part", ".other.{}.old")):
        with new_folder(tmp_path / "made") as folder:
            mark = folder.name.split(".")[-2]
            (folder / "a.txt").write_text(str(number))
        (tmp_path / "made").rename(tmp_path / name.format(mark))
    (tmp_path / "other").mkdir()
    remove_stale(tmp_path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["other", "page"]
    assert (tmp_path / "page" / "a.txt").read_text() == "0" and not list((tmp_path / "other").iterdir())


def test_durations_do_not_follow_the_clock_on_the_wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jumps = itertools.cycle([0.0, YEAR, -YEAR])
    now = time.time
    monkeypatch.setattr(time, "time", lambda: now() + next(jumps))
    watch, monitor = Stopwatch(), RunMonitor(limit=3600.0, progress=False)
    found = measure_each({"a": lambda: np.zeros(3)}, repeats=12, most_seconds=3600.0)
    assert found["a"]["count"] == 12 and 0 <= found["a"]["median_ms"] < 60_000
    assert 0 <= watch.seconds < 60 and not monitor.expired()
    fill(tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["inner"]


def test_no_module_takes_durations_from_the_clock_on_the_wall() -> None:
    package = Path(hyjax.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and ast.unparse(node) in (
                *("time.time", "time.time_ns", "datetime.datetime.now", "datetime.datetime.utcnow"),
            ):
                found.add(path.relative_to(package).as_posix())
    assert found == TELLS_THE_DATE
