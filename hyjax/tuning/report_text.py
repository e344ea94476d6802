"""Results of a tuning run in words and cells: shared by the table, the plots and the page."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hyjax.choices.table import CHOICES
from hyjax.configuration import DEFAULT, Configuration
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Tuned

MISSING_MARK = "–"
UNFINISHED = "unfinished"
"""Entry of the record of a search that is not at its end."""

KINDS = ("tuned", "preset", "paper", "naive")
"""Kinds of candidates, in the order of tables."""


def candidates(tuned: Tuned) -> list[tuple[str, Candidate]]:
    """(kind, candidate) for everything measured, each once, by time within its kind.

    Kinds are `tuned`, `preset` (the default is one), `paper` and `naive`. What is best for a budget is told with
    the name and the time that it has for that.
    """
    found: list[Candidate] = []
    for candidate in (*tuned.best, *tuned.references, *tuned.front):
        if not any(same(candidate, other) for other in found):
            found.append(candidate)
    rows = [(_kind(tuned, candidate), candidate) for candidate in found]
    return sorted(rows, key=lambda row: (KINDS.index(row[0]), row[1].time.median))


def _kind(tuned: Tuned, candidate: Candidate) -> str:
    if not any(same(candidate, other) for other in tuned.references):
        return "tuned"
    return next((kind for kind in ("paper", "naive") if candidate.name.startswith(kind)), "preset")


def same(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are one measured configuration, by any name."""
    return a is b or a.tuning is b.tuning  # the best is timed once more


def best_for(tuned: Tuned, candidate: Candidate) -> list[str]:
    """Labels of the budgets that a candidate is the best for."""
    return [b.label for b, best in zip(tuned.budgets, tuned.best, strict=True) if same(best, candidate)]


def on_front(tuned: Tuned, candidate: Candidate) -> bool:
    """Whether a candidate is on the front."""
    return any(same(candidate, other) for other in tuned.front)


def default_of(tuned: Tuned) -> Candidate | None:
    """The default, as it was measured and judged with the others."""
    return next((c for c in tuned.references if c.name == DEFAULT), None)


def choices_text(choices: Mapping[str, Any], beside: Mapping[str, Any] | None = None) -> str:
    """Choices of a trial: all, or those that differ from another's.

    >>> choices_text({"scale": 2, "kappa": 0.0312345, "views": None}, {"scale": 1, "views": None})
    'scale 2, kappa 0.03123'
    """
    missing = object()
    changes = [
        f"{name} {value_text(value)}"
        for name, value in choices.items()
        if beside is None or beside.get(name, missing) != value
    ]
    return ", ".join(changes) or "the default"


def value_text(value: Any) -> str:
    """A choice's value: `all` for none, `on` and `off`, four digits of a number."""
    if value is None:
        return "all"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def configuration_text(configuration: Configuration) -> str:
    """Choices of a configuration that differ from the default's.

    >>> configuration_text(Configuration()), configuration_text(Configuration(scale=2))
    ('the default', 'scale 2')
    """
    words, default = described(configuration), described(Configuration())
    return ", ".join(f"{name} {text}" for name, text in words.items() if text != default.get(name)) or "the default"


def described(configuration: Configuration) -> dict[str, str]:
    """Active choices of a configuration in words."""
    return {
        CHOICES[name].label or name: _levels(value) if isinstance(value, tuple) else value_text(value)
        for name, value in configuration.values().items()
    }


def _levels(values: Iterable[Any]) -> str:
    """A number for each level, or one if they are alike; a dash for levels without one."""
    texts = ["-" if value is None else f"{value:.4g}" for value in values]
    return " ".join(texts[:1] if len(set(texts)) == 1 else texts)


def summary(tuned: Tuned) -> list[str]:
    """Sentences of the result: one for each budget, missed budgets, times as predicted, what was left out."""
    sentences = unfinished_search(tuned)
    for budget, best in zip(tuned.budgets, tuned.best, strict=True):
        sentences.append(sentence(tuned, budget, best))
        sentences += missed(budget, best)
    sentences += choices_of_best(tuned) + outdone(tuned) + bargain(tuned) + disturbed(tuned)
    return sentences + further_budgets(tuned) + prediction(tuned) + unjudged(tuned) + cut_short(tuned)


def unfinished_search(tuned: Tuned) -> list[str]:
    """Sentence on a search that is not at its end."""
    if not tuned.record.get(UNFINISHED):
        return []
    count = tuned.record["trials"]
    return [
        f"Unfinished, after {count} trial{'s' * (count != 1)}: losses are of a part of the tuning frames, times "
        "are shares of the default's. --resume goes on."
    ]


def choices_of_best(tuned: Tuned) -> list[str]:
    """Sentences on the choices in which the best for each budget differ from the default."""
    words = {best.name: configuration_text(best.configuration) for best in tuned.best}

    def sentence_of(name: str, text: str) -> str:
        name = name if len(words) > 1 else "It"
        if text == "the default":
            return f"{name} is the default: nothing better was found."
        return f"{name} differs from the default in: {text}."

    return [sentence_of(name, text) for name, text in words.items() if name != "default"]


def disturbed(tuned: Tuned) -> list[str]:
    """Sentence on a clock that other work disturbed."""
    times = tuned.record.get("disturbed")
    if not times:
        return []
    return [
        f"Other work disturbed the clock: the default's p95 was {milliseconds(times[0])} ms, and "
        f"{milliseconds(times[1])} in the quieter half of the rounds without waiting for processors. Budgets are "
        "judged by the latter, and by the ratio to the default: they are kept while this machine does nothing else."
    ]


def further_budgets(tuned: Tuned) -> list[str]:
    """Sentence on further times that were searched for."""
    further = tuned.record.get("further budgets")
    if not further:
        return []
    return [
        f"Searched for {len(tuned.budgets)} budget{'s' * (len(tuned.budgets) > 1)} and, to draw the front, for "
        f"{', '.join(f'{share:g}' for share in further)} of the default's time (--no-extra leaves these out)."
    ]


def unjudged(tuned: Tuned) -> list[str]:
    """The choices that were not searched for want of true pictures."""
    names, like = tuned.record.get("not searched"), tuned.record.get("not searched, as in", "default")
    if not names:
        return []
    listed = ", ".join(names)
    return [
        f"Not searched: {listed}, for which {like}'s were taken; only the true pictures of --rooms can judge them."
    ]


def cut_short(tuned: Tuned) -> list[str]:
    """That the time limit has ended the search, or left configurations out, if it has."""
    record, lines = tuned.record, list[str]()
    if record.get("left out"):
        lines.append(f"There was no time to time and judge {', '.join(record['left out'])}.")
    if record.get("time was up"):
        count = record["trials"]
        lines.append(f"The time was up after {count} trial{'s' * (count > 1)}; --resume with more time goes on.")
    return lines


def outdone(tuned: Tuned) -> list[str]:
    """The candidate of the least loss within the first budget, where a far faster one is the result."""
    best, budget = tuned.best[0], tuned.budgets[0]
    within = [c for c in tuned.front if c.time.judged <= budget.milliseconds]
    least = min(within, key=lambda c: c.tuning["relative"], default=best)
    less = 100.0 * (1.0 - least.tuning["relative"] / best.tuning["relative"])
    if less <= 0.0 or same(least, best) or least.time.ratio < best.time.ratio:
        return []
    return [
        f"{least.name} has {less:.1f} % less loss within the budget, for {least.time.ratio / best.time.ratio:.1f} "
        "times the time (tuning frames)."
    ]


def bargain(tuned: Tuned) -> list[str]:
    """The fastest candidate within 1 % of the main result's loss, if it takes less than two thirds of its time."""
    best = tuned.best[0]
    for cheap in tuned.front:
        more = 100.0 * (cheap.tuning["relative"] / best.tuning["relative"] - 1.0)
        if more <= 1.0 and 1.5 * cheap.time.ratio < best.time.ratio and not same(cheap, best):
            return [
                f"A bargain: {cheap.name} ({configuration_text(cheap.configuration)}) takes "
                f"{milliseconds(cheap.time.median)} ms, {best.time.ratio / cheap.time.ratio:.1f} times less, for "
                f"{max(more, 0.0):.1f} % more loss (tuning frames)."
            ]
    return []


def sentence(tuned: Tuned, budget: Budget, best: Candidate) -> str:
    """Sentence of a budget: median, p95, share of the default's time, loss and PSNR against the default's."""
    base = default_of(tuned)
    p95 = f"p95 {milliseconds(best.time.judged)} ms"
    if best.time.judged < best.time.p95:
        p95 += f", of all rounds {milliseconds(best.time.p95)}"
    how = f", for {tuned.record.get('device', 'the device')} predicted, not timed," if best.time.predicted else ""
    frames, scores, reference = "tuning", best.tuning, None if base is None else base.tuning
    if best.held_out is not None:
        frames, scores, reference = "held-out", best.held_out, None if base is None else base.held_out
    text = (
        f"{budget_text(budget)}: {best.name} takes{how} {milliseconds(best.time.median)} ms ({p95}), "
        f"{best.time.ratio:.2f} of the default's time; loss {change_text(scores['relative'])}"
    )
    if "psnr" in scores:
        text += f", PSNR {scores['psnr']:.2f} dB"
        text += f" against {reference['psnr']:.2f}" if reference is not None and "psnr" in reference else ""
    return f"{text} ({frames} frames)."


def change_text(ratio: float) -> str:
    """A loss over the default's.

    >>> change_text(0.876), change_text(1.05), change_text(1.0)
    ('12.4 % less than the default', '5.0 % more than the default', 'equal to the default')
    """
    change = round(100 * (ratio - 1), 1)
    if not change:
        return "equal to the default"
    return f"{abs(change):.1f} % {'more' if change > 0 else 'less'} than the default"


def missed(budget: Budget, best: Candidate) -> list[str]:
    """Sentence of a budget that even the fastest configuration missed."""
    if best.time.judged <= budget.milliseconds:
        return []
    return [
        f"{budget_text(budget)} could not be kept: measured p95 {milliseconds(best.time.judged)} ms; "
        f"{best.name} is the fastest of those that were judged."
    ]


def prediction(tuned: Tuned) -> list[str]:
    """Distance of times from those that the surrogate had predicted; nothing if there are none."""
    errors = tuned.record.get("prediction errors") or []
    if not errors:
        return []
    return [
        f"Times of {len(errors)} proposed configurations were predicted with an error of "
        f"{100 * float(np.median(errors)):.1f} % (median), {100 * max(errors):.1f} % at worst."
    ]


def milliseconds(value: float | None) -> str:
    """A time with as many decimals as can be believed."""
    if value is None or not math.isfinite(value):
        return MISSING_MARK
    return f"{value:.2f}" if value >= 1 else f"{value:.3f}"


def budget_text(budget: Budget) -> str:
    """`60 fps = 16.67 ms`, or the label alone where it is the time."""
    time = (
        f"{budget.milliseconds:.4g} ms"
        if budget.milliseconds < 1
        else f"{budget.milliseconds:.2f}".rstrip("0").rstrip(".") + " ms"
    )
    return budget.label if budget.slug == time.replace(" ", "") else f"{budget.label} = {time}"


def score_text(scores: Mapping[str, float] | None, name: str, form: str) -> str:
    """A score, or a dash where there is none."""
    return MISSING_MARK if scores is None or name not in scores else format(scores[name], form)
