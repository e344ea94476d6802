"""Positions of point clouds in PLY files: ASCII and binary of both byte orders, read in pieces.

A laser scan has tens of millions of points with colours. trimesh reads a file whole with all its properties, and
takes an ASCII cloud that was cut off for a good one; here only positions are kept, in pieces, and counted.

Source: Turk, "The PLY polygon file format", 1994.
"""

import dataclasses
import itertools
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from hyjax.util.errors import InputError
from hyjax.util.reading import open_regular

ROWS = 1 << 21  # points of a piece
TEXT_ROWS = 1 << 18  # the same as lines of text, which take more memory
MOST_UNUSABLE = 0.01  # share of points that may be NaN or infinite; more is no slip of an exporter
LONGEST_HEADER = 10_000  # lines
TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Element:
    """One kind of rows in the file; `types` has None for a list."""

    name: str
    count: int
    types: dict[str, str | None] = dataclasses.field(default_factory=dict)

    @property
    def has_lists(self) -> bool:
        return None in self.types.values()

    def dtype(self, order: str) -> np.dtype:
        return np.dtype([(name, f"{order}{kind}") for name, kind in self.types.items()])


def load_points(path: Path) -> Float[np.ndarray, "n 3"]:
    """All positions in a PLY file, see `read_points`."""
    return np.concatenate(list(read_points(path)))


def read_points(path: Path) -> Iterator[Float[np.ndarray, "n 3"]]:
    """The positions in a PLY file, in pieces, as float32 or whatever wider type the file has.

    Colours, normals, faces and whatever else there is are passed over. Points with a NaN or infinite coordinate are
    dropped with a warning.

    Raises:
        InputError: no such file, not a PLY file, truncated, no vertices, vertices without x, y, z or with lists, a
            malformed line, more than one point in a hundred NaN or infinite.
    """
    path = Path(path)
    with open_regular(path) as file:
        order, elements = _read_header(path, file)
        vertex = _vertices_next(path, file, order, elements)
        kind = np.result_type(np.float32, *(vertex.dtype("")[axis] for axis in "xyz"))
        unusable: int = 0
        for piece in _binary_rows(path, file, order, vertex) if order else _text_rows(path, file, vertex):
            with np.errstate(over="ignore"):  # of a text's numbers: infinite then, and told below
                piece = piece.astype(kind, copy=False)
            finite = np.isfinite(piece).all(axis=1)
            unusable += int(np.count_nonzero(~finite))
            yield piece[finite]
    if unusable > MOST_UNUSABLE * vertex.count:
        raise InputError(f"{path}: {unusable} of {vertex.count} points are NaN or infinite; export the scan again")
    if unusable:
        _log.warning("%s: dropped %d points that are NaN or infinite", path, unusable)


def _read_header(path: Path, file: BinaryIO) -> tuple[str, list[Element]]:
    """NumPy's sign of the byte order ('' for text), and the elements in their order in the file."""
    if file.readline(16).strip() != b"ply":
        raise InputError(f"{path}: not a PLY file (its first line is not 'ply')")
    order: str | None = None
    elements: list[Element] = []
    for _ in range(LONGEST_HEADER):
        line = file.readline(4096).decode("latin-1")
        if line.strip() == "end_header":
            if order is None:
                raise InputError(f"{path}: its header has no 'format' line")
            return order, elements
        try:
            match line.split():
                case ["format", name, _]:
                    order = BYTE_ORDERS[name]
                case ["element", name, count] if int(count) >= 0:
                    elements.append(Element(name, int(count)))
                case ["property", "list", _, _, name]:
                    elements[-1].types[name] = None
                case ["property", kind, name] if name not in elements[-1].types:
                    elements[-1].types[name] = TYPES[kind]
                case ["comment" | "obj_info", *_]:
                    pass
                case _:
                    break
        except (ValueError, KeyError, IndexError):
            break
    raise InputError(f"{path}: not a PLY header, or cut off: cannot read its line {line[:60].strip()!r}")


def _vertices_next(path: Path, file: BinaryIO, order: str, elements: list[Element]) -> Element:
    """The vertex element, with the file moved to its first row."""
    for element in elements:
        if element.name == "vertex":
            break
        if not order:
            rows = min(element.count, sys.maxsize)
            next(itertools.islice(file, rows, rows), None)
        elif element.has_lists:
            raise InputError(
                f"{path}: '{element.name}' with its lists comes before the vertices; write vertices first"
            )
        else:
            file.seek(min(element.count * element.dtype(order).itemsize, path.stat().st_size), 1)
    else:
        raise InputError(f"{path}: has no vertices; need a point cloud")
    if element.count == 0:
        raise InputError(f"{path}: has no vertices; need a point cloud")
    if element.has_lists or not set("xyz") <= element.types.keys():
        properties = ", ".join(element.types)
        raise InputError(
            f"{path}: its vertices need plain x, y, z and no lists, they have {properties or 'nothing'}"
        )
    return element


def _binary_rows(path: Path, file: BinaryIO, order: str, vertex: Element) -> Iterator[Float[np.ndarray, "n 3"]]:
    rows = vertex.dtype(order)
    complete = (path.stat().st_size - file.tell()) // rows.itemsize
    if complete < vertex.count:
        raise InputError(f"{path}: truncated, has {max(complete, 0)} of {vertex.count} vertices")
    for start in range(0, vertex.count, ROWS):
        piece = np.fromfile(file, rows, min(ROWS, vertex.count - start))
        yield np.stack([piece[axis] for axis in "xyz"], axis=-1)


def _text_rows(path: Path, file: BinaryIO, vertex: Element) -> Iterator[Float[np.ndarray, "n 3"]]:
    columns = [list(vertex.types).index(axis) for axis in "xyz"]
    for start in range(0, vertex.count, TEXT_ROWS):
        lines = list(itertools.islice(file, min(TEXT_ROWS, vertex.count - start)))
        if len(lines) < min(TEXT_ROWS, vertex.count - start):
            raise InputError(f"{path}: truncated, has {start + len(lines)} of {vertex.count} vertices")
        try:
            numbers = np.loadtxt(lines, comments=None, ndmin=2)
        except ValueError as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"{path}: malformed or truncated after vertex {start} ({reason})") from error
        if numbers.shape != (len(lines), len(vertex.types)):
            raise InputError(
                f"{path}: malformed or truncated after vertex {start}; each needs {len(vertex.types)} numbers"
            )
        yield numbers[:, columns]
