"""What each stage of a frame costs at 512 x 512, first call and steady state.

    python -m experiments.stage_times [--capture PATH] [--repeats 30] [--out results/stage_times]

Takes about a minute on two cores (more the first time, when the built-in room is made). Prints the README's table,
and writes `stage_times.md`, `stage_times.json` with the raw figures, and the plot `stage_times.png`. The first call
contains the compilation, with no cache to help it; the rest are timed one by one, waiting for each result.

Expect: the visibility of soft lights and the G-buffer are the dearest; a cascade costs about what its steps and
conductances cost when they are measured alone.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import hyjax
from experiments.command import run
from experiments.plotting import new_figure
from hyjax.data.frames import fit
from hyjax.data.light_setups import named_setup, survey_capture
from hyjax.data.open import open_capture
from hyjax.data.room import load_room
from hyjax.data.surfaces import surface_of
from hyjax.environment import environment, peak_memory_mib
from hyjax.files import make_writable, whole, write_text
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.tuning.latency import measure


@dataclasses.dataclass(frozen=True)
class Config:
    capture: Path | None = None
    """Default: the built-in room with its simulated scan."""
    lights: str = "noon-window"
    """A named set-up."""
    frame: int = 0
    repeats: int = 30
    out: Path = Path("results/stage_times")


def main(config: Config) -> None:
    make_writable(config.out)
    capture = load_room() if config.capture is None else open_capture(config.capture)
    source, mesh = surface_of(capture)
    caster = RayCaster(mesh)
    frame = fit(capture[config.frame], (512, 512))
    setup = named_setup(config.lights, survey_capture(caster, capture))

    gbuffer = caster.gbuffer(frame.camera)
    maps = cast_shadow_maps(caster, setup.lights)
    guide = jnp.asarray(frame.image)
    linear = hyjax.to_linear(guide)
    lights = setup.lights
    each = hyjax.shade_each(gbuffer, lights)
    seen = hyjax.visibilities(gbuffer, lights, maps)
    shading = hyjax.shade(gbuffer, lights)
    paper_50, paper_80 = (hyjax.Schedule.preset(name) for name in ("paper-50", "paper-80"))
    shadow = hyjax.Schedule.preset("shadow")

    rows: list[tuple[str, Callable[..., Any], tuple[Any, ...], int]] = [
        ("G-buffer (host)", caster.gbuffer, (frame.camera,), config.repeats),
        ("shadow maps (host, once per scene)", cast_shadow_maps, (caster, lights), 3),
        ("shading", hyjax.shade_each, (gbuffer, lights), config.repeats),
        ("visibility (map look-ups)", hyjax.visibilities, (gbuffer, lights, maps), config.repeats),
        ("conductances, 4 levels", jax.jit(hyjax.level_edges), (guide, paper_50), config.repeats),
        ("cascade paper-50", hyjax.cascade, (shading, guide, paper_50), config.repeats),
        ("cascade paper-80", hyjax.cascade, (shading, guide, paper_80), config.repeats),
        ("fill of unseen visibility", hyjax.fill_visibility, (seen, each > 0, guide, paper_80), config.repeats),
        ("shadow pass", hyjax.shadow_pass, (seen, guide, shadow), config.repeats),
        ("composite", hyjax.composite, (shading, linear), config.repeats),
        ("frame on the device, paper-80", _frame, (linear, gbuffer, lights, guide, paper_80, maps), config.repeats),
    ]
    times = {}
    for name, function, args, repeats in rows:
        jax.clear_caches()  # a stage must not find parts of itself compiled by the one before
        times[name] = measure(function, *args, repeats=repeats)
    times |= {f"  alone: {name}": value for name, value in alone(shading, guide, paper_50, config.repeats).items()}
    record = {
        "times": times,
        "mesh": source,
        "faces": len(mesh.faces),
        "lights": [type(x).__name__ for x in lights],
    }
    record |= {"peak_memory_mib": round(peak_memory_mib()), "config": str(config)} | environment()
    table = markdown(record)
    print(table)
    with whole(config.out / "stage_times.png") as path:
        figure(path, record)
    write_text(config.out / "stage_times.md", table + "\n")
    write_text(config.out / "stage_times.json", json.dumps(record, indent=2) + "\n")


def _frame(linear: Any, gbuffer: Any, lights: Any, guide: Any, schedule: Any, maps: Any) -> Any:
    return hyjax.relight(linear, gbuffer, lights, guide, schedule, shadow_maps=maps)


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


def figure(path: Path, record: dict[str, Any]) -> None:
    """Median milliseconds of every stage, p95 as a tick."""
    fig = new_figure(7, 3.5)
    shown = {name: t for name, t in record["times"].items() if not name.startswith("  alone")}
    axes = fig.subplots()
    axes.barh(list(shown), [t["median_ms"] for t in shown.values()])
    axes.plot([t["p95_ms"] for t in shown.values()], list(shown), "k|")
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="milliseconds: median (bar), p95 (tick)", title=record["device"])
    fig.savefig(path, dpi=120)


def markdown(record: dict[str, Any]) -> str:
    """The table, with the cascade's parts summed up in one row."""
    times = record["times"]
    lines = ["| stage | first call ms | median ms | p95 ms |", "|---|---:|---:|---:|"]
    for name, t in times.items():
        if not name.startswith("  alone"):
            lines.append(f"| {name} | {t['first_ms']:.0f} | {t['median_ms']:.2f} | {t['p95_ms']:.2f} |")
    parts = sum(t["median_ms"] for name, t in times.items() if name.startswith("  alone"))
    together = parts + times["conductances, 4 levels"]["median_ms"]
    lines.append(f"| *steps and upsampling of paper-50, each alone, plus conductances* | | *{together:.2f}* | |")
    versions = record["versions"]
    lines += [
        "",
        f"512 x 512, {record['mesh']} ({record['faces']} triangles), {', '.join(record['lights'])}; "
        f"{record['device']}, {record['cpu_count']} cores, jax {versions['jax']}; "
        f"peak memory {record['peak_memory_mib']} MiB.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    run(main, Config)
