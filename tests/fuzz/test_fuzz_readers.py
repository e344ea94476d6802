"""Every reader takes any bytes and gives a result or an `InputError`, within 5 s and 2 GiB."""

from pathlib import Path

import pytest
from extras import missing, need

from .cases import FIRST_CASES, Bench
from .mutations import CLASSICS
from .readers import READERS
from .runner import run

FEW, MANY = 20, 300


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
