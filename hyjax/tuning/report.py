"""Files that a tuning run leaves: configurations or schedules, a table, a plot, a contact sheet and a page."""

import csv
import io
import re
from pathlib import Path

from hyjax.configuration import Configuration
from hyjax.metrics import plain_metrics
from hyjax.tuning.report_page import contact_sheet_rows, page
from hyjax.tuning.report_text import best_for, candidates, choices_text, configuration_text, on_front, summary
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.settings import BudgetStage
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.files import atomic_write, make_writable, remove, write_text

__all__ = ["CSV_COLUMNS", "summary", "write_results"]

STEMS: dict[BudgetStage, str] = {"frame": "configuration", "cascade": "schedule"}
"""Names of the result's files: of a whole configuration, or of the schedule of the diffusion alone."""
REPORT_FILE = "report.html"
CSV_COLUMNS = (
    *("name", "kind", "best_for", "front", "choices", "cases", "relative_loss", "relative_time"),
    *("median_ms", "p95_ms", "judged_p95_ms", "default_ms"),
)
"""Columns of the CSV file; after them `score_columns`."""


def file_stem(text: str, otherwise: str) -> str:
    """Text as the stem of a file's name; `otherwise` if nothing of it is left.

    >>> file_stem("tuned 3.4 ms", "schedule"), file_stem("/", "schedule")
    ('tuned-3.4-ms', 'schedule')
    """
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.") or otherwise


def score_names() -> list[str]:
    """Names of scores: losses, all metrics, and PSNR before gains are fitted."""
    return ["relative", "loss", *plain_metrics(), "lpips", "psnr_raw"]


def score_columns() -> list[str]:
    """Scores on the tuning and on the held-out frames, such as `held_out_psnr`."""
    return [f"{frames}_{score}" for frames in ("tuning", "held_out") for score in score_names()]


def write_results(out: Path, tuned: Tuned) -> None:
    """Write all files of a run.

    `configuration.json` is for the first budget; with several there is `configuration-60fps.json` and so on as
    well. `front` has a configuration for each point of the front, `pareto.csv` a row for each candidate and trial.
    Of the diffusion alone they are schedules: `schedule.json`.
    """
    from hyjax.tuning.report_plots import draw_front_plot  # Matplotlib is an extra's

    write_configurations(out, tuned)
    write_front(out / "front", tuned)
    write_pareto_csv(out / "pareto.csv", tuned)
    figure = draw_front_plot(tuned)
    with atomic_write(out / "pareto.png") as temporary:
        figure.savefig(temporary, dpi=200)
    if tuned.examples:
        write_contact_sheet(out / "contact_sheet.png", *contact_sheet_rows(tuned.examples))
    write_text(out / REPORT_FILE, page(tuned, tuned.examples))


def best_file(stage: BudgetStage) -> str:
    """Name of the file with the best for the first budget."""
    return f"{STEMS[stage]}.json"


def text_of(configuration: Configuration, stage: BudgetStage) -> str:
    """Content of a file: the configuration, or its schedule of the diffusion."""
    return (configuration if stage == "frame" else configuration.schedule).to_json() + "\n"


def write_configurations(out: Path, tuned: Tuned) -> list[Path]:
    """Write the configuration for each budget.

    Returns:
        The files, that for the first budget first.
    """
    stage, stem = tuned.stage, STEMS[tuned.stage]
    texts = {best_file(stage): text_of(tuned.configuration, stage)}
    if len(tuned.budgets) > 1:
        for budget, best in zip(tuned.budgets, tuned.best, strict=True):
            name = _free(f"{stem}-{file_stem(budget.slug, stem)}", texts)
            texts[name] = text_of(best.configuration, stage)
    for name, text in texts.items():
        write_text(out / name, text)
    return [out / name for name in texts]


def write_front(folder: Path, tuned: Tuned) -> None:
    """Write the configurations of the front, by name, into a folder of their own; beaten ones are removed."""
    texts: dict[str, str] = {}
    for candidate in tuned.front:
        name = _free(file_stem(candidate.name, STEMS[tuned.stage]), texts)
        texts[name] = text_of(candidate.configuration, tuned.stage)
    make_writable(folder)
    for path in folder.glob("*.json"):
        if path.name not in texts:
            remove(path)
    for name, text in texts.items():
        write_text(folder / name, text)


def _free(stem: str, taken: dict[str, str]) -> str:
    """Name of a file that is free, on case-insensitive systems too."""
    lower = {name.lower() for name in taken}
    names = (f"{stem}{end}.json" for end in ("", *(f"-{n}" for n in range(2, len(taken) + 3))))
    return next(name for name in names if name.lower() not in lower)


def write_pareto_csv(path: Path, tuned: Tuned) -> None:
    """Write a row for each candidate, then one for each trial; unknown values are empty.

    Columns are `CSV_COLUMNS` and `score_columns`. Losses of candidates are on all tuning frames, those of trials on
    the first `cases`.
    """
    buffer = io.StringIO()
    table = csv.DictWriter(buffer, [*CSV_COLUMNS, *score_columns()], restval="", lineterminator="\n")
    table.writeheader()
    for kind, candidate in candidates(tuned):
        table.writerow(_candidate_row(tuned, kind, candidate))
    for number, trial in enumerate(tuned.trials):
        row = {"name": f"trial-{number}", "kind": f"trial: {trial.phase}", "choices": choices_text(trial.choices)}
        numbers = {"relative_loss": trial.loss if trial.losses else None, "relative_time": trial.time}
        table.writerow(row | {"cases": len(trial.losses)} | _digits(numbers))
    write_text(path, buffer.getvalue())


def _candidate_row(tuned: Tuned, kind: str, candidate: Candidate) -> dict[str, str]:
    time = candidate.time
    numbers: dict[str, float | None] = {
        "relative_loss": candidate.tuning["relative"],
        "relative_time": time.ratio,
        "median_ms": time.median,
        "p95_ms": time.p95,
        "judged_p95_ms": time.judged,
        "default_ms": time.default,
    }
    for frames, scores in (("tuning", candidate.tuning), ("held_out", candidate.held_out or {})):
        numbers |= {f"{frames}_{name}": scores.get(name) for name in score_names()}
    return {
        "name": candidate.name,
        "kind": kind,
        "best_for": ", ".join(best_for(tuned, candidate)),
        "front": "yes" if on_front(tuned, candidate) else "no",
        "choices": configuration_text(candidate.configuration),
        "cases": str(tuned.record.get("cases", "")),
    } | _digits(numbers)


def _digits(numbers: dict[str, float | None]) -> dict[str, str]:
    return {name: "" if value is None else f"{value:.6g}" for name, value in numbers.items()}
