"""The paper's first ablation: 50 cascaded steps against 50 and 1000 steps at half size, in time and in distance.

    python -m experiments.ablation_cascade [--capture PATH] [--out results/ablation_cascade/room]

The rough surface of a few frames is lit by two coloured points, without shadows, and its filter refined by
`paper-50`, `naive-50` and `naive-1000`, in the paper's mode and in ours. Measured: the diffusion's time, all in
turns after a first call that compiles; the root mean square distance of the filter, in display values, to the
converged result (`CONVERGED` steps at half size) and to the filter of the accurate surface where that is relied
on; and PSNR of the frames relit with the two. A sweep over the number of steps at half size tells how far
diffusing on does any good: converged is not right, since conductances never are quite zero.

Takes about two minutes on two cores, once the surfaces are made.

Expect: the cascade nearer to the converged result than as many steps at half size, in a small part of the time of
1000 of them. Nearer to the converged result is not nearer to the accurate surface: there the distances differ
little."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hyjax
from experiments.blocks import Block, Picture, Plot, Table
from experiments.command import Start, experiment, run
from experiments.judging import middle
from experiments.paper_bench import METHODS, RAW_SCHEDULE, Bench, KappaConfig, reported
from experiments.paper_view import View
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from experiments.timing import check_repeats
from hyjax import metrics
from hyjax.core.schedule import Schedule
from hyjax.data.frames import spread
from hyjax.pipeline import Mode
from hyjax.tuning.calibration import MOST_SECONDS
from hyjax.tuning.clock import rounds_of
from hyjax.util.contact_sheet import write_contact_sheet

LIGHTS = "two-colors"
SCHEDULES = ("paper-50", "naive-50", "naive-1000")
CONVERGED = 20_000
SWEEP = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, CONVERGED)
SHEET = ("frame", "raw filter", *SCHEDULES, f"{CONVERGED} steps", "accurate surface")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(KappaConfig):
    frames: int = 6
    """How many, spread over those that `paper_table` reports on."""
    repeats: int = 50
    """Rounds of the timing."""


@experiment("Ablation: the cascade", "distance")
def main(config: Config, start: Start) -> None:
    check_repeats(config.repeats)
    capture, results = config.start(start)
    chosen = spread(reported(capture), config.frames)  # before the first slow step
    bench = config.bench(capture, Schedule.preset("paper-50"))
    sheet = []
    for view in bench.views(chosen, "diffusing"):
        for mode in METHODS:
            accurate = bench.relight(view, LIGHTS, mode, RAW_SCHEDULE, accurate=True)
            refined = {name: bench.relight(view, LIGHTS, mode, s).refined for name, s in schedules().items()}
            converged = refined[naive_name(CONVERGED)]
            for name, relight_filter in refined.items():
                results.add(
                    kind="distance",
                    frame=view.frame.name,
                    mode=mode,
                    schedule=name,
                    to_converged=rms(relight_filter, converged, jnp.ones(view.valid.shape), mode),
                    to_accurate=rms(relight_filter, accurate.shading, jnp.asarray(view.valid), mode),
                    psnr=psnr(view, relight_filter, accurate.shading, mode),
                )
            raw = bench.relight(view, LIGHTS, mode, RAW_SCHEDULE).shading
            shown = [raw, *(refined[name] for name in SCHEDULES), converged, accurate.shading]
            label = f"{view.frame.name}, {mode} mode, filters"
            sheet.append((label, [np.asarray(view.display), *(np.asarray(displayed(x, mode)) for x in shown)]))
    for mode, times in time_schedules(bench, view, config.repeats).items():
        for name, time in times.items():
            results.add(kind="time", mode=mode, schedule=name, **time)
    write_contact_sheet(results.out / "side_by_side.png", sheet[: 2 * 4], SHEET)


def naive_name(steps: int) -> str:
    return f"naive-{steps}"


def schedules() -> dict[str, Schedule]:
    """The cascade, and the sweep over steps at half size."""
    naive = {naive_name(steps): Schedule.uniform([(2, steps)], name=naive_name(steps)) for steps in SWEEP}
    return {"paper-50": Schedule.preset("paper-50")} | naive


def displayed(relight_filter: Float[Array, "h w 3"], mode: Mode) -> Float[Array, "h w 3"]:
    """A filter as a picture."""
    return jnp.clip(relight_filter if mode == "paper" else hyjax.to_display(relight_filter), 0.0, 1.0)


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


def time_schedules(bench: Bench, view: View, repeats: int) -> dict[Mode, dict[str, dict[str, float]]]:
    """Milliseconds of the diffusion of one filter, all schedules and both modes in turns.

    `ratio` is the median over the rounds of a schedule's time over the cascade's in the same round: other work on
    the machine changes it less than the milliseconds.
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

    def told(mode: Mode, name: str) -> dict[str, float]:
        own, cascaded = rounds[f"{mode} {name}"], rounds[f"{mode} {SCHEDULES[0]}"]
        median, p95 = np.percentile(own.wall, [50, 95])
        ratio = np.median(own.undisturbed / cascaded.undisturbed)
        return {"median": float(median), "p95": float(p95), "ratio": float(ratio)}

    return {mode: {name: told(mode, name) for name in SCHEDULES} for mode in METHODS}


def _finished(call: Callable[[], Any]) -> Any:
    return jax.block_until_ready(call())


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table, figure and picture from the rows."""
    distances = of_kind(rows, "distance")
    times = {(row["mode"], row["schedule"]): row for row in rows if row.get("kind") == "time"}
    lines = []
    for mode in METHODS:
        for name in (*SCHEDULES, naive_name(CONVERGED)):
            own = [row for row in distances if (row["mode"], row["schedule"]) == (mode, name)]
            time = times.get((mode, name))
            cells = [f"{time['median']:.2f}", f"{time['p95']:.2f}"] if time else ["–", "–"]
            cells.append(f"{time['ratio']:.2f}" if time and "ratio" in time else "–")
            for key, digits in (("to_converged", 4), ("to_accurate", 4), ("psnr", 2)):
                found = middle([row[key] for row in own])
                cells.append("–" if found is None else found.text(digits))
            lines.append([f"{mode} mode, {name}", *cells])
    frames = len({row["frame"] for row in distances})
    caption = (
        f"Diffusion of one filter, two lights; median over {frames} frames (95 % interval); distances are RMS of "
        f"display values. Converged: {CONVERGED} steps at half size."
    )
    header = [
        "",
        "median ms",
        "p95 ms",
        "of paper-50's time",
        "to converged",
        "to accurate surface",
        "relit PSNR dB",
    ]
    return [
        Table(caption, header, lines),
        Plot("steps", "Distance of the filter against steps at half size, means over frames.", figure(distances)),
        Picture(folder / "side_by_side.png", "Filters, side by side."),
    ]


def figure(distances: Sequence[Row]) -> Any:
    """Distance against the number of steps at half size, to the converged result and to the accurate surface."""
    fig = new_figure(10, 4)
    axes = fig.subplots(1, 2, sharey=True)
    for ax, key, title in zip(axes, ("to_converged", "to_accurate"), ("converged result", "accurate surface")):
        for k, mode in enumerate(METHODS):
            own = [row for row in distances if row["mode"] == mode]
            if not own:
                continue
            names = dict.fromkeys(row["schedule"] for row in own)
            mean = {name: np.mean([row[key] for row in own if row["schedule"] == name]) for name in names}
            steps = [n for n in SWEEP if key == "to_accurate" or n != CONVERGED]
            label, color = f"{mode} mode, steps at half size", f"C{k}"
            ax.semilogx(steps, [mean[naive_name(n)] for n in steps], marker="o", color=color, label=label)
            cascaded = f"{mode} mode, 50 cascaded steps"
            ax.axhline(mean["paper-50"], color=color, linestyle="--", linewidth=1, label=cascaded)
        ax.set(xlabel="steps at half size", title=f"distance to the {title}")
    axes[0].set(ylabel="RMS of display values", ylim=(0, None))
    axes[1].legend()
    return fig


if __name__ == "__main__":
    run(main)
