"""One page with the tables, figures and pictures of all runs that are found, made from their rows alone.

    python -m experiments.report [--results results] [--out results/report.html]

Takes seconds. Every `rows.jsonl` below the results folder is a run; interrupted ones are shown as far as they got
and say so. The page is a single file with everything in it.

Expect: a section for each run, in the order of `EXPERIMENTS`, with settings, commit and machine at its foot.
"""

import dataclasses
import importlib
import importlib.resources
import inspect
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from experiments import EXPERIMENTS
from experiments.blocks import html
from experiments.command import run
from experiments.records import FILE, Row, is_finished, machine, read_rows
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text
from hyjax.util.templates import templates

PARAGRAPHS = re.compile(r"\n\n|\n(?=- |[0-9]\. )")
"""Separator of paragraphs and items of lists in docstrings."""


@dataclasses.dataclass(frozen=True)
class Config:
    results: Path = Path("results")
    """Folder with the runs."""
    out: Path = Path("results/report.html")


def main(config: Config) -> None:
    """Read all runs and write the page."""
    if not config.results.is_dir():
        raise InputError(f"{config.results}: no such folder; run an experiment first, or give --results")
    runs = list(find_runs(config.results))
    if not runs:
        raise InputError(f"{config.results}: no {FILE} with rows in it or below; run an experiment first")
    make_writable(config.out.parent)
    write_text(config.out, page(runs))
    print(f"{len(runs)} runs; look at {config.out}")


def find_runs(results: Path) -> Iterator[tuple[Path, list[Row]]]:
    """(folder, rows) of every run with rows, in the order of `EXPERIMENTS`, then by folder."""
    found = [(path.parent, read_rows(path)) for path in sorted(results.rglob(FILE))]
    known = []
    for folder, rows in found:
        if rows and rows[0]["experiment"] in EXPERIMENTS:
            known.append((folder, rows))
        elif rows:
            name = rows[0]["experiment"]
            print(f"report: {folder}: left out, as {name!r} is not in EXPERIMENTS", file=sys.stderr)
    yield from sorted(known, key=lambda run: (EXPERIMENTS.index(run[1][0]["experiment"]), str(run[0])))


def page(runs: list[tuple[Path, list[Row]]]) -> str:
    """The whole page."""
    style = importlib.resources.files("hyjax.tuning").joinpath("report.css").read_text(encoding="utf-8")
    template = templates(Path(__file__).parent).get_template("report.html.jinja")
    return template.render(style=Markup(style), runs=[_section(folder, rows) for folder, rows in runs])


def _section(folder: Path, rows: list[Row]) -> dict[str, Any]:
    """One run for the template: the module's description, its blocks, the origin of its rows."""
    module: Any = importlib.import_module(f"experiments.{rows[0]['experiment']}")
    lead, *about = PARAGRAPHS.split(inspect.cleandoc(module.__doc__))
    try:
        blocks = html(module.main.blocks(rows, folder))
    except Exception as error:  # rows of older code, or damaged: one run must not take the page with it
        blocks = html([f"These rows cannot be shown ({type(error).__name__}: {error})."])
    return {
        "title": module.main.title if folder.name == module.main.name else f"{module.main.title}: {folder.name}",
        "lead": marked(lead),
        "about": [(marked(inspect.cleandoc(text)), text.startswith(" ")) for text in about],
        "finished": is_finished(rows),
        "blocks": blocks,
        "origin": origin(rows),
    }


def marked(text: str) -> Markup:
    """A docstring's `code` and *stress* as such."""
    escaped = re.sub(r"`+([^`]+)`+", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"(?<!\w)\*([^*\n]+)\*(?!\w)", r"<em>\1</em>", escaped))


def origin(rows: list[Row]) -> str:
    """Origin of the rows."""
    count = len(rows) - is_finished(rows)
    commits = ", ".join(dict.fromkeys(row["commit"][:12] + row["commit"][40:] for row in rows))
    machines = "; ".join(dict.fromkeys(machine(row) for row in rows))
    options = {key: value for key, value in rows[-1]["settings"].items() if value is not None}
    settings = ", ".join(f"{key} {json.dumps(value)}" for key, value in options.items())
    command = f"python -m experiments.{rows[0]['experiment']}"
    return f"{command}: {count} rows; commit {commits}; {machines}; settings: {settings}."


if __name__ == "__main__":
    run(main)
