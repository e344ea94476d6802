"""Pictures of `hyjax relight`, kept by one state of the code and compared by another.

    python -m experiments.same_pictures --out /tmp/before
    python -m experiments.same_pictures --out /tmp/after --against /tmp/before

Every named set-up, in our own mode, in paper mode, with `--video` and by the presets of configurations, on
the built-in room and on the captures that are there. Pictures are kept as float32; some minutes on two cores. Both
runs must share a cache folder: what it keeps of a scene is not what is compared.

Expect: within 1e-6 in linear light.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import hyjax
import hyjax.relighting.run as command
from experiments.command import run
from hyjax.util.errors import InputError

SETUPS = "noon-window", "golden-hour", "evening-lamps", "night-moon", "center-point", "two-colors"
MODES: dict[str, dict[str, Any]] = {
    "linear": {},
    "paper": {"paper_mode": True},
    "video": {"video": True},
    **{name: {"configuration": name} for name in ("quality", "balanced", "fast")},
}
CAPTURES = {"kitchen": "0:300:150", "scanner3d_chair": "0"}
"""Frames of each capture."""
ROOM_FRAMES = "0,12"
TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class Config:
    data: Path = Path("../shared/data")
    """Folder of the captures; those that are not there are left out."""
    size: str = "160x120"
    out: Path = Path("results/same_pictures")
    against: Path | None = None
    """Folder of the run to compare with."""


def main(config: Config) -> None:
    config.out.mkdir(parents=True, exist_ok=True)
    for capture, frames in captures(config):
        settings = hyjax.SceneSettings(capture=capture, size=config.size)
        scene, name = hyjax.Scene.open(settings), "room" if capture is None else capture.name
        runs = [(setup, mode) for setup in SETUPS for mode in MODES]
        for setup, mode in tqdm(runs, name, unit="run"):
            own = "0:2" if mode == "video" else frames
            options = hyjax.RelightSettings(settings, frames=own, lights=setup, quiet=True, **MODES[mode])
            pictures = relit(dataclasses.replace(options, out=config.out / "written"), scene)
            np.savez(config.out / f"{name}-{setup}-{mode}.npz", **pictures)
    if config.against is not None:
        largest = compare(config.against, config.out)
        print(f"{len(largest)} runs; largest difference {max(largest.values()):.2g}")
        if worse := [f"{name} {value:.3g}" for name, value in largest.items() if not value <= TOLERANCE]:
            raise InputError(f"more than {TOLERANCE:g}: {', '.join(worse)}")


def captures(config: Config) -> Iterator[tuple[Path | None, str]]:
    """Folder and frames of each capture; None for the built-in room."""
    yield None, ROOM_FRAMES
    for name, frames in CAPTURES.items():
        if (config.data / name).is_dir():
            yield config.data / name, frames


def relit(settings: hyjax.RelightSettings, scene: hyjax.Scene) -> dict[str, np.ndarray]:
    """Linear pictures of a run by frame and kind, before they are rounded to a file's half floats."""
    kept: dict[str, np.ndarray] = {}

    def keep(
        clock: Any, out: Path, name: str, pictures: dict[str, Any], mode: str, *, exr: bool
    ) -> dict[str, np.ndarray]:
        arrays = {kind: np.asarray(picture) for kind, picture in pictures.items()}
        kept.update({f"{name}.{kind}": array for kind, array in arrays.items()})
        return arrays

    write, command.write_frame = command.write_frame, keep
    try:
        hyjax.relight_capture(settings, scene=scene)
    finally:
        command.write_frame = write
    return kept


def compare(before: Path, after: Path) -> dict[str, float]:
    """Largest difference of each run's pictures.

    Raises:
        InputError: a run or a picture is there once only, or of another size.
    """
    mine, theirs = ({file.stem: np.load(file) for file in folder.glob("*.npz")} for folder in (after, before))
    if not mine or mine.keys() != theirs.keys():
        raise InputError(f"{sorted(mine.keys() ^ theirs.keys()) or 'nothing'}: kept by one run only")
    found: dict[str, float] = {}
    for name, pictures in mine.items():
        others = theirs[name]
        shapes = [{kind: each[kind].shape for kind in each.files} for each in (pictures, others)]
        if shapes[0] != shapes[1]:
            raise InputError(f"{name}: pictures {shapes[0]}, were {shapes[1]}")
        found[name] = max(float(np.abs(pictures[kind] - others[kind]).max()) for kind in pictures.files)
    return found


if __name__ == "__main__":
    run(main)
