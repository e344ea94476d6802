"""Helpers of the readers of captures: numbers in text, pictures, files named by time, fingerprints."""

import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from hyjax.data.file_tree import FileTree
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError
from hyjax.util.images import picture_shape, read_depth, read_image, read_labels
from hyjax.util.reading import parse_json

LARGEST_OF_NUMBERS = 1 << 16
"""Bytes of a text file that holds one matrix."""
LARGEST_NUMBER = 1e19
"""Largest number in a capture's file; nanoseconds since 1970 are the largest that any program writes."""
TIMED_NAME = re.compile(r"(?:\d+_)?(\d+\.\d+)")


def tree_numbers(
    tree: FileTree, name: str, shape: tuple[int, ...], meaning: str = "row by row"
) -> Float[np.ndarray, "*shape"]:
    """All numbers of a text file of a tree; see `parse_numbers`."""
    return parse_numbers(tree.text(name, LARGEST_OF_NUMBERS), tree.where(name), shape, meaning)


def parse_numbers(
    text: str, path: str, shape: tuple[int, ...], meaning: str = "row by row"
) -> Float[np.ndarray, "*shape"]:
    """All numbers of a text, separated by blanks and line ends."""
    try:
        numbers = np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: need {np.prod(shape)} plain numbers ({error})") from error
    if numbers.size != np.prod(shape):
        expected = "x".join(map(str, shape))
        raise InputError(f"{path}: has {numbers.size} numbers, need {expected}: {meaning}")
    if (np.isfinite(numbers) & (np.abs(numbers) > LARGEST_NUMBER)).any():
        raise InputError(f"{path}: has a number beyond {LARGEST_NUMBER:g}; need plain ones, {meaning}")
    return numbers.reshape(shape)


def read_colour(path: Path, where: str | None = None) -> Float[np.ndarray, "h w 3"]:
    """A colour picture, without its alpha channel if it has one."""
    image = read_image(path, where)
    if image.shape[2] < 3:
        raise InputError(f"{where or path}: need a colour picture, this one has {image.shape[2]} channel(s)")
    return image[..., :3]


def tree_colour(tree: FileTree, name: str) -> Float[np.ndarray, "h w 3"]:
    """A colour picture of a tree, without its alpha channel; see `read_colour`."""
    with tree.local(name) as path:
        return read_colour(path, tree.where(name))


def tree_depth(tree: FileTree, name: str, unit: float = 0.001) -> Float[np.ndarray, "h w"]:
    """A 16-bit depth map of a tree in metres, 0 where there is no reading; see `read_depth`."""
    with tree.local(name) as path:
        return read_depth(path, unit, tree.where(name))


def tree_labels(tree: FileTree, name: str) -> UInt8[np.ndarray, "h w"]:
    """An 8-bit picture of a tree whose values are numbers, such as confidences; see `read_labels`."""
    with tree.local(name) as path:
        return read_labels(path, tree.where(name))


def tree_json(tree: FileTree, name: str) -> Any:
    """Content of a JSON file of a tree."""
    return parse_json(tree.text(name), tree.where(name))


def intrinsics_at(where: str, width: int, height: int, *focal_and_centre: float) -> Intrinsics:
    """Intrinsics from fx, fy, cx, cy; an error names the file."""
    try:
        return Intrinsics(width, height, *map(float, focal_and_centre))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def looks_whole(tree: FileTree, name: str) -> bool:
    """Whether a JPEG or PNG begins and ends as one; its pixels are not read. True for other formats."""
    marks = {".jpg": (b"\xff\xd8", b"\xff\xd9"), ".png": (b"\x89PNG", b"IEND")}
    suffix = f".{name.rpartition('.')[2].lower()}".replace(".jpeg", ".jpg")
    if suffix not in marks:
        return tree.size(name) > 0
    try:
        head, tail = tree.ends(name, 64)
    except InputError:  # damaged in its archive, or not ours to read
        return False
    return head.startswith(marks[suffix][0]) and marks[suffix][1] in tail


def tree_shape(tree: FileTree, name: str) -> tuple[int, int]:
    """(height, width) of a picture of a tree, from its header; see `picture_shape`."""
    with tree.local(name) as path:
        return picture_shape(path, tree.where(name))


def bytes_colour(content: bytes, suffix: str, where: str) -> Float[np.ndarray, "h w 3"]:
    """A colour picture from the bytes of its file; see `read_colour`."""
    with tempfile.TemporaryDirectory(prefix="hyjax-") as folder:
        path = Path(folder) / f"picture{suffix}"
        path.write_bytes(content)
        return read_colour(path, where)


def by_number(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key to sort names by: the numbers in them as numbers, so that 10 comes after 9."""
    parts = re.split(r"0*(\d+)", name, flags=re.ASCII)
    return tuple((0, len(p), p) if p.isascii() and p.isdigit() else (1, 0, p) for p in parts)


def short_names(files: Sequence[str]) -> list[str]:
    """Names of frames from their files: without folder and extension, unless two would be alike."""
    stems = [PurePosixPath(file).stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    return [file.strip("/").replace("/", "_") for file in files]


class Tally:
    """Counts of a capture's faults and remarks, by kind.

    Example:
        >>> tally = Tally()
        >>> for name in ("3.jpg", "7.jpg"):
        ...     tally.add("pictures are damaged", name)
        >>> tally.lines()
        ['2 pictures are damaged (first: 3.jpg)']
    """

    def __init__(self) -> None:
        self._found: dict[str, tuple[int, str]] = {}

    def add(self, what: str, name: str) -> None:
        """Count one, which is called `name`."""
        count, first = self._found.get(what, (0, name))
        self._found[what] = count + 1, first

    def lines(self) -> list[str]:
        """A line for each kind of thing, in the order in which they were first seen."""
        return [f"{count} {what} (first: {first})" for what, (count, first) in self._found.items()]


class TimedFile(NamedTuple):
    """A file and the seconds in its name."""

    time: float
    name: str


class TimedFiles:
    """Files of different times, in order of time."""

    def __init__(self, files: Iterable[TimedFile]) -> None:
        self._files = sorted(files)
        self._times = np.array([file.time for file in self._files])

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[TimedFile]:
        return iter(self._files)

    def nearest(self, time: float, tolerance: float) -> TimedFile | None:
        """The file nearest to `time`; None if it is further away than `tolerance` seconds."""
        right = int(np.searchsorted(self._times, time))
        around = self._files[max(0, right - 1) : right + 1]
        best = min(around, key=lambda file: abs(file.time - time), default=None)
        return best if best is not None and abs(best.time - time) <= tolerance else None


def timed_files(tree: FileTree, folder: str, suffix: str) -> TimedFiles:
    """Files of a folder named as `47333462_6845.210.png`: video (or nothing), time in seconds, suffix."""
    found: dict[float, str] = {}
    for name in tree.below(folder, suffix):
        if match := TIMED_NAME.fullmatch(name.rpartition("/")[2].removesuffix(suffix)):
            time = float(match[1])
            if time in found:
                raise InputError(f"{tree.where(name)}: time {time:.3f} is also {found[time]}; keep one of the two")
            found[time] = name
    return TimedFiles(TimedFile(time, name) for time, name in found.items())
