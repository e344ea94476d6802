"""Comparison of hyjax, in one run, with torch, OpenCV, ONNX Runtime, and a loop in C as the floor.

    python -m experiments.bench_peers [--capture PATH] [--cores N] [--guard] [--out results/bench_peers]
    python -m experiments.bench_peers --parts quality --choose-on PATH    # the filters held out by scene

Every comparison is timed in turns (A B A B ...) after a first call that compiles, each time after an untimed call
of the same, so that nobody pays for what the one before left behind; medians and 95th percentiles. That all compute
the same is measured first, and part of the guard.

- *Step*: one step of Eq. 2 at several sizes and channels, in the form that `hyjax.diffuse` chooses and in the plain
  form; in torch, written from the formula, eager and compiled; in C, compiled on the spot. OpenCV's
  `anisotropicDiffusion` (8 bits, no guide but itself) is timed beside them. Above
  `hyjax.core.backends.MOST_VALUES` ours is the plain form: what they differ by is the noise.
- *Cascade*: whole schedules at 512 x 512, ours and torch's, with conductances by pooled guides in both. torch's is
  compiled a step at a time.
- *Quality*: OpenCV's edge-aware filters do another thing, so they are compared by what comes out: the relit frame's
  distance to that of the accurate surface, on frames held out. Each filters (w y, w) as ours does; its strength and
  reach are chosen by PSNR on tuning frames of the same capture, or of another one (`--choose-on`). Ours are
  presets, of which nothing is chosen here.
- *Guide*: the small network, ours, in torch and in ONNX Runtime. Whole frames: `frame_rate`.

`--cores 1` binds everything to one core. `--guard` makes the process fail where a ratio within the run is beyond
its limit, or could not be measured; the limits are those for `--cores 1`. Takes some minutes on two cores, which
should be idle.

Expect: a step near the C loop's time on one core; on two, where the form in place still runs on one, behind it.
The cascade a few times faster than torch's. OpenCV's global smoother, tuned, near the preset `hyjax` in quality and
time.
"""

import dataclasses
import itertools
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import hyjax
from experiments import peers
from experiments.command import RunConfig, Start, bind_to_cores, experiment, run
from experiments.guide_peers import last_bias, same_networks, torch_calls
from experiments.peers_report import COMPILED, COPY, FLOOR, OURS, PLAIN, TORCH, guard
from experiments.peers_report import blocks as blocks
from experiments.records import Results
from experiments.timing import check_repeats
from hyjax.core.diffusion import _steps
from hyjax.core.refine import HOLE_FLOOR
from hyjax.core.schedule import Schedule
from hyjax.data.frames import spread
from hyjax.guide import Guide, normalise
from hyjax.light.shading import mix_channels
from hyjax.pipeline import refine_illuminance
from hyjax.tuning.bench import Workbench, open_bench
from hyjax.tuning.cases import Case, filter_colors, raw_filter, refined_filter, scores
from hyjax.tuning.settings import TuneScene, TuneSettings
from hyjax.util.clock import measure_each
from hyjax.util.cores import cores
from hyjax.util.errors import InputError

CASCADES = ("paper-50", "paper-80", "naive-1000", "hyjax")
OPERATIONS = 13  # of a step, a pixel and channel: four differences, four products, four sums, one by λ
MOST_VALUES = 2**24
LAM = 0.2
CASCADE_SIZE = 512
GUIDE_SIZES = (256, 512)
"""Pixels a side."""
Part = Literal["steps", "cascades", "quality", "guide"]
MOST_SECONDS = 30.0


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """A capture with depth; by default the built-in room."""
    sizes: tuple[int, ...] = (128, 256, 512, 1024, 2048)
    """Side lengths of square pictures."""
    channels: tuple[int, ...] = (1, 3, 16)
    parts: tuple[Part, ...] = typing.get_args(Part)
    """Parts of the comparison to run."""
    choose_on: Path | None = None
    """Another capture to choose the filters' strengths on, or `room`, the built-in one. Default: earlier frames."""
    frames: int = 4
    """How many to choose strengths on, and how many to report on."""
    repeats: int = 20
    cores: int | None = None
    """How many cores to run on; by default all that this process may use."""
    guard: bool = False
    """End with status 1 where a ratio is beyond its limit."""
    seed: int = 0


@experiment("Beside others, in one run", "conditions")
def main(config: Config, start: Start) -> str | None:
    check_repeats(config.repeats)
    if bad := [size for size in config.sizes if size < 64]:
        raise InputError(f"sizes: a picture must be at least 64 pixels wide, got {bad[0]}")
    if config.cores is not None:
        bind_to_cores(config.cores)
    torch = peers.optional("torch")
    if torch is not None:
        torch.set_num_threads(cores())
    floor = peers.Floor()
    bench = open_bench(TuneSettings(TuneScene(capture=config.capture)))
    results = start()
    where = {"capture": bench.scene.capture.name, "meshes": bench.description}
    results.add(kind="conditions", cores=cores(), choose_on=config.choose_on, **where)
    parts: dict[Part, Callable[[], None]] = {
        "steps": lambda: time_steps(config, results, floor, torch),
        "cascades": lambda: time_cascades(config, results, torch),
        "quality": lambda: judge_filters(config, results, bench),
        "guide": lambda: time_guides(config, results),
    }
    for part in config.parts:
        parts[part]()
    broken = [what for what, *_, holds in guard(results.rows) if not holds] if config.guard else []
    return f"beyond its limit: {'; '.join(broken)}" if broken else None


def picture(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, np.float32)


def measured(calls: dict[str, Callable[[], Any]], config: Config) -> dict[str, dict[str, float | int]]:
    """`measure_each`, with nothing compiled before."""
    jax.clear_caches()
    return measure_each(calls, config.repeats, settled=True, most_seconds=MOST_SECONDS)


def furthest(a: Any, b: Any) -> float:
    a, b = (np.asarray(x.cpu() if hasattr(x, "cpu") else x) for x in (a, b))
    return float(np.abs(a - b).max())


def time_steps(config: Config, results: Results, floor: peers.Floor, torch: Any) -> None:
    for size in config.sizes:
        values = size * size
        for channels in config.channels:
            if values * channels > MOST_VALUES:
                continue
            steps = 48 if values * channels <= 2**19 else 16
            y, guide = picture(config.seed, size, size, channels), picture(config.seed + 1, size, size, 3)
            edges = hyjax.conductance(jnp.asarray(guide), 0.1)
            host = [np.asarray(edge) for edge in edges]
            device, sizes = jnp.asarray(y), jnp.full(steps, LAM)
            plain, first = jax.jit(_steps), np.moveaxis(y, -1, 0)
            expected = np.moveaxis(np.asarray(hyjax.diffuse(device, edges, sizes)), -1, 0)
            calls: dict[str, Callable[[], Any]] = {
                OURS: lambda y=device, e=edges, s=sizes: hyjax.diffuse(y, e, s),
                PLAIN: lambda f=plain, y=device, e=edges, s=sizes: f(y, e, s, None, None),
                FLOOR: floor.diffuse(first, host, steps, LAM, cores()),
                COPY: floor.copy(values * channels, steps, cores()),
            }
            difference = furthest(floor.diffuse(first, host, steps, LAM, cores())(), expected)
            if torch is not None:
                calls |= torch_step_calls(torch, first, host, steps)
                difference = max(difference, *(furthest(calls[who]()[0], expected) for who in (TORCH, COMPILED)))
            results.add(kind="agreement", what=f"steps at {size}², {channels} channels", difference=difference)
            if channels == 3 and (diffusion := peers.opencv_diffusion(y, steps)) is not None:
                calls["OpenCV anisotropicDiffusion"] = diffusion
            for who, time in measured(calls, config).items():
                times = {key: time[key] / steps for key in ("median_ms", "p95_ms")}
                copied = who == COPY
                results.add(
                    kind="step", size=size, channels=channels, who=who, first_ms=time["first_ms"], **times,
                    bytes=8 * values * channels + (0 if copied else 8 * values),
                    operations=0 if copied else OPERATIONS * values * channels,
                )  # fmt: skip


def torch_step_calls(
    torch: Any, y: np.ndarray, edges: list[np.ndarray], steps: int
) -> dict[str, Callable[[], Any]]:
    state = peers.torch_tensor(torch, y[None].copy())
    conductances = [peers.torch_tensor(torch, LAM * edge)[None, None] for edge in edges]
    compiled = peers.torch_compiled(torch)

    def call(run: peers.Steps) -> Any:
        with peers.torch_values(torch):
            return run(state, *conductances, steps)

    return {TORCH: lambda: call(peers.torch_steps), COMPILED: lambda: call(compiled)}


def time_cascades(config: Config, results: Results, torch: Any) -> None:
    y, guide = (picture(config.seed + k, CASCADE_SIZE, CASCADE_SIZE, 3) for k in range(2))
    y_jax, guide_jax = jnp.asarray(y), jnp.asarray(guide)
    for name in CASCADES:
        schedule = Schedule.preset(name)
        if name != "hyjax":  # the same operations as in torch
            schedule = dataclasses.replace(schedule, pooling="guide")
        calls: dict[str, Callable[[], Any]] = {OURS: lambda s=schedule: hyjax.cascade(y_jax, guide_jax, s)}
        if torch is not None and name != "hyjax":
            inputs = [peers.torch_tensor(torch, np.moveaxis(x, -1, 0)[None].copy()) for x in (y, guide)]
            compiled = peers.torch_compiled(torch)

            def call(run: peers.Steps, inputs: Any = inputs, schedule: Schedule = schedule) -> Any:
                with peers.torch_values(torch):
                    return peers.torch_cascade(*inputs, schedule, run)

            calls |= {TORCH: lambda c=call: c(peers.torch_steps), COMPILED: lambda c=call, r=compiled: c(r)}
            ours_first = np.moveaxis(np.asarray(calls[OURS]()), -1, 0)
            difference = max(furthest(calls[who]()[0], ours_first) for who in (TORCH, COMPILED))
            results.add(kind="agreement", what=name, difference=difference)
        for who, time in measured(calls, config).items():
            results.add(kind="cascade", schedule=name, who=who, **time)


def judge_filters(config: Config, results: Results, bench: Workbench) -> None:
    count = len(bench.scene)
    early, late = range(count - max(1, count // 4)), range(count - max(1, count // 4), count)
    if config.choose_on is None:
        tuning, _ = bench.cases(spread(early, config.frames), "tuning")
    else:
        other = None if config.choose_on == Path("room") else config.choose_on
        chosen_on = open_bench(TuneSettings(TuneScene(capture=other)))
        tuning, _ = chosen_on.cases(spread(range(len(chosen_on.scene)), config.frames), "tuning")
    held_out, _ = bench.cases(spread(late, config.frames), "held-out")
    options: dict[str, list[tuple[float, float]]] = {
        who: list(itertools.product(peers.STRENGTHS, reaches))
        for who, (_, reaches) in peers.opencv_filters(np.asarray(tuning[0].guide)).items()
    }
    chosen: dict[str, tuple[float, float] | None] = {}
    for who in ("raw filter", *CASCADES, *options):
        tried = options.get(who, [None])
        found = [scores(tuning, [filtered(case, who, option) for case in tuning])["psnr"] for option in tried]
        chosen[who] = option = tried[int(np.argmax(found))]
        score = scores(held_out, [filtered(case, who, option) for case in held_out])
        ends = {value for values in zip(*tried) for value in (min(values), max(values))} if option else set()
        results.add(
            kind="quality", who=who, chosen=option, at_end=bool(option) and not ends.isdisjoint(option),
            **score,
        )  # fmt: skip
    case = held_out[0]
    calls = {who: repair(case, who, option) for who, option in chosen.items() if who != "raw filter"}
    for who, time in measured(calls, config).items():
        results.add(kind="quality time", who=who, channels=case.shaded.colors.shape[0] + 1, **time)


def weighted(case: Case) -> np.ndarray:
    """(w y, w), as `cascade_known` diffuses them."""
    known = np.asarray(case.shaded.confidence)
    return np.ascontiguousarray(np.concatenate([np.asarray(case.shaded.illuminance) * known, known], axis=-1))


def filtered(case: Case, who: str, option: tuple[float, float] | None) -> Any:
    """The filter that somebody makes of a case; where a hole is out of reach the mean of all that is known."""
    if who == "raw filter":
        return raw_filter(case.shaded)
    if option is None:
        return refined_filter(case, Schedule.preset(who))
    out, known = repair(case, who, option)(), weighted(case)
    mean = known[..., :-1].sum((0, 1)) / known[..., -1:].sum()
    reached = np.clip(out[..., -1:], 0.0, 1.0)  # not every filter keeps between the values it is given
    floor = HOLE_FLOOR * (1.0 - reached)
    values = np.clip(out[..., :-1], 0.0, None) + floor * mean
    return mix_channels(jnp.asarray(values / np.maximum(reached + floor, 1e-6)), filter_colors(case.shaded))


def repair(case: Case, who: str, option: tuple[float, float] | None) -> Callable[[], Any]:
    """The repair of a case's channels by itself, on inputs as its library wants them."""
    if option is None:
        schedule = Schedule.preset(who)
        return lambda: refine_illuminance(case.shaded, case.guide, schedule)
    function, inputs = peers.opencv_filters(np.asarray(case.guide))[who][0], weighted(case)
    return lambda: function(inputs, *option)


def time_guides(config: Config, results: Results) -> None:
    network, theirs = same_networks("mobilenetv4_conv_small", config.seed)
    guide = Guide(network)
    for size in GUIDE_SIZES:
        display = jnp.asarray(picture(config.seed, size, size, 3))
        calls: dict[str, Callable[[], Any]] = {OURS: lambda x=display: guide.features(x)}
        if theirs is not None:
            normalised = np.asarray(normalise(display))
            calls |= torch_calls(theirs, normalised)
            if (session := peers.onnx_session(theirs, normalised, cores())) is not None:
                calls["ONNX Runtime"] = session
            features = np.moveaxis(np.asarray(calls[OURS]() + last_bias(network)), -1, 0)
            difference = furthest(calls[TORCH]()[0], features) / np.abs(features).max()
            results.add(kind="agreement", what=f"guide at {size}²", difference=difference)
        for who, time in measured(calls, config).items():
            results.add(kind="guide", size=size, who=who, **time)


if __name__ == "__main__":
    run(main)
