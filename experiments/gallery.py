"""Pictures of the documentation, each from the output of one command.

    python -m experiments.gallery pareto                        # from the rows that are kept
    python -m experiments.gallery contact_sheet --source out    # from what the picture's command has written there

`PICTURES` has the command of each. What is committed is cut out of it and made smaller, in `experiments/figures`.
Takes seconds, and the tour's a minute, which needs chromium and playwright; the real captures' takes some minutes
and needs their data.

Expect: the picture under its name; look at it before it is committed.
"""

import dataclasses
import functools
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from PIL import Image

from experiments.blocks import DPI, Plot
from experiments.command import run
from experiments.real_captures import real_captures
from experiments.records import ROOT
from experiments.tables import KEPT_FOLDER, experiment_of, kept_rows
from experiments.tour_picture import tour_picture
from hyjax.util.contact_sheet import GAP, LABEL
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.files import atomic_write

FIGURES = ROOT / "experiments" / "figures"
QUALITY = 88
"""Quality of JPEG."""
SHEET_WIDTH = 320
"""Width of a picture on a contact sheet."""
Pixels = np.ndarray[Any, np.dtype[np.uint8]]


@dataclasses.dataclass(frozen=True)
class Cells:
    """Cells of a contact sheet.

    Attributes:
        file: in the command's folder.
        rows: which rows, from 0; all if empty.
        columns: which columns, from 0; all if empty.
        height: of its pictures, in pixels.
    """

    file: str
    rows: tuple[int, ...] = ()
    columns: tuple[int, ...] = ()
    height: int = 320


@dataclasses.dataclass(frozen=True)
class Committed:
    """A picture that is committed.

    Attributes:
        command: that writes what it is made from.
        source: cells of contact sheets, stacked; or a function that makes the whole.
        width: in pixels.
    """

    command: str
    source: tuple[Cells, ...] | Callable[[], Pixels]
    width: int = 1600


def kept_plot(name: str) -> Pixels:
    """The figure of an experiment that has one, from its kept rows."""
    rows = kept_rows(KEPT_FOLDER / f"{name}.jsonl")
    (plot,) = (block for block in experiment_of(rows).blocks(rows, KEPT_FOLDER) if isinstance(block, Plot))
    stream = io.BytesIO()
    plot.figure.savefig(stream, format="png", dpi=DPI)
    return pixels(stream)


TRUTH = (0, 1, 2, 4)
"""Photo, hyjax 0.1, relit, truth."""
PICTURES: dict[str, Committed] = {
    "truth.jpg": Committed(
        "python -m experiments.truth --frames 2 --rooms random-5-7-day random-5-2-both random-23-1-lamps builtin-3",
        (Cells("builtin-3.png", (0, 2), TRUTH, 240), Cells("random-5-7-day.png", (0,), TRUTH, 240)),
        1300,
    ),
    "contact_sheet.jpg": Committed(
        "hyjax relight --frames 0:24:8 --lights evening-lamps --out out", (Cells("contact_sheet.png"),), 1500
    ),
    "tour.jpg": Committed("python -m experiments.gallery tour", tour_picture, 1800),
    "real_captures.jpg": Committed("python -m experiments.gallery real_captures", real_captures, 1600),
    "pareto.png": Committed(
        "python -m experiments.gallery pareto", functools.partial(kept_plot, "frame_tuning"), 900
    ),
    "number_search.png": Committed(
        "python -m experiments.gallery number_search", functools.partial(kept_plot, "number_search"), 900
    ),
    "space_race.png": Committed(
        "python -m experiments.gallery space_race", functools.partial(kept_plot, "space_race"), 1100
    ),
    "conductances.jpg": Committed("python -m experiments.conductances", (Cells("conductances.png"),), 1300),
    "structure.jpg": Committed("python -m experiments.structure", (Cells("structure.png"),)),
    "shadow_pass.jpg": Committed(
        "python -m experiments.paper --parts shadow", (Cells("shadow.png", (4, 5)),), 1700
    ),
}
"""File → how it is made."""


@dataclasses.dataclass(frozen=True)
class Config:
    name: Annotated[str, tyro.conf.Positional]
    """Of the picture, with or without its ending."""
    source: Path | None = None
    """Folder that its command has written, where it is not made by this one."""


def main(config: Config) -> None:
    """Make one picture.

    Raises:
        InputError: no such picture, or its command has not left what it is made from.
    """
    files = {Path(file).stem: file for file in PICTURES}
    file = files.get(Path(config.name).stem)
    if file is None:
        hint = did_you_mean(config.name, tuple(files))
        raise InputError(f"name: no picture {config.name!r}{hint}; there are {', '.join(files)}")
    picture = PICTURES[file]
    if callable(picture.source):
        made = picture.source()
    elif config.source is None:
        raise InputError(f"source: give the folder that this has written: {picture.command}")
    else:
        made = stacked([cells_of(config.source, cells) for cells in picture.source])
    write_figure(FIGURES / file, made, picture.width)
    print(f"look at {FIGURES / file}")


def cells_of(folder: Path, cells: Cells) -> Pixels:
    """Some rows and columns of a sheet, with the names above them.

    Raises:
        InputError: no such picture.
    """
    path = folder / cells.file
    if not path.is_file():
        raise InputError(f"{path}: no such picture; run the command again that makes it")
    return cut(pixels(path), cells)


def cut(sheet: Pixels, cells: Cells) -> Pixels:
    """Rows and columns of a contact sheet, as `hyjax.util.contact_sheet` lays them out."""
    step, deep = SHEET_WIDTH + GAP, cells.height + LABEL
    columns = cells.columns or range((sheet.shape[1] - GAP) // step)
    across = np.concatenate([*(sheet[:, i * step : (i + 1) * step] for i in columns), sheet[:, -GAP:]], axis=1)
    if not cells.rows:
        return across
    down = [across[LABEL + i * deep : LABEL + (i + 1) * deep] for i in cells.rows]
    return np.concatenate([across[:LABEL], *down])


def stacked(parts: Sequence[Pixels]) -> Pixels:
    """Cuts of several sheets below each other, the headings once."""
    return np.concatenate([parts[0], *(part[LABEL:] for part in parts[1:])])


def pixels(source: Path | io.BytesIO) -> Pixels:
    """A picture's bytes, (h, w, 3)."""
    return np.asarray(Image.open(source).convert("RGB"))


def write_figure(path: Path, made: Pixels, width: int) -> None:
    """Write a picture, at most so wide, in the format of its name's ending."""
    picture = Image.fromarray(made)
    if picture.width > width:
        picture = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
    options = {"quality": QUALITY, "optimize": True} if path.suffix == ".jpg" else {"optimize": True}
    with atomic_write(path) as temporary:
        picture.save(temporary, format="JPEG" if path.suffix == ".jpg" else "PNG", **options)


if __name__ == "__main__":
    run(main)
