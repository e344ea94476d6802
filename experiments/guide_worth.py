"""κ of each guide, and its gain in relit frames, between no guide and one that knows every border.

    python -m experiments.guide_worth [--capture PATH] [--guide small] [--out results/guide_worth/room]

It is the third benchmark of `paper`, relighting fidelity, with κ chosen for each guide and mode on tuning
frames; the last quarter of the capture is held out. The RGB guide is also tried with conductances of the pooled
guide, as the paper's equation has them and not its text, and with the norm of Metzger et al.'s code. *None* lets
light flow everywhere; *the surface* has the normals and the logarithm of the depth of the accurate surface for
features, so its borders are those of what the relit frame is judged by: a network can hardly be expected to do
better. What lies between the two is what guides are about.

Takes two minutes on two cores, once the capture's surfaces are made.

Expect: no guide worth more than the surface, and the distance from the RGB guide to it smaller than that from none
to the RGB guide: what is left is lost by the rough surface and by the cascade, not for want of borders. Curves are
flat around their tops, and poolings and norms lie close together."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import Array, Float
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import Start, experiment, run
from experiments.judging import middle, summarise, tuning_curve
from experiments.paper_bench import METHODS, OWN_GROUP, RAW_SCHEDULE, Bench, BenchConfig
from experiments.paper_view import View, linear_filter, multiplied
from experiments.plotting import panels
from experiments.records import Row, of_kind
from hyjax.core.schedule import Schedule
from hyjax.data.frames import spread
from hyjax.guide.choose import RGB, ReducedGuide, open_guide
from hyjax.metrics import psnr

LIGHTS = "two-colors"
KAPPAS = (0.0001, 0.0003, 0.0006, 0.00125, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
NONE, SURFACE = "none", "the surface"
POOLED, MEAN_ABS = "rgb, pooled guide", "rgb, mean of |Δ|"
NORMAL_WEIGHT = 0.1
"""Weight of normals relative to the logarithm of depth in the features: a right angle counts as 14 % of depth."""
HOLE_DEPTH = 10.0
"""Metres, in place of the depth where the accurate surface has a hole."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(BenchConfig):
    guide: str = "small"
    """Learned guide: name of shipped weights, or a file; see `hyjax relight --guide`."""
    schedule: str = "paper-80"
    frames: int = 6
    """How many tuning frames, and as many held out."""
    seed: int = 0
    """Of the built-in room and of the simulated scan."""


@experiment("What a guide is worth", "score")
def main(config: Config, start: Start) -> None:
    schedule, learned = Schedule.preset(config.schedule), open_guide(config.guide)
    reduced = ReducedGuide(learned)
    capture, results = config.start(start)
    first_held = len(capture) - max(1, len(capture) // 4)
    splits = {
        "tuning": spread(range(first_held), config.frames),
        "held-out": spread(range(first_held, len(capture)), config.frames),
    }

    schedules = {
        POOLED: dataclasses.replace(schedule, pooling="guide"),
        MEAN_ABS: dataclasses.replace(schedule, norm="mean_abs"),
    }

    def score(bench: Bench, split: str, view: View, guide: str, kappas: dict[str, Sequence[float]]) -> None:
        target = bench.relight(view, LIGHTS, "linear", RAW_SCHEDULE, accurate=True).shading
        for mode, group in OWN_GROUP.items():
            for kappa in kappas[mode]:
                relit = bench.relight(view, LIGHTS, mode, schedules.get(guide, schedule), kappa=kappa)
                found = multiplied(view, linear_filter(relit, mode), group)
                decibels = float(psnr(found, multiplied(view, target, group), valid=view.valid))
                row = {"capture": capture.name, "split": split, "frame": view.frame.name, "method": METHODS[mode]}
                results.add(kind="score", **row, guide=guide, kappa=kappa, psnr=decibels)

    with dataclasses.replace(config, guide=RGB.name).bench(capture, schedule) as bench:
        for split, indices in splits.items():
            for view in bench.views(indices, split):
                guides = {
                    NONE: jnp.zeros((*view.display.shape[:2], 1)),
                    RGB.name: view.display,
                    POOLED: view.display,
                    MEAN_ABS: view.display,
                    learned.name: learned.features(view.display),
                    reduced.name: reduced.features(view.display),
                    SURFACE: surface_features(view),
                }
                for name, features in guides.items():
                    tried = KAPPAS if name != NONE else KAPPAS[:1]
                    kappas: dict[str, Sequence[float]] = dict.fromkeys(METHODS, tried)
                    if split == "held-out":
                        kappas = {mode: (best(results.rows, METHODS[mode], name),) for mode in METHODS}
                    score(bench, split, dataclasses.replace(view, guide=features), name, kappas)


def surface_features(view: View) -> Float[Array, "h w 4"]:
    """Features that change where the accurate surface ends or turns."""
    seen = view.accurate
    depth = jnp.log(jnp.where(seen.hit, seen.depth, HOLE_DEPTH))
    return jnp.concatenate([NORMAL_WEIGHT * seen.normal, depth[..., None]], axis=-1)


def best(rows: Sequence[Row], method: str, guide: str) -> float:
    """The κ with the highest mean on the tuning frames."""
    means = curve(rows, method, guide)
    return max(means, key=means.__getitem__)


def curve(rows: Sequence[Row], method: str, guide: str) -> dict[float, float]:
    """κ → mean PSNR on the tuning frames."""
    return tuning_curve(_of(rows, method, guide))


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    scores = of_kind(rows, "score")
    held = [row for row in scores if row["split"] == "held-out"]
    lines = []
    for method in METHODS.values():
        rgb = {row["frame"]: row["psnr"] for row in _of(held, method, RGB.name)}
        for guide in dict.fromkeys(row["guide"] for row in scores):
            own, chosen = _of(held, method, guide), best(scores, method, guide)
            level = middle([row["psnr"] for row in own])
            gain = summarise([row["psnr"] - rgb[row["frame"]] for row in own])
            cells = ["" if x is None else x.text(2) for x in (level, gain)]
            tuned = f"{curve(scores, method, guide)[chosen]:.2f}"
            lines.append([f"{method}, {guide}", "" if guide == NONE else f"{chosen:g}", tuned, *cells])
    counts = [len({row["frame"] for row in scores if row["split"] == split}) for split in ("tuning", "held-out")]
    caption = (
        f"{scores[0]['capture']}: PSNR of relit frames against those of the accurate surface; "
        f"{scores[0]['settings']['schedule']}; mean over {counts[0]} tuning frames, on which κ is chosen; median "
        f"over {counts[1]} held-out ones (95 % interval), and mean of the gain ± half of its 95 % interval."
    )
    header = ["method, guide", "best kappa", "tuning dB", "held-out dB", "more than rgb, dB"]
    return [Table(caption, header, lines), Plot(main.name, "PSNR on the tuning frames against κ.", figure(scores))]


def figure(scores: Sequence[Row]) -> Figure:
    """A panel for each method, a curve for each guide; without a guide there is one point."""
    guides = dict.fromkeys(row["guide"] for row in scores)
    shown = {}
    for method in METHODS.values():
        means = {guide: curve(scores, method, guide) for guide in guides}
        shown[method] = {guide: (list(m), list(m.values())) for guide, m in means.items()}
    return panels(shown, xscale="log", xlabel="kappa", ylabel="PSNR on tuning frames, dB")


def _of(rows: Sequence[Row], method: str, guide: str) -> list[Row]:
    return [row for row in of_kind(rows, "score") if (row["method"], row["guide"]) == (method, guide)]


if __name__ == "__main__":
    run(main)
