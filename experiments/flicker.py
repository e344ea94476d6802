"""Flicker: changes of the light from one frame to the next.

    python -m experiments.flicker [--capture PATH] [--out results/flicker/room]

Consecutive frames of a capture under lights that do not move. Each frame's filter is compared with the frame
before's, carried along the accurate surface to where the camera has moved: on a surface that does not move, under
lamps that do not, a perfect filter differs from itself by nothing but the resampling. What that comes to the filter
of the accurate surface tells. *Flicker* is the mean difference of the filters' display values over all pixels that
both frames see and where the accurate surface is relied on. Compared are the bare mesh, the paper's method, ours
frame by frame, and ours with its memory of earlier frames (`hyjax.video`), keeping different shares of it. A memory
could buy stillness with old light: the relit frames' distance to those of the accurate surface is told beside it.
All filters are multiplied with light there, the paper's too.

Takes three minutes on two cores, once the capture's surfaces are made.

Expect: the paper's method well above the bare mesh, which has no camera noise in it; ours below the paper's; with
memory less than half of the paper's, at the same distance to the accurate surface."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from matplotlib.figure import Figure

import hyjax
from experiments.blocks import Block, Picture, Plot, Table
from experiments.command import Start, experiment, run
from experiments.judging import summarise
from experiments.paper_bench import METHODS, RAW_SCHEDULE, Bench, KappaConfig, reported
from experiments.paper_view import View, linear_filter, multiplied
from experiments.plotting import panels
from experiments.records import Row, of_kind
from hyjax.core.schedule import Schedule
from hyjax.data.frames import select_frames
from hyjax.light.color import decoded, encoded
from hyjax.metrics import psnr
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.video.temporal_filter import Memory, Video, recall

LIGHTS = "two-colors"
KEPT_SHARES = (0.5, 0.8, 0.9)
"""Shares of the last frame; the package's own is among them."""
BARE, ACCURATE = "bare mesh", "accurate surface"
GAIN = 8.0
"""Gain of the pictures of differences."""
SHEET_ROWS = 4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(KappaConfig):
    schedule: str = "paper-80"
    """Named schedule of the paper's mode."""
    frames: str | None = None
    """Which, see `hyjax relight --frames`; each must follow the one before. Default: the first 40 of those that
    `paper` reports on."""


@dataclasses.dataclass(frozen=True)
class Last:
    """State of the frame before."""

    view: View
    filters: dict[str, Float[Array, "h w 3"]]


@experiment("Flicker")
def main(config: Config, start: Start) -> None:
    schedule = Schedule.preset(config.schedule)  # before the first slow step
    capture, results = config.start(start)
    chosen = select_frames(config.frames, len(capture)) if config.frames else reported(capture)[:40]
    if len(chosen) < 2:
        raise InputError("frames: flicker is between frames; give at least two")
    videos, last, sheet = {share: Video(keep=share) for share in KEPT_SHARES}, None, []
    with config.bench(capture, schedule) as bench:
        for view in bench.views(chosen, "relighting"):
            filters = filters_of(bench, view, videos)
            target = multiplied(view, decoded(filters[ACCURATE]), "light")
            pair = None if last is None else Pair(last, view)
            shown = []
            for name, relight_filter in filters.items():
                relit = multiplied(view, decoded(relight_filter), "light")
                scores: dict[str, Any] = {"psnr": float(psnr(relit, target, valid=view.valid))}
                if pair is not None:
                    difference = pair.difference(name, relight_filter)
                    scores["flicker"] = float(difference[pair.both].mean())
                    shown.append(np.repeat(np.where(pair.both, GAIN * difference, 0.0)[..., None], 3, axis=-1))
                results.add(kind="score", frame=view.frame.name, method=name, **scores)
            if shown:
                sheet.append((view.frame.name, [np.asarray(view.display), *shown]))
            last = Last(view, filters)
    if not sheet:
        raise InputError("frames: only one of them sees both surfaces; flicker is between frames")
    every = max(1, len(sheet) // SHEET_ROWS)
    write_contact_sheet(results.out / "differences.png", sheet[::every][:SHEET_ROWS], ("frame", *filters))


def filters_of(bench: Bench, view: View, videos: dict[float, Video]) -> dict[str, Float[Array, "h w 3"]]:
    """Method → its filter without shadows, display values."""
    lights = bench.setups[LIGHTS].lights
    own = bench.own_kappa(bench.schedules["linear"], "linear")
    relit = {METHODS[mode]: bench.relight(view, LIGHTS, mode, bench.schedules[mode]) for mode in METHODS}
    found = {BARE: relit[METHODS["linear"]].shading}
    found |= {METHODS[mode]: linear_filter(relit[METHODS[mode]], mode) for mode in METHODS}
    camera = view.camera
    pose, intrinsics = jnp.asarray(camera.pose, jnp.float32), jnp.asarray(camera.intrinsics.matrix, jnp.float32)
    seen = hyjax.View.of(view.display, view.rough, pose=pose, intrinsics=intrinsics)
    for share, video in videos.items():
        temporal_filter = video.filter(seen, lights, view.guide, own)
        kept = bench.relight(view, LIGHTS, "linear", bench.schedules["linear"], temporal_filter=temporal_filter)
        found[kept_name(share)] = kept.refined
    found[ACCURATE] = bench.relight(view, LIGHTS, "linear", RAW_SCHEDULE, accurate=True).shading
    return {name: encoded(f) for name, f in found.items()}


def kept_name(share: float) -> str:
    return f"ours, keeping {share:g}"


class Pair:
    """Two frames, the first seen from the second.

    Attributes:
        both: pixels of the second whose surface point the first sees too, where the surface is relied on.
    """

    def __init__(self, last: Last, view: View) -> None:
        self.last, self.view = last, view
        _, found = self._recall(jnp.zeros((*view.valid.shape, 1)))
        self.both: Bool[np.ndarray, "h w"] = np.asarray(found) & np.asarray(view.valid)
        if not self.both.any():
            raise InputError(f"{view.frame.name}: sees nothing that the frame before sees; give frames that follow")

    def difference(self, name: str, relight_filter: Float[Array, "h w 3"]) -> Float[np.ndarray, "h w"]:
        """Mean over channels of how much a method's filter has changed at each surface point."""
        before, _ = self._recall(self.last.filters[name])
        return np.asarray(jnp.mean(jnp.abs(relight_filter - before), axis=-1))

    def _recall(self, channels: Array) -> tuple[Array, Array]:
        then, now = ((v.camera.pose, v.camera.intrinsics.matrix) for v in (self.last.view, self.view))
        memory = Memory(channels, self.last.view.accurate.depth, *map(jnp.asarray, then), ())
        return recall(memory, self.view.accurate.depth, *map(jnp.asarray, now))


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table, figure and picture from the rows."""
    scores = of_kind(rows, "score")
    if not any("flicker" in row for row in scores):
        return ["No two frames have been compared yet."]
    paper = mean(scores, METHODS["paper"])
    lines = []
    for name in dict.fromkeys(row["method"] for row in scores):
        own = [row for row in scores if row["method"] == name]
        flicker = summarise([1e3 * row["flicker"] for row in own if "flicker" in row])
        decibels = None if name == ACCURATE else summarise([row["psnr"] for row in own])
        cells = ["" if x is None else x.text(2) for x in (flicker, decibels)]
        lines.append([name, cells[0], f"{mean(scores, name) / paper:.2f}", cells[1]])
    count = len({row["frame"] for row in scores})
    caption = (
        f"{scores[0]['settings']['capture'] or 'built-in room'}, {count} frames: mean change of the filter at a "
        "surface point from frame to frame, in thousandths of white, ± half of the 95 % interval; and the relit "
        "frames' distance to the accurate surface's. Flicker of the accurate surface is that of the measurement."
    )
    return [
        Table(caption, ["method", "flicker", "over the paper's", "PSNR"], lines),
        Plot(main.name, "Flicker of each frame.", figure(scores)),
        Picture(folder / "differences.png", f"Change since the frame before, {GAIN:g} times."),
    ]


def mean(scores: Sequence[Row], name: str) -> float:
    """Flicker of a method."""
    return float(np.mean([row["flicker"] for row in scores if row["method"] == name and "flicker" in row]))


def figure(scores: Sequence[Row]) -> Figure:
    """A curve over the frames for each method."""
    curves: dict[str, list[float]] = {}
    for row in scores:
        curves.setdefault(row["method"], []).extend([1e3 * row["flicker"]] if "flicker" in row else [])
    shown = {name: (range(len(values)), values) for name, values in curves.items()}
    return panels({"": shown}, "-", xlabel="frame", ylabel="flicker, thousandths of white", ylim=(0, None))


if __name__ == "__main__":
    run(main)
