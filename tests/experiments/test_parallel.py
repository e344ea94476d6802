"""Parts of an experiment on several processes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.parallel import Collected, rows_of_parts
from hyjax.util.errors import InputError


def part(payload: dict[str, Any]) -> dict[str, Any]:
    """Two rows of a part; none of the part called bad."""
    if payload["name"] == "bad":
        raise InputError("bad: cannot be done")
    with Path(payload["log"]).open("a") as file:
        file.write(payload["name"])
    collected = Collected(Path())
    for k in range(2):
        collected.add(name=payload["name"], k=k, values=np.full(2, k), score=np.float32(0.5))
    return collected.result()


def rows(tmp_path: Path, *names: str, resume: bool = False) -> list[dict[str, Any]]:
    payloads = [{"name": name, "log": str(tmp_path / "log")} for name in names]
    return [row for rows in rows_of_parts(part, payloads, 0, tmp_path, resume=resume) for row in rows]


def test_rows_of_parts(tmp_path: Path) -> None:
    found = rows(tmp_path, "a", "b")
    assert [(row["name"], row["k"]) for row in found] == [("a", 0), ("a", 1), ("b", 0), ("b", 1)]
    assert found[1]["values"] == [1, 1] and found[1]["score"] == 0.5
    assert rows(tmp_path, "b", "c", resume=True)[:2] == found[2:]
    assert (tmp_path / "log").read_text() == "abc"
    rows(tmp_path, "a")
    assert (tmp_path / "log").read_text() == "abca"  # a new run begins anew
    with pytest.raises(InputError, match="bad: cannot be done"):
        rows(tmp_path, "bad")
