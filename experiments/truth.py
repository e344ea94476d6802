"""Relit frames against what the camera would see: rooms of known truth under new lights.

    python -m experiments.truth [--rooms NAME ...] [--frames 6] [--out results/truth] [--resume] [--workers 2]

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

import contextlib
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from experiments.blocks import Block
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import judge
from experiments.parallel import Collected, Sink, rows_of_parts
from experiments.records import Results, Row, of_kind
from experiments.truth_bench import TruthBench
from experiments.truth_camera import Exposed, fit_gains
from experiments.truth_methods import NEW, TODAY, TRUE_BOTH, LitBench
from experiments.truth_table import FITS, blocks_of
from hyjax.data.frames import spread
from hyjax.metrics import LpipsWeights, load_lpips, psnr
from hyjax.scene.light_setups import check_setup_name
from hyjax.scene.settings import parse_size
from hyjax.synthetic.truth import DEVELOPMENT_ROOMS, TEST_ROOMS
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

SETUPS = ("evening-lamps", "two-colors", "golden-hour", "night-moon")
SHEET = ("photo", TODAY, NEW, TRUE_BOTH, "truth")
Key = tuple[str, str, int]


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
    workers: int = 0
    """Processes that judge a room each; 0 for this one alone."""


@experiment("Against the true picture")
def main(config: Config, start: Start) -> None:
    size = _checked(config)
    weights, results = _weights(config.weights), start()
    finished = {row["room"] for row in of_kind(results.rows, "room")}
    rooms = [name for name in config.rooms if name not in finished]
    if config.workers:
        _judge_apart(config, rooms, results)
        return
    with tqdm(total=len(rooms) * len(config.setups) * config.frames, unit="picture") as bar:
        for name in rooms:
            _judge_room(results, config, TruthBench(name, config.photos, size, config.quality), weights, bar)


def _judge_apart(config: Config, rooms: list[str], results: Results) -> None:
    """Add the rows of rooms that are judged by other processes."""
    options = dataclasses.asdict(config)
    options["weights"] = None if config.weights is None else str(config.weights.resolve())
    for name in ("rooms", "resume", "workers"):
        options.pop(name)
    payloads = [options | {"room": name, "out": str(results.out.resolve())} for name in rooms]
    known = {_place(row) for row in results.rows}
    for rows in rows_of_parts(room_rows, payloads, config.workers, results.out, resume=config.resume):
        for row in rows:
            if _place(row) not in known:
                results.add(**row)


def room_rows(payload: dict[str, Any]) -> dict[str, Any]:
    """Rows of one room, in a process of its own."""
    options = {name: value for name, value in payload.items() if name not in ("room", "out")}
    config = Config(**options, rooms=(payload["room"],), out=Path(payload["out"]))
    collected, weights = Collected(Path(payload["out"])), None
    with contextlib.suppress(InputError):  # told already
        weights = load_lpips(config.weights)
    bench = TruthBench(payload["room"], config.photos, _checked(config), config.quality)
    _judge_room(collected, config, bench, weights, tqdm(disable=True))
    return collected.result()


def _place(row: Row) -> tuple[Any, ...]:
    return tuple(row.get(name) for name in ("kind", "room", "setup", "index"))


def _judge_room(results: Sink, config: Config, bench: TruthBench, weights: LpipsWeights | None, bar: tqdm) -> None:
    """Add the rows of one room that are not there yet, and write its sheet."""
    name, sheet = bench.capture.name, []
    frames = spread(range(config.photos), config.frames)
    for setup in config.setups:
        bar.set_description(f"{name}, {setup}")
        sheet.append(_judge_setup(results, bench, setup, frames, weights, bar))
    write_contact_sheet(results.out / f"{name}.png", sheet, SHEET)
    check = frames[len(frames) // 2]
    again = float(psnr(bench.again(check), bench.capture[check].image))
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


def _weights(path: Path | None) -> LpipsWeights | None:
    """Weights of LPIPS; without any it is left out, unless a file was asked for."""
    try:
        return load_lpips(path)
    except InputError as error:
        if path is not None:
            raise
        print(f"truth: LPIPS is left out ({error})")
        return None


def _judge_setup(
    results: Sink, bench: TruthBench, setup: str, frames: list[int], weights: LpipsWeights | None, bar: tqdm
) -> tuple[str, list[np.ndarray]]:
    """Add the rows of one set-up that are not there yet; a row of the sheet."""
    room, middle = bench.capture.name, frames[len(frames) // 2]
    done = {key_of(row) for row in of_kind(results.rows, "picture")}
    lit, shown = LitBench(bench, setup), []
    if (room, setup) not in {(row["room"], row["setup"]) for row in of_kind(results.rows, "setup")}:
        results.add(kind="setup", room=room, setup=setup, bounces=lit.bounce_ratio())
    for index in frames:
        new = (room, setup, index) not in done
        if new or index == middle:
            truth, pictures = lit.truth(index), lit.pictures(index)
            if new:
                methods = _scores(pictures, truth, weights)
                results.add(kind="picture", room=room, setup=setup, index=index, methods=methods)
            if index == middle:
                frame = np.asarray(bench.capture[index].image)
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


def key_of(row: Row) -> Key:
    """Room, set-up and frame of a picture."""
    return row["room"], row["setup"], row["index"]


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Tables, figure and pictures from the rows."""
    return blocks_of(rows, folder)


if __name__ == "__main__":
    run(main)
