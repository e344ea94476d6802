"""Shares of pixels that end nearly black or burnt out, of the photo and relit, for every capture and named set-up.

    python -m experiments.dark_frames [--captures DIR ...] [--setups NAME ...] [--frames 4] [--resume]

Pictures are spread over each capture; the built-in room comes first. *Nearly black* and *burnt out* are display
values below and from `hyjax.metrics.dark_share.BLACK_VALUE` and `BURNT_VALUE`, means of the channels. A picture is
*too dark* where a good part went black that was not (`hyjax.metrics.dark_share.DarkShare.too_dark`).

Takes some minutes a capture on two cores, most of it once: the fusion of its depth, and the photo's own light.

Expect: windows that are not burnt out more than in the photo; a dark floor out of the low sun's reach is too dark.
"""

import dataclasses
from pathlib import Path

import numpy as np
from tqdm import tqdm

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.data.frames import spread
from hyjax.light.color import to_display
from hyjax.metrics.dark_share import dark_share
from hyjax.scene.light_setups import DARK_SETUPS, SETUPS, check_setup_name
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

ROOM = "built-in room"
DATA = Path("../shared/data")
SHARES = "black_before", "black", "burnt_before", "burnt"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    captures: tuple[Path, ...] = tuple(
        DATA / name for name in ("scanner3d_board", "scanner3d_corridor", "scanner3d_chair", "kitchen")
    )
    """Captures in addition to the built-in room."""
    setups: tuple[str, ...] = tuple(name for name in SETUPS if name not in DARK_SETUPS)
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
    done = {row["capture"] for row in of_kind(results.rows, "capture")}
    for path in tqdm((None, *config.captures), unit="capture"):
        name = path.name if path else ROOM
        if name not in done:
            scene = Scene.open(SceneSettings(path, size=config.size))
            relighters = {setup: Relighter(scene, setup) for setup in config.setups}
            shares, sheet = [], []
            for index in spread(range(len(scene)), config.frames):
                photo = np.asarray(scene.frame(index).image)
                relit = {setup: np.asarray(to_display(own.picture(index))) for setup, own in relighters.items()}
                found = {setup: dark_share(photo, picture) for setup, picture in relit.items()}
                shares.append(
                    {setup: dataclasses.asdict(s) | {"too_dark": s.too_dark} for setup, s in found.items()}
                )
                sheet.append((f"frame {index}", [photo, *relit.values()]))
            write_contact_sheet(results.out / f"{name}.png", sheet, ("photo", *config.setups))
            results.add(kind="capture", capture=name, shares=shares)


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Table and sheets from the rows."""
    found, lines = of_kind(rows, "capture"), []
    for row in found:
        for setup in row["shares"][0]:
            own = [shares[setup] for shares in row["shares"]]
            worst = [f"{100 * max(one[share] for one in own):.0f} %" for share in SHARES]
            lines.append([row["capture"], setup, *worst, f"{sum(one['too_dark'] for one in own)} of {len(own)}"])
    header = ["", "set-up", "black, photo", "black, relit", "burnt, photo", "burnt, relit", "too dark"]
    caption = "Share of nearly black and of burnt-out pixels, each in its worst picture."
    sheets = [Picture(folder / f"{row['capture']}.png", f"{row['capture']}: photo and relit.") for row in found]
    return [Table(caption, header, lines, 2), *sheets]


if __name__ == "__main__":
    run(main)
