"""Every reader takes any bytes and gives a result or an `InputError`, within 5 s and 2 GiB."""

from pathlib import Path

import pytest

from .cases import Bench
from .readers import READERS
from .runner import run

FEW, MANY = 20, 300


@pytest.mark.parametrize("name", READERS)
def test_intact_files_are_read(name: str, tmp_path: Path) -> None:
    """Otherwise the mutated ones would test nothing."""
    bench = Bench(name, tmp_path)
    for file, content in bench.files.items():
        assert bench.run(file, content).kind == "result", file


@pytest.mark.slow
def test_mutated_files_are_read_or_refused(tmp_path: Path) -> None:
    rows = list(run(list(READERS), range(MANY), 0, tmp_path))
    others = [f"{row['reader']}: {other}" for row in rows for other in row["others"]]
    assert not others, "\n".join(others)
    assert all(row["cases"] == MANY for row in rows) and len(rows) == len(READERS)
