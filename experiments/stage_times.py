"""Time of each stage of a frame at 512 x 512, first call and steady state.

    python -m experiments.stage_times [--capture PATH] [--repeats 30] [--out results/stage_times]

Takes about a minute on two cores (more the first time, when the built-in room is made). Prints its table.
The first call contains the compilation, with no cache to help it; the rest are timed one by one, waiting for each
result.

Light is evaluated at a quarter of the pixels, as `hyjax relight` does it (`--sampling 1` for all).

Expect: the visibility of soft lights and the G-buffer are the dearest; a cascade costs about what its steps and
conductances cost when they are measured alone.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax

import hyjax
from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import bars
from experiments.records import Row, machine, of_kind
from experiments.timing import check_repeats
from hyjax.core.cascade import largest_sampling
from hyjax.data.frames import select_frames
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.gbuffer import sample_pixels
from hyjax.scene.place import view_of
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.clock import measure

CONDUCTANCES = "conductances, 4 levels"
SIZE = 512
"""Pixels a side."""


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """Default: the built-in room with its simulated scan."""
    lights: str = "noon-window"
    """A named set-up."""
    frame: int = 0
    sampling: int = 2
    """See `hyjax.relighting.settings.RelightSettings`."""
    repeats: int = 30


@experiment("What each stage of a frame costs", "stage")
def main(config: Config, start: Start) -> None:
    results = start()
    scene = Scene.open(SceneSettings(config.capture, size=str(SIZE)), progress=True)
    (index,) = select_frames(str(config.frame), len(scene))
    check_repeats(config.repeats)
    caster, frame, setup = scene.caster, scene.frame(index), scene.lights(config.lights)
    lights, maps = setup.lights, scene.shadow_maps(setup)
    view = view_of(frame, scene.gbuffer(frame.camera))
    gbuffer, linear, guide = view.gbuffer, view.frame, view.display
    names = "paper-50", "paper-80", "hyjax", "hyjax-scan-shadow"
    paper_50, paper_80, ours, shadow = (hyjax.Schedule.preset(name) for name in names)
    k = largest_sampling([ours, shadow], config.sampling)
    samples = sample_pixels(gbuffer, sampling=k)
    each = hyjax.shade_each(samples, lights)
    looked_up = functools.partial(hyjax.visibilities, interleave=k)
    fill, refine = (functools.partial(f, sampling=k) for f in (hyjax.fill_visibility, hyjax.shadow_pass))
    seen = looked_up(samples, lights, maps)
    shading = hyjax.shade(gbuffer, lights)
    filled = fill(seen, each > 0, guide)

    def shadows() -> Any:
        return refine(fill(looked_up(samples, lights, maps), each > 0, guide), guide, shadow)

    stages: list[tuple[str, Callable[..., Any], tuple[Any, ...], int]] = [
        ("G-buffer (host)", caster.gbuffer, (frame.camera,), config.repeats),
        ("shadow maps (host, once per scene)", cast_shadow_maps, (caster, lights), 3),
        ("shading", hyjax.shade_each, (samples, lights), config.repeats),
        ("visibility (map look-ups)", looked_up, (samples, lights, maps), config.repeats),
        (CONDUCTANCES, jax.jit(hyjax.level_edges), (guide, paper_50), config.repeats),
        ("cascade paper-50", hyjax.cascade, (shading, guide, paper_50), config.repeats),
        ("cascade paper-80", hyjax.cascade, (shading, guide, paper_80), config.repeats),
        ("cascade hyjax", hyjax.cascade, (shading, guide, ours), config.repeats),
        ("fill of unseen visibility", fill, (seen, each > 0, guide), config.repeats),
        ("shadow pass", refine, (filled, guide, shadow), config.repeats),
        ("visibility, fill and shadow pass", shadows, (), config.repeats),
        ("composite", hyjax.composite, (shading, linear), config.repeats),
    ]
    for schedule in (paper_80, ours):
        args = view, setup, schedule, maps, largest_sampling([schedule, shadow], k)
        stages.append((f"frame on the device, {schedule.name}", _frame, args, config.repeats))
    results.add(
        kind="scene",
        mesh=scene.source,
        faces=len(scene.mesh.faces),
        sampling=k,
        lights=[type(light).__name__ for light in lights],
    )
    for name, function, args, repeats in stages:
        jax.clear_caches()  # a stage must not find parts of itself compiled by the one before
        results.add(kind="stage", stage=name, **measure(function, *args, repeats=repeats))
    for name, time in alone(shading, guide, paper_50, config.repeats).items():
        results.add(kind="part", part=name, **time)


def _frame(view: hyjax.View, setup: hyjax.LightSetup, schedule: hyjax.Schedule, maps: Any, k: int) -> hyjax.Relit:
    return hyjax.relight(view, view.shade(setup, shadow_maps=maps, sampling=k), view.display, schedule)


def alone(y: Any, guide: Any, schedule: hyjax.Schedule, repeats: int) -> dict[str, dict[str, Any]]:
    """The parts of a cascade, each compiled and timed by itself."""
    parts = {}
    edges = hyjax.level_edges(guide, schedule)
    finer = [level.factor for level in schedule.levels[1:]] + [1]
    for level, level_edge, next_factor in zip(schedule.levels, edges, finer, strict=True):
        state = hyjax.downsample(y, level.factor)
        name = f"{level.steps} steps at 1/{level.factor}"
        parts[name] = measure(hyjax.diffuse, state, level_edge, level.step_sizes, repeats=repeats)
        ratio = level.factor // next_factor
        shape = tuple(-(-n // next_factor) for n in y.shape[:2])
        up = jax.jit(lambda x, ratio=ratio, shape=shape: hyjax.upsample(x, ratio, shape))
        parts[f"1/{level.factor} to 1/{next_factor}"] = measure(up, state, repeats=repeats)
    return parts


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows; the cascade's parts summed up in one line."""
    stages = of_kind(rows, "stage")
    lines = [
        [row["stage"], f"{row['first_ms']:.0f}", f"{row['median_ms']:.2f}", f"{row['p95_ms']:.2f}"]
        for row in stages
    ]
    if of_kind(rows, "part"):
        conductances = next(row for row in stages if row["stage"] == CONDUCTANCES)
        together = conductances["median_ms"] + sum(row["median_ms"] for row in of_kind(rows, "part"))
        name = "steps and upsampling of paper-50, each alone, plus conductances"
        lines.append([name, "", f"{together:.2f}", ""])
    conditions = [
        f"512 x 512, {scene['mesh']} ({scene['faces']} triangles), sampling {scene.get('sampling', 1)}, "
        f"{', '.join(scene['lights'])}; {machine(scene)}"
        for scene in of_kind(rows, "scene")
    ] + [f"peak memory {row['peak_memory_mib']} MiB" for row in of_kind(rows, "finished")]
    marks = [(row["stage"], row["p95_ms"]) for row in stages]
    figure = bars({row["stage"]: row["median_ms"] for row in stages}, marks, "milliseconds", xscale="log")
    return [
        Table("; ".join(conditions) + ".", ["stage", "first call ms", "median ms", "p95 ms"], lines),
        Plot(main.name, "Milliseconds of every stage: median (bar) and 95th percentile (tick).", figure),
    ]


if __name__ == "__main__":
    run(main)
