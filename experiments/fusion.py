"""Time and memory of fusing all depth maps of a capture.

    python -m experiments.fusion --capture PATH [--voxel 0.02] [--out results/fusion]

Takes well under a minute for the 300 frames of the red kitchen on two cores.

Expect: a line with time and memory, and a picture of the surface, lit from the camera, as four of the frames see
it: walls and furniture whole, dark red where no frame has seen a surface.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.data.frames import spread
from hyjax.data.registry import open_capture
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.tsdf import fuse
from hyjax.util.clock import Stopwatch
from hyjax.util.images import write_png


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path
    voxel: float = 0.02


@experiment("Fusing the depth maps of a capture")
def main(config: Config, start: Start) -> None:
    capture = open_capture(config.capture)
    results = start()
    watch = Stopwatch()
    mesh = fuse((capture[i] for i in range(len(capture))), config.voxel)
    results.add(
        kind="fusion", capture=capture.name, frames=len(capture), faces=len(mesh.faces), seconds=watch.seconds
    )
    caster, views = RayCaster(mesh), []
    for index in spread(range(len(capture)), 4):
        camera = capture[index].camera
        rays, seen = camera.rays(), caster.gbuffer(camera)
        facing = -np.sum(np.asarray(seen.normal) * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
        views.append(np.where(np.asarray(seen.hit)[..., None], np.clip(facing, 0, 1)[..., None], (0.3, 0.0, 0.0)))
    write_png(results.out / "fusion.png", np.concatenate(views, axis=1)[::2, ::2])


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    peak = next((str(row["peak_memory_mib"]) for row in of_kind(rows, "finished")), "–")
    fused = of_kind(rows, "fusion")
    lines = [[r["capture"], str(r["frames"]), str(r["faces"]), f"{r['seconds']:.1f}", peak] for r in fused]
    conditions = [f"; voxels of {100 * row['settings']['voxel']:g} cm; {machine(row)}" for row in fused]
    caption = f"TSDF fusion of all depth maps, reading included{''.join(conditions)}."
    return [
        Table(caption, ["capture", "frames", "triangles", "seconds", "peak memory MiB"], lines),
        Picture(folder / "fusion.png", "The surface, lit from the camera. Dark red: no surface."),
    ]


if __name__ == "__main__":
    run(main)
