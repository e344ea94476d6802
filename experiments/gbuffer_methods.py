"""Ways to G-buffers and shadow maps, side by side: rays by Embree, our rasteriser, and others if installed.

    python -m experiments.gbuffer_methods [--repeats 5] [--divisions 0 1 2 3] [--out results/gbuffer_methods]

Takes about two minutes on two cores. The built-in room's scan at 512 x 512, its triangles divided into four so
many times. All ways take turns, so that what else the machine does hits them alike. Processor time is that of all
threads.

Expect: the rasteriser is several times faster than rays by Embree at up to a hundred thousand triangles, and never
needs a tree; beyond that its time grows with the triangles, theirs hardly. Pictures at half size are wrong along
every edge.
"""

import contextlib
import dataclasses
import functools
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import trimesh
from jaxtyping import Float

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import panels
from experiments.records import Row, machine, of_kind
from hyjax.geometry import rasterizer
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, RectLight, SkyLight
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.cores import cores

RAYS = "Embree (embreex), every ray"
WRONG = 1e-3
"""Share of the depth, and of a unit normal, from which a pixel counts as different."""
AXES = {"xscale": "log", "yscale": "log", "xlabel": "triangles", "ylabel": "milliseconds"}
Picture = tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w 3"]]


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    repeats: int = 5
    divisions: tuple[int, ...] = (0, 1, 2, 3)


@experiment("Ways to G-buffers and shadow maps")
def main(config: Config, start: Start) -> None:
    results = start()
    scene = Scene.open(SceneSettings(None, size="512"), progress=True)
    camera, mesh, divided = scene.frame(0).camera, scene.mesh, 0
    for divisions in sorted(config.divisions):
        for _ in range(divisions - divided):
            mesh = mesh.subdivide()
        divided, ways = divisions, gbuffer_ways(mesh, camera)
        truth = ways[RAYS]()
        taken = take_turns(ways, config.repeats)
        for name, way in ways.items():
            results.add(kind="gbuffer", method=name, faces=len(mesh.faces), **taken[name], **parity(truth, way()))
    caster = RayCaster(scene.mesh)
    for name, light in lights(scene.mesh).items():
        views = light.shadow_views()
        assert views is not None
        layout = MapLayout.of(views, 1.0, scene.mesh.bounds)
        by_ray = functools.partial(map_by_rays, layout, caster)
        draw = functools.partial(map_drawn, layout, caster)
        rays, drawn = by_ray(), np.asarray(draw())
        with np.errstate(invalid="ignore"):
            same = (rays == drawn) | (np.abs(rays - drawn) <= WRONG * np.abs(rays))
        taken = take_turns({"rasteriser": draw}, config.repeats) | take_turns({"rays": by_ray}, 1)
        for method, times in taken.items():
            place = {"light": name, "views": layout.count, "size": layout.size}
            results.add(kind="shadow", method=method, **place, **times, differ=float((~same).mean()))


def gbuffer_ways(mesh: trimesh.Trimesh, camera: Camera) -> dict[str, Callable[[], Picture]]:
    """Ways to depth and normals of a mesh in a camera, each ready to be called again and again."""
    caster, k = RayCaster(mesh), camera.intrinsics
    half = Camera(k.resize(k.height // 2, k.width // 2), camera.pose)

    def drawn(threads: int) -> Picture:
        number, rasterizer.cores = rasterizer.cores, lambda: threads
        try:
            seen = jax.block_until_ready(caster.gbuffer(camera))
        finally:
            rasterizer.cores = number
        return np.asarray(seen.depth), np.asarray(seen.normal)

    def upsampled() -> Picture:
        rows, columns = ((np.arange(n) // 2).clip(0, n // 2 - 1) for n in k.shape)
        depth, normal = by_rays(caster, half)
        return depth[rows][:, columns], normal[rows][:, columns]

    ways: dict[str, Callable[[], Picture]] = {
        RAYS: lambda: by_rays(caster, camera),
        "rasteriser, one thread": lambda: drawn(1),
        f"rasteriser, {cores()} threads": lambda: drawn(cores()),
        "Embree at half size, nearest": upsampled,
    }
    with contextlib.suppress(ImportError):  # not installed, or without all it needs
        ways["Embree (Open3D), every ray"] = by_open3d(mesh, camera)
    return ways


def by_rays(caster: RayCaster, camera: Camera) -> Picture:
    """Depth and normals from a ray through each pixel."""
    rays, shape = camera.rays().astype(np.float32), camera.intrinsics.shape
    hits = caster.cast(camera.origin, rays.reshape(-1, 3), shape)
    normal = caster.interpolated_normals(hits).astype(np.float32).reshape(*shape, 3)
    return np.where(hits.hit, hits.distance, 0.0).reshape(shape), facing(normal, rays)


def facing(normal: Float[np.ndarray, "h w 3"], rays: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Normals turned against the rays, cheaply: at silhouettes the triangle's own side would decide."""
    return np.where(np.einsum("hwd,hwd->hw", normal, rays)[..., None] > 0, -normal, normal)


def by_open3d(mesh: trimesh.Trimesh, camera: Camera) -> Callable[[], Picture]:
    """The same by Open3D's scene, with the triangles' own normals."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    rays = camera.rays().astype(np.float32)
    starts = np.broadcast_to(camera.origin.astype(np.float32), rays.shape)
    packed = open3d.core.Tensor(np.concatenate([starts, rays], axis=-1))

    def look() -> Picture:
        found = scene.cast_rays(packed)
        depth = found["t_hit"].numpy()
        return np.where(np.isfinite(depth), depth, 0.0), facing(found["primitive_normals"].numpy(), rays)

    return look


def map_by_rays(layout: MapLayout, caster: RayCaster) -> Float[np.ndarray, "v s s"]:
    """Depth of a shadow map from a ray through each texel."""
    side = layout.size + 2
    rays = (layout.rays(view) for view in range(layout.count))
    return np.stack([each.depth(caster).astype(np.float32).reshape(side, side) for each in rays])


def map_drawn(layout: MapLayout, caster: RayCaster) -> jax.Array:
    """The same by the rasteriser."""
    return layout.cast(caster).depth


def lights(mesh: trimesh.Trimesh) -> dict[str, Light]:
    """A light of each kind of shadow map, in the middle of a room."""
    middle, up, white = mesh.bounds.mean(axis=0), np.array([0.0, 0.0, 1.0]), np.ones(3, np.float32)
    number = np.asarray(800.0, np.float32)
    window = Aperture.facing(middle - [0.0, 1.0, -0.2], np.array([0.0, 1.0, -0.4]), up, 1.5, 1.5)
    sun = np.array([0.1, 0.8, -0.6], np.float32)
    return {
        "window (rect)": RectLight.filling(window, number, white),
        "bulb (point with radius)": PointLight(
            middle.astype(np.float32), number, white, np.asarray(0.1, np.float32)
        ),
        "sun through a window": DirectionalLight(sun, number, white, np.asarray(0.005, np.float32), window),
        "sky": SkyLight(up.astype(np.float32), number, white),
    }


def take_turns(ways: dict[str, Callable[[], Any]], repeats: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of each way, by the clock and of processors, after a first call."""
    clock: dict[str, list[float]] = {name: [] for name in ways}
    used: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(repeats + 1):
        for name, way in ways.items():
            begun, busy = time.perf_counter(), time.process_time()
            jax.block_until_ready(way())
            if turn:
                clock[name].append(1e3 * (time.perf_counter() - begun))
                used[name].append(1e3 * (time.process_time() - busy))
    return {name: {"ms": statistics.median(clock[name]), "cpu_ms": statistics.median(used[name])} for name in ways}


def parity(truth: Picture, picture: Picture) -> dict[str, float]:
    """Share of pixels that differ in depth or normal, and the 99th percentile of either's difference."""
    depth = np.abs(picture[0] - truth[0]) / np.maximum(truth[0], 1e-3)
    normal = np.linalg.norm(picture[1] - truth[1], axis=-1)
    return {
        "depth_differs": float((depth > WRONG).mean()),
        "depth_p99": float(np.percentile(depth, 99)),
        "normal_differs": float((normal > WRONG).mean()),
        "normal_p99": float(np.percentile(normal, 99)),
    }


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    pictures, maps = of_kind(rows, "gbuffer"), of_kind(rows, "shadow")
    if not pictures:
        return ["Nothing has been timed yet."]
    shares = "depth_differs", "depth_p99", "normal_differs", "normal_p99"
    lines = [
        [
            f"{row['faces']}",
            row["method"],
            f"{row['ms']:.1f}",
            f"{row['cpu_ms']:.1f}",
            *(f"{row[s]:.1g}" for s in shares),
        ]
        for row in pictures
    ]
    curves = {}
    for name in dict.fromkeys(row["method"] for row in pictures):
        own = [row for row in pictures if row["method"] == name]
        curves[name] = [row["faces"] for row in own], [row["ms"] for row in own]
    differ = ["depth differs, share", "p99", "normal differs, share", "p99"]
    found: list[Block] = [
        Table(
            f"G-buffers of 512 x 512 (depth and normals), medians; {machine(pictures[0])}.",
            ["triangles", "method", "ms", "processor ms", *differ],
            lines,
        ),
        Plot(main.name, "Milliseconds of a G-buffer by the number of triangles.", panels({"": curves}, **AXES)),
    ]
    if maps:
        lines = []
        for row in maps:
            place, times = (
                [row["light"], f"{row['views']} x {row['size']}²"],
                [f"{row['ms']:.0f}", f"{row['cpu_ms']:.0f}"],
            )
            lines.append([*place, row["method"], *times, f"{row['differ']:.1g}"])
        head = ["light", "views", "method", "ms", "processor ms", "texels that differ, share"]
        found.append(Table("Shadow maps of the undivided scan.", head, lines))
    return found


if __name__ == "__main__":
    run(main)
