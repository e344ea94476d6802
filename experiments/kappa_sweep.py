"""Which κ, pooling and norm: fidelity of the relit frame on tuning frames, and of the winner on held-out frames.

    python -m experiments.kappa_sweep [--capture PATH] [--out results/kappa_sweep/room]

Takes about a minute on two cores, once the capture's surfaces are made. It is the third benchmark of
`paper_table`, relighting fidelity, on other frames: PSNR against the frame relit by the accurate surface under two
coloured points, where that is relied on; each mode multiplies as it is meant to. The last quarter of the capture
is held out: nothing is chosen on those frames.

Expect: our mode above the paper's, and the paper's above the bare mesh. The variants lie close together, and the
curves are flat around their tops; a κ far above its best costs ours more on a noisy capture than in the room."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

from experiments.blocks import Block, Plot, Table
from experiments.command import Start, experiment, run
from experiments.judging import tuning_curve
from experiments.paper_bench import ANY, METHODS, OWN_GROUP, BenchConfig
from experiments.paper_view import View, linear_filter, mean_colour, multiplied
from experiments.plotting import panels
from experiments.records import Row, of_kind
from hyjax.core.diffusion import Norm
from hyjax.core.schedule import Pooling, Schedule
from hyjax.data.frames import spread
from hyjax.metrics import psnr
from hyjax.pipeline import Mode

LIGHTS = "two-colors"
KAPPAS = (0.0025, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.4)
VARIANTS: dict[str, tuple[Mode, Pooling, Norm]] = {
    "paper's method, edges, l2": ("paper", "edges", "l2"),
    "ours, edges, l2": ("linear", "edges", "l2"),
    "ours, guide, l2": ("linear", "guide", "l2"),
    "ours, edges, mean_abs": ("linear", "edges", "mean_abs"),
}
BASELINES = ("bare mesh", "mean colour")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(BenchConfig):
    schedule: str = "paper-80"
    frames: int = 4
    """How many tuning frames, and as many held out."""
    seed: int = 0
    """Of the built-in room and of the simulated scan."""


@experiment("Fidelity against κ, pooling and norm")
def main(config: Config, start: Start) -> None:
    schedule = Schedule.preset(config.schedule)
    capture, results = config.start(start)
    first_held = len(capture) - max(1, len(capture) // 4)
    tuning = spread(range(first_held), config.frames)
    held_out = spread(range(first_held, len(capture)), config.frames)

    def score(
        split: str, view: View, method: str, group: str, relight_filter: Float[Array, "h w 3"], **values: float
    ) -> None:
        target = multiplied(view, bench.relight(view, LIGHTS, "linear", ANY, accurate=True).shading, group)
        found = float(psnr(multiplied(view, relight_filter, group), target, valid=view.valid))
        row = {"capture": capture.name, "split": split, "frame": view.frame.name, "method": method, "group": group}
        results.add(kind="score", **row, psnr=found, **values)

    def score_variant(split: str, view: View, name: str, kappa: float) -> None:
        mode, pooling, norm = VARIANTS[name]
        own = dataclasses.replace(schedule, pooling=pooling, norm=norm)
        relit = bench.relight(view, LIGHTS, mode, own, kappa=kappa)
        score(split, view, name, OWN_GROUP[mode], linear_filter(relit, mode), kappa=kappa)

    with config.bench(capture, schedule) as bench:
        for view in bench.views(tuning, "sweep"):
            for name in VARIANTS:
                for kappa in KAPPAS:
                    score_variant("tuning", view, name, kappa)
        for index in held_out:
            view = bench.view(index)
            if view.blind:
                continue
            for name in VARIANTS:
                score_variant("held-out", view, name, best(results.rows, name)[0])
            bare = bench.relight(view, LIGHTS, "linear", ANY).shading
            for mode, group in OWN_GROUP.items():
                for name, flat in zip(BASELINES, (bare, mean_colour(view, bare, group))):
                    score("held-out", view, f"{name}, as {METHODS[mode]}", group, flat)


def curve(rows: Sequence[Row], method: str) -> dict[float, float]:
    """Mean PSNR on the tuning frames by κ."""
    return tuning_curve([row for row in of_kind(rows, "score") if row["method"] == method])


def best(rows: Sequence[Row], method: str) -> tuple[float, float]:
    """The κ with the highest mean PSNR on the tuning frames, and this."""
    return max(curve(rows, method).items(), key=lambda point: point[1])


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    scores = of_kind(rows, "score")
    if not scores:
        return ["No frame has been scored yet."]
    methods = list(dict.fromkeys(row["method"] for row in scores))
    lines = []
    for method in sorted(methods, key=lambda method: method in VARIANTS):
        kappa, decibels = best(rows, method) if method in VARIANTS else ("", None)
        held = [row["psnr"] for row in scores if (row["split"], row["method"]) == ("held-out", method)]
        chosen = [str(kappa), f"{decibels:.2f}" if decibels is not None else ""]
        lines.append([method, *chosen, f"{np.mean(held):.2f}" if held else "–"])
    frames = {
        split: len({row["frame"] for row in scores if row["split"] == split}) for split in ("tuning", "held-out")
    }
    caption = (
        f"PSNR of relit frames against those of the accurate surface; {scores[0]['settings']['schedule']}, mean "
        f"over {frames['tuning']} tuning frames, on which κ is chosen, and {frames['held-out']} held-out ones."
    )
    points = {method: curve(rows, method) for method in VARIANTS}
    curves = {method: (list(found), list(found.values())) for method, found in points.items()}
    figure = panels({"": curves}, xscale="log", xlabel="kappa", ylabel="PSNR, dB")
    header = [f"{scores[0]['capture']}: method, pooling, norm", "best kappa", "tuning dB", "held-out dB"]
    return [
        Table(caption, header, lines),
        Plot(
            main.name,
            "PSNR on the tuning frames against κ.",
            figure,
        ),
    ]


if __name__ == "__main__":
    run(main)
