"""What a report is made of: text, tables, figures and pictures; Markdown for the terminal, HTML for the page."""

import dataclasses
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from hyjax.errors import InputError
from hyjax.files import whole, write_text
from hyjax.images import read_image
from hyjax.tuning.report_markup import Html, tag
from hyjax.tuning.report_pictures import data_uri

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
    """A picture that a run has written beside its rows, and that rows name.

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


def html(blocks: Iterable[Block]) -> list[Html]:
    """The same for a page of one file: figures are vector graphics, pictures are packed in."""
    return [_html(block) for block in blocks]


def write_blocks(out: Path, name: str, blocks: Sequence[Block]) -> None:
    """Print texts and tables, and leave them as `name`.md in `out` with the figures as PNG beside it."""
    text = markdown(blocks)
    print(text)
    write_text(out / f"{name}.md", text + "\n")
    for block in blocks:
        if isinstance(block, Plot):
            with whole(out / f"{block.name}.png") as temporary:
                block.figure.savefig(temporary, dpi=DPI)


def _line(cells: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _html(block: Block) -> Html:
    if isinstance(block, str):
        return tag("p", block)
    if isinstance(block, Table):
        places = [None] * block.names + ["n"] * (len(block.header) - block.names)
        head = tag("tr", [tag("th", text, class_=place) for text, place in zip(block.header, places)])
        body = [tag("tr", [tag("td", text, class_=p) for text, p in zip(row, places)]) for row in block.rows]
        table = tag("table", tag("thead", head), tag("tbody", body))
        return tag("figure", tag("figcaption", block.caption), tag("div", table, class_="wide"))
    if isinstance(block, Plot):
        stream = io.StringIO()
        with rc_context({"svg.hashsalt": "hyjax"}):  # the same page from the same rows
            block.figure.savefig(stream, format="svg", metadata=SVG)
        shown = Html(stream.getvalue()[stream.getvalue().index("<svg") :])
        return tag("figure", tag("div", shown, class_="plot"), tag("figcaption", block.caption))
    return tag("figure", _packed(block), tag("figcaption", block.caption))


def _packed(picture: Picture) -> Html:
    try:
        image = read_image(picture.path)
    except InputError as error:
        return tag("p", f"The picture is missing: {error}", class_="quiet")
    return tag("img", src=data_uri(image[..., :3]), alt=picture.caption)
