"""Shares of pixels that end nearly black or burnt out, of the photo and relit, for every capture and named set-up.

    python -m experiments.dark_frames [--captures DIR ...] [--setups NAME ...] [--frames 4] [--resume]

Pictures are spread over each capture; the built-in room comes first. *Nearly black* and *burnt out* are display
values below and from `hyjax.metrics.dark_share.BLACK_VALUE` and `BURNT_VALUE`, means of the channels. A picture is
*too dark* where a good part went black that was not (`hyjax.metrics.dark_share.DarkShare.too_dark`).

Takes some minutes a capture on two cores, most of it once: the fusion of its depth, and the photo's own light.

Expect: nothing too dark but by night-moon, and windows that are not burnt out more than in the photo.
"""

import dataclasses
from pathlib import Path

import numpy as np
from tqdm import tqdm

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.data.frames import spread
from hyjax.light.color import to_display
from hyjax.metrics.dark_share import DarkShare, dark_share
from hyjax.scene.light_setups import DARK_SETUPS, EXPOSURES, check_setup_name
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError

ROOM = "built-in room"
DATA = Path("../shared/data")
SHARES = tuple(field.name for field in dataclasses.fields(DarkShare))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    captures: tuple[Path, ...] = tuple(
        DATA / name for name in ("kitchen", "scanner3d_chair", "dining", "scanner3d_corridor", "scanner3d_board")
    )
    """Captures beside the built-in room."""
    setups: tuple[str, ...] = tuple(name for name in EXPOSURES if name not in DARK_SETUPS)
    """Named light set-ups."""
    frames: int = 4
    """Pictures of each capture, spread over it."""
    size: str = "320x240"
    """Width x height of the pictures."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("Pictures that end dark or burnt out")
def main(config: Config, start: Start) -> None:
    if config.frames < 1 or not config.setups:
        raise InputError("dark_frames: give at least one frame and one set-up")
    for setup in config.setups:
        check_setup_name(setup)
    results = start()
    done = {(row["capture"], row["setup"], row["index"]) for row in of_kind(results.rows, "picture")}
    captures = (None, *config.captures)
    with tqdm(total=len(captures) * len(config.setups), unit="set-up") as bar:
        for path in captures:
            name, scene = path.name if path else ROOM, Scene.open(SceneSettings(path, size=config.size))
            for setup in config.setups:
                bar.set_description(f"{name}, {setup}")
                relighter = Relighter(scene, setup)
                for index in spread(range(len(scene)), config.frames):
                    if (name, setup, index) not in done:
                        relit = np.asarray(to_display(relighter.picture(index)))
                        share = dark_share(scene.frame(index).image, relit)
                        shares = dataclasses.asdict(share) | {"too_dark": share.too_dark}
                        results.add(kind="picture", capture=name, setup=setup, index=index, **shares)
                bar.update()


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Table from the rows."""
    del folder
    found, lines = of_kind(rows, "picture"), []
    for capture, setup in dict.fromkeys((row["capture"], row["setup"]) for row in found):
        own = [row for row in found if (row["capture"], row["setup"]) == (capture, setup)]
        worst = [f"{100 * max(row[share] for row in own):.0f} %" for share in SHARES]
        lines.append([capture, setup, *worst, f"{sum(row['too_dark'] for row in own)} of {len(own)}"])
    header = ["", "set-up", "black, photo", "black, relit", "burnt, photo", "burnt, relit", "too dark"]
    return [Table("Share of nearly black and of burnt-out pixels, each in its worst picture.", header, lines, 2)]


if __name__ == "__main__":
    run(main)
