"""What a tuning run found, in words and cells: shared by the table, the plots and the page."""

import dataclasses
import math

import numpy as np

from hyjax.core.schedule import Schedule
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Tuned

MISSING = "–"


def candidates(tuned: Tuned) -> list[tuple[str, Candidate]]:
    """("tuned" or "baseline", candidate) for everything known, each once, by time within its kind.

    A schedule that is both on the front and best for a budget is listed as the latter.
    """
    own = {candidate.schedule.to_json(): candidate for candidate in tuned.best}
    best = {_content(candidate.schedule) for candidate in tuned.best}
    own |= {_content(c.schedule): c for c in tuned.front if _content(c.schedule) not in best}
    baselines = {candidate.schedule.to_json(): candidate for candidate in tuned.baselines}
    ordered = [("tuned", candidate) for candidate in sorted(own.values(), key=_order)]
    return ordered + [("baseline", candidate) for candidate in sorted(baselines.values(), key=_order)]


def on_front(tuned: Tuned, candidate: Candidate) -> bool:
    """Whether a schedule is on the front, under whatever name."""
    return _content(candidate.schedule) in {_content(other.schedule) for other in tuned.front}


def _content(schedule: Schedule) -> str:
    return dataclasses.replace(schedule, name="custom").to_json()


def _order(candidate: Candidate) -> float:
    return time_of(candidate).median


def time_of(candidate: Candidate) -> Milliseconds:
    """Measured if it was, predicted if not."""
    return candidate.measured or candidate.predicted


def best_for(tuned: Tuned, candidate: Candidate) -> list[str]:
    """Labels of the budgets that a candidate is the best for."""
    own = candidate.schedule.to_json()
    return [b.label for b, best in zip(tuned.budgets, tuned.best, strict=True) if best.schedule.to_json() == own]


def kind_of_baseline(candidate: Candidate) -> str:
    """Whose schedule a baseline is: "preset" (ours), "paper" or "naive"."""
    kinds = {"hyjax": "preset", "naive": "naive"}
    return next((kind for start, kind in kinds.items() if candidate.name.startswith(start)), "paper")


def steps_text(schedule: Schedule) -> str:
    """Factors and numbers of steps: `16:5 8:10 4:15 2:20`."""
    return " ".join(f"{level.factor}:{level.steps}" for level in schedule.levels)


def kappa_text(schedule: Schedule) -> str:
    """κ of each level."""
    return " ".join(f"{float(np.asarray(level.kappa)):.6g}" for level in schedule.levels)


def fidelity_text(schedule: Schedule) -> str:
    """α of each level, or `-` for one without."""
    values = (level.fidelity for level in schedule.levels)
    return " ".join("-" if alpha is None else f"{float(np.asarray(alpha)):.6g}" for alpha in values)


def lam_text(schedule: Schedule) -> str:
    """λ of each level: one number, or one for each step with slashes between, or `-` for a level without steps."""
    texts = []
    for level in schedule.levels:
        values = [f"{value:.6g}" for value in np.asarray(level.step_sizes)]
        texts.append("-" if not values else values[0] if len(set(values)) == 1 else "/".join(values))
    return " ".join(texts)


def milliseconds(value: float | None) -> str:
    """A time with as many decimals as can be believed."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{value:.2f}" if value >= 1 else f"{value:.3f}"


def number(value: float | None, form: str) -> str:
    """A number, or a dash where there is none."""
    return MISSING if value is None or not math.isfinite(value) else format(value, form)


def budget_text(budget: Budget) -> str:
    """`60 fps = 16.67 ms`, or the label alone where it is the time."""
    time = (
        f"{budget.milliseconds:.4g} ms"
        if budget.milliseconds < 1
        else f"{budget.milliseconds:.2f}".rstrip("0").rstrip(".") + " ms"
    )
    return budget.label if budget.slug == time.replace(" ", "") else f"{budget.label} = {time}"


def rival(tuned: Tuned, budget: Budget, best: Candidate) -> Candidate | None:
    """The baseline to compare with: the best of those that fit the budget, or else the fastest."""
    known = [c for c in tuned.baselines if loss_of(c, best) is not None]
    fitting = [c for c in known if time_of(c).p95 <= budget.milliseconds]
    if fitting:
        return min(fitting, key=lambda c: loss_of(c, best) or 0.0)
    return min(known, key=_order, default=None)


def loss_of(candidate: Candidate, beside: Candidate) -> float | None:
    """A candidate's loss on the frames that `beside` can be compared on: held-out ones if both have them."""
    both = candidate.held_out is not None and beside.held_out is not None
    scores = candidate.held_out if both else candidate.tuning
    return None if scores is None or not math.isfinite(scores.loss) else scores.loss


def summary(tuned: Tuned) -> list[str]:
    """One sentence for each budget: what fits it, how long it takes, and what it is worth against the paper's.

    And one more if a much faster schedule is nearly as good, which is worth knowing before a budget is spent.
    """
    sentences = [sentence(tuned, budget, best) for budget, best in zip(tuned.budgets, tuned.best, strict=True)]
    return sentences + bargain(tuned) + jointly(tuned)


def jointly(tuned: Tuned) -> list[str]:
    """What tuning the guide's last layer with the schedule has brought, if it was asked for."""
    record = tuned.record.get("joint")
    if record is None:
        return []
    before, after = record.get("held out", record["tuning"])
    frames = "held-out" if "held out" in record else "tuning"
    return [
        f"With the guide's last layer tuned too (guide.safetensors and joint.json): loss "
        f"{number(before['loss'], '.4g')} before, {number(after['loss'], '.4g')} after ({frames} frames), "
        f"{milliseconds(record['measured']['median'])} ms."
    ]


def bargain(tuned: Tuned) -> list[str]:
    """The fastest schedule within 1 % of the main result's loss, if it takes less than two thirds of its time."""
    best = tuned.best[0]
    if best.tuning is None:
        return []
    for cheap in tuned.front:
        if cheap.tuning is None or cheap.tuning.loss > 1.01 * best.tuning.loss:
            continue
        ours, theirs = time_of(cheap).median, time_of(best).median
        more = 100.0 * (cheap.tuning.loss / best.tuning.loss - 1.0)
        if 1.5 * ours < theirs:
            return [
                f"A bargain: {cheap.name} ({steps_text(cheap.schedule)}) takes {milliseconds(ours)} ms, "
                f"{theirs / ours:.1f} times less, for {max(more, 0.0):.1f} % more loss (tuning frames)."
            ]
    return []


def sentence(tuned: Tuned, budget: Budget, best: Candidate) -> str:
    """As `summary`, for one budget."""
    text = f"{budget_text(budget)}: schedule {steps_text(best.schedule)}"
    if best.measured is not None:
        text += (
            f", measured median {milliseconds(best.measured.median)} ms, p95 {milliseconds(best.measured.p95)} ms"
        )
    elif device := tuned.record.get("searched on") and tuned.record.get("device"):
        time = best.predicted
        text += (
            f", for {device} predicted, not timed: median {milliseconds(time.median)} ms, "
            f"p95 {milliseconds(time.p95)} ms"
        )
    other = rival(tuned, budget, best)
    against = None if other is None else loss_of(other, best)
    if other is None or against is None:
        own = loss_of(best, best)
        return text + ("." if own is None else f"; loss {own:.4g}.")
    own = loss_of(best, other)
    usual = milliseconds(time_of(other).median)
    late = "" if time_of(other).p95 <= budget.milliseconds else ", which does not fit"
    frames = "held-out" if best.held_out is not None and other.held_out is not None else "tuning"
    return text + (
        f"; loss {number(own, '.4g')} against {against:.4g} of {other.name} at {usual} ms{late} ({frames} frames)."
    )
