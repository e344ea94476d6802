"""Comparison of what two checkouts make: pictures, tuning journals, trained weights.

    git worktree add /tmp/before REVISION
    python -m experiments.before_after --checkout /tmp/before --out /tmp/runs/before
    python -m experiments.before_after --checkout . --out /tmp/runs/after --against /tmp/runs/before

Runs the commands of the checkout in processes of their own: `hyjax relight` on the built-in room and on a capture,
with every named set-up, in our own mode, in paper mode and with `--video`; a short `hyjax train`; a short
`hyjax tune` on the latency table of the run that is compared with. Takes about ten minutes a checkout on two cores.

Expect: pictures within 1e-6 in linear light, weights and the losses of the journal equal.
"""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from safetensors.numpy import load_file
from tqdm import tqdm

from experiments.command import run
from hyjax.util.errors import InputError

SETUPS = "noon-window", "golden-hour", "evening-lamps", "night-moon", "center-point", "two-colors"
MODES = {"linear": (), "paper": ("--paper-mode",), "video": ("--video",)}
ALSO = "--save-filters", "--save-visibility"
TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class Config:
    checkout: Path = Path()
    """Folder whose `hyjax` is run."""
    capture: Path | None = Path("../shared/data/kitchen")
    """Relit beside the built-in room, if it is there."""
    size: str = "320x240"
    out: Path = Path("results/before_after")
    against: Path | None = None
    """Folder of the run to compare with."""


def main(config: Config) -> None:
    config.out.mkdir(parents=True, exist_ok=True)
    if config.against is not None:
        for table in (config.against / "cache").glob("latency*"):
            (config.out / "cache").mkdir(exist_ok=True)
            shutil.copy(table, config.out / "cache")
    jobs = dict(commands(config))
    for name, arguments in tqdm(jobs.items(), unit="run"):
        call(config, name, arguments)
    if config.against is not None:
        worst = compare(config.against, config.out, list(jobs))
        print(f"{len(jobs)} runs agree; largest difference {worst:.2g}")


def commands(config: Config) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of every run."""
    captures: dict[str, list[str]] = {"room": ["--frames", "0:24:9"]}
    if config.capture is not None and config.capture.is_dir():
        captures["kitchen"] = ["--capture", str(config.capture.resolve()), "--frames", "0:300:140"]
    for source, chosen in captures.items():
        for setup in SETUPS:
            for mode, options in MODES.items():
                frames = [*chosen[:-1], "0:3"] if mode == "video" else chosen
                yield (
                    f"{source}-{setup}-{mode}",
                    ["relight", *frames, "--lights", setup, *options, "--size", config.size, *ALSO],
                )
    yield "train", ["train", "--iterations", "3", "--size", "64", "--batch", "2"]
    yield "tune", ["tune", "--fps", "200", "--size", "128", "--no-extra", "--frames", "0,8", "--holdout", "20"]


def call(config: Config, name: str, arguments: list[str]) -> None:
    """Run one command of the checkout into a folder of its own."""
    out = config.out / name
    shutil.rmtree(out, ignore_errors=True)
    environment = os.environ | {
        "HYJAX_CACHE": str((config.out / "cache").resolve()),
        "PYTHONPATH": str(config.checkout.resolve()),
    }
    command = [sys.executable, "-m", "hyjax.cli", *arguments, "--quiet", "--out", str(out.resolve())]
    done = subprocess.run(command, env=environment, cwd=config.checkout, capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"{name}: exit status {done.returncode}: {done.stderr.strip()[-2000:]}")


def compare(before: Path, after: Path, names: list[str]) -> float:
    """Largest difference between two runs of the commands.

    Raises:
        InputError: one is larger than `TOLERANCE`, or something is missing.
    """
    worst = 0.0
    for name in names:
        mine, theirs = dict(numbers(after / name)), dict(numbers(before / name))
        if not mine or mine.keys() != theirs.keys():
            raise InputError(f"{name}: {sorted(mine.keys() ^ theirs.keys()) or 'nothing'} was written by one only")
        for file, values in mine.items():
            if values.shape != theirs[file].shape:
                raise InputError(f"{name}: {file} is {values.shape}, was {theirs[file].shape}")
            worst = max(worst, float(np.abs(values - theirs[file]).max(initial=0.0)))
            if worst > TOLERANCE:
                raise InputError(f"{name}: {file} differs by {worst:.3g}, more than {TOLERANCE:g}")
    return worst


def numbers(folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Numbers that a run wrote, by file: linear pixels, weights, the journal's values in their order."""
    for file in sorted(folder.glob("*.exr")):
        yield file.name, OpenImageIO.ImageBuf(str(file)).get_pixels(OpenImageIO.DOUBLE)
    for file in sorted(folder.glob("*.safetensors")):
        for name, array in load_file(file).items():
            yield f"{file.name}:{name}", np.asarray(array, np.float64)
    for file in folder.glob("journal.jsonl"):
        lines = [json.loads(line) for line in file.read_text().splitlines()[1:]]
        yield file.name, np.asarray([number for line in lines for number in flat(line["value"])])


def flat(value: Any) -> Iterator[float]:
    """The numbers in a JSON value."""
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from flat(item)
    elif isinstance(value, int | float):
        yield float(value)


if __name__ == "__main__":
    run(main)
