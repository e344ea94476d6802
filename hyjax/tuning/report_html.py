"""Page of a tuning run: what the template `report.html.jinja` shows."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jaxtyping import ArrayLike

from hyjax.metrics import plain_metrics
from hyjax.tuning import report_text as text
from hyjax.tuning.report_axes import svg
from hyjax.tuning.report_pictures import Example, data_uris, pair_to_compare
from hyjax.tuning.report_plots import draw_history, draw_latency, draw_pareto
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Tuned

UNKNOWN = Milliseconds(math.nan, math.nan)


def templates(*folders: Path) -> jinja2.Environment:
    """Templates of folders, which escape everything that is not markup already."""
    loader = jinja2.FileSystemLoader(folders)
    return jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )


def page(tuned: Tuned, examples: Sequence[Example]) -> str:
    """The whole page as one HTML text, which needs nothing else."""
    rows = []
    for kind, candidate in text.candidates(tuned):
        labels = text.best_for(tuned, candidate) if kind == "tuned" else []
        rows.append((kind if kind == "tuned" else text.kind_of_baseline(candidate), labels, candidate))
    timed = [(c, _error(c.predicted, c.measured)) for _, _, c in rows if c.measured]
    errors = np.abs([error for _, error in timed] or [0.0])
    plots = {
        "pareto": svg(draw_pareto(tuned), "pareto", "Time against quality"),
        "history": svg(draw_history(tuned), "history", "Loss of the best so far against seconds"),
        "latency": svg(draw_latency(tuned), "latency", "Predicted against measured") if timed else "",
    }
    metrics, environment = plain_metrics(), templates(Path(__file__).parent)
    environment.globals |= {function.__name__.strip("_"): function for function in FUNCTIONS}
    return environment.get_template("report.html.jinja").render(
        tuned=tuned,
        found=list(zip(tuned.budgets, tuned.best, strict=True)),
        lead=[text.sentence(tuned, budget, best) for budget, best in zip(tuned.budgets, tuned.best, strict=True)],
        rows=rows,
        best_first=sorted(rows, key=lambda row: not row[1]),
        timed=timed,
        errors={"median": float(np.median(errors)), "worst": float(errors.max())},
        table_facts=_flat(tuned.record.get("latency")),
        examples=[(e, uris, pair_to_compare(list(uris))) for e, uris in zip(examples, data_uris(examples))],
        plots=plots,
        machine=machine(tuned.record),
        record=json.dumps(tuned.record, indent=2, ensure_ascii=False, default=str),
        unknown=UNKNOWN,
        score_labels=["loss", *(metric.label for metric in metrics.values())],
        score_forms={"loss": "#.3g"} | {name: f".{metric.digits}f" for name, metric in metrics.items()},
        missing=text.MISSING,
    )


def _error(predicted: Milliseconds, measured: Milliseconds) -> float:
    return predicted.median / measured.median - 1 if measured.median else math.nan


def machine(record: Mapping[str, Any]) -> str:
    """Device and version of jax, of a run's record."""
    versions = record.get("versions")
    jax = f"jax {versions['jax']}" if isinstance(versions, dict) and "jax" in versions else ""
    return ", ".join(str(part) for part in (record.get("device", ""), jax) if part)


def _gain(tuned: Tuned, budget: Budget, best: Candidate) -> list[tuple[str, str]]:
    """Loss relative to the baseline to compare with, if there is one."""
    other = text.rival(tuned, budget, best)
    if other is None:
        return []
    own, against = text.loss_of(best, other), text.loss_of(other, best)
    if own is None or not against:
        return []
    return [(f"loss against {other.name}", signed_percent(own / against - 1))]


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100 * share:.1f}%"


def signed_percent(share: float, digits: int = 0) -> str:
    """A change in percent, with its sign."""
    return f"{100 * share:+.{digits}f}%".replace("-", "−") if math.isfinite(share) else text.MISSING


def _flat(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Names and values of nested JSON, one line each."""
    if isinstance(value, dict):
        return [item for key, inner in value.items() for item in _flat(inner, f"{name} {key}".strip())]
    if value is None:
        return []
    if isinstance(value, float):
        return [(name.replace("_", " "), f"{value:.4g}")]
    return [(name.replace("_", " "), value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]


def _floats(values: ArrayLike) -> list[float]:
    return np.asarray(values, float).tolist()


FUNCTIONS = (
    *(text.budget_text, text.milliseconds, text.number, text.steps_text),
    *(_floats, _gain, percent, signed_percent),
)
"""Functions that the template calls, by their names."""
