"""Is a guide better trained through the cascade, as the pipeline runs it, or through many steps, as the paper does?

    python -m experiments.train_through [--updates 200] [--out results/train_through]

Two small guides start from the same random weights and see the same crops, and super-resolve the same tinted depth
and shading; neither is told where borders are. One learns through `paper-50`, the other through a random number of
full-size steps without gradient and some more with it. Both are then judged on rooms that neither has seen as
`depth_sr` judges guides: with full-size steps and through the cascade, the RGB guide beside them.

Takes about ten minutes on two cores, besides the rooms. After so few updates of so small crops neither is a good
guide: what is compared is how far each has come, in how much time.

Expect: little between the two after so few updates, and neither ahead of the RGB guide yet."""

import dataclasses
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments import depth_sr
from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import summarise
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from hyjax.pairs.registry import open_pairs
from hyjax.training.run import train
from hyjax.training.settings import Through, TrainSettings
from hyjax.util.clock import StageClock

THROUGH: tuple[Through, ...] = ("cascade", "steps")


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    pairs: tuple[str, ...] = ("rooms?frames=0:320&cached=yes",)
    """Trained on."""
    tuning: tuple[str, ...] = ("rooms?seed=1002&frames=0:32:4",)
    """κ is chosen on."""
    reported: tuple[str, ...] = ("rooms?seed=1001&frames=0:64:4",)
    updates: int = 200
    batch: int = 4
    encoder: str = "mobilenetv4_conv_small"
    features: int = 8
    size: int = 128
    """Of crops and of reported tiles, in pixels a side."""
    factors: tuple[int, ...] = (8, 16)
    """How much coarser sources are, trained with and judged with."""
    steps: int = 500
    """At full size: at most so many without gradient, and so many where guides are judged."""
    steps_with_gradient: int = 64
    seed: int = 0


@experiment("Training through the cascade or through many steps")
def main(config: Config, start: Start) -> None:
    settings = TrainSettings(
        encoder=config.encoder,
        features=config.features,
        pairs=config.pairs,
        size=config.size,
        batch=config.batch,
        iterations=config.updates,
        factors=config.factors,
        steps_without_gradient=config.steps,
        steps_with_gradient=config.steps_with_gradient,
        border_weight=0.0,
        decay_every=max(1, config.updates // 20),
        validate_every=config.updates,
        checkpoint_every=config.updates,
        seed=config.seed,
    ).check()
    results = start()
    for pairs in map(open_pairs, config.pairs):
        for number in range(min(len(pairs), config.updates * config.batch)):
            pairs[number]  # so that neither run is the one that renders them
    files = []
    for through in THROUGH:
        folder, clock = results.out / "runs" / through, StageClock()
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier run of this experiment
        with clock("run"):
            train(dataclasses.replace(settings, through=through), folder)
        lines = [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]
        losses = [line["loss"] for line in lines if "loss" in line]
        results.add(kind="run", through=through, seconds=clock.seconds["run"][0], losses=losses)
        files.append(results.out / f"{through}.safetensors")
        shutil.copyfile(folder / "last.safetensors", files[-1])
    judged = depth_sr.Config(
        pairs=config.reported,
        tuning=config.tuning,
        guides=("rgb", *map(str, files)),
        factors=config.factors,
        steps=config.steps,
        tile=config.size,
        peers=False,
        out=results.out / "depth_sr",
    )
    for row in of_kind(depth_sr.main(judged), "score"):
        pair = f"{row['pairs']} {row['pair']}"  # names are those of one source
        results.add(kind="score", pair=pair, **{key: row[key] for key in ("tile", "factor", "method", "mse")})


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    runs, scores = of_kind(rows, "run"), of_kind(rows, "score")
    if not scores:
        return ["No guide has been judged yet."]
    groups = depth_sr.by_method(scores)
    factors = list(dict.fromkeys(factor for factor, _ in groups))
    lines = []
    for method in dict.fromkeys(name for _, name in groups):
        if method != "bicubic":
            lines.append([method, *(_of_bicubic(groups, factor, method) for factor in factors)])
    seconds = ", ".join(f"{row['seconds']:.0f} s through {row['through']}" for row in runs)
    tiles = len({(row["pair"], row["tile"]) for row in scores})
    caption = (
        f"RMSE over bicubic interpolation's on {tiles} tiles of rooms that were not trained on, mean over pairs "
        "± half of the 95 % interval; guides are named by what they were "
        f"trained through. Training took {seconds}, compilation and validation included."
    )
    header = ["guide, used by", *(f"x{factor}" for factor in factors)]
    return [
        Table(caption, header, lines),
        Plot("loss", "Training loss, each run's own, means of ten updates.", figure(runs)),
    ]


def _of_bicubic(groups: dict[tuple[int, str], list[Row]], factor: int, method: str) -> str:
    own, bicubic = (depth_sr.per_pair(groups[factor, name], "mse") for name in (method, "bicubic"))
    found = summarise([float(np.sqrt(own[pair] / bicubic[pair])) for pair in own if bicubic[pair] > 0])
    return "–" if found is None else found.text(3)


def figure(runs: Sequence[Row]) -> Figure:
    """Loss over updates."""
    fig = new_figure(6, 4)
    axes = fig.subplots()
    for row in runs:
        whole = np.asarray(row["losses"][: len(row["losses"]) // 10 * 10], float).reshape(-1, 10)
        axes.plot(10 * np.arange(1, len(whole) + 1), whole.mean(axis=1), label=f"through {row['through']}")
    axes.set(xlabel="updates", ylabel="training loss", yscale="log")
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
