"""The three benchmarks of `paper_table` for every idea beyond the paper, alone and together, with their times.

    python -m experiments.beyond [--capture PATH] [--out results/beyond/room]

Ideas and what they change are in `experiments.beyond_ideas`. For each, κ is chosen by the PSNR of relighting
fidelity on tuning frames (the built-in room: another seed's scan; a capture: its first three quarters), and
everything is reported on frames that nothing was chosen on. Beside them: the bare mesh, the mean colour of its
filter, which any gain has to beat to be one, and the paper's method in the paper's mode. The time is that of
shading the lights and repairing the filter (in the second part of the latter alone); all are timed in turns.
*Perfect confidence* knows where the rough surface is wrong, which no method can: it shows what confidence may be
worth at most.

Each is compared with the accurate surface's frame as its own mode multiplies it: display values in the paper's,
light in all others. *Harmonic* and *converged* divide by what has arrived without `cascade_known`'s floor.

A second part weighs quality against time: the paper's method, its cascade with holes unknown, and ours, each with
few and with many steps.

Takes about a quarter of an hour on two cores.

Expect: holes unknown worth more than all else; the rest small and adding up; 13 steps at a quarter of the size as
good as 80; perfect confidence and convergence worth little more."""

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float
from matplotlib.figure import Figure

import hyjax
from experiments.beyond_ideas import BASE, IDEAS, KAPPAS, OURS, equivalents, known
from experiments.blocks import Block, Picture, Plot, Table
from experiments.command import Start, experiment, run
from experiments.judging import REGIONS, judge, pick, regions, summarise, text_of, tuning_curve
from experiments.paper_bench import ANY, BENCHMARKS, Bench, BenchConfig, reported
from experiments.paper_view import View, linear_filter, mean_colour, multiplied, with_kappa
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.data.builtin_room import load_room
from hyjax.data.frames import spread
from hyjax.light.setup import LightSetup
from hyjax.metrics import METRICS, load_lpips, psnr
from hyjax.pipeline import Mode
from hyjax.tuning.calibration import check_repeats, time_calls
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

FIDELITY = "relighting fidelity"
PAPER = "paper's method"
PAPER_KAPPAS = (0.02, 0.05, 0.1, 0.2, 0.4)
BASELINES = ("bare mesh", "mean colour", PAPER)
TUNING_SEED = 0
"""Seed of the room and scan that κ is chosen on; the built-in room that is reported on has another."""
STEPS_MORE = (1 / 3, 1, 3, 10)
"""Multiples of their own steps that the schedules of the second part take."""
SHEET = ("frame", "bare mesh", PAPER, "holes unknown", "hyjax", "accurate surface")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(BenchConfig):
    tuning: int = 6
    """How many tuning frames."""
    frames: int = 24
    """How many to report on, spread over those of `paper_table`."""
    repeats: int = 60
    weights: Path | None = None
    """LPIPS weights. Default: those converted of the extra `lpips`."""


@experiment("Beyond the paper")
def main(config: Config, start: Start) -> None:
    check_repeats(config.repeats)
    weights = load_lpips(config.weights)
    capture, results = config.start(start)
    room = capture.reference() is not None
    if room and config.seed == TUNING_SEED:
        raise InputError(f"seed: {TUNING_SEED} is the room that κ is chosen on; give another to report on")
    chosen = spread(reported(capture), config.frames)
    first_held = len(capture) if room else min(reported(capture))
    tuned = spread(range(first_held), config.tuning)
    own = load_room(TUNING_SEED) if room else capture
    settings = dataclasses.replace(config, seed=TUNING_SEED) if room else config
    shown: dict[str, list[np.ndarray]] = {}
    with contextlib.ExitStack() as stack:
        choosing = stack.enter_context(settings.bench(own, BASE))
        for view in choosing.views(tuned, "choosing κ"):
            for name, kappa, picture, target in candidates(choosing, view):
                decibels = float(psnr(picture, target, valid=view.valid))
                results.add(kind="tuning", split="tuning", method=name, kappa=kappa, psnr=decibels)
        kappas = best_kappas(results.rows)
        bench = choosing if own is capture else stack.enter_context(config.bench(capture, BASE))
        for view in bench.views(chosen, "judging"):
            where = regions(view.rough, view.accurate)
            scores: dict[str, Any] = {}
            for benchmark, lights in BENCHMARKS.items():
                pictures, targets = everything(bench, view, lights, kappas)
                fidelity = benchmark == FIDELITY
                for group, several in pictures.items():
                    target = targets[group] if fidelity else view.display
                    found = judge(several, target, where, weights, view.valid if fidelity else None)
                    scores.setdefault(benchmark, {}).update(found)
                if fidelity:
                    every = {name: p for several in pictures.values() for name, p in several.items()}
                    every |= {"frame": view.display, "accurate surface": targets["light"]}
                    shown[view.frame.name] = [np.asarray(every[name]) for name in SHEET]
            results.add(kind="frame", frame=view.frame.name, scores=scores)
            for name, line, steps, relit, target in front(bench, view, kappas):
                decibels = float(psnr(relit, target, valid=view.valid))
                results.add(kind="front", frame=view.frame.name, method=name, line=line, steps=steps, psnr=decibels)
        for name, time in measure(bench, view, kappas, config.repeats).items():
            results.add(kind="time", method=name, **dataclasses.asdict(time))
    write_contact_sheet(results.out / "best_and_worst.png", best_and_worst(results.rows, shown), SHEET)


# ---- pictures ----


def paper_filter(bench: Bench, view: View, lights: str, kappa: float, schedule: Schedule = BASE) -> Array:
    return linear_filter(bench.relight(view, lights, "paper", schedule, kappa=kappa), "paper")


def idea_filter(bench: Bench, view: View, lights: str, name: str, kappa: float) -> Array:
    setup = bench.setups[lights]
    return hyjax.colored(IDEAS[name].refine(view, setup, kappa), setup.lights) / setup.reference_lux


def true_filter(bench: Bench, view: View, lights: str, mode: Mode = "linear") -> Array:
    return bench.relight(view, lights, mode, ANY, accurate=True).shading


def candidates(bench: Bench, view: View) -> Any:
    """(name, κ, relit frame, relit frame of the accurate surface), of all that has a κ."""
    lights = BENCHMARKS[FIDELITY]
    true = true_filter(bench, view, lights)
    for kappa in PAPER_KAPPAS:
        own = (multiplied(view, f, "display values") for f in (paper_filter(bench, view, lights, kappa), true))
        yield PAPER, kappa, *own
    target = multiplied(view, true, "light")
    for name in IDEAS:
        for kappa in KAPPAS:
            yield name, kappa, multiplied(view, idea_filter(bench, view, lights, name, kappa), "light"), target


def best_kappas(rows: Sequence[Row]) -> dict[str, float]:
    """Method → the κ with the highest mean PSNR on the tuning frames."""
    found = {}
    for name in dict.fromkeys(row["method"] for row in of_kind(rows, "tuning")):
        curve = tuning_curve([row for row in of_kind(rows, "tuning") if row["method"] == name])
        found[name] = max(curve, key=curve.__getitem__)
    return found


def everything(
    bench: Bench, view: View, lights: str, kappas: Mapping[str, float]
) -> tuple[dict[str, dict[str, Float[Array, "h w 3"]]], dict[str, Float[Array, "h w 3"]]]:
    """Group → method → relit frame, and group → that of the accurate surface."""
    bare, true = bench.relight(view, lights, "linear", ANY).shading, true_filter(bench, view, lights)
    light = {"bare mesh": bare, "mean colour": mean_colour(view, bare, "light")}
    light |= {name: idea_filter(bench, view, lights, name, kappas[name]) for name in IDEAS}
    filters = {"light": light, "display values": {PAPER: paper_filter(bench, view, lights, kappas[PAPER])}}
    pictures = {
        group: {name: multiplied(view, f, group) for name, f in own.items()} for group, own in filters.items()
    }
    return pictures, {group: multiplied(view, true, group) for group in filters}


def best_and_worst(
    rows: Sequence[Row], shown: Mapping[str, list[np.ndarray]]
) -> list[tuple[str, list[np.ndarray]]]:
    """The frames that gain most and least PSNR on the paper's method."""
    frames = of_kind(rows, "frame")

    def gain(row: Row) -> float:
        return value(row, FIDELITY, "hyjax", "all", "psnr") - value(row, FIDELITY, PAPER, "all", "psnr")

    ordered = sorted(frames, key=gain)
    return [
        (f"{label}, {row['frame']}: {gain(row):+.1f} dB", shown[row["frame"]])
        for label, row in (("most gained", ordered[-1]), ("least gained", ordered[0]))
    ]


# ---- quality against time ----


def fronts(kappas: Mapping[str, float]) -> dict[str, tuple[str, float, Schedule]]:
    """Name → (line of the plot, its multiple of steps, schedule with κ)."""
    found = {}
    for more in STEPS_MORE:
        paper = [(level.factor, max(1, round(more * level.steps))) for level in BASE.levels]
        ours = [(level.factor, max(1, round(more * level.steps))) for level in OURS.levels]
        for line, schedule in (
            (PAPER, Schedule.uniform(paper, kappa=kappas[PAPER])),
            ("holes unknown", Schedule.uniform(paper, kappa=kappas["holes unknown"])),
            ("hyjax", guided_schedule(ours, kappa=kappas["hyjax"])),
        ):
            found[f"{line} x{more:.2g}"] = (line, more, schedule)
    return found


def front(bench: Bench, view: View, kappas: Mapping[str, float]) -> Any:
    """(name, line, steps, relit frame, that of the accurate surface) of each point."""
    lights = BENCHMARKS[FIDELITY]
    setup, true = bench.setups[lights], true_filter(bench, view, lights)
    for name, (line, _, schedule) in fronts(kappas).items():
        kappa, steps = float(schedule.levels[0].kappa), sum(level.steps for level in schedule.levels)
        if line == PAPER:
            relight_filter, group = paper_filter(bench, view, lights, kappa, schedule), "display values"
        else:
            channels = known(view, setup, kappa, schedule=schedule)
            relight_filter, group = hyjax.colored(channels, setup.lights) / setup.reference_lux, "light"
        yield name, line, steps, *(multiplied(view, f, group) for f in (relight_filter, true))


def measure(bench: Bench, view: View, kappas: Mapping[str, float], repeats: int) -> dict[str, Any]:
    """Milliseconds of the diffusion stage of everything, in turns."""
    lights = BENCHMARKS[FIDELITY]
    setup = bench.setups[lights]
    raw = bench.relight(view, lights, "paper", ANY).shading
    each, hit = hyjax.shade_each(view.rough, setup.lights), view.rough.hit[..., None]
    paper = with_kappa(BASE, kappas[PAPER])
    calls: dict[str, Callable[[], Any]] = {PAPER: lambda: hyjax.cascade(_rendered(view, setup), view.guide, paper)}
    for name, idea in IDEAS.items():
        calls[name] = lambda name=name, idea=idea: idea.refine(view, setup, kappas[name])
    for name, (line, _, schedule) in fronts(kappas).items():
        if line == PAPER:
            calls[name] = lambda s=schedule: hyjax.cascade(raw, view.guide, s)
        else:
            calls[name] = lambda s=schedule: hyjax.cascade_known(each, hit, view.guide, s)
    return time_calls(calls, repeats, most_seconds=240.0, progress=True)


def _rendered(view: View, setup: LightSetup) -> Array:
    """The paper's filter: shaded, coloured and encoded."""
    each = hyjax.shade_each(view.rough, setup.lights)
    return hyjax.to_display(hyjax.colored(each, setup.lights) / setup.reference_lux)


# ---- tables ----


def value(row: Row, *keys: str) -> float:
    return float(pick(row, "scores", *keys))


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables, figure and picture from the rows."""
    frames = of_kind(rows, "frame")
    if not frames:
        return ["No frame has been judged yet."]
    what = frames[0]["settings"]["capture"] or "built-in room"
    made: list[Block] = [whole(rows, frames, what)]
    made += [by_region(frames, benchmark) for benchmark in BENCHMARKS]
    if of_kind(rows, "time"):
        made.append(Plot("front", "Relighting fidelity against the time of the diffusion.", figure(rows)))
    return [*made, Picture(folder / "best_and_worst.png", "Frames that gain most and least on the paper's method.")]


def whole(rows: Sequence[Row], frames: Sequence[Row], what: str) -> Table:
    """A line for each method: κ, steps, time, and the metrics of the three benchmarks."""
    kappas, times = best_kappas(rows), {row["method"]: row for row in of_kind(rows, "time")}
    lines = []
    for name in (*BASELINES, *IDEAS):
        schedule = BASE if name == PAPER else IDEAS[name].schedule if name in IDEAS else None
        cells = [f"{kappas[name]:g}" if name in kappas else ""]
        cells.append("" if schedule is None else f"{equivalents(schedule):.2f}")
        cells.append("" if name not in times else f"{times[name]['median']:.1f} / {times[name]['p95']:.1f}")
        for benchmark in BENCHMARKS:
            for metric in METRICS:
                mean = summarise([pick(row, "scores", benchmark, name, "all", metric) for row in frames])
                cells.append("" if mean is None else text_of(mean, metric))
        lines.append([name, *cells])
    header = ["", "κ", "full-size steps", "ms median / p95"]
    header += [f"{benchmark}, {metric.label}" for benchmark in BENCHMARKS for metric in METRICS.values()]
    count = len({row["frame"] for row in frames})
    caption = (
        f"{what}: {count} frames that nothing was chosen on, ± half of the 95 % interval. The paper's method "
        "multiplies display values, all others light. Times: shading and repair of two lights."
    )
    return Table(caption, header, lines)


def by_region(frames: Sequence[Row], benchmark: str) -> Table:
    """The metrics by kind of pixel."""
    header = ["", *(f"{region} {metric.label}" for region in REGIONS[1:] for metric in METRICS.values())]
    lines = []
    for name in (*BASELINES, *IDEAS):
        cells = []
        for region in REGIONS[1:]:
            for metric in METRICS:
                mean = summarise([pick(row, "scores", benchmark, name, region, metric) for row in frames])
                cells.append("" if mean is None else f"{mean.mean:.{METRICS[metric].digits}f}")
        lines.append([name, *cells])
    return Table(f"{benchmark}, by kind of pixel.", header, lines)


def figure(rows: Sequence[Row]) -> Figure:
    """Mean PSNR against the median time: a line for each method with more and with fewer steps."""
    fig = new_figure(7, 4.5)
    axes = fig.subplots()
    times = {row["method"]: row["median"] for row in of_kind(rows, "time")}
    points = of_kind(rows, "front")
    for line in dict.fromkeys(row["line"] for row in points):
        names = list(dict.fromkeys(row["method"] for row in points if row["line"] == line))
        quality = [np.mean([row["psnr"] for row in points if row["method"] == name]) for name in names]
        axes.plot([times[name] for name in names], quality, "o-", label=line)
        for name, y in zip(names, quality):
            steps = next(row["steps"] for row in points if row["method"] == name)
            axes.annotate(str(steps), (times[name], y), textcoords="offset points", xytext=(4, -10), fontsize=7)
    axes.set(xscale="log", xlabel="milliseconds of the diffusion stage", ylabel="PSNR of relighting fidelity, dB")
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
