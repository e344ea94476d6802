"""The pictures of a report: small enough for one file, and in the rows that a contact sheet has."""

import base64
import dataclasses
import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.util.errors import InputError
from hyjax.util.images import resize, write_png

MOST_BYTES = 5_500_000  # of pictures in one report; as text they take a third more
# What is tried until it fits: lossless first, then ever smaller.
ENCODINGS = (("png", 1024), ("jpg", 1024), ("jpg", 768), ("jpg", 512), ("jpg", 384), ("jpg", 256), ("jpg", 160))
QUALITY = 90
BLANK = 0.09


@dataclasses.dataclass(frozen=True)
class Example:
    """One frame under one light set-up, relit in several ways.

    Attributes:
        name: such as "frame 12, evening-lamps".
        pictures: heading → display-encoded picture, in the order they are shown. Compared first are the last ones
            whose headings begin with "paper" and with "tuned".
    """

    name: str
    pictures: Mapping[str, Float[np.ndarray, "h w 3"]]


def data_uris(examples: Sequence[Example], most_bytes: int = MOST_BYTES) -> list[dict[str, str]]:
    """Every picture as a `data:` address, by example and heading: as PNG if they fit, else as JPEG."""
    for kind, width in ENCODINGS:
        total, found = 0, []
        for example in examples:
            files = {heading: _encode(picture, kind, width) for heading, picture in example.pictures.items()}
            total += sum(len(content) for content in files.values())
            if total > most_bytes:
                break
            found.append({heading: _uri(content, kind) for heading, content in files.items()})
        else:
            return found
    raise InputError(f"report: {len(examples)} examples are too many for one file; show fewer")


def data_uri(picture: Float[np.ndarray, "h w 3"], kind: str = "jpg", width: int = 2048) -> str:
    """One picture as a `data:` address, `png` or `jpg`, no wider than `width`."""
    return _uri(_encode(picture, kind, width), kind)


def _uri(content: bytes, kind: str) -> str:
    return f"data:image/{'png' if kind == 'png' else 'jpeg'};base64,{base64.b64encode(content).decode()}"


def _encode(picture: Float[np.ndarray, "h w 3"], kind: str, width: int) -> bytes:
    pixels = np.clip(np.nan_to_num(np.asarray(picture, dtype=np.float32)), 0.0, 1.0)
    if pixels.shape[1] > width:
        pixels = np.clip(resize(pixels, max(1, round(width * pixels.shape[0] / pixels.shape[1])), width), 0.0, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{kind}"
        if kind == "png":
            write_png(path, pixels)
        else:
            import OpenImageIO as oiio  # here: see `hyjax.util.images`

            buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
            buffer.specmod().attribute("Compression", f"jpeg:{QUALITY}")
            buffer.specmod().attribute("jpeg:subsampling", "4:4:4")
            if not buffer.write(str(path), "uint8"):
                raise InputError(f"report: cannot make a JPEG ({buffer.geterror().splitlines()[0]})")
        return path.read_bytes()


def pair_to_compare(headings: Sequence[str]) -> tuple[int, int]:
    """Positions of the two pictures that are compared first: the last "paper…" and "tuned…", else the last two."""
    last = len(headings) - 1
    paper = [i for i, heading in enumerate(headings) if heading.startswith("paper")]
    tuned = [i for i, heading in enumerate(headings) if heading.startswith("tuned")]
    return (paper[-1], tuned[-1]) if paper and tuned else (max(0, last - 1), last)


def contact_sheet_rows(
    examples: Sequence[Example],
) -> tuple[list[tuple[str, list[Float[np.ndarray, "h w 3"]]]], list[str]]:
    """Rows and headings for `write_contact_sheet`; a picture that an example lacks is blank."""
    headings = list(dict.fromkeys(itertools.chain.from_iterable(example.pictures for example in examples)))

    def pictures(example: Example) -> Iterator[Float[np.ndarray, "h w 3"]]:
        blank = np.full_like(next(iter(example.pictures.values())), BLANK)
        yield from (example.pictures.get(heading, blank) for heading in headings)

    return [(example.name, list(pictures(example))) for example in examples], headings
