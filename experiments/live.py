"""Live scene: how often the mesh of a room follows its frames, and how soon a chair's shadow goes with the chair.

    python -m experiments.live [--seconds 20] [--voxel 0.04] [--out results/live]

Takes two minutes on two cores. Depth of the built-in room is rendered along a walk, 30 maps for each second, of
256 x 192 (a phone's) and of 640 x 480 pixels. Frames arrive by the clock, whether or not somebody takes them; one
thread takes them and renews mesh and caster, another relights the newest frame again and again with one lamp, at
256 x 192. Then, by the frames' own time and in one thread, a chair beneath the lamp is taken away while the camera
looks on: the share of its shadow that is still there, second by second.

Expect: five renewals of the mesh a second or more, relit frames meanwhile, and no shadow after two seconds.
"""

import dataclasses
import functools
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
import trimesh

import hyjax
from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.data.builtin_room import UP
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.scan import RenderedDepths
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.color import blackbody
from hyjax.light.kinds import PointLight
from hyjax.live.follow import Follower
from hyjax.live.scene import VOXEL, LiveScene
from hyjax.scene.surfaces import SURFACE_ERROR
from hyjax.synthetic.room import make_room
from hyjax.synthetic.room.path import camera_path
from hyjax.util.environment import peak_memory_mib
from hyjax.util.errors import InputError

FPS = 30
SIZES = ((256, 192), (640, 480))
CHAIR = (1.87, 2.30)
"""Place on the floor of the chair that is taken away."""
MOST_OF_A_CHAIR = 2500
"""Triangles of one of its parts; the room's shell has more."""
LAMP = PointLight(np.array([1.3, 3.1, 2.0], np.float32), np.float32(800.0), blackbody(3000.0))
PICTURE = 256, 192
GREY = np.full((192, 256, 3), 0.5, np.float32)


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    seconds: float = 20.0
    """Of the walk."""
    voxel: float = VOXEL
    """Metres."""


@experiment("Frames arrive, and the mesh follows", "walk")
def main(config: Config, start: Start) -> None:
    if not config.seconds >= 1:
        raise InputError("seconds: need at least 1")
    results = start()
    mesh = make_room().mesh
    for width, height in SIZES:
        results.add(kind="walk", width=width, height=height, **walk(mesh, width, height, config))
    for row in removal(mesh, config.voxel):
        results.add(kind="removal", **row)


def walk(mesh: trimesh.Trimesh, width: int, height: int, config: Config) -> dict[str, Any]:
    """Frames by the clock, a surface that follows them, and relit frames meanwhile."""
    frames = list(frames_of(mesh, camera_path(round(FPS * config.seconds), width, height)))
    schedule = hyjax.Schedule.preset("hyjax")
    warm = LiveScene(voxel=config.voxel)  # what is compiled is not timed
    for frame in frames[:3]:
        warm.add(frame)
    warm.update()
    jax.block_until_ready(hyjax.Relighter(warm, [LAMP], schedule).relit(frames[0]))

    scene, begun = LiveScene(voxel=config.voxel), time.perf_counter()
    taken: list[tuple[float, dict[str, float], int, int]] = []

    def updated(frame: Frame) -> None:
        faces = 0 if scene.surface is None else len(scene.surface.caster.rasterizer.triangles)
        taken.append((time.perf_counter() - begun, scene.times, len(scene.pieces.waiting), faces))

    relighter = hyjax.Relighter(scene, [LAMP], schedule)
    follower = Follower(scene, by_the_clock(frames, begun), updated).start()
    pictures: list[float] = []
    while not follower.wait(0.0):
        newest = follower.newest
        if newest is None or scene.surface is None:
            time.sleep(0.005)
            continue
        jax.block_until_ready(relighter.relit(newest))
        pictures.append(time.perf_counter() - begun)
    seconds = taken[-1][0]
    gaps = 1e3 * np.diff([when for when, *_ in taken])
    return {
        "seconds": seconds,
        "updates": len(taken),
        "pictures": len(pictures),
        "taken": follower.frames,
        "dropped": follower.dropped,
        "gap_ms": statistics(gaps),
        "mesh_ms": statistics([1e3 * times["mesh"] for _, times, _, _ in taken]),
        "caster_ms": statistics([1e3 * times["caster"] for _, times, _, _ in taken]),
        "picture_ms": statistics(1e3 * np.diff(pictures)),
        "waiting": statistics([waiting for _, _, waiting, _ in taken]),
        "faces": taken[-1][3],
        "alone": alone(frames, config, schedule),
        "peak_mib": peak_memory_mib(),
    }


def alone(frames: Sequence[Frame], config: Config, schedule: hyjax.Schedule) -> dict[str, list[float]]:
    """Milliseconds of each part run alone: a renewal after every sixth frame, then a relit picture."""
    scene, own = LiveScene(voxel=config.voxel), hyjax.Configuration.of(schedule)
    relighter, sampled = hyjax.Relighter(scene, [LAMP], own), own.sampled()
    spent: dict[str, list[float]] = {}

    def timed(name: str, call: Any) -> Any:
        begun = time.perf_counter()
        made = jax.block_until_ready(call())
        spent.setdefault(name, []).append(1e3 * (time.perf_counter() - begun))
        return made

    for number, frame in enumerate(frames):
        timed("a depth map into the volume", lambda frame=frame: scene.add(frame))
        if number % 6 == 5:
            scene.update()
            spent.setdefault("mesh, changed regions", []).append(1e3 * scene.times["mesh"])
            spent.setdefault("caster", []).append(1e3 * scene.times["caster"])
            view = timed("surface in the picture", lambda frame=frame: relighter.view(frame))
            maps = timed("shadow map", lambda: scene.shadow_maps([LAMP]))
            light = functools.partial(view.shade, [LAMP], shadow_maps=maps, interleave=own.interleave)
            cascades = {"schedule": sampled.schedule, "shadow_schedule": sampled.shadow_schedule}
            timed(
                "diffusion", functools.partial(hyjax.relight, view, timed("light", light), view.display, **cascades)
            )
    return {name: statistics(values) for name, values in spent.items()}


def removal(mesh: trimesh.Trimesh, voxel: float, seconds: float = 4.0) -> Iterator[dict[str, float]]:
    """Share of a chair's shadow that is left, ever since the chair was taken away half-way."""
    whole, without = mesh, without_chair(mesh)
    cameras = around_the_chair(round(2 * FPS * seconds))
    half = len(cameras) // 2
    frames = [*frames_of(whole, cameras[:half]), *frames_of(without, cameras[half:], half)]
    scene, looked = LiveScene(voxel=voxel), {}
    shadow = chair_shadow(whole, without, cameras[half])
    for number, frame in enumerate(frames):
        scene.add(frame)
        if number % 6 == 5:
            scene.update()
            since = (number + 1 - half) / FPS
            seen = visible(scene, cameras[half])
            looked[since] = float(np.mean(1.0 - seen[shadow]))
            yield {"since": since, "shadow": looked[since], "pixels": int(shadow.sum())}


def visible(scene: LiveScene, camera: Camera) -> np.ndarray:
    """Visibility of the lamp in a picture, by the scene as it is."""
    frame = Frame("look", np.full((*camera.intrinsics.shape, 3), 0.5, np.float32), camera, 0.0)
    return np.asarray(hyjax.Relighter(scene, [LAMP]).shade(scene.view(frame)).visibility[..., 0])


def chair_shadow(whole: trimesh.Trimesh, without: trimesh.Trimesh, camera: Camera) -> np.ndarray:
    """Pixels that are in shadow with the chair, lit without it, and show the same surface either way."""
    found = []
    for mesh in (whole, without):
        caster = RayCaster(mesh)
        gbuffer = caster.gbuffer(camera)
        maps = cast_shadow_maps(caster, [LAMP], slack=SURFACE_ERROR)
        found.append((np.asarray(gbuffer.depth), np.asarray(hyjax.visibility(gbuffer, LAMP, maps[0]))))
    (depth, dark), (depth_after, lit) = found
    return (np.abs(depth - depth_after) < 1e-3) & (dark < 0.1) & (lit > 0.9)


def frames_of(mesh: trimesh.Trimesh, cameras: Sequence[Camera], first: int = 0) -> Iterator[Frame]:
    """Grey pictures with rendered depth, 30 a second."""
    views = RenderedDepths(mesh, cameras)
    for number, camera in enumerate(cameras):
        picture = Camera(camera.intrinsics.resize(*PICTURE[::-1]), camera.pose)
        at = first + number
        depth = np.asarray(views[number][0])
        yield Frame(f"{at:06d}", GREY, picture, at / FPS, depth, depth_intrinsics=camera.intrinsics)


def by_the_clock(frames: Sequence[Frame], begun: float) -> Iterator[Frame]:
    """Each frame when its time has come."""
    for frame in frames:
        threading.Event().wait(max(0.0, begun + frame.time - time.perf_counter()))
        yield frame


def around_the_chair(count: int, width: int = 256, height: int = 192) -> list[Camera]:
    """A hand-held look at the chair, swaying a little."""
    focal = 210.0 * width / 256
    intrinsics = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    turns = np.linspace(0.0, 6.0 * np.pi, count)
    eyes = np.stack(
        [2.9 + 0.25 * np.sin(turns), 3.5 + 0.2 * np.cos(0.7 * turns), 1.5 + 0.1 * np.sin(turns)], axis=1
    )
    return [Camera(intrinsics, look_at(eye, np.array([*CHAIR, 0.3]), UP)) for eye in eyes]


def without_chair(
    mesh: trimesh.Trimesh, place: tuple[float, float] = CHAIR, radius: float = 0.33
) -> trimesh.Trimesh:
    """The mesh without parts that stand free on the floor around a place and are no higher than a chair."""
    parts = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    corners = mesh.vertices[mesh.faces]
    count = np.bincount(parts)
    middles = np.stack([np.bincount(parts, corners[..., k].mean(axis=1)) / count for k in (0, 1)], axis=1)
    beside = np.linalg.norm(middles - np.asarray(place), axis=1) > radius
    high = np.bincount(parts, corners[..., 2].max(axis=1) > 0.95) > 0
    kept = (beside | high | (count > MOST_OF_A_CHAIR))[parts]
    return trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False)


def statistics(values: Any) -> list[float]:
    """Median and 95th percentile."""
    return [float(x) for x in np.percentile(np.asarray(values, float), (50, 95))] if len(values) else [0.0, 0.0]


def blocks(rows: Sequence[Row], folder: Any) -> list[Block]:
    """Tables from the rows."""
    walks, removals = of_kind(rows, "walk"), of_kind(rows, "removal")
    made: list[Block] = [
        Table(
            "A walk through the built-in room, 30 depth maps a second by the clock; the newest is relit meanwhile.",
            [
                "depth",
                "mesh updates/s",
                "relit frames/s",
                "maps taken/s",
                "dropped",
                "regions waiting, median",
                "triangles",
            ],
            [
                [
                    f"{r['width']}x{r['height']}",
                    *(f"{r[key] / r['seconds']:.1f}" for key in ("updates", "pictures", "taken")),
                    f"{r['dropped']}",
                    f"{r['waiting'][0]:.0f}",
                    f"{r['faces']}",
                ]
                for r in walks
            ],
        )
    ]
    names = {
        "gap_ms": "between updates",
        "mesh_ms": "mesh",
        "caster_ms": "caster",
        "picture_ms": "between pictures",
    }
    for r in walks:
        lines = [[text, f"{r[key][0]:.0f}", f"{r[key][1]:.0f}"] for key, text in names.items()]
        lines += [[f"alone: {key}", f"{v[0]:.1f}", f"{v[1]:.1f}"] for key, v in r["alone"].items()]
        made.append(
            Table(f"Its parts with depth of {r['width']}x{r['height']}.", ["", "median, ms", "p95, ms"], lines)
        )
    made.append(
        Table(
            "A chair is taken away: share of its shadow's pixels that the lamp does not reach.",
            ["seconds since", "shadow"],
            [[f"{r['since']:.1f}", f"{100 * r['shadow']:.0f} %"] for r in removals if r["since"] >= -0.2],
        )
    )
    made.append(f"{machine(walks[0])}. Peak memory {max(r['peak_mib'] for r in walks):.0f} MiB.")
    return made


if __name__ == "__main__":
    run(main)
