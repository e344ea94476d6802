import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyjax.sweep.rows import ERROR, RowStore, RowWriter
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError

VALUES = st.recursive(st.integers(-9, 9) | st.text(max_size=3), lambda inner: st.lists(inner, max_size=3))


def write(folder: Path, *rows: dict) -> Path:
    writer = RowWriter(folder)
    for row in rows:
        writer.add(row)
    writer.close()
    return writer.path


def row(key: str, value: int = 0, kind: str = "result") -> dict:
    return {"key": key, "kind": kind, "value": value}


@given(st.dictionaries(st.text(max_size=4), VALUES, max_size=5), st.randoms())
def test_a_key_is_of_the_content(payload: dict, random) -> None:
    items = list(payload.items())
    random.shuffle(items)
    assert Task(dict(items)).key == Task(payload).key
    assert Task(payload | {"more": 1}).key != Task(payload).key != Task(payload, "time").key


def test_files_are_merged_and_none_goes_on(tmp_path: Path) -> None:
    first = write(tmp_path, row("a", 1), row("b", 2))
    second = write(tmp_path, row("c", 3))
    assert first != second
    assert [r["value"] for r in RowStore(tmp_path).read()] == [1, 2, 3]
    assert write(tmp_path).exists() is False  # an empty file goes


@given(cut=st.integers(1, 20))
def test_a_cut_off_row_counts_for_nothing(cut: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("rows")
    path = write(folder, row("a"), row("b"))
    os.truncate(path, path.stat().st_size - cut)
    write(folder, row("c"))
    store = RowStore(folder)
    assert [r["key"] for r in store.read()] == ["a", "c"] and "b" not in store
    assert store.damaged() == 1


def test_damaged_lines_are_counted(tmp_path: Path) -> None:
    path = write(tmp_path, row("a"), row("b"))
    assert RowStore(tmp_path).damaged() == 0
    whole, cut = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(cut[:9] + whole + b"\0\0\n" + cut + b"{")
    store = RowStore(tmp_path)
    assert [r["key"] for r in store.read()] == ["b"] and store.damaged() == store.damaged() == 3


def test_the_first_result_counts_and_stands_before_errors(tmp_path: Path) -> None:
    write(tmp_path, row("a", kind=ERROR), row("b", 1), row("b", 2), row("c", kind=ERROR))
    write(tmp_path, row("a", 5))
    store = RowStore(tmp_path)
    assert {r["key"]: (r["kind"], r["value"]) for r in store.read()} == {
        "a": ("result", 5),
        "b": ("result", 1),
        "c": (ERROR, 0),
    }
    assert store.duplicates() == 1 and store.done() == {"a", "b"} and len(store) == 3


def test_finding_rows_does_not_decode_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, row("a"), row("b"))
    lines = [b"{", b'{"key": 1, "kind": "a"}', b'{"key": "\xff", "kind": ""}', b"[" * 100_000, path.read_bytes()]
    path.write_bytes(b"\n".join(lines))
    monkeypatch.setattr("hyjax.sweep.rows.parse_json", lambda *_: pytest.fail("decoded a row"))
    assert RowStore(tmp_path).refresh().done() == {"a", "b"}


def test_a_store_reads_on(tmp_path: Path) -> None:
    writer, store = RowWriter(tmp_path), RowStore(tmp_path)
    for count, key in enumerate("abc", start=1):
        writer.add(row(key, count))
        assert len(store.refresh()) == count and store.get(key) == row(key, count)
    assert store.get("d") is None
    writer.close()


FULL = """
import resource, sys
from pathlib import Path
from hyjax.sweep.rows import RowWriter
from hyjax.util.errors import InputError
resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
writer = RowWriter(Path(sys.argv[1]))
try:
    for number in range(10):
        writer.add({"key": f"{number}", "kind": "result", "value": 0})
except InputError as error:
    print(error)
"""


def test_a_row_that_does_not_fit_leaves_no_part(tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="no limit of a file's size on this system")
    done = subprocess.run([sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, check=True)
    assert "cannot write (File too large); the rows so far are kept" in done.stdout
    (path,) = tmp_path.iterdir()
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) == 2 and all(line.endswith("\n") and json.loads(line) for line in lines)


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        RowWriter(tmp_path / "none")


def test_a_driver_waits_for_workers_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fcntl", reason="no locks of files on this system")
    writer, told = RowWriter(tmp_path), []
    monkeypatch.setattr("hyjax.sweep.rows.TAKE_OVER_SECONDS", 0.2)
    with writer.locked(), pytest.raises(InputError, match="still writes"):
        RowStore(tmp_path).take_over("new", told.append)
    RowStore(tmp_path).take_over("newer", told.append)
    assert len(told) == 1 and RowStore(tmp_path).driver() == "newer"
    writer.close()
