"""The files that a tuning run leaves: schedules, a table, a plot and a page to show."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from hyjax.metrics import plain_metrics
from hyjax.tuning.report_files import file_stem, write_folder
from hyjax.tuning.report_html import page
from hyjax.tuning.report_pictures import Example, contact_sheet_rows
from hyjax.tuning.report_plots import draw_pareto
from hyjax.tuning.report_text import (
    best_for,
    candidates,
    fidelity_text,
    kappa_text,
    lam_text,
    steps_text,
    summary,
)
from hyjax.tuning.result import Milliseconds, Scores, Tuned
from hyjax.util.files import atomic_write, write_text

__all__ = [
    "CSV_COLUMNS",
    "Example",
    "contact_sheet_rows",
    "draw_pareto",
    "summary",
    "write_front",
    "write_pareto_csv",
    "write_pareto_plot",
    "write_report",
    "write_schedules",
]

CSV_COLUMNS = (
    *("name", "kind", "best_for", "schedule", "pooling", "upsampling", "norm", "kappa", "lam", "fidelity"),
    *("predicted_median_ms", "predicted_p95_ms", "measured_median_ms", "measured_p95_ms"),
)
"""Columns of the CSV file; after them `score_columns`."""


def write_schedules(out: Path, tuned: Tuned) -> list[Path]:
    """Write `schedule.json`, for the first budget; with several budgets also `schedule-60fps.json` and so on.

    Args:
        out: a folder that is there.
        tuned: what was found.

    Returns:
        The files, `schedule.json` first.

    Raises:
        InputError: a file cannot be written.
    """
    texts = {"schedule.json": tuned.schedule.to_json()}
    if len(tuned.budgets) > 1:
        for budget, best in zip(tuned.budgets, tuned.best, strict=True):
            slug = file_stem(budget.slug, "schedule")
            name, count = f"schedule-{slug}.json", 2
            while name in texts:
                name, count = f"schedule-{slug}-{count}.json", count + 1
            texts[name] = best.schedule.to_json()
    for name, text in texts.items():
        write_text(out / name, text + "\n")
    return [out / name for name in texts]


def write_front(folder: Path, tuned: Tuned) -> None:
    """Write the schedules of the front as `tuned-3.41ms.json` and so on, into a folder of their own.

    Raises:
        InputError: a file cannot be written.
    """
    texts = {f"{file_stem(c.name, 'schedule')}.json": c.schedule.to_json() + "\n" for c in tuned.front}
    write_folder(folder, texts, "tuned-*.json")  # what is left was beaten since


def write_pareto_csv(path: Path, tuned: Tuned) -> None:
    """Write a row for each candidate: the front, the best for each budget, the baselines, each once.

    Columns are `CSV_COLUMNS` and `score_columns`: `schedule` is factor:steps of each level, coarse to fine;
    `kappa`, `lam` and `fidelity` have one entry for each level, and a level's λ are joined by `/` where its steps
    differ. What is not known is empty.

    Raises:
        InputError: the file cannot be written.
    """
    buffer = io.StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow([*CSV_COLUMNS, *score_columns()])
    for kind, candidate in candidates(tuned):
        schedule = candidate.schedule
        table.writerow(
            [
                *(candidate.name, kind, ", ".join(best_for(tuned, candidate)) if kind == "tuned" else ""),
                *(steps_text(schedule), schedule.pooling, schedule.upsampling, schedule.norm),
                *(kappa_text(schedule), lam_text(schedule), fidelity_text(schedule)),
                *(*_times(candidate.predicted), *_times(candidate.measured)),
                *(*_scores(candidate.tuning), *_scores(candidate.held_out)),
            ]
        )
    write_text(path, buffer.getvalue())


def _times(time: Milliseconds | None) -> list[str]:
    return ["", ""] if time is None else [f"{time.median:.6g}", f"{time.p95:.6g}"]


def score_columns() -> list[str]:
    """Loss and metrics on the tuning and on the held-out frames, such as `held_out_psnr_db`."""
    names = ["loss", *(metric.column for metric in plain_metrics().values())]
    return [f"{frames}_{name}" for frames in ("tuning", "held_out") for name in names]


def _scores(scores: Scores | None) -> list[str]:
    row = {} if scores is None else scores.row()
    return [f"{row[name]:.6g}" if name in row else "" for name in ("loss", *plain_metrics())]


def write_pareto_plot(path: Path, tuned: Tuned) -> None:
    """Write time against quality as a picture, 1800 pixels wide; the suffix says which kind, PNG or SVG.

    Raises:
        InputError: the file cannot be written.
    """
    figure = draw_pareto(tuned)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=200)


def write_report(path: Path, tuned: Tuned, examples: Sequence[Example]) -> None:
    """Write the whole story as one HTML file of at most 8 MB or so, which needs nothing else and no network.

    Args:
        path: the file.
        tuned: what was found.
        examples: frames to look at; may be empty.

    Raises:
        InputError: the file cannot be written, or there are more examples than fit.
    """
    write_text(path, page(tuned, examples))
