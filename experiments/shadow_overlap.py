"""Shadows of a rough scan against the true ones: how far they overlap.

    python -m experiments.shadow_overlap [--rooms room:0:1 random:1:0 ...] [--workers 2]
        [--out results/shadow_overlap]

A room whose true mesh is known is scanned as a headset would, and frames of it are lit by named set-ups. What each
light leaves visible on the rough surface, after the shadow pass, is compared with the shadows that the true mesh
throws on itself, pixel by pixel: where both surfaces are seen within `NEAR` of each other and both face the light.

- *overlap*: intersection over union of the shadows (visibility below one half), over all frames;
- *soft overlap*: Σ min / Σ max of what shadows take away;
- *by frame*: mean overlap of frames in which a shadow covers `LEAST` of what is counted.

Shadows are thrown by the bare *surface*, by the surface with its small holes *closed*, and by that *completed* from
depth maps (see `hyjax.scene.occluders`). A room is `room:SEED:SCAN` (the built-in one) or `random:SEED:NUMBER`.
Takes about a minute for each room. Seed 0 of the built-in room and random room 0:0 were chosen on.

Expect: closing holes helps a little, depth maps help most.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Bool, Float

import hyjax
from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.parallel import Collected, Sink, rows_of_parts
from experiments.records import Row
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import UP, load_room, scan_config
from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.scan import RenderedDepths, ScanConfig, simulate_scan, simulate_sensors
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.geometry.tsdf import fuse
from hyjax.light.setup import LightSetup
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import visibilities
from hyjax.pipeline import refine_visibility
from hyjax.scene.light_setups import LightAnchors, named_setup, survey, survey_capture
from hyjax.scene.occluders import SLACK, VOXEL, complete, fine_detail
from hyjax.scene.surfaces import surface_of
from hyjax.synthetic.random_room import make_random_room, photograph
from hyjax.synthetic.random_room.views import draw_view
from hyjax.util.errors import InputError

SETUPS = ("golden-hour", "evening-lamps", "two-colors", "center-point")
NEAR = 0.1  # metres
LEAST = 0.01
DIM = 0.02  # of the reference illuminance
SCANNED = 64  # views of a random room that its scan is made from


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    rooms: tuple[str, ...] = ("room:0:0", "random:0:0", "room:0:2", "room:1:1", "random:1:0", "random:2:1")
    """Rooms: room:SEED:SCAN or random:SEED:NUMBER."""
    frames: int = 5
    """How many of each."""
    size: int = 384
    """Pixels a side of random rooms' pictures."""
    workers: int = 0
    """Processes that judge a room each; 0 for this one alone."""


@dataclasses.dataclass(frozen=True)
class Place:
    """A room with its scan: true mesh, rough mesh, finer fusion, pictures with cameras, places for lights."""

    true: trimesh.Trimesh
    rough: trimesh.Trimesh
    detail: trimesh.Trimesh | None
    pictures: list[tuple[Float[np.ndarray, "h w 3"], Camera]]
    anchors: LightAnchors


@experiment("Overlap of shadows")
def main(config: Config, start: Start) -> None:
    results = start()
    if not config.workers:
        for room in config.rooms:
            judge_room(results, room, config)
        return
    payloads = [{"room": room, "frames": config.frames, "size": config.size} for room in config.rooms]
    for rows in rows_of_parts(room_rows, payloads, config.workers, results.out):
        for row in rows:
            results.add(**row)


def room_rows(payload: dict[str, Any]) -> dict[str, Any]:
    """Rows of one room, in a process of its own."""
    collected = Collected(Path())
    judge_room(collected, payload["room"], Config(frames=payload["frames"], size=payload["size"]))
    return collected.result()


def judge_room(results: Sink, room: str, config: Config) -> None:
    """Add the rows of one room."""
    place = open_place(room, config)
    for setup_name in SETUPS:
        for row in compare(place, named_setup(setup_name, place.anchors)):
            results.add(kind="score", room=room, setup=setup_name, **row)


def open_place(room: str, config: Config) -> Place:
    """A room by its name.

    Raises:
        InputError: no such room.
    """
    kind, *numbers = room.split(":")
    if kind not in ("room", "random") or len(numbers) != 2 or not all(n.isdecimal() for n in numbers):
        raise InputError(f"rooms: {room!r} must be room:SEED:SCAN or random:SEED:NUMBER")
    first, second = map(int, numbers)
    if kind == "room":
        capture = load_room(first)
        _, rough = surface_of(capture, "scan", seed=second)
        frames = [capture[k] for k in spread(range(len(capture)), config.frames)]
        anchors = survey_capture(RayCaster(rough), capture)
        pictures = [(frame.image, frame.camera) for frame in frames]
        true = capture.reference()
        assert true is not None
        return Place(true, rough, fine_detail(capture, "scan", second), pictures, anchors)
    lit = make_random_room(first, second)

    def camera(view: int, stream: int, size: int) -> Camera:
        return draw_view(lit.room, lit.caster, size, np.random.default_rng((*lit.key, stream, view)))

    cameras, true = [camera(k, 9, 192) for k in range(SCANNED)], lit.room.furnished.mesh
    depths = RenderedDepths(true, cameras)
    rough, detail = simulate_scan(depths, scan_config()), finer(depths, scan_config())
    pictures = [
        (np.asarray(photograph(lit, k, config.size).image, np.float32), camera(k, 2, config.size))
        for k in range(config.frames)
    ]
    return Place(true, rough, detail, pictures, survey(RayCaster(rough), spread(cameras, 8), UP))


def finer(depths: RenderedDepths, scan: ScanConfig) -> trimesh.Trimesh:
    """`fine_detail` of what is no capture."""
    return fuse(simulate_sensors(depths, scan, 0), VOXEL, 3 * VOXEL, scan.max_depth, scan.min_weight)


def compare(place: Place, setup: LightSetup) -> Iterator[Row]:
    """A row for each light that throws shadows, each frame, and what throws them: areas in pixels."""
    rough, true = RayCaster(place.rough), RayCaster(place.true)
    true_maps = cast_shadow_maps(true, setup.lights)
    closed, completed = RayCaster(complete(place.rough)), RayCaster(complete(place.rough, place.detail))
    maps = {
        "surface": cast_shadow_maps(rough, setup.lights),
        "closed": cast_shadow_maps(closed, setup.lights, slack=SLACK),
        "completed": cast_shadow_maps(completed, setup.lights, slack=SLACK),
    }
    for number, (image, camera) in enumerate(place.pictures):
        view, seen = hyjax.View.of(jnp.asarray(image), rough.gbuffer(camera)), true.gbuffer(camera)
        truth = np.asarray(visibilities(seen, setup.lights, true_maps))
        both = view.gbuffer.hit & seen.hit & (jnp.abs(view.gbuffer.depth - seen.depth) < NEAR)
        lux = jnp.minimum(*(shade_each(gbuffer, setup.lights) for gbuffer in (view.gbuffer, seen)))
        counted = np.asarray(both[..., None] & (lux > DIM * setup.reference_lux))
        for occluders, own in maps.items():
            preset = "hyjax-shadow" if occluders == "surface" else "hyjax-scan-shadow"
            shaded = view.shade(setup, shadow_maps=own)
            visible = np.asarray(refine_visibility(shaded, view.display, Schedule.preset(preset)))
            for k, shadow_map in enumerate(own):
                if shadow_map is not None:
                    areas = overlap(visible[..., k], truth[..., k], counted[..., k])
                    yield {"frame": number, "light": k, "occluders": occluders, **areas}


def overlap(
    visible: Float[np.ndarray, "h w"], truth: Float[np.ndarray, "h w"], counted: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """Pixels in both shadows and in either, hard and soft, and of the true one."""
    taken, true = 1.0 - visible[counted], 1.0 - truth[counted]
    return {
        "both": float(((taken > 0.5) & (true > 0.5)).sum()),
        "either": float(((taken > 0.5) | (true > 0.5)).sum()),
        "soft both": float(np.minimum(taken, true).sum()),
        "soft either": float(np.maximum(taken, true).sum()),
        "true": float((true > 0.5).sum()),
        "counted": float(counted.sum()),
    }


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """A table for each room."""
    scores = [row for row in rows if row.get("kind") == "score"]
    made: list[Block] = []
    for room in dict.fromkeys(row["room"] for row in scores):
        lines = []
        own = [row for row in scores if row["room"] == room]
        for setup, light in dict.fromkeys((row["setup"], row["light"]) for row in own):
            for occluders in dict.fromkeys(row["occluders"] for row in own):
                key = (setup, light, occluders)
                found = [row for row in own if (row["setup"], row["light"], row["occluders"]) == key]
                lines.append([f"{setup}, light {light}, {occluders}", *cells(found)])
        made.append(Table(f"Room {room}.", ["", "overlap", "soft overlap", "by frame"], lines))
    return made or ["No shadow has been judged yet."]


def cells(rows: Sequence[Row]) -> list[str]:
    """Overlap, soft overlap and mean overlap of frames."""
    totals = {name: sum(row[name] for row in rows) for name in ("both", "either", "soft both", "soft either")}
    each = [row["both"] / row["either"] for row in rows if row["true"] > LEAST * max(row["counted"], 1.0)]
    shares = (
        totals["both"] / totals["either"] if totals["either"] else None,
        totals["soft both"] / totals["soft either"] if totals["soft either"] else None,
        float(np.mean(each)) if each else None,
    )
    return ["–" if share is None else f"{share:.3f}" for share in shares]


if __name__ == "__main__":
    run(main)
