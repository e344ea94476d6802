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
from collections.abc import Iterator
from html import escape as html_escape
from pathlib import Path
from typing import Any

from experiments.blocks import html
from experiments.command import run
from experiments.records import FILE, Row, is_finished, machine, read_rows
from hyjax.errors import InputError
from hyjax.files import make_writable, write_text
from hyjax.tuning.report_markup import Html, join, tag

EXPERIMENTS = (
    "paper_table",
    "paper_difference",
    "beyond",
    "flicker",
    "ablation_cascade",
    "ablation_shadow",
    "structure",
    "conductances",
    "depth_sr",
    "train_through",
    "reference_quality",
    "kinect_registration",
    "kappa_sweep",
    "guide_worth",
    "tuning_gain",
    "tuning_transfer",
    "tuning_promise",
    "tuning_optimum",
    "tuning_race",
    "stage_times",
    "guide_speed",
    "fusion",
    "bench_peers",
    "tour_latency",
)
"""Modules with a `TITLE` and `blocks(rows, folder)`, in the page's order."""

PARAGRAPHS = re.compile(r"\n\n|\n(?=- |[0-9]\. )")
"""What separates paragraphs and items of lists in docstrings."""

STYLE = """
nav { position: static; display: block; columns: 22rem; padding: .9rem 0; }
nav a { display: block; padding: .1rem 0; break-inside: avoid; }
section { border-top: 1px solid var(--grid); margin-top: 2.6rem; }
section:first-child { border: 0; margin: 0; }
section p, section pre { max-width: 62rem; }
pre { margin: .6rem 0; }
details { margin: 0 0 1.2rem; border: 0; padding: 0; } summary { color: var(--quiet); font-size: .9rem; }
figure { margin: 1.6rem 0; }
figcaption { max-width: 62rem; color: var(--quiet); font-size: .9rem; }
.wide { margin-top: .3rem; } .plot, figure > img { margin-bottom: .5rem; }
figure > img { display: block; max-width: 100%; border-radius: .4rem; }
.plot svg { width: auto; min-width: 30rem; max-width: 100%; }
.plot svg { padding: .5rem; background: #fff; border-radius: .4rem; }
@media (max-width: 34rem) { .plot svg { max-width: none; } }
"""


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
    for folder, rows in sorted(((f, r) for f, r in found if r), key=lambda found: _place(*found)):
        if rows[0]["experiment"] not in EXPERIMENTS:
            raise InputError(f"{folder}: rows of an unknown experiment {rows[0]['experiment']!r}")
        yield folder, rows


def page(runs: list[tuple[Path, list[Row]]]) -> str:
    """The whole page."""
    sections = [(f"run-{n}", *_section(folder, rows)) for n, (folder, rows) in enumerate(runs)]
    body = [
        tag("header", tag("p", "hyjax", class_="kicker"), tag("h1", "Experiments")),
        tag("nav", [tag("a", title, href=f"#{key}") for key, title, _ in sections]),
        tag("main", [tag("section", tag("h2", title), content, id=key) for key, title, content in sections]),
    ]
    style = importlib.resources.files("hyjax.tuning").joinpath("report.css").read_text(encoding="utf-8") + STYLE
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", "hyjax experiments"),
        tag("style", Html(style)),
    )
    return "<!doctype html>\n" + tag("html", head, tag("body", body), lang="en")


def _place(folder: Path, rows: list[Row]) -> tuple[int, str]:
    name = rows[0]["experiment"]
    return (EXPERIMENTS.index(name) if name in EXPERIMENTS else len(EXPERIMENTS)), str(folder)


def _section(folder: Path, rows: list[Row]) -> tuple[str, Html]:
    """Title and content of one run: what the module says of itself, its blocks, where the rows come from."""
    module: Any = importlib.import_module(f"experiments.{rows[0]['experiment']}")
    title = module.TITLE if folder.name == rows[0]["experiment"] else f"{module.TITLE}: {folder.name}"
    unfinished = "" if is_finished(rows) else tag("p", tag("strong", "This run did not come to its end."))
    first, *rest = PARAGRAPHS.split(inspect.cleandoc(module.__doc__))
    told = [tag("pre" if text.startswith(" ") else "p", marked(inspect.cleandoc(text))) for text in rest]
    about = [
        tag("p", marked(first), class_="lead"),
        tag("details", tag("summary", "How, and what to expect"), told),
    ]
    try:
        shown = html(module.blocks(rows, folder))
    except Exception as error:  # rows of older code, or damaged: one run must not take the page with it
        shown = [tag("p", f"These rows cannot be shown ({type(error).__name__}: {error}).")]
    return title, join([about, unfinished, shown, footer(rows)])


def marked(text: str) -> Html:
    """A docstring's `code` and *stress* as such."""
    escaped = re.sub(r"`+([^`]+)`+", r"<code>\1</code>", html_escape(text, quote=False))
    return Html(re.sub(r"(?<!\w)\*([^*\n]+)\*(?!\w)", r"<em>\1</em>", escaped))


def footer(rows: list[Row]) -> Html:
    """Where the rows come from."""
    count = len(rows) - is_finished(rows)
    commits = ", ".join(dict.fromkeys(row["commit"][:12] + row["commit"][40:] for row in rows))
    machines = "; ".join(dict.fromkeys(machine(row) for row in rows))
    given = {key: value for key, value in rows[-1]["settings"].items() if value is not None}
    settings = ", ".join(f"{key} {json.dumps(value)}" for key, value in given.items())
    command = f"python -m experiments.{rows[0]['experiment']}"
    return tag("p", f"{command}: {count} rows; commit {commits}; {machines}; settings: {settings}.", class_="quiet")


if __name__ == "__main__":
    run(main, Config)
