"""Every reader takes any bytes and gives a result or an `InputError`, within 5 s of a processor and 2 GiB."""

import random
from pathlib import Path

import pytest
from extras import missing, need

from . import cases, mutations
from .cases import FIRST_CASES, Bench
from .mutations import CLASSICS
from .readers import READERS
from .runner import run

FEW, MANY = 20, 120


@pytest.mark.parametrize("name", READERS)
def test_intact_files_are_read_and_a_few_mutated_ones_too(name: str, tmp_path: Path) -> None:
    """Were intact ones refused, mutated ones would test nothing."""
    if READERS[name].extra:
        need(READERS[name].extra)
    bench = Bench(name, tmp_path)
    for file, content in bench.files.items():
        assert bench.run(file, content).kind == "result", file
    first = bench.first_mutated
    for number in (*range(len(CLASSICS), FIRST_CASES), *range(first, first + FEW)):
        outcome = bench.run(*bench.case(number, seed=1))
        assert outcome.kind != "other", f"case {number}: {outcome.note}"


@pytest.mark.slow
def test_mutated_files_are_read_or_refused(tmp_path: Path) -> None:
    """The same, and no process dies of one, takes too long or too much."""
    names = [name for name, reader in READERS.items() if not reader.extra or not missing(reader.extra)]
    rows = list(run(names, range(MANY), 0, tmp_path))
    others = [f"{row['reader']}: {other}" for row in rows for other in row["others"]]
    assert not others, "\n".join(others)
    assert [(row["reader"], row["cases"]) for row in rows] == [(name, MANY) for name in names]


def test_a_case_that_takes_too_much_is_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its memory is measured: a limit of the system would make a clean error of it."""
    monkeypatch.setattr(cases, "MOST_MIB", 64)
    bench = Bench("results", tmp_path)
    bench.reader = bench.reader._replace(read=lambda path: bytearray(b"\1") * (128 << 20))
    outcome = bench.run(*next(iter(bench.files.items())))
    assert outcome.kind == "other" and outcome.note.startswith("took 1")


@pytest.mark.parametrize("name", ["b.glb", "a.safetensors"])
def test_json_in_a_binary_header_is_changed_and_its_sizes_told(name: str, tmp_path: Path) -> None:
    bench = Bench("mesh" if name.endswith("glb") else "safetensors", tmp_path)
    content, source = bench.files[name], random.Random(0)
    changed = {mutations._header_json(content, source) for _ in range(20)}
    assert len(changed) > 10
    for each in changed:
        span = mutations._json_inside(each)
        assert span is None or each[span[0] : span[1]].rstrip().endswith((b"}", b"]"))
        assert name != "b.glb" or int.from_bytes(each[8:12], "little") == len(each)
