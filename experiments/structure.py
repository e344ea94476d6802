"""The paper's explanatory figure: noise in, structure out.

    python -m experiments.structure [--capture PATH] [--frame 0] [--out results/structure/room]

A filter of pure noise, one grey value a pixel, is diffused under the frame's guidance. What comes out is all the
guide's: flat within surfaces, with steps at their borders. Shown after 10 to 10 000 steps at half size and after
the paper's 80 cascaded ones. Takes seconds. Tabled: the share of the filter's variance that is left, and the share
of what is left that lies between the frame's own segments (Felzenszwalb and Huttenlocher, 2004) instead of within
them.

Expect: the variance falls by orders of magnitude, and what is left moves to between the segments; the cascade
comes as far as hundreds of steps at half size."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int
from skimage.segmentation import felzenszwalb

import hyjax
from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import check_size
from experiments.records import Row
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.data.frames import fit, select_frames
from hyjax.data.registry import open_capture
from hyjax.util.contact_sheet import write_contact_sheet

STEPS = (10, 100, 1000, 10_000)


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """Default: the built-in room."""
    frame: int = 0
    size: int = 512
    """Pixels a side."""
    kappa: float = PAPER_KAPPA
    seed: int = 0
    """Of the noise."""


@experiment("Noise in, structure out")
def main(config: Config, start: Start) -> None:
    check_size(config.size)
    capture = open_capture(config.capture)
    (index,) = select_frames(str(config.frame), len(capture))
    results = start(capture.name)
    guide = fit(capture.picture(index), (config.size, config.size)).image
    segments = felzenszwalb(guide, scale=100, sigma=0.8, min_size=50)
    noise = jax.random.uniform(jax.random.key(config.seed), (config.size, config.size, 1))
    schedules = {f"{n} steps": Schedule.uniform([(2, n)], kappa=config.kappa) for n in STEPS}
    schedules["paper-80"] = Schedule.preset("paper-80", kappa=config.kappa)
    diffused = {"noise": noise} | {name: hyjax.cascade(noise, guide, s) for name, s in schedules.items()}
    for name, value in diffused.items():
        results.add(kind="spread", schedule=name, **spread(np.asarray(value)[..., 0], segments))
    pictures = [guide, *(stretched(np.asarray(value)) for value in diffused.values())]
    write_contact_sheet(results.out / "structure.png", [(f"frame {index}", pictures)], ["guide", *diffused])


def spread(value: Float[np.ndarray, "h w"], segments: Int[np.ndarray, "h w"]) -> dict[str, float]:
    """Variance of a filter, and the share of it between segments."""
    count = np.bincount(segments.ravel())
    means = np.bincount(segments.ravel(), weights=value.ravel()) / np.maximum(count, 1)
    total = float(value.var())
    return {"variance": total, "between": float(np.var(means[segments]) / total)}


def stretched(value: Float[np.ndarray, "h w 1"]) -> Float[np.ndarray, "h w 3"]:
    """A grey picture whose darkest and brightest percent are black and white."""
    low, high = np.percentile(value, [1, 99])
    return np.repeat(np.clip((value - low) / max(high - low, 1e-9), 0.0, 1.0), 3, axis=-1)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    spreads: list[Any] = [row for row in rows if row.get("kind") == "spread"]
    start = spreads[0]["variance"] if spreads else 1.0
    lines = [
        [row["schedule"], f"{100 * row['variance'] / start:.3g} %", f"{100 * row['between']:.0f} %"]
        for row in spreads
    ]
    header = ["", "variance left", "of it between segments"]
    return [
        Table("Noise, diffused under the guidance of a frame.", header, lines),
        Picture(folder / "structure.png", "Each filter stretched to the whole range of grey."),
    ]


if __name__ == "__main__":
    run(main)
