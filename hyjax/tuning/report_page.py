"""Page of a tuning run, one file with all its pictures, and its contact sheet."""

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.configuration import Configuration
from hyjax.metrics import plain_metrics
from hyjax.tuning import report_text as text
from hyjax.tuning.result import Tuned
from hyjax.util.errors import InputError
from hyjax.util.images import picture_file, resize
from hyjax.util.templates import templates

MOST_BYTES = 5_500_000  # of pictures in one report; as text they take a third more
# What is tried until it fits: lossless first, then ever smaller.
ENCODINGS = (("png", 1024), ("jpg", 1024), ("jpg", 768), ("jpg", 512), ("jpg", 384), ("jpg", 256), ("jpg", 160))
QUALITY = 90
BLANK_GREY = 0.09


Example = tuple[str, Mapping[str, Float[np.ndarray, "h w 3"]]]
"""Frame under a light set-up, by name, and its display-encoded pictures by heading, in the order they are shown."""


def data_uris(examples: Sequence[Example], most_bytes: int = MOST_BYTES) -> list[dict[str, str]]:
    """Every picture as a `data:` address, by example and heading: as PNG if they fit, else as JPEG."""
    for kind, width in ENCODINGS:
        total, found = 0, []
        for _, pictures in examples:
            files = {heading: _encode(picture, kind, width) for heading, picture in pictures.items()}
            total += sum(len(content) for content in files.values())
            if total > most_bytes:
                break
            found.append({heading: _uri(content, kind) for heading, content in files.items()})
        else:
            return found
    raise InputError(f"report: {len(examples)} examples are too many for one file; show fewer")


def data_uri(picture: Float[np.ndarray, "h w 3"], kind: str = "jpg", width: int = 2048) -> str:
    """One picture as a `data:` address, `png` or `jpg`, no wider than `width`."""
    return _uri(_encode(picture, kind, width), kind)


def _uri(content: bytes, kind: str) -> str:
    return f"data:image/{'png' if kind == 'png' else 'jpeg'};base64,{base64.b64encode(content).decode()}"


def _encode(picture: Float[np.ndarray, "h w 3"], kind: str, width: int) -> bytes:
    pixels = np.clip(np.nan_to_num(np.asarray(picture, dtype=np.float32)), 0.0, 1.0)
    if pixels.shape[1] > width:
        pixels = np.clip(resize(pixels, max(1, round(width * pixels.shape[0] / pixels.shape[1])), width), 0.0, 1.0)
    return picture_file(pixels, "PNG") if kind == "png" else picture_file(pixels, quality=QUALITY, subsampling=0)


def pair_to_compare(headings: Sequence[str]) -> tuple[int, int]:
    """Positions of the two pictures that are compared first: the last "paper…" and "tuned…", else the last two."""
    last = len(headings) - 1
    paper = [i for i, heading in enumerate(headings) if heading.startswith("paper")]
    tuned = [i for i, heading in enumerate(headings) if heading.startswith("tuned")]
    return (paper[-1], tuned[-1]) if paper and tuned else (max(0, last - 1), last)


def contact_sheet_rows(
    examples: Sequence[Example],
) -> tuple[list[tuple[str, list[Float[np.ndarray, "h w 3"]]]], list[str]]:
    """Rows and headings for `write_contact_sheet`; a picture that an example lacks is blank."""
    headings, rows = list(dict.fromkeys(heading for _, pictures in examples for heading in pictures)), []
    for name, pictures in examples:
        blank = np.full_like(next(iter(pictures.values())), BLANK_GREY)
        rows.append((name, [pictures.get(heading, blank) for heading in headings]))
    return rows, headings


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
    return f"{100 * share:+.{digits}f}%".replace("-", "−") if math.isfinite(share) else text.MISSING_MARK


def score_forms(tuned: Tuned) -> dict[str, tuple[str, str]]:
    """Heading and number format of each score that the page shows beside the loss."""
    forms = {name: (metric.label, f".{metric.digits}f") for name, metric in plain_metrics().items()}
    forms |= {"psnr_raw": ("PSNR raw", ".2f"), "lpips": ("LPIPS", ".4f")}
    known = [c.tuning for _, c in text.candidates(tuned)]
    return {name: form for name, form in forms.items() if any(name in own for own in known)}


def page(tuned: Tuned, examples: Sequence[Example]) -> str:
    """The whole page as one HTML text, which needs nothing else."""
    from hyjax.tuning.report_plots import draw_effects, draw_front_plot  # Matplotlib is an extra's
    from hyjax.tuning.report_points import svg

    here = Path(__file__).parent
    environment = templates(here)
    environment.globals |= {function.__name__: function for function in FUNCTIONS}
    rows = [(kind, text.best_for(tuned, c), c) for kind, c in text.candidates(tuned)]
    plots = {"front": svg(draw_front_plot(tuned), "front", "Time of a frame against loss")}
    if tuned.effects:
        plots["effects"] = svg(draw_effects(tuned.effects), "effects", "Change of time against change of loss")
    default = next((trial.choices for trial in tuned.trials if trial.phase == "default"), None)
    return (
        environment.get_template("report.html.jinja")
        .render(
            tuned=tuned,
            heading="Tuned configurations" if tuned.stage == "frame" else "Tuned schedules",
            lead=text.summary(tuned),
            machine=machine(tuned.record),
            found=list(zip(tuned.budgets, tuned.best, strict=True)),
            rows=rows,
            trials=[(text.choices_text(trial.choices, default), trial) for trial in tuned.trials],
            examples=[(e[0], uris, pair_to_compare(list(uris))) for e, uris in zip(examples, data_uris(examples))],
            plots=plots,
            scores=(scores := score_forms(tuned)),
            columns=[label for label, _ in scores.values()],
            judged="held-out" if all(c.held_out for _, _, c in rows) else "tuning",
            usual_choices=text.described(Configuration()),
            missing=text.MISSING_MARK,
            record=json.dumps(tuned.record, indent=2, ensure_ascii=False, default=str),
        )
        .lstrip()
    )


FUNCTIONS = (
    *(text.budget_text, text.milliseconds, percent, signed_percent),
    *(text.configuration_text, text.described, text.missed, text.score_text, text.value_text),
)
"""Functions that the template calls, by their names."""
