"""The pictures of a tuning report: the same frame under the paper's schedule and the tuned one, at equal time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.data.frames import spread
from hyjax.light.color import to_display
from hyjax.tuning.bench import Workbench
from hyjax.tuning.cases import Case, raw_filter, refined_filter
from hyjax.tuning.report import Example, contact_sheet_rows, write_report
from hyjax.tuning.report_text import time_of
from hyjax.tuning.result import Candidate, Tuned
from hyjax.util.contact_sheet import contact_sheet
from hyjax.util.images import write_png

MOST_EXAMPLES = 4


def equal_time(tuned: Tuned) -> tuple[Candidate, Candidate]:
    """A schedule of the paper and the best tuned one that is no slower (the fastest if none is)."""
    paper = next((c for c in tuned.baselines if c.name == "paper-50"), [*tuned.baselines, *tuned.best][0])
    candidates = tuned.front or tuned.best
    within = [c for c in candidates if time_of(c).median <= time_of(paper).median]
    return paper, (within[-1] if within else candidates[0])


def examples(tuned: Tuned, bench: Workbench, indices: Sequence[int]) -> list[Example]:
    """At most four frames: frame, filters and relit pictures, raw, paper's, tuned and target."""
    paper, ours = equal_time(tuned)
    note = ", ".join(f"{c.name} {time_of(c).median:.2f} ms" for c in (paper, ours))
    made = []
    for index in spread(indices, MOST_EXAMPLES):
        case = bench.case(index)
        if case is not None:
            made.append(Example(bench.name(index), _pictures(case, paper, ours), note))
    return made


def _pictures(case: Case, paper: Candidate, ours: Candidate) -> dict[str, Float[np.ndarray, "h w 3"]]:
    filters = {
        "raw": raw_filter(case.shaded),
        paper.name: refined_filter(case, paper.schedule),
        "tuned": refined_filter(case, ours.schedule),
        "target": jnp.where(case.valid[..., None], case.target, 0.0),
    }
    # Filters brighter than white are dimmed, all alike, until their structure shows.
    dim = max(1.0, float(np.percentile(np.asarray(case.target), 98)))
    pictures: dict[str, Any] = {"frame": to_display(case.frame)}
    pictures |= {f"{name} filter": to_display(relight_filter / dim) for name, relight_filter in filters.items()}
    pictures |= {name: to_display(relight_filter * case.frame) for name, relight_filter in filters.items()}
    return {name: np.asarray(picture) for name, picture in pictures.items()}


def write_report_with_pictures(out: Path, tuned: Tuned, bench: Workbench, indices: Sequence[int]) -> None:
    """`report.html` and `contact_sheet.png`."""
    made = examples(tuned, bench, indices)
    if made:
        write_png(out / "contact_sheet.png", contact_sheet(*contact_sheet_rows(made)))
    write_report(out / "report.html", tuned, made)
