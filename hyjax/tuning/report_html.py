"""The page that a tuning run leaves. Everything goes through `tag`, which escapes what is not markup already."""

import importlib.resources
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hyjax.schedule import Level
from hyjax.tuning.report_axes import svg
from hyjax.tuning.report_markup import Html, join, tag
from hyjax.tuning.report_pictures import Example, data_uris, pair_to_compare
from hyjax.tuning.report_plots import draw_history, draw_latency, draw_pareto
from hyjax.tuning.report_text import (
    MISSING,
    best_for,
    budget_text,
    candidates,
    kind_of_baseline,
    loss_of,
    milliseconds,
    number,
    rival,
    sentence,
    steps_text,
)
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Scores, Tuned

# The browser itself refuses whatever is not in the file.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def page(tuned: Tuned, examples: Sequence[Example]) -> str:
    """The whole page."""
    sections = [
        ("trade-off", "Time against quality", _plot(tuned)),
        ("candidates", "Candidates", _table(tuned)),
        ("schedules", "Schedules", _schedules(tuned)),
        ("pictures", "Pictures", _pictures(examples)),
        ("search", "Search", svg(draw_history(tuned), "history", "Loss of the best so far against seconds")),
        ("latency", "Latency model", _latency(tuned)),
        ("record", "Record", _record(tuned)),
    ]
    shown = [(key, title, content) for key, title, content in sections if content]
    body = [
        tag(
            "header",
            tag("p", "hyjax tune", class_="kicker"),
            tag("h1", "Tuned schedules"),
            [tag("p", sentence(tuned, b, c), class_="lead") for b, c in zip(tuned.budgets, tuned.best)],
            tag("p", _where(tuned), class_="quiet") if _where(tuned) else "",
        ),
        tag("div", [_card(tuned, b, c) for b, c in zip(tuned.budgets, tuned.best)], class_="cards"),
        tag("nav", [tag("a", title, href=f"#{key}") for key, title, _ in shown]),
        tag("main", [tag("section", tag("h2", title), content, id=key) for key, title, content in shown]),
        tag("dialog", tag("figure"), aria_label="Picture, enlarged") if examples else "",
        tag("script", Html(_asset("report.js"))) if examples else "",
    ]
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", "hyjax tune: " + ", ".join(budget.label for budget in tuned.budgets)),
        tag("style", Html(_asset("report.css"))),
    ]
    return "<!doctype html>\n" + tag("html", tag("head", head), "\n", tag("body", body), lang="en") + "\n"


def _asset(name: str) -> str:
    return importlib.resources.files("hyjax.tuning").joinpath(name).read_text(encoding="utf-8")


def _where(tuned: Tuned) -> str:
    versions = tuned.record.get("versions")
    jax = f"jax {versions['jax']}" if isinstance(versions, dict) and "jax" in versions else ""
    return ", ".join(str(part) for part in (tuned.record.get("device", ""), jax) if part)


def _card(tuned: Tuned, budget: Budget, best: Candidate) -> Html:
    """A budget with what was found for it: how much of the time is used, and how much better it is."""
    time = best.measured or best.predicted
    end = max(budget.milliseconds, time.p95) or 1.0
    place = {key: f"{100 * value / end:.1f}%" for key, value in vars(time).items()}
    style = f"--median:{place['median']};--p95:{place['p95']};--budget:{100 * budget.milliseconds / end:.1f}%"
    facts = [("median", f"{milliseconds(time.median)} ms"), ("p95", f"{milliseconds(time.p95)} ms")]
    other = rival(tuned, budget, best)
    if other is not None:
        own, against = loss_of(best, other), loss_of(other, best)
        if own is not None and against:
            facts.append((f"loss against {other.name}", f"{100 * (own / against - 1):+.0f}%".replace("-", "−")))
    return tag(
        "div",
        tag("h3", budget_text(budget)),
        tag("p", steps_text(best.schedule), class_="steps"),
        tag("div", tag("i"), tag("b"), tag("u"), class_="gauge", style=style, title="median, p95 and the budget"),
        tag("dl", [tag("div", tag("dt", key), tag("dd", value)) for key, value in facts]),
        class_="card",
    )


def _plot(tuned: Tuned) -> Html:
    return tag("div", svg(draw_pareto(tuned), "pareto", "Time against quality"), class_="plot")


def _table(tuned: Tuned) -> Html:
    groups = [("", 2), ("predicted ms", 1), ("measured ms", 2), ("tuning frames", 3), ("held-out frames", 3)]
    names = ["name", "schedule", "median", "median", "p95", *["loss", "PSNR", "SSIM"] * 2]
    head = [
        tag("tr", [tag("th", text, colspan=width, scope="colgroup") for text, width in groups]),
        tag("tr", [tag("th", text, scope="col", class_="n" if i > 1 else None) for i, text in enumerate(names)]),
    ]
    body = []
    for kind, candidate in candidates(tuned):
        labels = best_for(tuned, candidate) if kind == "tuned" else []
        color = kind if kind == "tuned" else kind_of_baseline(candidate)
        cells = [
            tag("th", _dot(color), candidate.name, [tag("mark", x) for x in labels], scope="row"),
            tag("td", steps_text(candidate.schedule), class_="steps"),
            _number(milliseconds(candidate.predicted.median)),
            *_times(candidate.measured),
            *_scores(candidate.tuning),
            *_scores(candidate.held_out),
        ]
        body.append(tag("tr", cells, class_="best" if labels else None))
    table = tag("table", tag("thead", head), tag("tbody", body))
    return join(
        [
            tag("div", table, class_="wide", tabindex="0"),
            tag(
                "p",
                "Factor:steps of each level, coarse to fine. Loss: lower is better; PSNR in dB.",
                class_="quiet",
            ),
        ]
    )


def _dot(color: str) -> Html:
    return tag("span", class_="dot", style=f"background:var(--{color})")


def _number(text: str) -> Html:
    return tag("td", text, class_="n")


def _times(time: Milliseconds | None) -> list[Html]:
    return [_number(milliseconds(None if time is None else value)) for value in _values(time, "median", "p95")]


def _scores(scores: Scores | None) -> list[Html]:
    loss, psnr, ssim = _values(scores, "loss", "psnr", "ssim")
    return [_number(number(loss, "#.3g")), _number(number(psnr, ".2f")), _number(number(ssim, ".3f"))]


def _values(source: object, *names: str) -> list[Any]:
    return [getattr(source, name, None) for name in names]


def _schedules(tuned: Tuned) -> Html:
    """Every level of every candidate; those that are best for a budget come first, unfolded."""
    parts = []
    labelled = [(best_for(tuned, c) if kind == "tuned" else [], kind, c) for kind, c in candidates(tuned)]
    for labels, kind, candidate in sorted(labelled, key=lambda item: not item[0]):
        schedule = candidate.schedule
        total = sum(level.steps for level in schedule.levels)
        form = f"pooling {schedule.pooling}, upsampling {schedule.upsampling}, norm {schedule.norm}"
        title = f" {total} steps, {form}"
        names = {"factor": "n", "steps": "n", "κ": "n", "α": "n", "λ": None}
        head = tag("tr", [tag("th", name, class_=class_) for name, class_ in names.items()])
        table = tag("table", tag("thead", head), tag("tbody", [_level(level) for level in schedule.levels]))
        name = [_dot(kind if kind == "tuned" else kind_of_baseline(candidate)), tag("strong", candidate.name)]
        parts.append(
            tag(
                "details",
                tag("summary", name, [tag("mark", x) for x in labels], tag("span", title, class_="quiet")),
                tag("div", table, class_="wide"),
                open=bool(labels),
            )
        )
    return join(parts)


def _level(level: Level) -> Html:
    lam = np.asarray(level.step_sizes, dtype=float)
    if not lam.size:
        text: list[str] = [MISSING]
    elif np.ptp(lam) == 0:
        text = [f"{lam[0]:.4g}"]
    else:
        each = " ".join(f"{value:.3g}" for value in lam)
        text = [_bars(lam), f" {lam.min():.3g} to {lam.max():.3g} ", tag("small", each)]
    kappa = f"{float(np.asarray(level.kappa)):.4g}"
    alpha = MISSING if level.attachment is None else f"{float(np.asarray(level.attachment)):.4g}"
    numbers = [_number(value) for value in (str(level.factor), str(level.steps), kappa, alpha)]
    return tag("tr", numbers, tag("td", text))


def _bars(lam: np.ndarray) -> Html:
    """λ of each step as a small bar; a full bar is 1/4, where the steps stop being stable."""
    bars = [
        tag("rect", x=4 * i, y=f"{16 - 64 * v:.2f}", width=3, height=f"{64 * v:.2f}") for i, v in enumerate(lam)
    ]
    width = 4 * len(lam)
    return tag("svg", bars, class_="bars", viewBox=f"0 0 {width} 16", width=width, height=16, aria_hidden="true")


def _pictures(examples: Sequence[Example]) -> Html:
    if not examples:
        return Html("")
    hint = (
        "Rest the pointer on the large picture, or press X, to see the other of the two in its place; on a small "
        "one to see that. Click to enlarge; then the arrow keys walk through all of them."
    )
    parts = [tag("p", hint, class_="quiet script", hidden=True)]
    for i, (example, sources) in enumerate(zip(examples, data_uris(examples), strict=True)):
        first, second = pair_to_compare(list(sources))
        strip = [
            tag(
                "button",
                tag("img", src=source, alt=f"{example.name}: {heading}"),
                tag("span", heading),
                type="button",
            )
            for heading, source in sources.items()
        ]
        parts.append(
            tag(
                "article",
                tag("h3", example.name, id=f"example-{i}"),
                tag("p", example.note, class_="quiet") if example.note else "",
                tag("div", class_="stage script", hidden=True),
                tag("div", strip, class_="strip"),
                class_="example",
                data_first=first,
                data_second=second,
            )
        )
    return join(parts)


def _latency(tuned: Tuned) -> Html:
    """Predicted against measured; what the table knows of its error is the record's `latency`."""
    known = [c for _, c in candidates(tuned) if c.measured is not None]
    rows, errors = [], []
    for candidate in known:
        predicted, measured = candidate.predicted.median, _values(candidate.measured, "median")[0]
        error = predicted / measured - 1 if measured else math.nan
        errors.append(abs(error))
        text = MISSING if math.isnan(error) else f"{100 * error:+.1f}%".replace("-", "−")
        cells = [tag("th", candidate.name, scope="row"), _number(milliseconds(predicted))]
        rows.append(tag("tr", cells, _number(milliseconds(measured)), _number(text)))
    facts = _flat(tuned.record.get("latency"))
    if not known and not facts:
        return Html("")
    parts = []
    if known:
        median, worst = 100 * float(np.median(errors)), 100 * float(np.max(errors))
        said = f"{len(known)} schedules timed; predictions off by {median:.1f}% (median), {worst:.1f}% at most."
        head = tag(
            "tr", [tag("th", x, class_="n" if x else None) for x in ("", "predicted ms", "measured ms", "error")]
        )
        table = tag("div", tag("table", tag("thead", head), tag("tbody", rows)), class_="wide", tabindex="0")
        plot = tag("div", svg(draw_latency(tuned), "latency", "Predicted against measured"), class_="plot")
        parts = [tag("p", said), tag("div", plot, table, class_="beside")]
    if facts:
        items = [tag("div", tag("dt", key), tag("dd", value)) for key, value in facts]
        parts += [tag("h3", "The latency table"), tag("dl", items, class_="facts")]
    return join(parts)


def _flat(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Names and values of nested JSON, one line each."""
    if isinstance(value, dict):
        return [item for key, inner in value.items() for item in _flat(inner, f"{name} {key}".strip())]
    if value is None:
        return []
    if isinstance(value, float):
        return [(name.replace("_", " "), f"{value:.4g}")]
    return [(name.replace("_", " "), value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]


def _record(tuned: Tuned) -> Html:
    text = json.dumps(tuned.record, indent=2, ensure_ascii=False, default=str)
    return tag("details", tag("summary", "Settings, versions, device, frames"), tag("pre", text))
