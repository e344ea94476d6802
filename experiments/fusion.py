"""Time and memory of fusing all depth maps of a capture.

    python -m experiments.fusion --capture PATH [--voxel 0.02] [--frames 20000] [--out results/fusion]

Takes well under a minute for the 300 frames of the red kitchen on two cores. With more frames than the capture has
it is walked to and fro, as a long capture of one place: memory must not grow after the first walk.

Expect: a line with time and memory, and a picture of the surface, lit from the camera, as four of the frames see
it: walls and furniture whole, dark red where no frame has seen a surface.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.data.frames import spread
from hyjax.data.registry import open_capture
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.tsdf import fuse
from hyjax.scene.fusion import Readings, plan_fusion
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.util.clock import Stopwatch
from hyjax.util.environment import peak_memory_mib
from hyjax.util.images import write_png


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path
    voxel: float = 0.02
    frames: int | None = None
    """How many depth maps. Default: those of the capture."""


MEMORY = "MiB after a tenth, half, all"


class Walk:
    """Depth maps of a capture, to and fro, with the peak memory of this process after each tenth of them."""

    def __init__(self, readings: Readings, count: int) -> None:
        self.memory: list[float] = []
        self._readings, self._count = readings, count

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[DepthReading]:
        for number, reading in enumerate(self._readings, start=1):
            yield reading
            if number % max(1, self._count // 10) == 0:
                self.memory.append(round(peak_memory_mib(), 1))


@experiment("Fusing the depth maps of a capture")
def main(config: Config, start: Start) -> None:
    capture = open_capture(config.capture)
    results = start()
    plan = plan_fusion(capture, FusionSettings(voxel=config.voxel, fuse_frames=0))
    count = config.frames or capture.depth_count
    there = [*range(capture.depth_count), *range(capture.depth_count - 2, 0, -1)]
    walk = Walk(Readings(capture, list(itertools.islice(itertools.cycle(there), count)), plan.confidence), count)
    watch = Stopwatch()
    mesh = fuse(walk, plan.voxel, plan.truncation, plan.far, plan.min_weight)
    results.add(
        kind="fusion",
        capture=capture.name,
        frames=count,
        faces=len(mesh.faces),
        seconds=watch.seconds,
        memory_mib=walk.memory,
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
    lines = [
        [
            row["capture"],
            str(row["frames"]),
            str(row["faces"]),
            f"{row['seconds']:.1f}",
            " ".join(f"{row['memory_mib'][k]:.0f}" for k in (0, len(row["memory_mib"]) // 2, -1)),
            peak,
        ]
        for row in fused
    ]
    conditions = [f"; voxels of {100 * row['settings']['voxel']:g} cm; {machine(row)}" for row in fused]
    caption = f"TSDF fusion of all depth maps, reading included{''.join(conditions)}."
    return [
        Table(
            caption,
            ["capture", "frames", "triangles", "seconds", "MiB after a tenth, half, all", "peak MiB"],
            lines,
        ),
        Picture(folder / "fusion.png", "The surface, lit from the camera. Dark red: no surface."),
    ]


if __name__ == "__main__":
    run(main)
