"""Whole frames a second: the guard, and the difference that sampling makes; `.ci/run` makes a small run."""

from pathlib import Path
from typing import Any

import pytest

from experiments import frame_quality, frame_rate
from experiments.records import Row
from hyjax.util.errors import InputError


def rate(sampling: int, cpu_ms: float, gbuffer: float = 1.0) -> Row:
    stages = {"G-buffer": gbuffer, "light": 10.0}
    return {"kind": "rate", "faces": 9, "sampling": sampling, "divided": True, "cpu_ms": cpu_ms, "stages": stages}


def quality(sampling: int, raw: float, **other: Any) -> Row:
    picture = {"room": "a", "setup": "b", "index": 0} | other
    return {"kind": "quality", "sampling": sampling, "raw": raw, "fitted": raw + 1.0, **picture}


def holds(rows: list[Row]) -> dict[str, bool]:
    return {what.split(",")[0].split(" /")[0]: ok for what, _, _, ok in frame_rate.guard(rows)}


def test_the_guard_tells_what_got_slower_or_worse() -> None:
    sizes = [{"kind": "size", "size": size, "cpu_ms": 1e-4 * size**2} for size in (64, 128)]
    good = [rate(2, 40.0), rate(1, 100.0), *sizes, quality(1, 30.0), quality(2, 29.95)]
    assert all(holds(good).values()) and len(holds(good)) == 4
    assert not holds([rate(2, 90.0), *good[1:]])["CPU of a frame"]
    assert not holds([rate(2, 40.0, gbuffer=30.0), *good[1:]])["G-buffer"]
    slow = {"kind": "size", "size": 256, "cpu_ms": 1e-4 * 256**2 * 1.6}
    assert not holds([*good, slow])["CPU a pixel"]
    assert not holds([*good, quality(1, 30.0, index=1), quality(2, 29.7, index=1)])["dB lost by sampling"]
    assert not any(holds([]).values()), "what was not measured does not hold"


def test_differences_are_of_the_same_picture() -> None:
    rows = [quality(1, 30.0), quality(2, 29.0), quality(1, 20.0, room="c"), quality(2, 22.0, room="c")]
    rows.append(quality(2, 5.0, room="not judged whole"))
    assert frame_quality.differences(rows) == {(2, "raw"): 0.5, (2, "fitted"): 0.5}


def test_large_frames_are_compared_picture_by_picture() -> None:
    picture = {"kind": "large", "room": "a", "setup": "b", "index": 0}
    rows = [
        picture | {"whole": whole, "index": i, "raw": raw, "fitted": 30.0, "cpu_ms": 40.0 if whole else 10.0}
        for i, pair in enumerate([(20.5, 20.0), (24.0, 25.0)])
        for whole, raw in zip((False, True), pair)
    ]
    (table,) = frame_quality.tables(rows)
    assert table.rows[0][1:] == ["-0.25", "-1", "+0.5"] and table.rows[2][1:] == ["-30", "-30", "-30"]


@pytest.mark.parametrize(
    ("options", "message"),
    [({"frames": 1}, "at least 2"), ({"sizes": (16,)}, "at least 32 pixels"), ({"cores": 0}, "may use 1 to")],
)
def test_bad_options(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        frame_rate.main(frame_rate.Config(out=tmp_path, **options))
