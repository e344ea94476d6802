"""README's picture: photos of places of known truth, relit, and the true pictures under the new lights.

    python -m experiments.readme_picture [--out results/readme_picture]

Photo, relit picture and truth side by side: a generated room that no setting was chosen with, by two set-ups; and a
real place, relit by lights that are fitted to half of the true photo as in `experiments.real`. Without the real
place's pictures its row is left out, with a line. It becomes `docs/examples/readme.jpg` by `--keep`. Takes some
minutes the first time, when the room is rendered, and about one after that.

Expect: PSNR of 21 to 28 dB, as it comes; of the real place on blocks that no light was fitted to.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from PIL import Image

import hyjax
from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.real_bench import RealPlace, named_pairs
from experiments.real_methods import default_picture
from experiments.real_scores import scores
from experiments.records import Row, of_kind
from hyjax.data.truth_room import load_truth_room
from hyjax.metrics import psnr
from hyjax.util.images import resize, to_bytes

KEPT_PICTURE = Path(__file__).parents[1] / "docs" / "examples" / "readme.jpg"
GAP, WIDEST = 6, 1200
Pictures = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Photo, relit picture and truth: display values."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    folder: Path = Path("../shared/data/middlebury_relit")
    """Of real places, see `hyjax.data.relit_pairs`."""
    pair: str = "Piano"
    """The real place."""
    flipped: bool = True
    """Whether its second picture is the photo."""
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
    pairs = named_pairs(config.folder, (config.pair,)) if config.folder.is_dir() else []
    results, rows = start(), list[Pictures]()
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
        rows.append((photo, relit, truth))
    for pair in pairs:
        place = RealPlace(pair, config.flipped, "true")
        picture = default_picture(place)
        decibels = scores(place, {"relit": picture}, None)["relit"]["psnr"]
        results.add(kind="picture", room=config.pair, setup="fitted", frame=0, psnr_db=decibels)
        rows.append((place.photo, picture.display, place.target))
    if not pairs:
        print(f"readme_picture: {config.folder} is not there: without the real place", file=sys.stderr)
    whole = beside_each_other(rows, config.size[0])
    hyjax.write_png(results.out / "readme.png", whole)
    if config.keep:
        kept = Image.fromarray(to_bytes(whole))
        kept.thumbnail((WIDEST, WIDEST))
        kept.save(KEPT_PICTURE, quality=85, optimize=True)


def beside_each_other(
    rows: Sequence[Sequence[Float[np.ndarray, "_ _ 3"]]], width: int
) -> Float[np.ndarray, "h w 3"]:
    """Rows of pictures, each so wide, with white between them."""
    lines = []
    for pictures in rows:
        height = round(width * pictures[0].shape[0] / pictures[0].shape[1])
        white = np.ones((height, GAP, 3))
        parts = [part for picture in pictures for part in (resize(picture, height, width), white)]
        lines += [np.concatenate(parts[:-1], axis=1)]
        lines += [np.ones((GAP, lines[-1].shape[1], 3))]
    return np.concatenate(lines[:-1], axis=0)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """PSNR of each picture, and the pictures."""
    lines = [[r["room"], r["setup"], str(r["frame"]), f"{r['psnr_db']:.1f}"] for r in of_kind(rows, "picture")]
    return [
        Table("Relit pictures against the truth.", ["room", "set-up", "frame", "PSNR dB"], lines),
        Picture(folder / "readme.png", "The photo; relit; what the camera would see."),
    ]


if __name__ == "__main__":
    run(main)
