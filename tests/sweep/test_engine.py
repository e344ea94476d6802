"""The engine, with functions that stand in for work: in this process, and on workers that are killed."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import standins
from extras import need

from hyjax.sweep import batch as batches
from hyjax.sweep.dispatch import Dispatch
from hyjax.sweep.engine import Engine
from hyjax.sweep.rows import ERROR, Row, RowStore
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError

STAMPS = ("commit", "device", "seconds", "worker")


def tasks(count: int, **more: Any) -> list[Task]:
    return [Task({"number": number} | more) for number in range(count)]


def run_here(folder: Path, function: batches.Function, todo: list[Task]) -> list[Row]:
    with Engine.open(0, None, folder) as engine:
        return list(engine.run(function, todo))


def plain(rows: Iterator[Row] | list[Row]) -> dict[str, Row]:
    """Rows by key, without what differs from run to run."""
    return {row["key"]: {name: value for name, value in row.items() if name not in STAMPS} for row in rows}


def times_done(folder: Path) -> Counter[str]:
    """How often each key is in the files."""
    lines = [line for path in folder.glob("rows-*") for line in path.read_text().splitlines()]
    return Counter(json.loads(line)["key"] for line in lines if line.endswith("}"))


def test_rows_of_this_process(tmp_path: Path) -> None:
    rows = run_here(tmp_path, standins.double, tasks(30, seed=7))
    assert [row["double"] for row in rows] == list(range(0, 60, 2))
    assert all(row["seed"] == 7 and row["commit"] and row["device"] and row["seconds"] >= 0 for row in rows)
    assert run_here(tmp_path, standins.double, tasks(31, seed=7))[0]["number"] == 30  # nothing is done twice


def test_a_task_named_twice_is_done_once(tmp_path: Path) -> None:
    assert len(run_here(tmp_path, standins.double, tasks(5) + tasks(7))) == 7


def test_input_errors_are_rows_and_tried_again_by_the_next(tmp_path: Path) -> None:
    rows = run_here(tmp_path, standins.refuse_odd, tasks(4))
    assert [row["kind"] for row in rows] == ["result", ERROR] * 2
    assert rows[1]["error"] == "number: 1 is odd" and rows[1]["type"] == "InputError"
    again = run_here(tmp_path, standins.double, tasks(4))
    assert [row["double"] for row in again] == [2, 6]
    assert {row["kind"] for row in RowStore(tmp_path).read()} == {"result"}


@pytest.mark.parametrize(("failures", "tried"), [(3, 4), (4, None)])
def test_other_exceptions_are_tried_three_times_more(failures: int, tried: int | None, tmp_path: Path) -> None:
    (marks := tmp_path / "marks").mkdir()
    (row,) = run_here(tmp_path / "out", standins.fail_at_first, [Task({"marks": str(marks), "failures": failures})])
    assert row.get("tried") == tried and len(list(marks.iterdir())) == 4
    if tried is None:
        assert row["type"] == "ZeroDivisionError" and "by nothing (standins.py:" in row["error"]


def test_another_run_takes_over(tmp_path: Path) -> None:
    with Engine.open(0, None, tmp_path) as engine:
        rows = engine.run(standins.double, tasks(3))
        next(rows)
        with Engine.open(0, None, tmp_path), pytest.raises(InputError, match="another run has taken over"):
            list(rows)
    assert len(RowStore(tmp_path).refresh()) == 1


def test_timing_shares_the_device_with_nothing(tmp_path: Path) -> None:
    with Engine.open(0, None, tmp_path) as engine:
        rows = engine.run(standins.double, tasks(3))
        next(rows)
        with pytest.raises(RuntimeError, match="must not share"):
            next(engine.run(standins.double, tasks(2), timing=True))
        assert len(list(rows)) == 2


def test_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="workers: must be >= 0"):
        Engine.open(-1, None, tmp_path)
    with pytest.raises(InputError, match="give one of the two"):
        Engine.open(1, "tcp://localhost:1", tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write there"):
        Engine.open(0, None, tmp_path / "file")
    with Engine.open(0, None, tmp_path) as engine, pytest.raises(InputError, match="top of its module"):
        list(engine.run(lambda payload: payload, tasks(1)))


def test_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask", None)
    monkeypatch.delitem(sys.modules, "hyjax.sweep.dask_pool", raising=False)
    with pytest.raises(InputError, match=r"pip install '\.\[tune\]'"):
        Engine.open(1, None, tmp_path)


def test_batches_take_about_half_a_second(tmp_path: Path) -> None:
    work = Dispatch("m:f", iter(tasks(1000)), "driver", RowStore(tmp_path))
    batch = work.next_batch(2, 0)
    assert batch is not None and len(batch.tasks) == 1
    list(work.finished(batch, batches.Outcome(computed=1, seconds=0.01)))
    batch = work.next_batch(2, 0)
    assert batch is not None and len(batch.tasks) == 50
    list(work.lost(list(batch.tasks)))
    assert work.next_batch(2, 1) is None  # the one that may have been the reason is alone
    batch = work.next_batch(2, 0)
    assert batch is not None and len(batch.tasks) == 1 and work.next_batch(2, 1) is None
    sizes = [len(batch.tasks) for under_way in range(2) if (batch := work.next_batch(2, under_way))]
    assert sizes == [49, 50]


@pytest.fixture(scope="module")
def distributed() -> None:
    """Dask, imported in the main thread as its configuration wants it."""
    need("tune")
    import distributed  # noqa: F401


def start(folder: Path, *arguments: Any) -> subprocess.Popen[str]:
    here = Path(__file__).parent
    command = [sys.executable, str(here / "run_standins.py"), str(folder), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def until(condition: Callable[[], Any], seconds: float = 30.0) -> Any:
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.02)
    return found


def workers_of(folder: Path) -> list[int]:
    """Processes that have written rows, the newest file last."""
    files = sorted(folder.glob("rows-*"), key=lambda path: path.stat().st_mtime_ns)
    return [int(path.stem.split("-")[-2]) for path in files if path.stat().st_size]


@pytest.mark.slow
@pytest.mark.usefixtures("distributed")
def test_killed_workers_and_a_killed_driver_lose_nothing(tmp_path: Path) -> None:
    killed, undisturbed, count = tmp_path / "killed", tmp_path / "undisturbed", 120
    driver = start(killed, 2, count, 0.02)
    os.kill(until(lambda: workers_of(killed))[-1], signal.SIGKILL)
    until(lambda: len(RowStore(killed).refresh()) > 40 or driver.poll() is not None)
    driver.kill()
    _, told = driver.communicate()
    ours, *_ = told.splitlines()
    assert "worker lost; its" in ours and "istributed" not in told and "Traceback" not in told, told
    before = len(RowStore(killed).refresh())
    assert 40 < before < count
    out, told = start(killed, 2, count, 0.02).communicate(timeout=60)
    assert told == "" and int(out) >= count - before - 2
    run_here(undisturbed, standins.double, tasks(count, sleep=0.02))
    assert plain(RowStore(killed).read()) == plain(RowStore(undisturbed).read())
    assert set(times_done(killed).values()) == {1} and RowStore(killed).duplicates() == 0


@pytest.mark.slow
@pytest.mark.usefixtures("distributed")
def test_a_task_that_takes_its_workers_along(tmp_path: Path) -> None:
    """It is given up, all others are done; timing then finds the device, and a full disk ends the run."""
    told: list[str] = []
    with Engine.open(1, None, tmp_path, told.append) as engine:
        rows = list(engine.run(standins.die_at_three, tasks(12)))
        assert {row["number"] for row in rows if row["kind"] == ERROR} == {3} and len(rows) == 12
        assert told[0].startswith("worker lost; its") and len(told) == 4
        timed = list(engine.run(standins.double, [Task({"number": 3}, "time")], timing=True))
        assert [row["kind"] for row in timed] == ["time"] and timed[0]["double"] == 6
        with pytest.raises(InputError, match=r"cannot write \(File too large\).*make room and resume"):
            list(engine.run(standins.fill_disk, tasks(12, bytes=10)))
    kept = [row for row in RowStore(tmp_path).read() if "bytes" in row]
    assert [row["number"] for row in kept] == [0, 1, 2]
    assert len(run_here(tmp_path, standins.double, tasks(12, bytes=10))) == 9


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["first", "second"])  # a second engine of a process starts as the first did
def test_a_worker_that_dies_with_its_result(engine: str, tmp_path: Path) -> None:
    """Dask runs its batch again by itself."""
    need("tune")
    from hyjax.sweep import dask_pool

    mark, told = tmp_path / "mark", list[str]()
    todo = tuple(tasks(1, mark=str(mark), sleep=0.5))
    pool = dask_pool.DaskPool.open(2, None, tmp_path, told.append)
    try:
        RowStore(tmp_path).take_over("driver", told.append)
        pool.submit(batches.TaskBatch("standins:die_afterwards", str(tmp_path), "driver", todo), timing=False)
        (future,) = pool._batches
        until(lambda: future.status == "finished")
        for rows in tmp_path.glob("rows-*"):
            rows.unlink()  # so that the batch takes its time again
        until(lambda: future.status != "finished")
        assert [outcome is not None for _, outcome in pool.collect()] == [True]
    finally:
        pool.close()
    assert not told


@pytest.mark.slow
@pytest.mark.usefixtures("distributed")
def test_a_scheduler_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("tune")
    from distributed import LocalCluster

    from hyjax.sweep import dask_pool

    monkeypatch.setattr(dask_pool, "POLL_SECONDS", 0.1)
    monkeypatch.setattr(dask_pool, "CONNECT_SECONDS", 1.0)
    told: list[str] = []
    options = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with (
        LocalCluster(n_workers=1, **options) as cluster,
        Engine.open(None, cluster.scheduler_address, tmp_path, told.append) as engine,
    ):
        rows = engine.run(standins.double, tasks(60, gate=str(gate := tmp_path / "gate")))
        next(rows)
        os.kill(workers_of(tmp_path)[0], signal.SIGKILL)  # with work left, however slow this process is
        gate.touch()
        assert len(list(rows)) == 59 and set(times_done(tmp_path).values()) == {1}
        assert "lost; its tasks run again" in told[0]
        with pytest.raises(InputError, match="no worker has the device; start one with: dask worker --res"):
            engine.check_timing()
    with pytest.raises(InputError, match=r"scheduler .*: cannot be reached"):
        Engine.open(None, "tcp://127.0.0.1:9", tmp_path)
