"""Page of a tuning run, from the template `frame.html.jinja`."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from hyjax.configuration import Configuration
from hyjax.metrics import plain_metrics
from hyjax.tuning.frame import report_text as text
from hyjax.tuning.frame.report_plots import draw_effects, draw_front_plot
from hyjax.tuning.frame.result import Tuned
from hyjax.tuning.report_axes import svg
from hyjax.tuning.report_pictures import Example, data_uris, pair_to_compare


def templates(*folders: Path) -> jinja2.Environment:
    """Templates of folders, which escape everything that is not markup already."""
    loader = jinja2.FileSystemLoader(folders)
    return jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )


def machine(record: Mapping[str, Any]) -> str:
    """Device and version of jax, of a run's record."""
    versions = record.get("versions")
    jax = f"jax {versions['jax']}" if isinstance(versions, dict) and "jax" in versions else ""
    return ", ".join(str(part) for part in (record.get("device", ""), jax) if part)


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100 * share:.1f}%"


def signed_percent(share: float, digits: int = 0) -> str:
    """A change in percent, with its sign."""
    return f"{100 * share:+.{digits}f}%".replace("-", "−") if math.isfinite(share) else text.MISSING


def score_forms() -> dict[str, tuple[str, str]]:
    """Heading and number format of each score that the page shows."""
    metrics = {name: (metric.label, f".{metric.digits}f") for name, metric in plain_metrics().items()}
    return {"relative": ("loss over the default's", ".3f")} | metrics


def page(tuned: Tuned, examples: Sequence[Example]) -> str:
    """The whole page as one HTML text, which needs nothing else.

    Args:
        tuned: what was found.
        examples: pictures to look at; may be empty.
    """
    here = Path(__file__).parent
    environment = templates(here, here.parent)
    environment.globals |= {function.__name__: function for function in FUNCTIONS}
    rows = [(kind, text.best_for(tuned, c), c) for kind, c in text.candidates(tuned)]
    plots = {"front": svg(draw_front_plot(tuned), "front", "Time of a frame against loss")}
    if tuned.effects:
        plots["effects"] = svg(draw_effects(tuned.effects), "effects", "Change of time against change of loss")
    default = next((trial.choices for trial in tuned.trials if trial.phase == "default"), None)
    return environment.get_template("frame.html.jinja").render(
        tuned=tuned,
        heading="Tuned configurations" if tuned.stage == "frame" else "Tuned schedules",
        lead=text.summary(tuned),
        machine=machine(tuned.record),
        found=list(zip(tuned.budgets, tuned.best, strict=True)),
        rows=rows,
        trials=[(text.choices_text(trial.choices, default), trial) for trial in tuned.trials],
        examples=[(e, uris, pair_to_compare(list(uris))) for e, uris in zip(examples, data_uris(examples))],
        plots=plots,
        scores=score_forms(),
        usual_choices=text.described(Configuration()),
        missing=text.MISSING,
        record=json.dumps(tuned.record, indent=2, ensure_ascii=False, default=str),
    )


FUNCTIONS = (
    *(text.budget_text, text.milliseconds, percent, signed_percent),
    *(text.configuration_text, text.described, text.missed, text.score_text, text.value_text),
)
"""Functions that the template calls, by their names."""
