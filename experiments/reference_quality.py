"""Quality of a cleaned fusion as a reference: on the built-in room, where the truth is known.

    python -m experiments.reference_quality [--out results/reference_quality]

The room's depth is rendered along a walk, spoilt as a Kinect spoils it, fused at 2 cm and cleaned with more or
fewer passes (`experiments.references`). Frames relit by two coloured points with the filter of that surface are
compared with the same frames relit by the true mesh: over all pixels, and over those that are relied on. What is
chosen here is used as the reference for captures without a truth. Takes about four minutes on two cores.

Expect: the mask gains more than the smoothing, and much smoothing loses again in PSNR and LPIPS by rounding off
what has edges."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import hyjax
from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import check_size, judge, summarise
from experiments.records import Row
from experiments.references import VOXEL, cleaned
from hyjax.data.builtin_room import load_room
from hyjax.data.frames import fit
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.scan import RenderedDepths, ScanConfig, simulate_sensor
from hyjax.geometry.tsdf import fuse
from hyjax.light.gbuffer import GBuffer
from hyjax.metrics import METRICS, load_lpips
from hyjax.scene.light_places import survey_capture
from hyjax.scene.light_setups import named_setup
from hyjax.synthetic.room import path

KINECT = ScanConfig(
    width=640, noise=0.0015, noise_grain=0.8, jitter=0.5, step=0.0028, drift=0.002, turn=0.001, max_depth=4.0
)
"""Khoshelham and Elberink, *Accuracy and resolution of Kinect depth data*, Sensors 2012: 1.5 mm of noise and 2.8 mm
between values at 1 m, both growing with the square."""
PASSES = ((0, 0), (0, 2), (0, 4), (1, 2), (1, 4), (2, 4), (4, 4), (4, 16))


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    frames: int = 6
    """How many pictures to judge, of the first three quarters of the walk."""
    views: int = 120
    """How many depth maps to fuse."""
    size: int = 512
    """Pixels a side."""
    weights: Path | None = None
    """LPIPS weights. Default: those converted of the extra `lpips`."""
    seed: int = 0
    """Of the depth maps' noise."""


@experiment("How good a cleaned fusion is as a reference")
def main(config: Config, start: Start) -> None:
    check_size(config.size)
    weights = load_lpips(config.weights)
    results = start()
    room = load_room()
    depths = RenderedDepths(room.reference(), path.camera_path(config.views, KINECT.width, 480))
    mesh = fuse(
        (simulate_sensor(depths[i], KINECT, np.random.default_rng((config.seed, i))) for i in range(config.views)),
        VOXEL,
    )
    truth = RayCaster(room.reference())
    setup = named_setup("two-colors", survey_capture(truth, room))
    chosen = np.linspace(0, 0.75 * len(room) - 1, config.frames).astype(int)
    frames = [fit(room[int(i)], (config.size, config.size)) for i in chosen]

    def relit(image: Any, gbuffer: GBuffer) -> Any:
        shading = hyjax.shade(gbuffer, setup.lights) / setup.reference_lux
        return jnp.clip(hyjax.to_display(hyjax.to_linear(image) * shading), 0.0, 1.0)

    for relaxing, smoothing in tqdm(PASSES, desc="cleaning", unit="surface"):
        reference = cleaned("fused", mesh, relaxing, smoothing)
        for frame in frames:
            image, true, made = (
                jnp.asarray(frame.image),
                truth.gbuffer(frame.camera),
                reference.gbuffer(frame.camera),
            )
            # The frame's depth is dropped: rendered from the truth, it would tell what a sensor cannot.
            reliable = reference.reliable(frame, frame.camera, made)
            both = np.asarray(true.hit & made.hit)
            regions = {"all": both, "relied on": both & reliable}
            found = judge({"relit": relit(image, made)}, relit(image, true), regions, weights)["relit"]
            values = {
                "relaxing": relaxing,
                "smoothing": smoothing,
                "scores": found,
                "share": float(reliable.mean()),
            }
            results.add(kind="score", frame=frame.name, **values)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """The table from the rows."""
    scores = [row for row in rows if row.get("kind") == "score"]
    lines = []
    for passes in PASSES:
        own = [row for row in scores if (row["relaxing"], row["smoothing"]) == passes]
        cells = [f"{100 * np.mean([row['share'] for row in own]):.0f} %"] if own else ["–"]
        for metric, shown in METRICS.items():
            for region in ("all", "relied on"):
                found = summarise([row["scores"].get(region, {}).get(metric) for row in own])
                cells.append("–" if found is None else f"{found.mean:.{shown.digits}f}")
        lines.append(["{} over vertices, {} over normals".format(*passes), *cells])
    header = ["passes", "relied on"]
    header += [f"{metric.label}, {region}" for metric in METRICS.values() for region in ("all", "relied on")]
    count = len({row["frame"] for row in scores})
    return [
        Table(f"The true mesh's relit frames against those of a cleaned fusion, {count} frames.", header, lines)
    ]


if __name__ == "__main__":
    run(main)
