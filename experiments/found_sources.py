"""Windows and lamps of photos: those that the search finds in generated rooms, that it misses, and wrong ones.

    python -m experiments.found_sources [--seed 83] [--count 18] [--size 320x240] [--resume]

Rooms are lit by day, by lamps, or by both, in turns; the search sees twelve photos and the scan, and no hint.
Sources count where two frames see a good part of them. A window is *found* where it and a rectangle share 0.4 of
their union, a lamp where one lies within 35 cm. *Wrong* are windows that share less than a tenth with any that
shines, and lamps within 35 cm of none that is lit. The search was made with seeds 41 and 57, not with 83.

Takes a minute and a half on two cores, and five seconds more for each room that is not in the cache.

Expect: nine of ten windows, and hardly a wrong one; more than half of the lamps: some burn out what is behind.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw
from tqdm import tqdm

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.data.capture import Frame
from hyjax.data.truth_room import TruthCapture, load_truth_room
from hyjax.photo_light.hints import hinted_windows
from hyjax.photo_light.source_search import search_sources
from hyjax.photo_light.sources import PhotoLamp, PhotoWindow
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings, parse_size
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

KINDS = "both", "day", "lamps"
"""Lights of the photos."""
PHOTOS, FEWEST_FRAMES, SEEN_SHARE = 12, 2, 0.3
"""Photos of a room; fewest that must see a source, and the share of it that each must see."""
LEAST_OVERLAP, LARGEST_OVERLAP_OF_WRONG, LAMP_DISTANCE = 0.4, 0.1, 0.35
GLOBE_RADIUS = 0.12
"""Distance from a lamp's middle, in metres, of the points that frames see of it."""
COLORS = {"found": "#33dd55", "missed": "#ff4033", "wrong": "#ffcc00"}


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    seed: int = 83
    """Seed of the rooms."""
    count: int = 18
    """Number of rooms."""
    size: str = "320x240"
    """Width x height of the photos."""
    quality: float = 0.4
    """Effort of the photos' light, of 1."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("Windows and lamps found in photos")
def main(config: Config, start: Start) -> None:
    if config.count < 1:
        raise InputError("found_sources: give at least one room")
    height, width = parse_size(config.size)
    results = start()
    done = {row["room"] for row in of_kind(results.rows, "room")}
    names = [f"random-{config.seed}-{n}-{KINDS[n % len(KINDS)]}" for n in range(config.count)]
    for name in tqdm(names, unit="room"):
        if name in done:
            continue
        capture = load_truth_room(name, PHOTOS, width, height, quality=config.quality)
        scene = Scene.open(SceneSettings(), capture=capture)
        frames = [scene.frame(index) for index in range(len(scene))]
        found = search_sources(scene.caster, frames, np.asarray(capture.up, np.float64))
        judged = _judged(capture, *found)
        sheet = results.out / f"{name}.png"
        write_contact_sheet(sheet, [("", [_drawn(frame, judged) for frame in frames[::3]])], [""] * 4)
        counts = {f"{kind}s {verdict}": 0 for kind in ("window", "lamp") for verdict in COLORS}
        for kind, verdict, _ in judged:
            counts[f"{kind}s {verdict}"] += 1
        results.add(kind="room", room=name, light=name.rpartition("-")[2], counts=counts)


def _judged(
    capture: TruthCapture, windows: tuple[PhotoWindow, ...], lamps: tuple[PhotoLamp, ...]
) -> list[tuple[str, str, Float[np.ndarray, "n 3"]]]:
    """Kind, verdict and points of each source that is there or was found."""
    light, anchors = capture.name.rpartition("-")[2], capture.anchors
    panes = () if light == "lamps" else hinted_windows(anchors, np.asarray(capture.up, np.float64))
    places: list[Any] = [place["position"] for name, place in anchors.items() if name.startswith("lamp_")]
    globes = [] if light == "day" else [np.asarray(place, np.float64) for place in places]
    judged = []
    for pane in panes:
        here = max([_overlap(pane, other) for other in windows], default=0.0) >= LEAST_OVERLAP
        grid = itertools.product(np.linspace(-0.8, 0.8, 5), repeat=2)
        points = np.stack([pane.center + 0.02 * pane.normal + x * pane.right + y * pane.up for x, y in grid])
        if _seen(capture, points):
            judged.append(("window", "found" if here else "missed", pane.corners))
    for globe in globes:
        here = any(np.linalg.norm(globe - lamp.position) < LAMP_DISTANCE for lamp in lamps)
        points = globe + GLOBE_RADIUS * np.concatenate([np.eye(3), -np.eye(3)])
        if _seen(capture, points):
            judged.append(("lamp", "found" if here else "missed", globe[None]))
    for window in windows:
        if all(_overlap(pane, window) < LARGEST_OVERLAP_OF_WRONG for pane in panes):
            judged.append(("window", "wrong", window.corners))
    for lamp in lamps:
        if all(np.linalg.norm(globe - lamp.position) >= LAMP_DISTANCE for globe in globes):
            judged.append(("lamp", "wrong", lamp.position[None]))
    return judged


def _seen(capture: TruthCapture, points: Float[np.ndarray, "n 3"]) -> bool:
    """Whether enough frames see a good part of some points."""
    frames = 0
    for index in range(len(capture)):
        camera = capture.camera(index)
        (x, y), depth = (v.T for v in camera.project(points))
        k = camera.intrinsics
        inside = (depth > 0.1) & (x >= 0) & (x < k.width) & (y >= 0) & (y < k.height)
        hidden = capture.room.caster.occluded(
            np.tile(camera.origin, (len(points), 1)), points - camera.origin, 0.97
        )
        frames += bool((inside & ~hidden).mean() > SEEN_SHARE)
    return frames >= FEWEST_FRAMES


def _overlap(a: PhotoWindow, b: PhotoWindow) -> float:
    """Share of two windows in their union, on the wall of the first."""
    if a.normal @ b.normal < 0.8 or abs((b.center - a.center) @ a.normal) > LAMP_DISTANCE:
        return 0.0
    axes = np.stack([axis / np.linalg.norm(axis) for axis in (a.right, a.up)], axis=1)
    spans = [np.stack([(w.corners @ axes).min(axis=0), (w.corners @ axes).max(axis=0)]) for w in (a, b)]
    low, high = np.maximum(spans[0][0], spans[1][0]), np.minimum(spans[0][1], spans[1][1])
    shared = float(np.prod(np.maximum(high - low, 0.0)))
    return shared / (sum(float(np.prod(span[1] - span[0])) for span in spans) - shared)


def _drawn(frame: Frame, judged: list[tuple[str, str, Float[np.ndarray, "n 3"]]]) -> Float[np.ndarray, "h w 3"]:
    """Picture with the sources in it: outlines of windows, circles round lamps."""
    image = Image.fromarray(to_bytes(frame.image))
    draw = ImageDraw.Draw(image)
    for kind, verdict, points in judged:
        places, depth = frame.camera.project(points)
        if (depth < 0.2).any():
            continue
        corners = [(float(x), float(y)) for x, y in places]
        if kind == "window":
            draw.polygon(corners, outline=COLORS[verdict], width=2)
        else:
            draw.circle(corners[0], 12, outline=COLORS[verdict], width=2)
    return np.asarray(image, np.float32) / 255


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Table by the light of the photos, and a sheet of each room."""
    rooms = of_kind(rows, "room")
    lines = []
    for light in (*KINDS, "all"):
        chosen = [row["counts"] for row in rooms if light in ("all", row["light"])]
        sums = {key: sum(counts[key] for counts in chosen) for key in (chosen[0] if chosen else ())}
        if sums:
            lines.append([light, str(len(chosen)), *map(str, sums.values())])
    header = ["light", "rooms", *(f"{kind}s {verdict}" for kind in ("window", "lamp") for verdict in COLORS)]
    caption = "Sources of the photos in generated rooms without hints: found, missed, and wrong."
    colors = "green found, red missed, yellow wrong"
    sheets = [Picture(folder / f"{row['room']}.png", f"{row['room']}: {colors}.") for row in rooms]
    return [Table(caption, header, lines, 2), *sheets]


if __name__ == "__main__":
    run(main)
