"""Texts, JSON and YAML of files that may be damaged or come from strangers.

Every reader of the package reads through these: what they return is plain data of bounded size and depth, and
whatever is wrong is one `InputError`.
"""

import errno
import functools
import io
import json
import math
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from hyjax.util.errors import InputError, shown

LARGEST_TEXT = 1 << 28
"""Bytes of a text."""
LARGEST_JSON = 1 << 26
"""Characters; poses and intrinsics of a hundred thousand frames have less. One letter beyond Latin makes four bytes
of each, in the text and in what is read of it."""
LARGEST_YAML = 1 << 18
"""Bytes of a YAML file, which takes three seconds to read; a large one is better JSON."""
DEEPEST_NESTING = 64
"""Lists and mappings within each other."""
MOST_MARKS = 1 << 22
"""Commas, colons and opening brackets of a JSON text: mappings in mappings take three seconds and 0.4 GiB."""
MOST_DIGITS = 20
"""Most digits of a whole number; it must have at most 64 bits too, with a sign or without."""
HALF_LETTER = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
"""Escape of a lone surrogate in JSON; valid pairs contain it too."""
MOST_NODES = 100_000
"""Values of a YAML file, each alias counted with all that it stands for."""


def open_regular(path: Path, where: str | None = None) -> BinaryIO:
    """A file opened for reading; pipes, devices and folders are refused and not waited for."""
    where = where or str(path)
    try:
        # Without O_NONBLOCK, opening a pipe waits for somebody who writes.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except FileNotFoundError:
        raise InputError(f"{where}: no such file") from None
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        raise InputError(f"{where}: cannot read ({_reason(error)})") from None
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        os.close(descriptor)
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe, socket or device"
        raise InputError(f"{where}: is {kind}, not a file")
    if found.st_dev in _kernel_devices():
        os.close(descriptor)
        raise InputError(f"{where}: leads to a file that the kernel makes up, not a stored one")
    return io.BufferedReader(_StoredFile(descriptor, where))


class _StoredFile(io.FileIO):
    """A file whose disk may fail while it is read."""

    def __init__(self, descriptor: int, where: str) -> None:
        super().__init__(descriptor, "rb")
        self.where = where

    def readinto(self, buffer: Any, /) -> int | None:
        try:
            return super().readinto(buffer)
        except OSError as error:
            raise InputError(f"{self.where}: cannot read ({_reason(error)})") from None

    def readall(self) -> bytes:
        try:
            return super().readall()
        except OSError as error:
            raise InputError(f"{self.where}: cannot read ({_reason(error)})") from None


@functools.cache
def _kernel_devices() -> set[int]:
    """Numbers of the file systems whose files have no content until they are read."""
    return {place.stat().st_dev for place in (Path("/proc"), Path("/sys")) if place.is_dir()}


def check_regular(path: Path) -> None:
    """Raise `InputError` unless a path is a regular, readable file."""
    open_regular(path).close()


def exists(path: Path) -> bool:
    """Whether there is a file or folder of a name; none has a name that is too long, or with a NUL in it."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, where: str | None = None, most: int = LARGEST_TEXT) -> bytes:
    """Content of a file."""
    where = where or str(path)
    with open_regular(path, where) as file:
        size = os.fstat(file.fileno()).st_size
        check_most(size, most, where)
        return file.read(size)


def check_most(size: int, most: int, where: str) -> None:
    """Raise `InputError` for a file of more than `most` bytes."""
    if size > most:
        raise InputError(f"{where}: has over {_size(most)}; too large for its kind")


def read_text(path: Path, where: str | None = None, most: int = LARGEST_TEXT) -> str:
    """A text file (UTF-8, with or without a byte order mark)."""
    return as_text(read_bytes(path, where, most), where or str(path))


def as_text(content: bytes, where: str) -> str:
    """Bytes of UTF-8 as a text."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: not a text file (byte {error.start} is not UTF-8)") from None


def read_json(path: Path) -> Any:
    """Plain data of a JSON file; see `parse_json`."""
    return parse_json(read_text(path, most=LARGEST_JSON), str(path))


def parse_json(text: str | bytes, where: str, *, only_finite: bool = False) -> Any:
    """Plain data of a JSON text.

    Args:
        only_finite: refuse NaN and infinite numbers too, which Python writes though JSON has none.

    Example:
        >>> parse_json('{"size": [640, 480]}', "camera.json")
        {'size': [640, 480]}
    """
    if isinstance(text, bytes | str):
        check_most(len(text), LARGEST_JSON, where)
    if isinstance(text, bytes):
        text = as_text(text, where)
    if not isinstance(text, str):
        raise InputError(f"{where}: need JSON text, got {shown(text)}")
    if len(text) > MOST_MARKS and sum(map(text.count, ",:[{")) > MOST_MARKS:
        raise InputError(f"{where}: has over {MOST_MARKS} values; too many for its kind")

    def whole(digits: str) -> int:
        if len(digits.lstrip("-")) > MOST_DIGITS:
            raise InputError(f"{where}: a whole number of {len(digits)} digits; at most {MOST_DIGITS} are read")
        return _of_64_bits(int(digits), where)

    def real(digits: str) -> float:
        number = float(digits)
        if not math.isfinite(number):
            raise InputError(f"{where}: not JSON ({shown(digits)} is no number of it)")
        return number

    strict: dict[str, Any] = {"parse_float": real, "parse_constant": real} if only_finite else {}
    try:
        value = json.loads(text, parse_int=whole, **strict)
    except RecursionError:
        raise InputError(f"{where}: lists and mappings more than {DEEPEST_NESTING} deep") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{where}: not JSON (line {error.lineno}: {error.msg})") from None
    if _depth(value) > DEEPEST_NESTING:
        raise InputError(f"{where}: lists and mappings more than {DEEPEST_NESTING} deep")
    if HALF_LETTER.search(text):
        for part, _ in _parts(value):
            _check_letters(part, where)
    return value


def read_yaml(path: Path) -> Any:
    """Plain data of a YAML or JSON file; see `parse_yaml`."""
    return parse_yaml(read_text(path, most=LARGEST_YAML), str(path))


def parse_yaml(text: str, where: str) -> Any:
    """Plain data of a YAML text; JSON is a part of YAML.

    Example:
        >>> parse_yaml("lights:\\n  - {type: point, lux: 80}", "lamps.yaml")
        {'lights': [{'type': 'point', 'lux': 80}]}
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # C's is ten times as fast
    depth = 0
    try:
        for event in yaml.parse(text, loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST_NESTING:
                raise InputError(f"{where}: lists and mappings more than {DEEPEST_NESTING} deep")
            if _is_merge(event):  # expanded while it is loaded, before anything can be counted
                raise InputError(f"{where}: a merge key (<<); write out what it stands for")
        value = yaml.load(text, loader)
    except InputError:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" (line {mark.line + 1}: {getattr(error, 'problem', '')})" if mark else ""
        raise InputError(f"{where}: neither YAML nor JSON{line}") from None
    except Exception as error:  # the constructors of scalars: `2026-99-99`, `!!int x`, `0b_`
        raise InputError(f"{where}: a value that YAML cannot make ({error})") from None
    _check_values(value, where)
    return value


def _is_merge(event: Any) -> bool:
    """Whether an event of YAML is a merge key: by how it is written, or by its tag."""
    tag, value = getattr(event, "tag", None), getattr(event, "value", None)
    return (value == "<<" and event.implicit[0]) or (tag or "").endswith(":merge")


def _of_64_bits(number: int, where: str) -> int:
    if not -(1 << 63) <= number < 1 << 64:
        raise InputError(f"{where}: a whole number beyond 64 bits")
    return number


def _check_values(value: Any, where: str) -> None:
    for count, (part, depth) in enumerate(_parts(value), start=1):
        if count > MOST_NODES or depth > DEEPEST_NESTING:  # a list that holds itself is as deep as one likes
            raise InputError(f"{where}: aliases that stand for over {MOST_NODES} values")
        if isinstance(part, int):
            _of_64_bits(part, where)
        _check_letters(part, where)


def _check_letters(value: Any, where: str) -> None:
    """Raise `InputError` for a text with half of a pair of surrogates, which no file can hold."""
    try:
        if isinstance(value, str):
            value.encode()
    except UnicodeEncodeError:
        raise InputError(f"{where}: a text with half a letter (a lone surrogate)") from None


def _parts(value: Any) -> Iterator[tuple[Any, int]]:
    """A value and all in its lists and mappings, keys among them, each with its depth."""
    left = [(value, 1)]
    while left:
        part, depth = left.pop()
        yield part, depth
        if isinstance(part, dict):
            left += [(each, depth + 1) for pair in part.items() for each in pair]
        elif isinstance(part, list | tuple | set):
            left += [(each, depth + 1) for each in part]


def _depth(value: Any) -> int:
    """Depth of lists and mappings within each other; stops where they are too many."""
    depth, layer = 0, [value]
    while layer and depth <= DEEPEST_NESTING:
        layer = [
            part
            for outer in layer
            if isinstance(outer, dict | list)
            for part in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(part, dict | list)
        ]
        depth += 1
    return depth


def finite(value: Any, where: str, *, least: float = -math.inf, most: float = math.inf) -> float:
    """A number of a file as a float.

    Example:
        >>> finite(50, "lens.json, fx", least=1e-3)
        50.0
    """
    known = isinstance(value, int | float) and not isinstance(value, bool)
    if not known or (isinstance(value, float) and not math.isfinite(value)):
        raise InputError(f"{where}: must be a number, got {shown(value)}")
    if not least <= value <= most:
        raise InputError(f"{where}: must be {least:g} to {most:g}, got {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: a whole number that is too large") from None


def disk_error(path: Path | str, error: OSError) -> NoReturn:
    """Raise the `InputError` for a file or folder that cannot be written."""
    hint = "; free some space, or write elsewhere" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
    raise InputError(f"{path}: cannot write ({_reason(error)}{hint})") from None


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >> 20 else f"{count} bytes"
