"""Blocks of a report: text, tables, figures and pictures; Markdown for the terminal, HTML for the page."""

import dataclasses
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from hyjax.tuning.report_page import data_uri
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, write_text
from hyjax.util.images import read_image
from hyjax.util.templates import templates

DPI = 120
SVG = {"Date": None, "Creator": None, "Format": None, "Type": None}
"""No metadata: the page says where its rows come from."""


@dataclasses.dataclass(frozen=True)
class Table:
    """A table. Numbers are formatted by whoever makes it, and set to the right.

    Attributes:
        caption: what it shows, in a sentence.
        header: names of the columns.
        rows: texts, as many as columns.
        names: how many columns at the left are no numbers.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    names: int = 1


@dataclasses.dataclass(frozen=True)
class Plot:
    """A figure drawn from rows.

    Attributes:
        name: of its file, without extension.
        caption: what it shows, in a sentence.
        figure: as drawn.
    """

    name: str
    caption: str
    figure: Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """Picture file in the folder of a run's rows, which name it.

    Attributes:
        path: PNG file.
        caption: what it shows, in a sentence.
    """

    path: Path
    caption: str


Block = str | Table | Plot | Picture


def markdown(blocks: Iterable[Block]) -> str:
    """Texts and tables; figures and pictures by their captions."""
    parts = []
    for block in blocks:
        if isinstance(block, str):
            parts.append(block)
        elif isinstance(block, Table):
            right = len(block.header) - block.names
            lines = [_line(block.header), "|---" * block.names + "|---:" * right + "|"]
            parts += [block.caption, "\n".join([*lines, *map(_line, block.rows)])]
        elif isinstance(block, Plot):
            parts.append(f"{block.name}.png: {block.caption}")
        else:
            parts.append(f"{block.path.name}: {block.caption}")
    return "\n\n".join(parts)


def html(blocks: Iterable[Block]) -> list[Markup]:
    """The same for a page of one file: figures are vector graphics, pictures are packed in."""
    macros: Any = templates(Path(__file__).parent).get_template("blocks.html.jinja").module
    return [_html(block, macros) for block in blocks]


def write_blocks(out: Path, name: str, blocks: Sequence[Block]) -> None:
    """Print texts and tables, and leave them as `name`.md in `out` with the figures as PNG files."""
    text = markdown(blocks)
    print(text)
    write_text(out / f"{name}.md", text + "\n")
    for block in blocks:
        if isinstance(block, Plot):
            with atomic_write(out / f"{block.name}.png") as temporary:
                block.figure.savefig(temporary, dpi=DPI)


def _line(cells: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _html(block: Block, macros: Any) -> Markup:
    if isinstance(block, str):
        return macros.text(block)
    if isinstance(block, Table):
        return macros.table(block)
    if isinstance(block, Plot):
        stream = io.StringIO()
        with rc_context({"svg.hashsalt": "hyjax"}):  # the same page from the same rows
            block.figure.savefig(stream, format="svg", metadata=SVG)
        return macros.plot(block, Markup(stream.getvalue()[stream.getvalue().index("<svg") :]))
    try:
        return macros.picture(block, data_uri(read_image(block.path)[..., :3]), "")
    except InputError as error:
        return macros.picture(block, "", error)
