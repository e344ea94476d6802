"""README's picture: photos of a room of known truth, relit, and the true pictures under the new lights.

    python -m experiments.readme_picture [--out results/readme_picture]

Photo, relit picture and truth side by side, for two set-ups of lights, in a room that no setting was chosen with.
It becomes `docs/examples/readme.jpg` by `--keep`. Takes some minutes the first time, when the room is rendered, and
about one after that.

Expect: PSNR of 22 to 24 dB, as it comes.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from PIL import Image

import hyjax
from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.data.truth_room import load_truth_room
from hyjax.metrics import psnr

KEPT_PICTURE = Path(__file__).parents[1] / "docs" / "examples" / "readme.jpg"
GAP, WIDEST = 6, 1200


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    room: str = "builtin-3"
    """See `hyjax.synthetic.truth.lit_room`."""
    shown: tuple[str, ...] = ("evening-lamps:4", "golden-hour:9")
    """Set-ups with the frame that each is shown on."""
    photos: int = 12
    """Photos of the room, along a walk."""
    size: tuple[int, int] = (512, 384)
    """Width and height of the photos."""
    quality: float = 1.0
    """Of the room's light and textures."""
    keep: bool = False
    """Put the picture into the documentation."""


@experiment("README's picture")
def main(config: Config, start: Start) -> None:
    results, rows = start(), []
    capture = load_truth_room(config.room, config.photos, *config.size, quality=config.quality)
    scene = hyjax.Scene.open(hyjax.SceneSettings(), capture=capture)
    for text in config.shown:
        name, _, frame = text.partition(":")
        setup, index = scene.lights(name), int(frame)
        made = scene.relit(index, setup)
        relit, (truth,) = np.asarray(hyjax.to_display(made.image)), capture.truth(setup, [index])
        photo = scene.frame(index).image
        decibels = float(psnr(jnp.asarray(relit), jnp.asarray(truth)))
        results.add(kind="picture", room=config.room, setup=name, frame=index, psnr_db=decibels)
        white = np.ones((photo.shape[0], GAP, 3), np.float32)
        rows.append(np.concatenate([photo, white, relit, white, truth], axis=1))
    between = np.ones((GAP, rows[0].shape[1], 3), np.float32)
    whole = np.concatenate([part for row in rows for part in (row, between)][:-1], axis=0)
    hyjax.write_png(results.out / "readme.png", whole)
    if config.keep:
        picture = Image.fromarray(np.asarray(np.clip(whole, 0, 1) * 255 + 0.5, np.uint8))
        picture.thumbnail((WIDEST, WIDEST))
        picture.save(KEPT_PICTURE, quality=85, optimize=True)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """PSNR of each picture, and the pictures."""
    lines = [[r["setup"], str(r["frame"]), f"{r['psnr_db']:.1f}"] for r in of_kind(rows, "picture")]
    return [
        Table("Relit pictures against the truth.", ["set-up", "frame", "PSNR dB"], lines),
        Picture(folder / "readme.png", "The photo; relit; what the camera would see."),
    ]


if __name__ == "__main__":
    run(main)
