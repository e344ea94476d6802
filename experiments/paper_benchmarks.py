"""Tables and figure of the paper's three benchmarks, from the rows of `experiments.paper`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from experiments.blocks import Block, Picture, Plot, Table
from experiments.judging import REGIONS, Middle, better_text, middle, pick, summarise, text_of
from experiments.paper_bench import BENCHMARKS, METHODS, OWN_GROUP, PointPlace
from experiments.plotting import new_figure
from experiments.records import Row, size_of
from hyjax.metrics import METRICS

PAPER = {
    "mesh error correction": {"lpips": (0.1322, 0.1078), "psnr": (12.7437, 12.8100)},
    "multi-lighting consistency": {"lpips": (0.4310, 0.4120), "psnr": (1.7916, 1.7672)},
    "relighting fidelity": {"lpips": (0.1391, 0.1200), "psnr": (15.7850, 15.7437)},
}
"""The paper's own table: ARKit mesh, their method; 596 frames of ARKitScenes 47333462."""
POINT: dict[PointPlace, str] = {
    "room": "; the lamp in the middle of the room as in the paper",
    "view": "; the lamp near what the cameras look at",
}
BARE = "bare mesh"
LITTLE_SHARE = 0.5  # share of the pixels that the accurate surface is relied on, below which something is amiss
GROUP_COLORS = {"display values": "C1", "light": "C0"}


def blocks(frames: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figures from the rows of frames that have scores."""
    last = frames[-1]
    share = {name: _percent(frames, "shares", name) for name in REGIONS[1:]}
    relied = {name: _percent(frames, "relied on", name) for name in REGIONS}
    made: list[Block] = [
        f"{len(frames)} frames; {last['meshes']}. The rough surface has no surface in {share['holes']} of the "
        f"pixels, and {share['silhouettes']} lie beside a silhouette.",
        f"Relighting fidelity is judged where the accurate surface is relied on: in {relied['all']} of the pixels, "
        f"{relied['holes']} of those in holes, {relied['silhouettes']} of those beside silhouettes and "
        f"{relied['elsewhere']} of the others. The first two benchmarks are judged everywhere.",
    ]
    if np.mean([row["relied on"]["all"] for row in frames]) < LITTLE_SHARE:
        made.append("That is little. Are the accurate surface and the frames' depth aligned?")
    made.append(directions(frames))
    for benchmark in BENCHMARKS:
        made += [whole(frames, benchmark), by_region(frames, benchmark)]
    made += [
        Plot("benchmarks", "Medians over frames of all pixels, with their 95 % intervals.", figure(frames)),
        Picture(folder / "contact_sheet.png", "Under two colours. White: where the accurate surface is relied on."),
    ]
    return made


def methods(frames: Sequence[Row], benchmark: str) -> list[tuple[str, str]]:
    """(group, method) in the order of the tables."""
    return [(group, name) for group, found in frames[0]["scores"][benchmark].items() for name in found]


def summary(
    frames: Sequence[Row], benchmark: str, group: str, method: str, region: str, metric: str
) -> Middle | None:
    return middle([pick(row, "scores", benchmark, group, method, region, metric) for row in frames])


def whole(frames: Sequence[Row], benchmark: str) -> Table:
    """One benchmark over all pixels, with the paper's own figures."""
    rows = []
    for group, method in methods(frames, benchmark):
        cells = [text_of(summary(frames, benchmark, group, method, "all", metric), metric) for metric in METRICS]
        own = {BARE: 0, METHODS["paper"]: 1}.get(method) if group == "display values" else None
        theirs = ["" if own is None else f"{values[own]:.4f}" for values in PAPER[benchmark].values()]
        rows.append([f"{method}, times {group}", *cells, *theirs])
    header = ["", *(metric.label for metric in METRICS.values())]
    header += [f"the paper's {METRICS[name].label}" for name in PAPER[benchmark]]
    where = POINT[frames[0]["settings"].get("point", "view")] if benchmark == "mesh error correction" else ""
    over = f"median over {len(frames)} frames (95 % interval)"
    return Table(f"{benchmark.capitalize()} at {size_of(frames)}: {over}{where}.", header, rows)


def by_region(frames: Sequence[Row], benchmark: str) -> Table:
    """The same split by kind of pixel."""
    rows = []
    for group, method in methods(frames, benchmark):
        cells = []
        for metric in METRICS:
            for region in REGIONS[1:]:
                found = summary(frames, benchmark, group, method, region, metric)
                cells.append("–" if found is None else f"{found.median:.{METRICS[metric].digits}f}")
        rows.append([f"{method}, times {group}", *cells])
    header = ["", *(f"{metric.label} {region}" for metric in METRICS.values() for region in REGIONS[1:])]
    caption = f"{benchmark.capitalize()} at {size_of(frames)}, by kind of pixel: medians over frames."
    return Table(caption, header, rows)


def directions(frames: Sequence[Row]) -> Table:
    """Change by refinement from the bare mesh, here and in the paper."""
    rows = []
    for benchmark in BENCHMARKS:
        for metric, (bare, refined) in PAPER[benchmark].items():
            changes = []
            for mode, group in OWN_GROUP.items():
                both = BARE, METHODS[mode]
                pairs = [[pick(r, "scores", benchmark, group, m, "all", metric) for m in both] for r in frames]
                changes.append(middle([after - before for before, after in pairs if None not in (before, after)]))
            cells = ["–" if change is None else change.text(4, sign="+") for change in changes]
            verdict = _verdict(changes[0], refined - bare)
            rows.append([f"{benchmark}, {METRICS[metric].label}", f"{refined - bare:+.4f}", *cells, verdict])
    header = ["change against the bare mesh", "the paper's table", "paper's method", "ours", "same direction"]
    caption = (
        f"Does the paper's comparison reproduce? Refined minus bare at {size_of(frames)}, median over "
        f"{len(frames)} frames (95 % interval). {better_text()}. The last column is of the paper's method; open: "
        "the interval holds 0, or there are too few frames."
    )
    return Table(caption, header, rows)


def figure(frames: Sequence[Row]) -> Any:
    """The paper's metrics of every method: a column of panels for each benchmark, a bar for each method."""
    names = methods(frames, next(iter(BENCHMARKS)))
    fig = new_figure(13, 8)
    axes = fig.subplots(2, len(BENCHMARKS), squeeze=False, sharey=True, sharex="row")
    for column, benchmark in enumerate(BENCHMARKS):
        axes[0, column].set_title(benchmark)
        for ax, metric in zip(axes[:, column], PAPER[benchmark]):
            for y, (group, method) in enumerate(names):
                found = summary(frames, benchmark, group, method, "all", metric)
                if found is not None:
                    ax.barh(y, found.median, color=GROUP_COLORS[group], alpha=0.85)
                    if found.low is not None:
                        ax.plot([found.low, found.high], [y, y], color="0.2", linewidth=1)
            ax.set_yticks(range(len(names)), [method for _, method in names], fontsize=8)
            ax.set_xlabel(f"{METRICS[metric].label}, {METRICS[metric].better} is better")
    axes[0, 0].invert_yaxis()
    bars = [Patch(color=color, alpha=0.85, label=f"times {group}") for group, color in GROUP_COLORS.items()]
    interval = Line2D([], [], color="0.2", linewidth=1, label="95 % interval")
    fig.legend(handles=[*bars, interval], loc="outside lower center", ncols=3, fontsize=8)
    return fig


def _percent(frames: Sequence[Row], kind: str, name: str) -> str:
    found = summarise([pick(row, kind, name) for row in frames])
    return "–" if found is None else f"{100 * found.mean:.0f} %"


def _verdict(change: Middle | None, theirs: float) -> str:
    """Whether the change has the direction of the paper's."""
    if change is None or change.low is None or change.high is None or change.low <= 0.0 <= change.high:
        return "open"
    return "yes" if (change.median > 0) == (theirs > 0) else "no"
