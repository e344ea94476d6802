"""Commands as small as they go, and of their results what must not depend on kills."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

CAPTURE, SPEC = "capture", "sweep.json"
SIZE = "64x48"
ROUNDS = 4
TIMES = ("seconds", "worker", "peak_memory_mib", "commit")


@dataclasses.dataclass(frozen=True)
class Command:
    """A command and its result.

    Attributes:
        name: of the command.
        arguments: (shared folder, out folder) → what follows `python -m`.
        result: out folder → what must be equal, by name.
        going_on: options with which it goes on after a kill.
        is_finished: out folder → whether the command would refuse to run again, since all is done.
    """

    name: str
    arguments: Callable[[Path, Path], list[str]]
    result: Callable[[Path], dict[str, Any]]
    going_on: tuple[str, ...] = ()
    is_finished: Callable[[Path], bool] = lambda out: False


def prepare(shared: Path) -> list[str]:
    """Write what commands read; the arguments that make the capture."""
    spec = {"scenes": [str(shared / CAPTURE)], "lights": ["two-colors"], "configurations": ["default", "paper"]}
    (shared / SPEC).write_text(json.dumps(spec | {"frames": 2, "size": SIZE}))
    out = str(shared / CAPTURE)
    return ["hyjax.cli", "convert", "--to", "7scenes", "--size", SIZE, "--frames", "0:6", "--quiet", "--out", out]


def lines(path: Path) -> list[dict[str, Any]]:
    """Objects of a file of JSON lines."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def timeless(value: Any) -> Any:
    """A value without the entries that say when, where and how fast it was made."""
    if isinstance(value, dict):
        return {name: timeless(inner) for name, inner in value.items() if name not in TIMES}
    return [timeless(inner) for inner in value] if isinstance(value, list) else value


def contents(out: Path, *patterns: str) -> dict[str, Any]:
    """Bytes of files by their names."""
    return {str(file.relative_to(out)): file.read_bytes() for each in patterns for file in sorted(out.glob(each))}


def _relit(out: Path) -> dict[str, Any]:
    run = json.loads((out / "run.json").read_text())
    return contents(out, "*.png", "*.exr", "lights.json") | {"frames": run["frames"]}


def _trained(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = {"log": lines(out / "log.jsonl")}
    for name in ("guide", "last"):
        found |= {f"{name} {key}": value.tobytes() for key, value in load_file(out / f"{name}.safetensors").items()}
    return found | contents(out, "validation/*.png", "curve.png")


def _has_trained(out: Path) -> bool:
    return (out / "checkpoints" / str(ROUNDS)).is_dir()


def _swept(out: Path) -> dict[str, Any]:
    rows = {row["key"]: timeless(row) for row in lines(out / "rows.jsonl")}
    return {"rows": rows} | contents(out, "summary.csv", "sweep.png")


def _judged(out: Path) -> dict[str, Any]:
    rows = [timeless(row) for row in lines(out / "rows.jsonl")]
    ended = [row.get("kind") == "finished" for row in rows]
    found = {
        "frames": [row for row in rows if row.get("kind") == "frame"],
        "finished": ended.count(True) == ended[-1],
    }
    return found | contents(out, "*.md", "*.png")


def _tuned(out: Path) -> dict[str, Any]:
    """What was chosen depends on times: only that all files are there, and that each is one of its kind."""
    names = sorted(str(file.relative_to(out)) for file in out.rglob("*.*") if "front" not in file.parts)
    json.loads((out / "schedule.json").read_text())
    return {"files": names, "trials": bool(entries(out))}


def entries(out: Path) -> dict[str, Any]:
    """Losses of a tuning's trials by their choices; those of one key are equal in all runs."""
    from hyjax.tuning.study import FILE_NAME, kept_trials

    return {repr(sorted(t.choices.items())): t.losses for t in kept_trials(out / FILE_NAME, "cascade")}


RELIGHT = ["relight", "--size", SIZE, "--save-filters", "--quiet"]
RELIGHT += ["--keep-photo-light"]  # its programs take as long to compile as all others
TRAIN = ["--pairs", "rooms", "--size", "32", "--batch", "1", "--features", "4", "--factors", "8"]
TRAIN += ["--iterations", str(ROUNDS), "--validate-every", "2", "--checkpoint-every", "2", "--quiet"]
TUNE = ["--stage", "cascade", "--budget-ms", "200", "--size", "64", "--frames", "0:1", "--holdout", "1:2"]
TUNE += ["--no-extra", "--lights", "two-colors", "--quiet"]


def _hyjax(*arguments: str, capture: bool = True, option: bool = True) -> Callable[[Path, Path], list[str]]:
    def build(shared: Path, out: Path) -> list[str]:
        given = [*(["--capture"] if option else []), str(shared / CAPTURE)] if capture else []
        return ["hyjax.cli", *arguments, *given, "--out", str(out)]

    return build


COMMANDS = {
    command.name: command
    for command in (
        Command("relight", _hyjax(*RELIGHT), _relit),
        Command(
            "convert",
            _hyjax("convert", "--to", "nerfstudio", "--quiet", option=False),
            lambda out: contents(out, "**/*.*"),
            is_finished=Path.exists,
        ),
        Command(
            "sweep",
            lambda shared, out: ["hyjax.cli", "sweep", str(shared / SPEC), "--workers", "1", "--out", str(out)],
            _swept,
            ("--resume",),
        ),
        Command("train", _hyjax("train", *TRAIN, capture=False), _trained, ("--resume",), _has_trained),
        Command("tune", _hyjax("tune", *TUNE), _tuned, ("--resume",)),
        Command(
            "paper",
            lambda shared, out: [
                *("experiments.paper", "--capture", str(shared / CAPTURE), "--parts", "benchmarks"),
                *("--size", "64", "--frames", "0:2", "--out", str(out)),
            ],
            _judged,
            ("--resume",),
        ),
    )
}


def differences(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Names of what is not equal."""
    names = sorted(found.keys() | expected.keys())
    return [name for name in names if not _equal(found.get(name), expected.get(name))]


def _equal(found: Any, expected: Any) -> bool:
    if isinstance(found, np.ndarray):
        return np.array_equal(found, expected)
    return bool(found == expected)
