"""Contact sheets: rows of labelled pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from hyjax.util.images import to_bytes, write_png

BACKGROUND, INK = 0.09, 0.92
GAP, LABEL, FONT = 4, 20, 13
WIDTH = 320
"""Width of a picture on a sheet, in pixels."""

Picture = Float[np.ndarray, "h w c"] | UInt8[np.ndarray, "h w c"]
"""Display-encoded, of three channels or of one."""


def contact_sheet(
    rows: Sequence[tuple[str, Sequence[Picture]]], headings: Sequence[str], width: int = WIDTH
) -> Float[np.ndarray, "h w 3"]:
    """Compose a sheet.

    Args:
        rows: (label above them, display-encoded pictures), as many pictures as headings.
        headings: one for each column.
        width: of each picture on the sheet, in pixels.

    Returns:
        The sheet, display-encoded.
    """
    return _sheet(rows, headings, width).astype(np.float32) / np.float32(255.0)


def fitted_row(pictures: Sequence[Picture], width: int = WIDTH) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Pictures of a row at their size on the sheet, which take less memory until it is composed."""
    first = pictures[0]
    height = round(width * first.shape[0] / first.shape[1])
    return [np.asarray(_fitted(picture, height, width)) for picture in pictures]


def write_contact_sheet(path: Path, rows: Sequence[tuple[str, Sequence[Picture]]], headings: Sequence[str]) -> None:
    """Write a `contact_sheet` into a PNG."""
    write_png(path, _sheet(rows, headings, WIDTH))


def _sheet(
    rows: Sequence[tuple[str, Sequence[Picture]]], headings: Sequence[str], width: int
) -> UInt8[np.ndarray, "h w 3"]:
    first = rows[0][1][0]
    height = round(width * first.shape[0] / first.shape[1])
    size = len(headings) * (width + GAP) + GAP, LABEL + len(rows) * (height + LABEL)
    paper, ink = ((round(255 * value),) * 3 for value in (BACKGROUND, INK))
    sheet = Image.new("RGB", size, paper)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(FONT)

    def text(x: int, baseline: int, line: str) -> None:
        draw.text((x, baseline), line, ink, font, anchor="ls")

    for i, heading in enumerate(headings):
        text(GAP + i * (width + GAP), LABEL - 6, heading)
    for r, (label, pictures) in enumerate(rows):
        top = 2 * LABEL + r * (height + LABEL)
        text(GAP, top - 6, label)
        for i, picture in enumerate(pictures):
            sheet.paste(_fitted(picture, height, width), (GAP + i * (width + GAP), top))
    return np.asarray(sheet)


def _fitted(picture: Picture, height: int, width: int) -> Image.Image:
    pixels = picture if picture.dtype == np.uint8 else to_bytes(picture)
    image = Image.fromarray(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))))
    return image.resize((width, height), Image.Resampling.HAMMING, reducing_gap=3.0)
