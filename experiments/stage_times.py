"""Programs of a frame at 512 x 512: their time beside a bound by memory and arithmetic, and their first call.

    python -m experiments.stage_times [--capture PATH] [--repeats 30] [--out results/stage_times]

Takes about a minute on two cores (more the first time, when the built-in room is made). Prints its table. The frame
is the default's. Its programs are recorded while it is relit, and then timed one by one, waiting for each result. A
first call contains the compilation, with no cache to help it.

*In and out* is the size of a program's arguments and results, *touched* all that XLA reads and writes in memory to
get from these to those, by its own cost analysis, as are operations. The *bound* is the longer of two: in and out
at the rate at which a 16 MiB array is read and written, operations at the rate of a product of matrices; both rates
are measured in the same run. Times of several calls of a program, one for each light, are added up, p95 too.

Expect: light edges, the refinement of light and of visibility, and the G-buffer are the dearest; the refinements
are farthest from their bounds, as they touch many times what they read and write.
"""

import collections
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import bars
from experiments.records import Row, machine, of_kind
from experiments.timing import check_repeats
from hyjax.data.frames import select_frames
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.view import View
from hyjax.scene.relighter import Relighter, refine
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.clock import measure

SIZE = 512
"""Pixels a side."""
MEMORY_ARRAY, MATRIX_SIDE = 1 << 22, 1024
"""Numbers in the array that is read and written, and side of the matrices that are multiplied, for the bounds."""
HOST_PROGRAM, MAPS_PROGRAM = "G-buffer (host)", "shadow maps (host, once per scene)"


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """Default: the built-in room with its simulated scan."""
    lights: str = "noon-window"
    """A named set-up."""
    frame: int = 0
    repeats: int = 30


@dataclasses.dataclass(frozen=True)
class Call:
    """Call of a program of a frame."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: dict[str, Any]

    def __call__(self) -> Any:
        return self.function(*self.arguments, **self.options)

    @property
    def name(self) -> str:
        """Name of the function; of a class' method with that of the class."""
        owner = getattr(self.function, "__self__", None)
        name = str(getattr(self.function, "__name__", self.function))
        return f"{owner.__name__}.{name}" if isinstance(owner, type) else name

    def costs(self) -> dict[str, float]:
        """Megabytes in and out and touched, and millions of operations."""
        leaves, tree = jax.tree.flatten((self.arguments, self.options))
        arrays = [place for place, leaf in enumerate(leaves) if getattr(leaf, "ndim", 0)]

        def whole(*given: Any) -> Any:
            filled = dict(enumerate(leaves)) | dict(zip(arrays, given, strict=True))
            arguments, options = jax.tree.unflatten(tree, list(filled.values()))
            return self.function(*arguments, **options)

        found = jax.jit(whole).lower(*(leaves[place] for place in arrays)).compile().cost_analysis() or {}
        operations = found.get("flops", 0.0) + found.get("transcendentals", 0.0)
        return {
            "in_out_mb": (size(leaves) + size(self())) / 1e6,
            "touched_mb": found.get("bytes accessed", 0.0) / 1e6,
            "operations_m": operations / 1e6,
        }


def size(tree: Any) -> int:
    """Bytes of a tree's arrays."""
    return sum(getattr(leaf, "nbytes", 0) for leaf in jax.tree.leaves(tree))


@experiment("What each program of a frame costs, beside a bound", "stage")
def main(config: Config, start: Start) -> None:
    results = start()
    scene = Scene.open(SceneSettings(config.capture, size=str(SIZE)), progress=True)
    (index,) = select_frames(str(config.frame), len(scene))
    check_repeats(config.repeats)
    relighter, camera = Relighter(scene, config.lights), scene.frame(index).camera
    setup = relighter.setup
    results.add(
        kind="scene",
        mesh=scene.source,
        faces=len(scene.mesh.faces),
        sampling=relighter.configuration.light.sampling,
        lights=[type(light).__name__ for light in setup.lights],
    )
    array, matrix = jnp.ones(MEMORY_ARRAY), jnp.ones((MATRIX_SIDE, MATRIX_SIDE))
    memory, product = (
        measure(jax.jit(function), given, repeats=config.repeats)["median_ms"]
        for function, given in ((lambda x: x + 1, array), (lambda x: x @ x, matrix))
    )
    results.add(
        kind="rates",
        gb_per_second=2e-6 * array.nbytes / memory,
        operations_g=2e-6 * MATRIX_SIDE**3 / product,
    )
    maps = Call(cast_shadow_maps, (scene.caster, setup.lights), {})
    gbuffer = Call(relighter.gbuffer, (camera,), {})
    for name, call, repeats in ((MAPS_PROGRAM, maps, 3), (HOST_PROGRAM, gbuffer, config.repeats)):
        results.add(kind="stage", stage=name, **measure(call, repeats=repeats))
    programs = collections.defaultdict[str, list[Call]](list)
    for stage, call in recorded(scene, relighter, index):
        programs[f"{stage}: {call.name}"].append(call)
    for name, calls in programs.items():
        jax.clear_caches()  # a program must not find parts of itself compiled by the one before
        times = [measure(call, repeats=config.repeats) for call in calls]
        parts = [call.costs() for call in calls]
        sums = {key: sum(time[key] for time in times) for key in ("first_ms", "median_ms", "p95_ms")}
        costs = {key: sum(part[key] for part in parts) for key in parts[0]}
        results.add(kind="stage", stage=name, calls=len(calls), **sums, **costs)


def recorded(scene: Scene, relighter: Relighter, index: int) -> Iterator[tuple[str, Call]]:
    """Stage and call of each program of a frame, but for its G-buffer, in order."""
    calls: list[Call] = []

    def record(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        calls.append(Call(function, arguments, options))
        return function(*arguments, **options)

    def done(stage: str) -> Iterator[tuple[str, Call]]:
        yield from ((stage, call) for call in calls)
        calls.clear()

    lit, setup = relighter.lit(index), relighter.setup
    seen = lit.view
    View.of(seen.display, seen.gbuffer, pose=seen.pose, intrinsics=seen.intrinsics, full=seen.full, run=record)
    yield from done("view")
    light = scene.surface_light(setup)
    interleave = relighter.configuration.interleave
    maps = scene.shadow_maps(setup)
    for stage, _ in seen.shade_stages(
        setup, shadow_maps=maps, surface_light=light, interleave=interleave, run=record
    ):
        yield from done(stage)
    for stage, _ in refine(lit, relighter.configuration, run=record):
        yield from done(stage)
        if stage == "composite":
            break


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    stages, (rates,) = of_kind(rows, "stage"), of_kind(rows, "rates")
    bounds = {row["stage"]: bound(row, rates) for row in stages if "operations_m" in row}
    conditions = [
        f"512 x 512, {scene['mesh']} ({scene['faces']} triangles), sampling {scene['sampling']}, "
        f"{', '.join(scene['lights'])}; {machine(scene)}; {rates['gb_per_second']:.0f} GB/s, "
        f"{rates['operations_g']:.0f} billion operations/s"
        for scene in of_kind(rows, "scene")
    ] + [f"peak memory {row['peak_memory_mib']} MiB" for row in of_kind(rows, "finished")]
    headings = ["program", "calls", "first call ms", "median ms", "p95 ms"]
    headings += ["in and out MB", "touched MB", "million operations", "bound ms", "times the bound"]
    lines = [[*told(row), *beside(row["median_ms"], bounds.get(row["stage"]))] for row in stages]
    of_frame = [row for row in stages if row["stage"] in bounds]
    whole = sum(row["median_ms"] for row in of_frame), sum(bounds.values())
    lines.append(["all but those of the host", "", "", f"{whole[0]:.2f}", "", "", "", "", *beside(*whole)])
    marks = [(row["stage"], bounds[row["stage"]]) for row in of_frame]
    figure = bars({row["stage"]: row["median_ms"] for row in stages}, marks, "milliseconds", xscale="log")
    return [
        Table("; ".join(conditions) + ".", headings, lines),
        Plot(main.name, "Milliseconds of every program: median (bar) and its bound (tick).", figure),
    ]


def bound(row: Row, rates: Row) -> float:
    """Milliseconds that a program takes at least, by memory or by arithmetic."""
    return float(max(row["in_out_mb"] / rates["gb_per_second"], row["operations_m"] / rates["operations_g"]))


def told(row: Row) -> list[str]:
    """Columns of a program that were measured."""
    costs = [f"{row[key]:.1f}" if key in row else "" for key in ("in_out_mb", "touched_mb", "operations_m")]
    times = f"{row['first_ms']:.0f}", f"{row['median_ms']:.2f}", f"{row['p95_ms']:.2f}"
    return [row["stage"], str(row.get("calls", 1)), *times, *costs]


def beside(milliseconds: float, least: float | None) -> list[str]:
    """Bound, and a time as a multiple of it."""
    return ["", ""] if least is None else [f"{least:.2f}", f"{milliseconds / least:.1f}"]


if __name__ == "__main__":
    run(main)
