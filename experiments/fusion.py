"""How long it takes to fuse all depth maps of a capture, and how much memory.

    python -m experiments.fusion --capture PATH [--voxel 0.02] [--out results/fusion]

Takes well under a minute for the 300 frames of the red kitchen on two cores. Writes `fusion.json` and the picture
`fusion.png`: the surface, lit from the camera, as four of the frames see it. Dark red: no surface.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np

from experiments.command import run
from hyjax.data.frames import spread
from hyjax.data.open import open_capture
from hyjax.environment import environment, peak_memory_mib
from hyjax.files import make_writable, write_text
from hyjax.images import write_png
from hyjax.scene.raycast import RayCaster
from hyjax.scene.tsdf import fuse
from hyjax.tuning.latency import StageClock


@dataclasses.dataclass(frozen=True)
class Config:
    capture: Path
    voxel: float = 0.02
    out: Path = Path("results/fusion")


def main(config: Config) -> None:
    make_writable(config.out)
    clock, capture = StageClock(), open_capture(config.capture)
    with clock("fuse, reading included"):
        mesh = fuse((capture[i] for i in range(len(capture))), config.voxel)
    record = {
        "frames": len(capture),
        "faces": len(mesh.faces),
        "seconds": clock.seconds["fuse, reading included"][0],
    }
    record |= {"peak_memory_mib": peak_memory_mib(), "config": str(config)} | environment()
    print({key: record[key] for key in ("frames", "faces", "seconds", "peak_memory_mib")})
    write_text(config.out / "fusion.json", json.dumps(record, indent=2) + "\n")
    caster, views = RayCaster(mesh), []
    for index in spread(range(len(capture)), 4):
        camera = capture[index].camera
        rays, seen = camera.rays(), caster.gbuffer(camera)
        facing = -np.sum(np.asarray(seen.normal) * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
        views.append(np.where(np.asarray(seen.hit)[..., None], np.clip(facing, 0, 1)[..., None], (0.3, 0.0, 0.0)))
    write_png(config.out / "fusion.png", np.concatenate(views, axis=1)[::2, ::2])


if __name__ == "__main__":
    run(main, Config)
