"""Run of a sweep from its spec to its summary."""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hyjax.sweep import work
from hyjax.sweep.batch import Function
from hyjax.sweep.engine import Engine
from hyjax.sweep.rows import ERROR, PART_PREFIX, Row, RowStore
from hyjax.sweep.settings import SweepSettings
from hyjax.sweep.spec import Spec, configurations_of, frames_of, read_spec
from hyjax.sweep.summary import Line, draw, lines_of, write_csv
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.files import atomic_write
from hyjax.util.reading import read_bytes

RESULT, TIME = "result", "time"
DPI = 120
MOST_FILE_BYTES = 1 << 32
"""Largest size of a file of lights or of a guide's weights, in bytes."""


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """Result of a sweep.

    Attributes:
        repeated: tasks that were done more than once.
        damaged: lines of rows that were left out, as a kill or a full disk cut them off.
    """

    out: Path
    tasks: int
    errors: list[str]
    repeated: int
    damaged: int
    lines: list[Line]


def run_sweep(
    settings: SweepSettings, *, evaluate: Function = work.evaluate, time_frames: Function = work.time_frames
) -> SweepResult:
    """Run the tasks of a sweep without a result, and write `rows.jsonl`, `summary.csv` and `sweep.png`."""
    settings.check()
    optional_module("matplotlib", "tune", "sweep")
    spec, out, part = read_spec(settings.spec), settings.out, settings.part
    if part is not None:
        out = out / f"{PART_PREFIX}{part[0]}-of-{part[1]}"
    store = RowStore(out)
    if not settings.resume and store.files():
        raise InputError(
            f"{out}: holds the rows of a sweep; add --resume to go on with it, or choose another --out"
        )
    configurations = configurations_of(spec)
    tasks = list(tasks_of(spec, list(configurations.values())))
    if part is not None:
        tasks = tasks[part[0] - 1 :: part[1]]
    left = sum(task.key not in store for task in tasks) if store.refresh() else len(tasks)
    quality, timed = ([task for task in tasks if task.kind == kind] for kind in (RESULT, TIME))
    with (
        Engine.open(settings.workers, settings.scheduler, out) as engine,
        tqdm(total=len(tasks), initial=len(tasks) - left, unit="task", disable=settings.quiet) as bar,
    ):
        if timed:
            engine.check_timing()
        for _ in itertools.chain(
            engine.run(evaluate, quality), engine.run(time_frames, timed, timing=True) if timed else ()
        ):
            bar.update()
    return _conclude(out, tasks, configurations)


def tasks_of(spec: Spec, configurations: list[dict[str, Any]]) -> Iterator[Task]:
    """Tasks of a spec, scene by scene; then the timing tasks, for the first seed."""
    frames = {scene: frames_of(spec, scene) for scene in spec.scenes}
    for kind, seeds in ((RESULT, spec.seeds), (TIME, spec.seeds[:1] if spec.time else [])):
        for scene, lights, configuration, seed in itertools.product(
            spec.scenes, spec.lights, configurations, seeds
        ):
            payload = {"scene": scene, "lights": lights, "configuration": configuration}
            files = [name for name in (lights, configuration["guide"]["name"]) if Path(name).is_file()]
            payload |= {"files": [content_key(name) for name in files]}
            yield Task(payload | {"frames": frames[scene], "size": spec.size, "seed": seed}, kind)


@functools.cache
def content_key(path: str) -> str:
    """Hash of a file's content: a task is another one when it changes."""
    return hashlib.sha256(read_bytes(Path(path), most=MOST_FILE_BYTES)).hexdigest()[:16]


def _conclude(out: Path, tasks: list[Task], configurations: dict[str, dict[str, Any]]) -> SweepResult:
    """Write the merged rows, in the order of the tasks, and the summary."""
    store = RowStore(out).refresh()
    names = {json.dumps(value, sort_keys=True): name for name, value in configurations.items()}
    rows: list[Row] = []
    for task in tasks:
        row = store.get(task.key)
        if row is not None:
            name = names[json.dumps(task.payload["configuration"], sort_keys=True)]
            rows.append(row | {"name": name})
    with atomic_write(out / "rows.jsonl") as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(json.dumps(row) + "\n" for row in rows)
    lines = lines_of(rows)
    write_csv(out / "summary.csv", lines)
    with atomic_write(out / "sweep.png") as temporary:
        draw(lines).savefig(temporary, dpi=DPI)
    errors = [f"{row['name']} on {row['scene']}: {row['error']}" for row in rows if row["kind"] == ERROR]
    return SweepResult(out, len(tasks), errors, store.duplicates(), store.damaged(), lines)
