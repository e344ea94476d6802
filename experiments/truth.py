"""Relit frames against the camera's true pictures: rooms of known truth under new lights.

    python -m experiments.truth [--rooms NAME ...] [--frames 6] [--out results/truth] [--resume]

The other experiments compare with the same multiplication by an accurate filter. Here every relit frame is compared
with the true picture of a generated room under the new lights (`hyjax.synthetic.truth`): same lens, same camera
response, six bounces. Four rooms were chosen on, four are reported on (`--rooms` takes any). Methods, from the
untouched photo to those that are told what nobody knows, are in `experiments.truth_methods`. *Raw* is a picture as
it comes, *fitted* has the three gains, in linear light, that bring it nearest to the truth: what is left of the
error beside exposure and white balance. Differences are paired with *hyjax 0.1*, which keeps the photo's own light;
their intervals are by bootstrap over rooms and set-ups.

A check renders frames again under the photo's own light, which must give the photo back but for its noise.
Takes about twenty minutes on two cores, and a minute more for each room that is not in the cache.

Expect: the default gains some 5 dB fitted and 8 dB raw on hyjax 0.1, a little more where the photo's light is told.
True light on a true mesh comes to some 34 dB, less raw: the rest is the camera, mirror images and what shines.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import judge, weights_or_none
from experiments.records import Results, of_kind
from experiments.truth_bench import TruthBench
from experiments.truth_camera import Exposed, fit_gains
from experiments.truth_methods import NEW, TODAY, TRUE_BOTH, LitBench
from experiments.truth_table import FITS
from experiments.truth_table import blocks as blocks
from hyjax.data.frames import spread
from hyjax.metrics import LpipsWeights, psnr
from hyjax.scene.light_setups import check_setup_name
from hyjax.scene.settings import parse_size
from hyjax.synthetic.truth import DEVELOPMENT_ROOMS, TEST_ROOMS
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

SETUPS = ("evening-lamps", "two-colors", "golden-hour", "night-moon")
SHEET = ("photo", TODAY, NEW, TRUE_BOTH, "truth")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    rooms: tuple[str, ...] = DEVELOPMENT_ROOMS + TEST_ROOMS
    """Names, see `hyjax.synthetic.truth.lit_room`."""
    setups: tuple[str, ...] = SETUPS
    """Named light set-ups."""
    frames: int = 6
    """Pictures of each room and set-up, spread over the photos."""
    photos: int = 12
    """Photos of each room, along a walk."""
    size: str = "320x240"
    """Width x height of the photos."""
    quality: float = 1.0
    """Of the rooms' light and textures."""
    weights: Path | None = None
    """LPIPS weights. Default: those converted of the extra `lpips`; without them there is no LPIPS."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("Against the true picture", "picture")
def main(config: Config, start: Start) -> None:
    size = _checked(config)
    weights, results = weights_or_none(config.weights), start()
    finished = {row["room"] for row in of_kind(results.rows, "room")}
    rooms = [name for name in config.rooms if name not in finished]
    with tqdm(total=len(rooms) * len(config.setups) * config.frames, unit="picture") as bar:
        for name in rooms:
            _judge_room(results, config, TruthBench(name, config.photos, size, config.quality), weights, bar)


def _judge_room(
    results: Results, config: Config, bench: TruthBench, weights: LpipsWeights | None, bar: tqdm
) -> None:
    """Add the rows of one room that are not there yet, and write its sheet."""
    name, sheet = bench.capture.name, []
    frames = spread(range(config.photos), config.frames)
    for setup in config.setups:
        bar.set_description(f"{name}, {setup}")
        sheet.append(_judge_setup(results, bench, setup, frames, weights, bar))
    write_contact_sheet(results.out / f"{name}.png", sheet, SHEET)
    check = frames[len(frames) // 2]
    again = float(psnr(bench.again(check), bench.capture.picture(check).image))
    results.add(kind="room", room=name, again=again, **bench.row())


def _checked(config: Config) -> tuple[int, int]:
    """Width and height of the pictures, if the options can be used."""
    for name, values in {"rooms": config.rooms, "setups": config.setups}.items():
        if not values or len(set(values)) < len(values):
            raise InputError(f"{name}: give at least one, each once")
    for setup in config.setups:
        check_setup_name(setup)
    if not 1 <= config.frames <= config.photos:
        raise InputError(f"frames: must be between 1 and photos ({config.photos}), got {config.frames}")
    size = parse_size(config.size)
    assert size is not None
    return size[1], size[0]


def _judge_setup(
    results: Results, bench: TruthBench, setup: str, frames: list[int], weights: LpipsWeights | None, bar: tqdm
) -> tuple[str, list[np.ndarray]]:
    """Add the rows of one set-up that are not there yet; a row of the sheet."""
    room, middle = bench.capture.name, frames[len(frames) // 2]
    done = {
        row["index"] for row in of_kind(results.rows, "picture") if (row["room"], row["setup"]) == (room, setup)
    }
    lit, shown = LitBench(bench, setup), []
    if (room, setup) not in {(row["room"], row["setup"]) for row in of_kind(results.rows, "setup")}:
        results.add(kind="setup", room=room, setup=setup, bounces=lit.bounce_ratio())
    for index in frames:
        new = index not in done
        if new or index == middle:
            truth, pictures = lit.truth(index), lit.pictures(index)
            if new:
                methods = _scores(pictures, truth, weights)
                results.add(kind="picture", room=room, setup=setup, index=index, methods=methods)
            if index == middle:
                frame = np.asarray(bench.capture.picture(index).image)
                shown = [frame, *(pictures[name].display() for name in SHEET[1:-1]), truth]
        bar.update()
    return f"{setup}, frame {middle}", shown


def _scores(
    pictures: Mapping[str, Exposed], truth: np.ndarray, weights: LpipsWeights | None
) -> dict[str, dict[str, Any]]:
    """Method → raw and fitted scores, and the gains."""
    gains = {name: fit_gains(picture, truth) for name, picture in pictures.items()}
    raw, fitted = FITS
    shown = {f"{name}|{raw}": jnp.asarray(picture.display()) for name, picture in pictures.items()}
    shown |= {f"{name}|{fitted}": jnp.asarray(picture.display(gains[name])) for name, picture in pictures.items()}
    found = judge(shown, jnp.asarray(truth), {"all": np.ones(truth.shape[:2], bool)}, weights)
    return {
        name: {fit: found[f"{name}|{fit}"]["all"] for fit in FITS} | {"gains": gains[name]} for name in pictures
    }


if __name__ == "__main__":
    run(main)
