"""What a diffusion schedule costs on this device: a model fitted to schedules timed whole, and a cache for it.

The compiled cascade is one program, so its parts cannot be timed one by one. Whole schedules are, some thirty of
them, and an additive model is fitted to their times,

    t = fixed + Σ (level_l + step_l n_l) + finest_f,

summed over the levels l that have steps, with f the finest of these: its result is upsampled to full size. What any
schedule pays goes to `fixed`. The coefficients are not negative, and errors count relative to the time.

Symbols of this file: a *ladder* is the factors that a schedule may use, coarse to fine; *steps* are n_l over the
ladder, 0 where a level is left out.
"""

import concurrent.futures
import dataclasses
import functools
import hashlib
import itertools
import json
import logging
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import nnls
from tqdm import tqdm

from hyjax.cache import cache_folder
from hyjax.cascade import level_edges
from hyjax.environment import environment
from hyjax.errors import InputError
from hyjax.files import write_text
from hyjax.pyramid import downsample, level_shape, upsample
from hyjax.refine import cascade_known
from hyjax.schedule import PRESETS, Schedule
from hyjax.tuning import latency
from hyjax.tuning.result import Milliseconds

log = logging.getLogger(__name__)

LADDER = (32, 16, 8, 4, 2, 1)
# Cells that the shorter side of a level must have to be worth a place in a ladder.
FEWEST_CELLS = 4

FORMAT = 1
DTYPES = ("float16", "bfloat16", "float32", "float64")

REPEATS = 60
# Large pictures get fewer rounds instead of minutes.
MOST_SECONDS = 30.0
PROBE_REPEATS = 40
# No measured time is taken to be shorter, in milliseconds: what the clock's record is rounded to.
SHORTEST = 1e-3
# A stored table is believed while a probe takes between 1/1.3 and 1.3 times as long as it did then.
PROBE_TOLERANCE = 1.3

# Steps by factor that make a level's steps cost about as much as the rest of a single-level schedule.
MANY_STEPS = {1: 10, 2: 24, 4: 40, 8: 80}
MANY_COARSE_STEPS = 240
FEW_STEPS = 2

Arguments = tuple[Float[Array, "h w lights"], Bool[Array, "h w 1"], Float[Array, "h w f"]]


@dataclasses.dataclass(frozen=True)
class Workload:
    """The shapes that a cascade is timed on: `cascade_known` with one channel a light.

    Attributes:
        height: pixels.
        width: pixels.
        lights: channels of the filter.
        guide_channels: features of the guide.
        dtype: of filter and guide.

    Raises:
        InputError: a size below 1, an unknown dtype, or float64 while JAX runs without it.
    """

    height: int
    width: int
    lights: int
    guide_channels: int = 3
    dtype: str = "float32"

    def __post_init__(self) -> None:
        for name in ("height", "width", "lights", "guide_channels"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise InputError(f"workload: {name} must be a whole number >= 1, got {value!r}")
        if self.dtype not in DTYPES:
            raise InputError(f"workload: dtype {self.dtype!r} is unknown; use one of {', '.join(DTYPES)}")
        if self.dtype == "float64" and jax.dtypes.canonicalize_dtype("float64") != "float64":
            raise InputError("workload: dtype float64 needs JAX_ENABLE_X64=1")

    def arguments(self) -> Arguments:
        """Filter, known and guide of these shapes: pseudo-random, the same every time, on the default device."""
        rng = np.random.default_rng(0)
        size = self.height, self.width
        y = rng.random((*size, self.lights), np.float32)
        known = rng.random((*size, 1)) > 0.1
        guide = rng.random((*size, self.guide_channels), np.float32)
        return jnp.asarray(y, self.dtype), jnp.asarray(known), jnp.asarray(guide, self.dtype)

    def __str__(self) -> str:
        lights = f"{self.lights} light{'s' if self.lights > 1 else ''}"
        return f"{self.height}x{self.width}, {lights}, {self.guide_channels} guide channels, {self.dtype}"


@dataclasses.dataclass(frozen=True)
class CostModel:
    """Additive cost of a schedule, in milliseconds; one entry for each level of the ladder, coarse to fine.

    Attributes:
        fixed: what any schedule costs.
        level: for having the level at all: its conductances, and getting there from the level before.
        step: for each of its steps.
        finest: for ending there: upsampling to full size, beyond the part that is in `fixed`.
    """

    fixed: float
    level: tuple[float, ...]
    step: tuple[float, ...]
    finest: tuple[float, ...]

    def __call__(self, steps: Sequence[int | float]) -> float:
        """Milliseconds for a schedule with these steps over the ladder; a level with 0 steps is left out.

        Raises:
            InputError: not one entry for each level of the ladder, a negative one, or none above 0.
        """
        row = _row(_checked(steps, len(self.level)))
        return float(row @ np.concatenate([[self.fixed], self.level, self.step, self.finest]))


@dataclasses.dataclass
class LatencyTable:
    """What `calibrate` found out about one workload on one device. All times are milliseconds.

    Attributes:
        workload: the shapes.
        ladder: factors that a schedule may use, coarse to fine.
        device: platform and kind, cores, compiler flags.
        versions: of what decides how fast the compiled code is.
        created: when it was calibrated, ISO 8601.
        median: model of the median time.
        p95: model of the 95th percentile, nowhere below `median`.
        error: `median_relative` and `worst_relative` of the median model on the calibration's schedules, each
            predicted from all the others. The worst is a level on its own, of whose cost no other schedule tells.
        probe: a paper-like schedule timed on its own, to recognise later whether the device still is as fast.
        calibration: the schedules timed: `steps`, `median_ms`, `p95_ms`.
        stages: fixed costs of other stages, by name, see `time_stages`.
        timed: whole schedules timed for real, by `schedule_key`, see `time_schedules`.
    """

    workload: Workload
    ladder: tuple[int, ...]
    device: dict[str, Any]
    versions: dict[str, str]
    created: str
    median: CostModel
    p95: CostModel
    error: dict[str, float]
    probe: Milliseconds
    calibration: list[dict[str, Any]]
    stages: dict[str, Milliseconds] = dataclasses.field(default_factory=dict)
    timed: dict[str, Milliseconds] = dataclasses.field(default_factory=dict)

    def predict(self, steps: Sequence[int | float]) -> Milliseconds:
        """What a schedule with these steps over the ladder costs; a level with 0 steps is left out.

        Raises:
            InputError: as `CostModel` does.
        """
        return Milliseconds(self.median(steps), self.p95(steps))

    def steps_of(self, schedule: Schedule) -> tuple[int, ...]:
        """A schedule's steps over the ladder; levels without steps vanish.

        Raises:
            InputError: a factor with steps that is not in the ladder.
        """
        counts = {level.factor: level.steps for level in schedule.levels if level.steps}
        for factor in counts.keys() - set(self.ladder):
            raise InputError(
                f"schedule {schedule.name}: factor {factor} is not in the latency table's ladder "
                f"{', '.join(map(str, self.ladder))}"
            )
        return tuple(counts.get(factor, 0) for factor in self.ladder)

    def key(self) -> dict[str, Any]:
        """What must agree for the table to be used again, as JSON's types."""
        return _key(self.workload, self.ladder, self.device, self.versions)

    def to_json(self) -> str:
        """The table as JSON text, for `from_json`."""
        content = {"format": FORMAT} | dataclasses.asdict(self)
        return json.dumps(content, indent=1)

    @classmethod
    def from_json(cls, text: str) -> "LatencyTable":
        """Read what `to_json` wrote.

        Raises:
            InputError: not JSON, of another format version, or something missing or not what it should be.
        """
        try:
            content = json.loads(text)
        except ValueError as error:  # also undecodable text
            raise InputError(f"latency table: not JSON ({str(error).splitlines()[0]})") from None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            found = content.get("format") if isinstance(content, dict) else None
            raise InputError(f"latency table: format {found!r}, need {FORMAT}")
        try:
            return _read_table(content)
        except InputError as error:
            raise InputError(f"latency table: {error}") from None
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
            raise InputError(f"latency table: {type(error).__name__}: {error}".replace("\n", " ")) from None


def _read_table(content: dict[str, Any]) -> LatencyTable:
    ladder = tuple(content["ladder"])
    _check_ladder(ladder)

    def model(entry: dict[str, Any]) -> CostModel:
        parts = [tuple(map(_number, entry[name])) for name in ("level", "step", "finest")]
        if any(len(part) != len(ladder) for part in parts):
            raise ValueError("a cost for each level of the ladder is needed")
        return CostModel(_number(entry["fixed"]), *parts)

    def milliseconds(entry: dict[str, Any]) -> Milliseconds:
        return Milliseconds(_number(entry["median"]), _number(entry["p95"]))

    return LatencyTable(
        workload=Workload(**content["workload"]),
        ladder=ladder,
        device=dict(content["device"]),
        versions={name: str(version) for name, version in content["versions"].items()},
        created=str(content["created"]),
        median=model(content["median"]),
        p95=model(content["p95"]),
        error={name: _number(content["error"][name]) for name in ("median_relative", "worst_relative")},
        probe=milliseconds(content["probe"]),
        calibration=[
            {
                "steps": list(_checked(entry["steps"], len(ladder))),
                "median_ms": _number(entry["median_ms"]),
                "p95_ms": _number(entry["p95_ms"]),
            }
            for entry in content["calibration"]
        ],
        stages={name: milliseconds(entry) for name, entry in content["stages"].items()},
        timed={name: milliseconds(entry) for name, entry in content["timed"].items()},
    )


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise ValueError(f"{value!r} is no time or error")
    return float(value)


# ---- ladders and schedules ----


def ladder_for(height: int, width: int, ladder: Sequence[int] = LADDER) -> tuple[int, ...]:
    """The factors of a ladder that are not too coarse for a picture of this size.

    Raises:
        InputError: factors do not fall, are no multiples of each other, or are all too coarse.
    """
    _check_ladder(ladder)
    fitting = tuple(f for f in ladder if f == 1 or min(level_shape((height, width), f)) >= FEWEST_CELLS)
    if not fitting:
        raise InputError(f"ladder: every factor of {tuple(ladder)} is too coarse for {height}x{width} pixels")
    return fitting


def _check_ladder(ladder: Sequence[int]) -> None:
    whole = all(isinstance(f, int) and not isinstance(f, bool) and f >= 1 for f in ladder)
    if not ladder or not whole or any(c <= f or c % f for c, f in itertools.pairwise(ladder)):
        raise InputError(f"ladder: factors must fall, each a multiple of the next, got {tuple(ladder)}")


def schedule_key(schedule: Schedule) -> str:
    """What decides a schedule's time: `16:5 8:10`, factor and steps, with pooling and norm if not the defaults."""
    text = " ".join(f"{level.factor}:{level.steps}" for level in schedule.levels)
    if schedule.pooling != "edges":
        text += f" pooling={schedule.pooling}"
    if schedule.norm != "l2":
        text += f" norm={schedule.norm}"
    return text


def _schedule(ladder: Sequence[int], steps: Sequence[int]) -> Schedule:
    return Schedule.uniform([(factor, count) for factor, count in zip(ladder, steps) if count])


def probe_steps(ladder: Sequence[int]) -> tuple[int, ...]:
    """The paper's 50 steps as far as the ladder has their levels; two a level if it has none of them."""
    paper = dict(PRESETS["paper-50"])
    steps = tuple(paper.get(factor, 0) for factor in ladder)
    return steps if any(steps) else (FEW_STEPS,) * len(ladder)


def calibration_steps(ladder: Sequence[int]) -> list[tuple[int, ...]]:
    """The schedules that `calibrate` times, as steps over the ladder.

    Each level alone with few and with many steps, every entry and every finest level of longer ladders, two
    schedules of the paper, every other level, and some mixtures, so that all coefficients can be told apart and an
    outlier cannot carry one of them alone.
    """
    count = len(ladder)
    many = [MANY_STEPS.get(factor, MANY_COARSE_STEPS) for factor in ladder]
    rng = np.random.default_rng(0)

    def mixed(present: Iterable[int]) -> tuple[int, ...]:
        chosen = set(present)
        return tuple(
            int(rng.integers(FEW_STEPS, max(most // 2, 3))) if i in chosen else 0 for i, most in enumerate(many)
        )

    rows = [probe_steps(ladder)]
    paper = dict(PRESETS["paper-80"])
    rows += [tuple(paper.get(factor, 0) for factor in ladder)]
    for i in range(count):
        rows += [tuple(steps if j == i else 0 for j in range(count)) for steps in (FEW_STEPS, many[i])]
    rows += [mixed(range(i, count)) for i in range(count - 1)]  # every entry
    rows += [mixed(range(i + 1)) for i in range(1, count - 1)]  # every finest level
    rows += [mixed(range(0, count, 2)), mixed(range(1, count, 2))]
    rows += [mixed((i, i + 1)) for i in range(1, count - 1)]
    return [row for row in dict.fromkeys(rows) if any(row)]


def _checked(steps: Sequence[int | float], count: int) -> Sequence[int | float]:
    if len(steps) != count:
        raise InputError(f"steps: need one number for each of {count} levels, got {len(steps)}")
    for value in steps:
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"steps: must be finite and >= 0, got {value}")
    if not any(steps):
        raise InputError("steps: at least one level must have some")
    return steps


# ---- the fit ----


def _row(steps: Sequence[int | float]) -> Float[np.ndarray, "k"]:
    """What the coefficients (fixed, levels, steps, finest) are multiplied with."""
    counts = np.asarray(steps, float)
    present = counts > 0
    finest = np.zeros(len(counts))
    finest[np.flatnonzero(present)[-1]] = 1.0
    return np.concatenate([[1.0], present, counts, finest])


def fit(steps: Sequence[Sequence[int]], times: Sequence[float], *, above: CostModel | None = None) -> CostModel:
    """Fit the additive model to times of whole schedules, robustly and relative to the times.

    Huber's weights on the relative residuals, least squares under coefficients ≥ 0 (Lawson and Hanson).

    Args:
        steps: over the ladder, one entry for each schedule.
        times: milliseconds, > 0.
        above: a model whose coefficients bound the new ones from below.
    """
    design, measured = np.stack([_row(row) for row in steps]), np.maximum(np.asarray(times, float), SHORTEST)
    count = len(steps[0])
    low = np.zeros(design.shape[1])
    if above is not None:
        low = np.concatenate([[above.fixed], above.level, above.step, above.finest])
    # The last level is never anything but the finest: the two costs cannot be told apart, `level` has both.
    relative, target = design[:, :-1] / measured[:, None], 1.0 - design @ low / measured
    free = relative.shape[1]
    # A constant may move between `fixed` and all of `finest`: a trace of a penalty decides.
    penalty = 1e-7 * np.diag(np.linalg.norm(relative, axis=0))
    weight = np.ones(len(measured))
    for _ in range(50):
        rows = np.concatenate([relative * weight[:, None], penalty])
        solution, _ = nnls(rows, np.concatenate([target * weight, np.zeros(free)]), maxiter=100 * free)
        residual = np.abs(relative @ solution - target)
        scale = max(1.4826 * float(np.median(residual)), 1e-4)
        new = np.sqrt(np.minimum(1.0, 1.345 * scale / np.maximum(residual, 1e-12)))
        if np.allclose(new, weight, rtol=1e-3):
            break
        weight = new
    values = low + np.append(solution, 0.0)
    fixed, (level, step, finest) = values[0], values[1:].reshape(3, count)
    if above is None:  # what every schedule pays belongs to `fixed`
        shared = min([level[-1], *finest[:-1]])
        fixed, finest[:-1], level[-1] = fixed + shared, finest[:-1] - shared, level[-1] - shared
    return CostModel(float(fixed), tuple(level.tolist()), tuple(step.tolist()), tuple(finest.tolist()))


def leave_one_out(steps: Sequence[Sequence[int]], times: Sequence[float]) -> Float[np.ndarray, "n"]:
    """Relative error of each time when predicted by a model fitted to all the others."""
    errors = []
    for i, row in enumerate(steps):
        model = fit([*steps[:i], *steps[i + 1 :]], [*times[:i], *times[i + 1 :]])
        errors.append(abs(model(row) / times[i] - 1.0))
    return np.array(errors)


# ---- timing ----


def _compile_all(schedules: Sequence[Schedule], arguments: Arguments, *, progress: bool) -> list[Callable[[], Any]]:
    """`cascade_known` compiled for each schedule, with its arguments bound and already on the device.

    Two at a time; all are ready before anything is timed.
    """
    y, known, guide = arguments

    def compiled(schedule: Schedule) -> Callable[[], Any]:
        schedule = jax.device_put(schedule)
        return functools.partial(
            cascade_known.lower(y, known, guide, schedule).compile(), y, known, guide, schedule
        )

    with concurrent.futures.ThreadPoolExecutor(min(2, _cores())) as pool:
        jobs = [pool.submit(compiled, schedule) for schedule in schedules]
        try:
            finished = concurrent.futures.as_completed(jobs)
            bar = tqdm(finished, "compiling", len(jobs), unit="schedule", leave=False, disable=not progress)
            for job in bar:
                job.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [job.result() for job in jobs]


def _milliseconds(
    calls: Mapping[str, Callable[[], Any]], repeats: int, *, progress: bool, most_seconds: float | None = None
) -> dict[str, Milliseconds]:
    if repeats < 1:
        raise InputError(f"repeats: must be at least 1, got {repeats}")
    summary = latency.measure_each(calls, repeats, most_seconds=most_seconds, progress=progress)
    return {name: Milliseconds(entry["median_ms"], entry["p95_ms"]) for name, entry in summary.items()}


def calibrate(
    workload: Workload, ladder: Sequence[int] = LADDER, *, repeats: int = REPEATS, progress: bool = True
) -> LatencyTable:
    """Time some thirty schedules and fit the model to them. Takes about half a minute at 512×512 on two cores.

    Args:
        workload: the shapes.
        ladder: factors, coarse to fine; those too coarse for the shapes are dropped.
        repeats: times each schedule runs, fewer if that would take more than half a minute.
        progress: show bars on stderr.

    Raises:
        InputError: a ladder that no schedule can have, or no repeats.
    """
    ladder = ladder_for(workload.height, workload.width, ladder)
    arguments = workload.arguments()
    steps = calibration_steps(ladder)
    calls = _compile_all([_schedule(ladder, row) for row in steps], arguments, progress=progress)
    named = {str(index): call for index, call in enumerate(calls)}
    times = list(_milliseconds(named, repeats, progress=progress, most_seconds=MOST_SECONDS).values())
    medians, p95s = [t.median for t in times], [t.p95 for t in times]
    median = fit(steps, medians)
    errors = leave_one_out(steps, medians)
    device, versions = _device_and_versions()
    table = LatencyTable(
        workload=workload,
        ladder=ladder,
        device=device,
        versions=versions,
        created=latency.timestamp(),
        median=median,
        p95=fit(steps, p95s, above=median),
        error={"median_relative": float(np.median(errors)), "worst_relative": float(errors.max())},
        probe=_milliseconds({"probe": calls[steps.index(probe_steps(ladder))]}, PROBE_REPEATS, progress=False)[
            "probe"
        ],
        calibration=[{"steps": list(row), "median_ms": t.median, "p95_ms": t.p95} for row, t in zip(steps, times)],
    )
    time_stages(table, _own_stages(table, arguments), repeats)
    return table


def _own_stages(table: LatencyTable, arguments: Arguments) -> dict[str, Callable[[], Any]]:
    """Parts of the paper's cascade alone: the conductances of its levels; down to its entry level and up again."""
    y, _, guide = arguments
    schedule = jax.device_put(_schedule(table.ladder, probe_steps(table.ladder)))
    entry, full = schedule.levels[0].factor, y.shape[:2]
    edges = jax.jit(level_edges)
    resample = jax.jit(lambda picture: upsample(downsample(picture, entry), entry, full))
    return {
        "conductance": functools.partial(edges, guide, schedule),
        "resampling": functools.partial(resample, y),
    }


def time_stages(
    table: LatencyTable, calls: Mapping[str, Callable[[], Any]], repeats: int = REPEATS
) -> dict[str, Milliseconds]:
    """Time other stages of the pipeline in turns and keep the times in `table.stages`.

    Args:
        table: what they are added to; equal names are replaced.
        calls: by the stage's name; each returns what has to be waited for.
        repeats: rounds after the first one, which compiles.
    """
    times = _milliseconds(calls, repeats, progress=False, most_seconds=MOST_SECONDS)
    table.stages.update(times)
    return times


def time_schedules(
    table: LatencyTable,
    schedules: Sequence[Schedule],
    *,
    arguments: Arguments | None = None,
    repeats: int = 100,
    again: bool = False,
    progress: bool = True,
) -> list[Milliseconds]:
    """Time the compiled `cascade_known` for each schedule, in turns, and remember the times in `table.timed`.

    Args:
        table: for its workload and its memory; `save_table` keeps what it learns.
        schedules: any; those that differ in λ and κ alone take the same time and are timed once.
        arguments: filter, known and guide to time on; the workload's if not given.
        repeats: times each schedule runs, fewer (at least ten) if that would take more than a minute.
        again: also time those that the table remembers.
        progress: show bars on stderr.

    Raises:
        InputError: a schedule that cannot be run, arguments that are not the workload's shapes, or no repeats.
    """
    keys = [schedule_key(schedule.check()) for schedule in schedules]
    wanted = {key: schedule for key, schedule in zip(keys, schedules) if again or key not in table.timed}
    if wanted:
        arguments = _on_device(table.workload, arguments)
        calls = _compile_all(list(wanted.values()), arguments, progress=progress)
        named = dict(zip(wanted, calls))
        table.timed.update(_milliseconds(named, repeats, progress=progress, most_seconds=2 * MOST_SECONDS))
    return [table.timed[key] for key in keys]


def _on_device(workload: Workload, arguments: Arguments | None) -> Arguments:
    if arguments is None:
        return workload.arguments()
    size = workload.height, workload.width
    shapes = (*size, workload.lights), (*size, 1), (*size, workload.guide_channels)
    for name, array, shape in zip(("filter", "known", "guide"), arguments, shapes, strict=True):
        if array.shape != shape:
            raise InputError(f"{name}: shape {array.shape} is not the latency table's {shape}")
    y, known, guide = (jnp.asarray(array) for array in arguments)
    return y, known, guide


# ---- the cache ----


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def _device_and_versions() -> tuple[dict[str, Any], dict[str, str]]:
    record = environment()
    device = {"name": record["device"], "cores": _cores(), "xla_flags": os.environ.get("XLA_FLAGS", "")}
    return device, {name: record["versions"][name] for name in ("hyjax", "jax", "jaxlib")}


def _key(
    workload: Workload, ladder: Sequence[int], device: Mapping[str, Any], versions: Mapping[str, str]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "workload": dataclasses.asdict(workload),
        "ladder": list(ladder),
        "device": dict(device),
        "versions": dict(versions),
    }


def _path(key: Mapping[str, Any]) -> Path:
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return cache_folder() / f"latency-{digest[:16]}.json"


def save_table(table: LatencyTable) -> None:
    """Keep a table for `load_table`. A cache that cannot be written to is a warning in the log, no more."""
    path = _path(table.key())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, table.to_json())
    except (OSError, InputError) as error:
        log.warning("latency table is not kept: %s", error)


def load_table(
    workload: Workload,
    ladder: Sequence[int] = LADDER,
    *,
    recalibrate: bool = False,
    progress: bool = True,
) -> tuple[LatencyTable, str]:
    """The latency table of a workload on this device: from the cache if it still holds, else calibrated and kept.

    Args:
        workload: the shapes.
        ladder: factors, coarse to fine; those too coarse for the shapes are dropped.
        recalibrate: calibrate anew whatever the cache says.
        progress: show bars on stderr.

    Returns:
        The table, and in a few words where it is from.

    Raises:
        InputError: a ladder that no schedule can have.
    """
    ladder = ladder_for(workload.height, workload.width, ladder)
    reason = "asked for"
    if not recalibrate:
        found = _from_cache(workload, ladder)
        if isinstance(found, LatencyTable):
            return found, f"from the cache (calibrated {found.created})"
        reason = found
    table = calibrate(workload, ladder, progress=progress)
    save_table(table)
    return table, f"calibrated anew: {reason}"


def _from_cache(workload: Workload, ladder: tuple[int, ...]) -> LatencyTable | str:
    """The stored table, or why there is none to use."""
    key = _key(workload, ladder, *_device_and_versions())
    path = _path(key)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return "none in the cache for this device, size and these versions"
    except (OSError, UnicodeError) as error:
        return f"{path.name} in the cache cannot be read ({error.__class__.__name__})"
    try:
        table = LatencyTable.from_json(text)
    except InputError as error:
        return f"{path.name} in the cache is broken ({error})"
    if table.key() != key:
        changed = [name for name, value in table.key().items() if value != key[name]]
        return f"{path.name} in the cache is of another {', '.join(changed)}"
    (probe,) = _compile_all([_schedule(ladder, probe_steps(ladder))], workload.arguments(), progress=False)
    for repeats in (PROBE_REPEATS, 3 * PROBE_REPEATS):  # a burst of other work on the machine is no reason yet
        now = _milliseconds({"probe": probe}, repeats, progress=False)["probe"].median
        if now <= PROBE_TOLERANCE * table.probe.median and table.probe.median <= PROBE_TOLERANCE * now:
            return table
    return f"a schedule that took {table.probe.median:.2f} ms then takes {now:.2f} ms now"
