"""Numbers that docs/limits.md promises are those of the code, and its tables those of kept rows."""

import json
from pathlib import Path
from typing import Any

from extras import need
from fuzz.bombs import MAKERS
from fuzz.readers import READERS

from hyjax.core import checks, pyramid, schedule
from hyjax.data import archive, capture_files, mp4_boxes, scannet, video_frames
from hyjax.geometry import camera, gltf, mesh
from hyjax.pairs import nyu
from hyjax.tuning import request
from hyjax.util import picture_header, reading, tensors

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MIB = 1 << 20

LIMITS = {
    "a text": (reading, f"{reading.LARGEST_TEXT // MIB} MiB, UTF-8"),
    "a JSON text": (reading, f"{reading.LARGEST_JSON // MIB} MiB, 2²²"),
    "a YAML file": (reading, f"{reading.LARGEST_YAML >> 10} KiB, {reading.MOST_NODES // 1000} 000 values"),
    "lists and mappings in each other": (reading, f"{reading.DEEPEST_NESTING}"),
    "whole numbers": (reading, f"{reading.MOST_DIGITS} digits, 64 bits"),
    "a picture": (picture_header, f"{picture_header.MOST_MEGAPIXELS:.0f} million pixels of four channels"),
    "a picture of over 16 million pixels": (
        picture_header,
        f"{picture_header.MOST_PIXELS_PER_BYTE} pixels in a byte",
    ),
    "a JPEG": (picture_header, "2³⁰"),
    "intrinsics": (camera, f"focal lengths from {camera.SHORTEST_FOCAL:g}, all values up to 10⁷ pixels"),
    "poses": (camera, "numbers up to 10⁹"),
    "numbers in a capture's files": (capture_files, "up to 10¹⁹"),
    "a labelled file of NYU": (nyu, f"4 million pixels, pieces of {nyu.MOST_CHUNK_BYTES // MIB} MiB"),
    "a video": (video_frames, f"8192 x 4352 pixels; tables of {mp4_boxes.LARGEST_TABLES // MIB} MiB"),
    "a `.sens` file": (scannet, f"{scannet.MOST_PIXELS / 1e6:.1f} million pixels"),
    "a glTF": (gltf, f"nodes {gltf.DEEPEST_NODE} deep, {gltf.MOST_PARTS // 1000} 536 nodes"),
    "a file that a mesh names": (mesh, "of 1 GiB"),
    "weights": (tensors, "of 1 GiB, with a header of 1 MiB"),
    "a ZIP archive": (archive, f"at most {archive.LARGEST_RATIO} times their size"),
    "steps of a schedule": (schedule, f"{schedule.MOST_STEPS // 1000} 000 in all"),
    "fidelity": (checks, "10¹⁵"),
    "pixels that a cell is wide": (pyramid, "2³⁰"),
    "a budget of `tune`": (request, "10⁻⁶ to 10⁷ ms"),
}
"""What is limited, as the table has it: the module and a part of the limit's text."""
POWERS = (
    (reading.MOST_MARKS, 2**22),
    (picture_header.MOST_PASSES, 2**30),
    (picture_header.FREELY_PACKED_PIXELS, 16e6),
    (picture_header.MOST_CHANNELS, 4),
    (picture_header.LARGEST_FILE, 2**30),
    (camera.LARGEST_SIDE, 2**20),
    (camera.LARGEST_VALUE, 1e7),
    (camera.LARGEST_DISTANCE, 1e9),
    (capture_files.LARGEST_NUMBER, 1e19),
    (nyu.MOST_PIXELS, 2**22),
    (video_frames.MOST_PIXELS, 8192 * 4352),
    (gltf.MOST_PARTS, 65_536),
    (gltf.MOST_COPIES, 4_000_000),
    (gltf.MOST_READINGS, 4),
    (mesh.LARGEST_BUFFER, 2**30),
    (tensors.LARGEST_FILE, 2**30),
    (tensors.LARGEST_HEADER, MIB),
    (archive.MOST_FILES, 1_000_000),
    (archive.HARMLESS_BYTES, 16 * MIB),
    (pyramid.LARGEST_FACTOR, 2**30),
    (request.LEAST_MS, 1e-6),
    (request.MOST_MS, 1e7),
)
"""Limits that the text writes as powers or words."""


def tables() -> dict[tuple[str, ...], list[tuple[str, ...]]]:
    """Rows of the tables of docs/limits.md by their headings."""
    found: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    heading: tuple[str, ...] | None = None
    for line in (DOCS / "limits.md").read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            heading = None
            continue
        cells = tuple(cell.strip() for cell in line.strip("|").split(" | "))
        if heading is None:
            heading = cells
            found.setdefault(heading, [])
        elif not cells[0].startswith(":"):
            found[heading].append(cells)
    return found


def test_limits_are_those_of_the_code() -> None:
    rows = tables()["what", "limit", "where"]
    told = {what: (limit, where) for what, limit, where in rows}
    assert told.keys() - {"a file that is read"} == LIMITS.keys()
    for what, (module, text) in LIMITS.items():
        limit, where = told[what]
        assert text in limit, what
        assert where == f"`{module.__name__.replace('.', '/')}.py`", what
    assert all(found == expected for found, expected in POWERS)


def test_memory_of_the_tour_is_that_of_the_code() -> None:
    need("tour")
    from hyjax.tour.editable_scene import PARTS_MIB
    from hyjax.tour.layers import KEPT_MIB

    text = " ".join((DOCS / "limits.md").read_text(encoding="utf-8").split())
    assert f"has {KEPT_MIB} MiB in all, and parts that were moved {PARTS_MIB} MiB or four rooms" in text


def kept(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (DOCS / name).read_text().splitlines()]


def test_readers_are_those_of_the_first_kept_rows() -> None:
    """Of seed 0; later rows are of other cases, and those of readers that are gone stay."""
    heading = ("reader", "cases", "results", "`InputError`s", "others", "worst time, s", "worst memory, MiB")
    numbers = "reader", "cases", "result", "InputError", "other", "worst_seconds", "worst_mib"
    rows = [[row[name] for name in numbers] for row in kept("limits_fuzz.jsonl") if row["seed"] == 0]
    rows = [row for row in rows if row[0] in READERS]
    expected = [(*map(str, row[:5]), f"{row[5]:.2f}", str(row[6])) for row in rows]
    assert sorted(tables()[heading]) == sorted(expected)
    assert {row[0] for row in rows} == READERS.keys() >= MAKERS.keys()


def test_every_case_that_was_kept_is_a_result_or_an_error() -> None:
    rows = kept("limits_fuzz.jsonl")
    assert not any(row["other"] for row in rows)
    text = " ".join((DOCS / "limits.md").read_text(encoding="utf-8").split())
    of_37 = [row for row in rows if row["seed"] == 37]
    largest = max(of_37, key=lambda row: row["worst_mib"])
    total = sum(row["cases"] for row in of_37)
    assert f"{total} cases, none other, at most {largest['worst_mib']} MiB ({largest['reader']})" in text
