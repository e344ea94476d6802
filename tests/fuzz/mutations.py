"""Mutations of a file's bytes: blind ones, and such that know texts, JSON, YAML, PNG and fields of 32 bits."""

import json
import random
import struct
import zlib
from collections.abc import Callable, Sequence
from typing import Any

NUMBERS = [
    "nan",
    "-inf",
    "1e999",
    "-0",
    "0",
    "-1",
    "1e-300",
    "1e300",
    "10" * 200,
    "9" * 5000,
    "0.5",
    "65536",
    "1e7",
]
WORDS = ["null", "true", "[]", "{}", '"x"', "2026-99-99", "!!int x", "!!bool x", "!!binary x", "&a [*a]", ".."]
WORDS += ["0b_", '"\\u0000"', '"\\ud800"', "1:60", "<<"]
BYTES = [0, 1, 0x7F, 0x80, 0xB0, 0xFF, 0x20, 0x0A, 0x22, 0x2D, 0x5B, 0x7B]
FIELDS = [0, 1, 2, 0xFF, 0xFFFF, 1 << 16, 1 << 20, 1 << 24, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF]
VALUES: list[Any] = [None, True, False, 0, -1, 1, 3, 0.5, 1e-300, 1e300, 10**400, 2**63, float("nan"), float("inf")]
VALUES += ["", "x", "..", "a\0b", "no", "\ud800", "é" * 300, [], {}, [[]], {"": None}, [1], ["x", 1]]
VALUES += [{"settings": [1]}, {"key": [1], "value": 2}]
CLASSICS = [
    b"",
    b"\0",
    b"\n",
    b"\xff\xfe\x00\x80",
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b"[" * 2000 + b"]" * 2000,
    b"- " * 2000 + b"1",
    b"9" * 5000,
    b'{"iteration": ' + b"9" * 400 + b"}",
    b"[" + b"[]," * 100_000 + b"[]]",
    b"null",
    b"[]",
    b"{}",
    b'{"iteration": "x"}\n',
    b'{"settings": [1]}\n{"key": [1], "value": 2}\n{}\n',
    b'{"key": [1], "value": 2}\n{"key": "a"}\n',
    b"a: &a [1, 2]\nb: [*a, *a]\n" + b"".join(b"c%d: &c%d [*a, *a, *a, *a]\n" % (n, n) for n in range(50)),
    b"a0: &a0 {x: 1}\n"
    + b"".join(b"a%d: &a%d {<<: [%s]}\n" % (n, n, b", ".join([b"*a%d" % (n - 1)] * 9)) for n in range(1, 9)),
    b"PK\x05\x06" + bytes(18),
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff\xe0" + bytes(100),
]
"""Whole contents, tried first: the empty file, deep nesting, long numbers, what once came through."""


def mutated(content: bytes, others: Sequence[bytes], source: random.Random) -> bytes:
    """The content with one to three things changed.

    Args:
        content: of a file.
        others: contents of other files of the same kind, to take pieces from.
        source: of randomness.
    """
    for _ in range(source.choice((1, 1, 1, 2, 3))):
        knowing = _knowing(content)
        change = source.choice(knowing if knowing and source.random() < 0.6 else BLIND)
        content = change(content, source) if change is not _spliced else _spliced(content, source, others)
    return content


Change = Callable[..., bytes]


def _knowing(content: bytes) -> list[Change]:
    """What goes with a format."""
    if content.startswith(b"\x89PNG"):
        return [_field, _png_chunk]
    if _json_inside(content):
        return [_field, _header, _swapped, _header_json, _header_json]
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return [_field, _header, _swapped]
    if "\0" in text:
        return [_field, _header, _swapped]
    return (
        [_number, _word, _line, _json, _json, _json] if text[:1] in ("{", "[") else [_number, _number, _word, _line]
    )


# ---- blind ----


def _bits(content: bytes, source: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(source.choice((1, 1, 2, 8)) if changed else 0):
        changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
    return bytes(changed)


def _byte(content: bytes, source: random.Random) -> bytes:
    at = source.randrange(len(content) + 1)
    return content[:at] + bytes([source.choice(BYTES)]) + content[at + 1 :]


def _cut(content: bytes, source: random.Random) -> bytes:
    return content[: source.randrange(len(content) + 1)]


def _inserted(content: bytes, source: random.Random) -> bytes:
    at = source.randrange(len(content) + 1)
    return content[:at] + source.randbytes(source.choice((1, 2, 4, 16, 300))) + content[at:]


def _removed(content: bytes, source: random.Random) -> bytes:
    start, end = _span(content, source)
    return content[:start] + content[end:]


def _doubled(content: bytes, source: random.Random) -> bytes:
    start, end = _span(content, source)
    return content[:end] + content[start:]


def _spliced(content: bytes, source: random.Random, others: Sequence[bytes] = ()) -> bytes:
    other = source.choice(list(others) or [content])
    start, end = _span(other, source)
    at, after = _span(content, source)
    return content[:at] + other[start:end] + content[after:]


def _span(content: bytes, source: random.Random) -> tuple[int, int]:
    start = source.randrange(len(content) + 1)
    return start, min(len(content), start + source.choice((1, 4, 16, 64, 1 << 20)))


BLIND: list[Change] = [_bits, _byte, _cut, _inserted, _removed, _doubled, _spliced]

# ---- binary ----


def _field(content: bytes, source: random.Random, most: int = 1 << 30) -> bytes:
    """A field of 16, 32 or 64 bits at an extreme, of either byte order."""
    code = source.choice(("<I", ">I", "<I", ">I", "<H", ">H", "<Q", "<f"))
    size = struct.calcsize(code)
    at = source.randrange(max(1, min(len(content), most) - size + 1))
    if code == "<f":
        field = struct.pack(code, source.choice((float("nan"), float("inf"), 1e-30, -1.0, 1e30)))
    else:
        field = struct.pack(code, source.choice(FIELDS) & ((1 << 8 * size) - 1))
    return content[:at] + field + content[at + size :]


def _header(content: bytes, source: random.Random) -> bytes:
    return _field(content, source, 512)


def _swapped(content: bytes, source: random.Random) -> bytes:
    """Two fields of 32 bits in each other's place."""
    if len(content) < 8:
        return content
    one, other = (4 * source.randrange(min(len(content), 512) // 4) for _ in range(2))
    changed = bytearray(content)
    changed[one : one + 4], changed[other : other + 4] = content[other : other + 4], content[one : one + 4]
    return bytes(changed)


def _json_inside(content: bytes) -> tuple[int, int] | None:
    """Where JSON lies in the header of a GLB or of safetensors."""
    start = 20 if content.startswith(b"glTF") else 8
    size = int.from_bytes(content[12:16] if start == 20 else content[:8], "little")
    return (start, start + size) if content[start : start + 1] == b"{" and start + size <= len(content) else None


def _header_json(content: bytes, source: random.Random) -> bytes:
    """A value of the JSON in a header changed, and the sizes that tell of it made right."""
    start, end = _json_inside(content) or (0, 0)
    text = _json(content[start:end], source)
    text += b" " * (-len(text) % 4)
    size = len(text).to_bytes(4, "little")
    if start == 8:
        return size + bytes(4) + text + content[end:]
    total = (len(content) - end + start + len(text)).to_bytes(4, "little")
    return content[:8] + total + size + content[16:20] + text + content[end:]


def _png_chunk(content: bytes, source: random.Random) -> bytes:
    """A chunk dropped, doubled, longer, or of a giant size in the header, its own checksum made right."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        chunks.append(content[at : at + 12 + length])
        at += 12 + length
    if not chunks:
        return content
    place = source.randrange(len(chunks))
    kind, value = chunks[place][4:8], chunks[place][8:-4]
    if kind == b"IHDR":
        value = struct.pack(">2I", *source.choices(FIELDS[6:], k=2)) + value[8:]
    if kind == b"IHDR" or (kind != b"IDAT" and source.random() < 0.3):
        value += b"" if kind == b"IHDR" else b"\0"
        length = struct.pack(">I", len(value))
        chunks[place] = length + kind + value + struct.pack(">I", zlib.crc32(value, zlib.crc32(kind)))
    elif kind != b"IDAT":  # without some of the pixels libpng itself complains
        chunks[place : place + 1] = source.choice(([], [chunks[place]] * 2))
    return content[:8] + b"".join(chunks)


# ---- text ----


def _tokens(content: bytes, of: bytes) -> list[tuple[int, int]]:
    """Places of words of these letters."""
    spans, start = [], None
    for at, letter in enumerate(content[:20_000] + b"\0"):
        if letter in of:
            start = at if start is None else start
        elif start is not None:
            spans.append((start, at))
            start = None
    return spans


def _replaced(content: bytes, source: random.Random, of: bytes, values: Sequence[str]) -> bytes:
    spans = _tokens(content, of)
    if not spans:
        return content
    start, end = source.choice(spans)
    return content[:start] + source.choice(values).encode() + content[end:]


def _number(content: bytes, source: random.Random) -> bytes:
    return _replaced(content, source, b"0123456789.+-eE", NUMBERS)


def _word(content: bytes, source: random.Random) -> bytes:
    letters = b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789.-"
    return _replaced(content, source, letters, [*NUMBERS, *WORDS])


def _line(content: bytes, source: random.Random) -> bytes:
    """A line dropped, doubled or moved."""
    lines = content.split(b"\n")
    line = lines.pop(source.randrange(len(lines)))
    for _ in range(source.randrange(3)):
        lines.insert(source.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _json(content: bytes, source: random.Random) -> bytes:
    """A value, at any depth, replaced, dropped, wrapped in lists or under another key; in one of JSON lines."""
    lines = content.split(b"\n")
    place = source.randrange(len(lines))
    try:
        value = json.loads(content)
        lines, place = [content], 0
    except (ValueError, RecursionError):
        try:
            value = json.loads(lines[place])
        except (ValueError, RecursionError):
            return _word(content, source)
    text = json.dumps(_changed(value, source))
    if source.random() < 0.1 and text.startswith('{"'):  # its first key twice
        text = text[:1] + text[1 : text.index('"', 2) + 1] + ": null, " + text[1:]
    lines[place] = text.encode()
    return b"\n".join(lines)


def _changed(value: Any, source: random.Random) -> Any:
    root = [value]
    holder: Any = root
    key: Any = 0
    while isinstance(holder[key], dict | list) and holder[key] and source.random() < 0.8:
        holder = holder[key]
        key = source.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    what = source.random()
    if what < 0.1:  # its value and another's change places, or it comes many times, as instances of a mesh do
        if isinstance(holder, list) and source.random() < 0.5:
            holder += [holder[key]] * source.choice((1, 1000))
        else:
            other = source.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
            holder[key], holder[other] = holder[other], holder[key]
    elif what < 0.3 and isinstance(holder, dict):
        taken = holder.pop(key)
        if what < 0.15:
            holder["unknown"] = taken
    elif what < 0.4:
        for _ in range(source.choice((1, 3, 200))):
            holder[key] = [holder[key]]
    else:
        holder[key] = source.choice(VALUES)
    return root[0]
