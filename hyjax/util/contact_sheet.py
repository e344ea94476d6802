"""Contact sheets: rows of labelled pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.util.images import resize, write_png

BACKGROUND, INK = 0.09, 0.92
GAP, LABEL, FONT = 4, 20, 13
WIDTH = 320
"""Width of a picture on a sheet, in pixels."""


def contact_sheet(
    rows: Sequence[tuple[str, Sequence[Float[np.ndarray, "h w 3"]]]], headings: Sequence[str], width: int = WIDTH
) -> Float[np.ndarray, "h w 3"]:
    """Compose a sheet.

    Args:
        rows: (label above them, display-encoded pictures), as many pictures as headings.
        headings: one for each column.
        width: of each picture on the sheet, in pixels.

    Returns:
        The sheet, display-encoded.
    """
    first = rows[0][1][0]
    height = round(width * first.shape[0] / first.shape[1])
    sheet = np.full(
        (LABEL + len(rows) * (height + LABEL), len(headings) * (width + GAP) + GAP, 3), BACKGROUND, np.float32
    )
    texts = [(GAP + i * (width + GAP), LABEL - 6, heading) for i, heading in enumerate(headings)]
    for r, (label, pictures) in enumerate(rows):
        top = 2 * LABEL + r * (height + LABEL)
        for i, picture in enumerate(_resized(pictures, height, width)):
            left = GAP + i * (width + GAP)
            sheet[top : top + height, left : left + width] = np.clip(picture, 0, 1)
        texts.append((GAP, top - 6, label))
    return _write_texts(sheet, texts)


def fitted_row(
    pictures: Sequence[Float[np.ndarray, "h w 3"]], width: int = WIDTH
) -> list[Float[np.ndarray, "height width 3"]]:
    """Pictures of a row at their size on the sheet, which take less memory until it is composed."""
    first = pictures[0]
    return list(_resized(pictures, round(width * first.shape[0] / first.shape[1]), width))


def write_contact_sheet(
    path: Path, rows: Sequence[tuple[str, Sequence[Float[np.ndarray, "h w 3"]]]], headings: Sequence[str]
) -> None:
    """Write a `contact_sheet` into a PNG."""
    write_png(path, contact_sheet(rows, headings))


def _resized(
    pictures: Sequence[Float[np.ndarray, "h w 3"]], height: int, width: int
) -> Sequence[Float[np.ndarray, "height width 3"]]:
    """Pictures of that size; those of one size at once, which takes half the time."""
    if len({picture.shape for picture in pictures}) > 1:
        return [resize(picture, height, width) for picture in pictures]
    return np.split(resize(np.concatenate(pictures, axis=-1), height, width), len(pictures), axis=-1)


def _write_texts(
    sheet: Float[np.ndarray, "h w 3"], texts: list[tuple[int, int, str]]
) -> Float[np.ndarray, "h w 3"]:
    import OpenImageIO as oiio  # here: see `hyjax.util.images`

    buffer = oiio.ImageBuf(np.ascontiguousarray(sheet))
    for x, y, text in texts:
        # An OpenImageIO built without fonts leaves the sheet unlabelled, which is no reason to lose the sheet.
        if not oiio.ImageBufAlgo.render_text(buffer, x, y, text, FONT, "", (INK, INK, INK)):
            break
    return np.asarray(buffer.get_pixels(oiio.FLOAT))
