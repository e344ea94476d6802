"""Borders, coverage and time of fused depth, judged by depth maps that were not fused, for hyjax and Open3D.

    python -m experiments.fusion_borders [--capture PATH] [--voxel 0.02] [--out results/fusion_borders]

Every second depth map is fused, the others judge. Near jumps of depth, readings of the far side that a mesh hides
are *bloated*, readings of the near side that it lacks are *eroded*; only readings of full confidence judge. Without
a capture it is the built-in room: the depth maps of its simulated headset are fused, the true ones judge.

Open3D's `VoxelBlockGrid` takes part where the package open3d is installed (it is no dependency: its wheel has
400 MB). Takes half a minute for 70 depth maps on two cores.

A phone's poses drift: in one row more the fused maps are registered to each other and the judges to their surface.

Expect: aligned poses are worth more than all else. Weights by confidence erode less than none; a band of three
voxels in place of four bloats less. Open3D is given the same readings, those of no confidence taken out, with the
same range and band.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy import ndimage

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.data.frames import spread
from hyjax.data.registry import open_capture
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.registration import register, registered
from hyjax.geometry.scan import simulate_sensors
from hyjax.geometry.tsdf import fuse
from hyjax.scene.fusion import Readings, plan_fusion
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.util.clock import Stopwatch
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

JUMP = 0.15
"""Metres between near and far, within `BORDER_PIXELS` pixels of a reading, from which it counts as at a border."""
BORDER_PIXELS = 9
WRONG_METRES = 0.05
"""Metres by which a mesh is before or behind a reading to hide or to lack it."""
JUDGES = 20
OPEN3D_BLOCKS = 40_000
OPEN3D_VIEWS = 1.0
"""Views that a voxel must have; with Open3D's default of 3 it covers less."""
Make = Callable[[Sequence[DepthReading]], trimesh.Trimesh]


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """With depth. Default: the built-in room."""
    voxel: float = 0.02
    """Of all fusions, metres."""
    rounds: int = 3
    """How often each is timed; the median counts."""


@experiment("Fused surfaces beside held-out depth")
def main(config: Config, start: Start) -> None:
    capture = open_capture(config.capture)
    fused, judges = _depth_maps(capture)
    plan = plan_fusion(capture, FusionSettings(voxel=config.voxel, fuse_frames=0))
    results = start()
    made: dict[str, trimesh.Trimesh] = {}

    def add(name: str, mesh: trimesh.Trimesh, against: Sequence[DepthReading] = judges, **values: float) -> None:
        made[name], shared = mesh, {"capture": capture.name, "faces": len(mesh.faces)}
        results.add(kind="fusion", name=name, **shared, **values, **judged(mesh, against))

    makers = _makers(plan.voxel, plan.truncation, plan.far, plan.min_weight)
    for name, make in makers.items():
        seconds = []
        for _ in range(config.rounds):
            watch = Stopwatch()
            mesh = make(fused)
            seconds.append(watch.seconds)
        add(name, mesh, seconds=float(np.median(seconds)), frames=len(fused))
    if capture.sensor == PHONE_LIDAR:
        watch = Stopwatch()
        mesh = makers["hyjax"](register(fused, makers["hyjax"], plan.far, progress=False))
        taken, caster = watch.seconds, RayCaster(mesh)
        others = [registered(reading, caster, plan.far) for reading in judges]
        add("hyjax, poses aligned", mesh, others, seconds=taken, frames=len(fused))
    if (own := capture.mesh()) is not None:
        add("the device's mesh", own)
    write_png(results.out / "borders.png", _picture(made, judges))


def _depth_maps(capture: Any) -> tuple[list[DepthReading], list[DepthReading]]:
    """Depth maps to fuse, and others to judge by."""
    true = capture.reference()
    if true is None:
        maps = list(Readings(capture, range(capture.depth_count), 0.5))
        if len(maps) < 4:
            raise InputError(f"{capture.name}: has {len(maps)} depth maps; need at least 4")
        return maps[::2], spread(maps[1::2], JUDGES)
    frames, scanner = capture.scan_input()
    assert scanner is not None
    simulated = [DepthReading(*view) for view in simulate_sensors(frames, scanner, 0)]
    return simulated, [capture.depth_reading(k) for k in spread(range(capture.depth_count), JUDGES)]


def _makers(voxel: float, truncation: float, far: float, weight: float) -> dict[str, Make]:
    def ours(change: Callable[[DepthReading], DepthReading], band: float) -> Make:
        return lambda maps: fuse([change(m) for m in maps], voxel, band, far, weight, progress=False)

    def alike(reading: DepthReading) -> DepthReading:
        return DepthReading(reading.depth, reading.camera)

    def sure(reading: DepthReading) -> DepthReading:
        if reading.confidence is None:
            return reading
        return DepthReading(np.where(reading.confidence == 1, reading.depth, 0), reading.camera)

    other = (3.0 if truncation > 3.5 * voxel else 4.0) * voxel
    makers = {
        "hyjax": ours(lambda reading: reading, truncation),
        "weights without confidence": ours(alike, truncation),
        "full confidence only": ours(sure, truncation),
        f"band of {other / voxel:g} voxels": ours(lambda reading: reading, other),
    }
    if importlib.util.find_spec("open3d") is not None:
        makers["Open3D VoxelBlockGrid"] = lambda maps: _open3d(maps, voxel, truncation, far)
    return makers


def _open3d(maps: Sequence[DepthReading], voxel: float, truncation: float, far: float) -> trimesh.Trimesh:
    import open3d as o3d

    core, band = o3d.core, truncation / voxel
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), (1, 1), voxel, 16, OPEN3D_BLOCKS
    )
    for depth, camera, _ in maps:
        k = camera.intrinsics
        # Open3D counts pixels from the centre of the first.
        lens = core.Tensor(np.array([[k.fx, 0, k.cx - 0.5], [0, k.fy, k.cy - 0.5], [0, 0, 1.0]]))
        to_camera = core.Tensor(np.linalg.inv(camera.pose))
        image = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(depth, dtype=np.float32)))
        seen = grid.compute_unique_block_coordinates(image, lens, to_camera, 1.0, far, band)
        grid.integrate(seen, image, lens, to_camera, 1.0, far, band)
    mesh = grid.extract_triangle_mesh(OPEN3D_VIEWS).to_legacy()
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles), process=False)


def judged(mesh: trimesh.Trimesh, judges: Sequence[DepthReading]) -> dict[str, float]:
    """Shares and distances of a mesh by depth maps that it was not made of."""
    caster = RayCaster(mesh)
    hidden = beside_far = lacking = beside_near = 0
    for reading in judges:
        seen = np.asarray(caster.gbuffer(reading.camera).depth)
        far, near = _borders(reading)
        hidden += int((far & (seen > 0) & (seen < reading.depth - WRONG_METRES)).sum())
        lacking += int((near & ((seen == 0) | (seen > reading.depth + WRONG_METRES))).sum())
        beside_far, beside_near = beside_far + int(far.sum()), beside_near + int(near.sum())
    coverage = Coverage.of(caster, judges)
    return {
        "bloated": hidden / max(beside_far, 1),
        "eroded": lacking / max(beside_near, 1),
        "covered": coverage.covered,
        "distance": coverage.distance,
    }


def _borders(reading: DepthReading) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Readings on the far and on the near side of borders."""
    depth = reading.depth
    sure = depth > 0 if reading.confidence is None else (depth > 0) & (reading.confidence == 1)
    nearest = ndimage.minimum_filter(np.where(depth > 0, depth, np.inf), BORDER_PIXELS)
    farthest = ndimage.maximum_filter(depth, BORDER_PIXELS)
    return sure & (depth - nearest > JUMP), sure & (farthest - depth > JUMP)


def _picture(made: dict[str, trimesh.Trimesh], judges: Sequence[DepthReading]) -> Float[np.ndarray, "h w 3"]:
    """Surfaces lit from the camera; red pixels hide a far reading, blue ones lack a near reading."""
    rows = []
    for mesh in made.values():
        caster, pictures = RayCaster(mesh), []
        for reading in spread(judges, 3):
            gbuffer, rays = caster.gbuffer(reading.camera), reading.camera.rays()
            facing = -np.sum(np.asarray(gbuffer.normal) * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
            picture = np.repeat(np.clip(facing, 0, 1)[..., None], 3, axis=-1)
            seen, (far, near) = np.asarray(gbuffer.depth), _borders(reading)
            picture[far & (seen > 0) & (seen < reading.depth - WRONG_METRES)] = (0.9, 0.1, 0.1)
            picture[near & ((seen == 0) | (seen > reading.depth + WRONG_METRES))] = (0.2, 0.4, 1.0)
            step = max(1, round(picture.shape[0] / 240))
            pictures.append(picture[::step, ::step])
        rows.append(np.concatenate(pictures, axis=1))
    return np.concatenate(rows)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    fused = of_kind(rows, "fusion")
    lines = [
        [
            row["name"],
            *(f"{100 * row[key]:.1f}" for key in ("bloated", "eroded", "covered")),
            f"{1000 * row['distance']:.1f}",
            str(row["faces"]),
            f"{row['seconds']:.2f}" if "seconds" in row else "–",
        ]
        for row in fused
    ]
    first = next((row for row in fused if "frames" in row), None)
    what = "" if first is None else f" of {first['frames']} depth maps of {first['capture']}"
    where = "" if first is None else f"; voxels of {100 * first['settings']['voxel']:g} cm; {machine(first)}"
    caption = (
        f"Fusion{what}, judged by others: readings beside a border that a mesh hides (bloated) or lacks (eroded), "
        f"readings that it covers, median distance{where}."
    )
    header = ["surface", "bloated %", "eroded %", "covered %", "distance mm", "triangles", "seconds"]
    legend = "From the top, the rows of the table: red hides what was read behind it, blue lacks what was read."
    return [Table(caption, header, lines), Picture(folder / "borders.png", legend)]


if __name__ == "__main__":
    run(main)
