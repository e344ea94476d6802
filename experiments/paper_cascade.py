"""The paper's first ablation: 50 cascaded steps against 50 and 1000 steps at half size, in time and in distance.

The rough surface of a frame is lit by two coloured points, without shadows, and its filter refined by `paper-50`,
`naive-50` and `naive-1000`, in the paper's mode and in ours. Measured: the diffusion's time, all in turns after a
first call that compiles; the root mean square distance of the filter, in display values, to the converged result
(`CONVERGED` steps at half size) and to the filter of the accurate surface where that is relied on; and PSNR of the
frames relit with the two. A sweep over the number of steps at half size tells how far diffusing on does any good:
converged is not right, since conductances never are quite zero.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hyjax
from experiments.blocks import Block, Picture, Plot, Table
from experiments.judging import Middle, middle
from experiments.paper_bench import METHODS, RAW_SCHEDULE, Bench
from experiments.paper_view import View
from experiments.plotting import new_figure
from experiments.records import Row, of_kind, size_of
from hyjax import metrics
from hyjax.core.schedule import Schedule
from hyjax.light.color import encoded
from hyjax.pipeline import Mode
from hyjax.tuning.calibration import MOST_SECONDS
from hyjax.tuning.clock import rounds_of

LIGHTS = "two-colors"
SCHEDULES = ("paper-50", "naive-50", "naive-1000")
CONVERGED = 20_000
SWEEP = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, CONVERGED)
TIMES = len(METHODS) * len(SCHEDULES)
"""Number of rows of times."""
SHEET = ("frame", "raw filter", *SCHEDULES, f"{CONVERGED} steps", "accurate surface")


def judge(bench: Bench, view: View) -> tuple[list[dict[str, Any]], list[tuple[str, list[Any]]]]:
    """Distances of a frame's filters, and its rows of the contact sheet."""
    scores, sheet = [], []
    for mode in METHODS:
        accurate = bench.relight(view, LIGHTS, mode, RAW_SCHEDULE, accurate=True)
        refined = {name: bench.relight(view, LIGHTS, mode, s).refined for name, s in schedules().items()}
        converged = refined[naive_name(CONVERGED)]
        for name, relight_filter in refined.items():
            score = {
                "mode": mode,
                "schedule": name,
                "to_converged": rms(relight_filter, converged, jnp.ones(view.valid.shape), mode),
                "to_accurate": rms(relight_filter, accurate.shading, jnp.asarray(view.valid), mode),
                "psnr": psnr(view, relight_filter, accurate.shading, mode),
            }
            scores.append(score)
        raw = bench.relight(view, LIGHTS, mode, RAW_SCHEDULE).shading
        shown = [raw, *(refined[name] for name in SCHEDULES), converged, accurate.shading]
        label = f"{view.frame.name}, {mode} mode, filters"
        sheet.append((label, [np.asarray(view.display), *(np.asarray(displayed(x, mode)) for x in shown)]))
    return scores, sheet


def naive_name(steps: int) -> str:
    return f"naive-{steps}"


def schedules() -> dict[str, Schedule]:
    """The cascade, and the sweep over steps at half size."""
    naive = {naive_name(steps): Schedule.uniform([(2, steps)], name=naive_name(steps)) for steps in SWEEP}
    return {"paper-50": Schedule.preset("paper-50")} | naive


def displayed(relight_filter: Float[Array, "h w 3"], mode: Mode) -> Float[Array, "h w 3"]:
    """A filter as a picture."""
    return jnp.clip(relight_filter if mode == "paper" else encoded(relight_filter), 0.0, 1.0)


def rms(a: Array, b: Array, weight: Array, mode: Mode) -> float:
    """Root mean square difference of two filters' display values."""
    squared = jnp.mean((displayed(a, mode) - displayed(b, mode)) ** 2, axis=-1)
    return float(jnp.sqrt(jnp.sum(squared * weight) / jnp.sum(weight)))


def psnr(view: View, relight_filter: Array, accurate: Array, mode: Mode) -> float:
    """PSNR of the relit frame against that of the accurate surface, where this is relied on, in dB."""
    linear = hyjax.to_linear(view.display)
    a, b = (
        jnp.clip(f * view.display if mode == "paper" else hyjax.to_display(f * linear), 0.0, 1.0)
        for f in (relight_filter, accurate)
    )
    return float(metrics.psnr(a, b, valid=jnp.asarray(view.valid)))


def times(bench: Bench, view: View, repeats: int) -> Iterator[dict[str, Any]]:
    """Milliseconds of the diffusion of one filter, all schedules and both modes in turns.

    `ms` is without the time that the process waited for others. `ratio` is of a schedule's time over the cascade's
    in the same round: other work on the machine changes it less. Both are medians over rounds with their intervals.
    """
    setup = bench.setups[LIGHTS]
    each, known = hyjax.shade_each(view.rough, setup.lights), view.rough.hit[..., None]
    raw = bench.relight(view, LIGHTS, "paper", RAW_SCHEDULE).shading
    calls: dict[str, Callable[[], Any]] = {}
    for name in SCHEDULES:
        paper, ours = (jax.device_put(bench.own_kappa(Schedule.preset(name), mode)) for mode in METHODS)
        calls[f"paper {name}"] = functools.partial(hyjax.cascade, raw, view.guide, paper)
        calls[f"linear {name}"] = functools.partial(hyjax.cascade_known, each, known, view.guide, ours)
    waiting = {name: functools.partial(_finished, call) for name, call in calls.items()}
    for call in waiting.values():
        call()
    rounds = rounds_of(waiting, repeats, MOST_SECONDS)
    for mode in METHODS:
        cascaded = rounds[f"{mode} {SCHEDULES[0]}"].undisturbed
        for name in SCHEDULES:
            own = rounds[f"{mode} {name}"].undisturbed
            told = {"ms": _bounds(own), "ratio": _bounds(own / cascaded)}
            yield {"mode": mode, "schedule": name, "rounds": len(own), **told}


def _finished(call: Callable[[], Any]) -> Any:
    return jax.block_until_ready(call())


def _bounds(values: np.ndarray) -> list[float | None]:
    """Median over rounds, and its interval."""
    found = middle(values.tolist())
    assert found is not None  # there is a round
    return [found.median, found.low, found.high]


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table, figure and picture from the rows."""
    distances = [score for row in of_kind(rows, "cascade") for score in row["scores"]]
    clock = {(row["mode"], row["schedule"]): row for row in of_kind(rows, "time")}
    lines = []
    for mode in METHODS:
        for name in (*SCHEDULES, naive_name(CONVERGED)):
            own = [score for score in distances if (score["mode"], score["schedule"]) == (mode, name)]
            time = clock.get((mode, name))
            cells = [Middle(*time[key]).text(2) if time else "–" for key in ("ms", "ratio")]
            for key, digits in (("to_converged", 4), ("to_accurate", 4), ("psnr", 2)):
                found = middle([score[key] for score in own])
                cells.append("–" if found is None else found.text(digits))
            lines.append([f"{mode} mode, {name}", *cells])
    frames = sum(bool(row["scores"]) for row in of_kind(rows, "cascade"))
    rounds = max((row["rounds"] for row in clock.values()), default=0)
    caption = (
        f"Diffusion of one filter at {size_of(rows)}, two lights: medians (95 % intervals), of times over {rounds} "
        f"rounds in turns, of the rest over {frames} frames. Distances are RMS of display values. Converged: "
        f"{CONVERGED} steps at half size."
    )
    header = ["", "ms", "of paper-50's time", "to converged", "to accurate surface", "relit PSNR dB"]
    return [
        Table(caption, header, lines),
        Plot(
            "cascade_steps",
            "Distance of the filter against steps at half size, medians over frames.",
            figure(distances),
        ),
        Picture(folder / "cascade.png", "Filters, side by side."),
    ]


def figure(distances: Sequence[Row]) -> Any:
    """Distance against the number of steps at half size, to the converged result and to the accurate surface."""
    fig = new_figure(10, 4)
    axes = fig.subplots(1, 2, sharex=True, sharey=True)
    for ax, key, title in zip(axes, ("to_converged", "to_accurate"), ("converged result", "accurate surface")):
        for k, mode in enumerate(METHODS):
            own = [row for row in distances if row["mode"] == mode]
            if not own:
                continue
            names = dict.fromkeys(row["schedule"] for row in own)
            median = {name: np.median([row[key] for row in own if row["schedule"] == name]) for name in names}
            steps = [n for n in SWEEP if key == "to_accurate" or n != CONVERGED]
            label, color = f"{mode} mode, steps at half size", f"C{k}"
            ax.semilogx(steps, [median[naive_name(n)] for n in steps], marker="o", color=color, label=label)
            cascaded = f"{mode} mode, 50 cascaded steps"
            ax.axhline(median["paper-50"], color=color, linestyle="--", linewidth=1, label=cascaded)
        ax.set(xlabel="steps at half size", title=f"distance to the {title}")
    axes[0].set(ylabel="RMS of display values", ylim=(0, None))
    axes[1].legend()
    return fig
