"""Report of `bench_peers` from its rows: tables, the roofline, and the guard's ratios."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind

OURS, PLAIN, TORCH, COMPILED, FLOOR = "hyjax", "hyjax, plain form", "torch", "torch, compiled", "C loop"
CHANNELS_LAST = "torch, channels last"
COPY = "copy in C"
SMOOTHER = "OpenCV fastGlobalSmootherFilter"


def guard(rows: Sequence[Row]) -> list[tuple[str, float, float, bool]]:
    """Ratios within the run: name, ratio, limit, whether it holds. A ratio that was not measured does not hold."""
    nan = math.nan
    steps = {(r["size"], r["channels"], r["who"]): r["median_ms"] for r in of_kind(rows, "step")}
    cascades = {(r["schedule"], r["who"]): r["median_ms"] for r in of_kind(rows, "cascade")}
    quality = {r["who"]: r["median_ms"] for r in of_kind(rows, "quality time")}
    guides = {(r["size"], r["who"]): r["median_ms"] for r in of_kind(rows, "guide")}
    ratios = [
        ("step at 256², 3 channels: hyjax / C loop", steps, (256, 3, OURS), (256, 3, FLOOR), 1.5),
        ("step at 256², 3 channels: hyjax / plain form", steps, (256, 3, OURS), (256, 3, PLAIN), 1.1),
        ("paper-50 at 512²: hyjax / torch", cascades, ("paper-50", OURS), ("paper-50", TORCH), 0.2),
        ("repair at 512²: hyjax / OpenCV's global smoother", quality, OURS, SMOOTHER, 1.0),
        ("guide at 256²: hyjax / torch", guides, (256, OURS), (256, TORCH), 1.0),
        ("guide at 512²: hyjax / torch", guides, (512, OURS), (512, TORCH), 1.0),
    ]
    found = [(what, times.get(a, nan) / times.get(b, nan), limit) for what, times, a, b, limit in ratios]
    differences = [row["difference"] for row in of_kind(rows, "agreement")]
    found.append(("largest difference of what is compared", max(differences, default=nan), 1e-3))
    return [(what, ratio, limit, ratio <= limit) for what, ratio, limit in found]


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figures from the rows."""
    conditions = of_kind(rows, "conditions")
    where = f"{machine(conditions[0])}, {conditions[0]['cores']} used"
    shown: list[Block] = [step_table(of_kind(rows, "step"), where)] if of_kind(rows, "step") else []
    cascades = [
        [row["schedule"], row["who"], f"{row['median_ms']:.2f}", f"{row['p95_ms']:.2f}"]
        for row in of_kind(rows, "cascade")
    ]
    shown.append(Table("Cascades at 512 x 512, 3 channels.", ["schedule", "by", "ms", "p95"], cascades, names=2))
    times = {row["who"]: row for row in of_kind(rows, "quality time")}
    quality = [
        [row["who"], " / ".join(f"{x:g}" for x in row["chosen"] or ()) + "*" * row["at_end"]]
        + [f"{row['psnr']:.2f}", f"{row['loss']:.4f}"]
        + (
            [f"{times[row['who']][key]:.1f}" for key in ("median_ms", "p95_ms")]
            if row["who"] in times
            else ["", ""]
        )
        for row in of_kind(rows, "quality")
    ]
    where = conditions[0].get("choose_on") or "its earlier frames"
    caption = (
        f"Repair of two lights at 512 x 512, judged on held-out frames ({conditions[0]['capture']}; "
        f"{conditions[0]['meshes']}); strengths chosen on {where}. *: at an end of what was tried."
    )
    shown.append(Table(caption, ["", "strength / reach", "PSNR dB", "loss", "ms", "p95"], quality))
    guides = [
        [f"{row['size']}²", row["who"], f"{row['median_ms']:.1f}", f"{row['p95_ms']:.1f}"]
        for row in of_kind(rows, "guide")
    ]
    shown.append(Table("The small guide network, 64 features.", ["picture", "by", "ms", "p95"], guides, names=2))
    ratios = [
        [what, f"{ratio:.2f}", f"{limit:g}", "yes" if holds else "NO"] for what, ratio, limit, holds in guard(rows)
    ]
    shown.append(Table("Ratios within this run.", ["", "ratio", "limit", "holds"], ratios))
    shown = [block for block in shown if not isinstance(block, Table) or block.rows]  # parts that were left out
    if of_kind(rows, "step"):
        caption = (
            "A step's operations a second against its operations a byte, counting every array once. Lines: what "
            "the bandwidth of a copy allows, at each size."
        )
        shown.append(Plot("roofline", caption, roofline(of_kind(rows, "step"))))
    return shown


def step_table(steps: Sequence[Row], where: str) -> Table:
    """Microseconds a step, the share of a copy's bandwidth, and the ratio to the floor."""
    rows = {(r["size"], r["channels"], r["who"]): r for r in steps}
    lines = []
    for (size, channels, who), row in rows.items():
        if who == COPY:
            continue
        copy, floor = rows[size, channels, COPY], rows[size, channels, FLOOR]
        share = (row["bytes"] / row["median_ms"]) / (copy["bytes"] / copy["median_ms"])
        times = [f"{1e3 * row[key]:.0f}" for key in ("median_ms", "p95_ms")]
        ratio = f"{row['median_ms'] / floor['median_ms']:.2f}"
        lines.append([f"{size}², {channels} channels", who, *times, f"{100 * share:.0f} %", ratio])
    header = ["picture", "by", "µs a step", "p95", "of a copy's bandwidth", "times the C loop"]
    return Table(f"One step of Eq. 2; {where}.", header, lines, names=2)


def roofline(steps: Sequence[Row]) -> Figure:
    """Operations a second against operations a byte."""
    fig = new_figure(7, 4.5)
    axes = fig.subplots()
    sizes = list(dict.fromkeys(row["size"] for row in steps))
    shapes = {OURS: "o", PLAIN: "s", TORCH: "x", COMPILED: "+", FLOOR: "^"}
    intensities = np.geomspace(0.5, 2.0, 2)
    for k, size in enumerate(sizes):
        copies = [r for r in steps if r["size"] == size and r["who"] == COPY]
        bandwidth = max(r["bytes"] / r["median_ms"] for r in copies) / 1e6
        axes.plot(intensities, bandwidth * intensities, color=f"C{k}", label=f"copy at {size}²", lw=1)
        for row in steps:
            if row["size"] == size and row["who"] in shapes:
                intensity, rate = row["operations"] / row["bytes"], row["operations"] / row["median_ms"] / 1e6
                axes.plot(intensity, rate, shapes[row["who"]], color=f"C{k}", fillstyle="none")
    for who, shape in shapes.items():
        axes.plot([], [], shape, color="k", fillstyle="none", label=who)
    axes.set(xscale="log", yscale="log", xlabel="operations a byte", ylabel="gigaoperations a second")
    axes.legend(fontsize=7, ncols=2)
    return fig
