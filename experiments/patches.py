"""Patches of one material on captures of real rooms, relit evenly: how much of the photo's uneven light is left.

    python -m experiments.patches [--folder DIR] [--captures NAME ...] [--patches FILE] [--size 320x240] [--resume]

`experiments/patches.json` has the patches, drawn by hand: capture, place of the frame in it, material, and corners
in pixels of the frame as captured. The new light is ambient alone. *Unevenness* is the standard deviation of the
logarithm of luminance in a patch; *robust* half the distance of its percentiles 16 and 84. A material has texture
and gloss, too: unevenness cannot fall to nothing.

`--folder` has the captures in layouts that hyjax reads. The dining room's lens, 518 519 325.5 253.5, is given in a
`camera_primesense.json`; without one the PrimeSense's default is taken.

Takes some minutes a capture on two free cores, most of it once: the fusion of its depth, and the photo's own light.

Expect: with the photo's light kept, a ratio of 1.00; with the default and the presets, most below 1 and some above.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from scipy.ndimage import binary_erosion
from tqdm import tqdm

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.configuration import PRESETS, Configuration
from hyjax.light.color import luminance, to_display, to_linear
from hyjax.light.kinds import AmbientLight
from hyjax.light.setup import REFERENCE_LUX
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.reading import read_json

DARKEST = 1e-4
"""Luminance that darker pixels are taken to have."""
OUTLINE = (1.0, 0.2, 0.8)
KEPT = "photo's light kept"
WAYS = {name: Configuration.of(name) for name in ("default", *PRESETS)} | {
    "without light edges": Configuration().with_choices({"light_edges": False}),
    KEPT: Configuration().with_choices({"photo_light": "kept"}),
}
"""Configurations by the names of columns."""


class Patch(msgspec.Struct, forbid_unknown_fields=True):
    """Patch of one material.

    Attributes:
        capture: folder's name.
        frame: place in the capture.
        material: in a few words.
        corners: (x, y) in pixels of the frame as captured.
    """

    capture: str
    frame: int
    material: str
    corners: list[tuple[float, float]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    folder: Path = Path("../shared/data")
    """Has the captures."""
    captures: tuple[str, ...] = ()
    """Those to look at. Default: all that have patches."""
    patches: Path = Path("experiments/patches.json")
    """Patches."""
    size: str = "320x240"
    """Width x height of the pictures."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("Patches of one material, relit evenly", "patch")
def main(config: Config, start: Start) -> None:
    patches = read_patches(config.patches)
    known = list(dict.fromkeys(patch.capture for patch in patches))
    if unknown := [name for name in config.captures if name not in known]:
        raise InputError(f"captures: {unknown[0]!r} has no patch; {', '.join(known)} have some")
    results = start()
    done = {row["capture"] for row in of_kind(results.rows, "patch")}
    chosen = [name for name in config.captures or known if name not in done]
    for name in tqdm(chosen, unit="capture"):
        scene = Scene.open(SceneSettings(config.folder / name, size=config.size))
        own = [patch for patch in patches if patch.capture == name]
        made, sheet = _rows(scene, own)
        write_contact_sheet(results.out / f"{name}.png", sheet, ("photo", *WAYS))
        for row in made:
            results.add(kind="patch", capture=name, **row)


def read_patches(file: Path) -> list[Patch]:
    """Patches of a file.

    Raises:
        InputError: it is not a list of patches, or a patch has fewer than three corners.
    """
    try:
        patches = msgspec.convert(read_json(file), list[Patch])
    except msgspec.ValidationError as error:
        raise InputError(f"{file}: {error}") from None
    if narrow := [patch for patch in patches if len(patch.corners) < 3]:
        raise InputError(f"{file}: the patch in {narrow[0].capture}, frame {narrow[0].frame}, needs three corners")
    return patches


def inside(corners: list[tuple[float, float]], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Pixels of a polygon."""
    height, width = shape
    mask = Image.new("1", (width, height))
    ImageDraw.Draw(mask).polygon(corners, fill=1)
    return np.array(mask)


def unevenness(linear: Float[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> dict[str, float]:
    """Deviation of the logarithm of luminance in a patch: standard, and by percentiles."""
    log = np.log(np.maximum(np.asarray(luminance(jnp.asarray(linear)))[mask], DARKEST))
    low, high = np.percentile(log, (16, 84))
    return {"deviation": float(log.std()), "robust": float((high - low) / 2)}


def _rows(scene: Scene, patches: list[Patch]) -> tuple[list[Row], list[tuple[str, list[Any]]]]:
    """Row of each patch, and lines of the sheet."""
    even = (AmbientLight(jnp.float32(REFERENCE_LUX), jnp.ones(3)),)
    relighters = {way: Relighter(scene, even, configuration) for way, configuration in WAYS.items()}
    rows: list[Row] = []
    sheet = []
    for index, group in itertools.groupby(sorted(patches, key=lambda patch: patch.frame), lambda p: p.frame):
        frame = scene.frame(index)
        pictures = {"photo": np.asarray(to_linear(jnp.asarray(frame.image)))}
        pictures |= {way: np.asarray(relighter.picture(index)) for way, relighter in relighters.items()}
        shown = [np.array(to_display(jnp.asarray(picture))) for picture in pictures.values()]
        factor = frame.camera.intrinsics.width / scene.capture.camera(index).intrinsics.width
        for patch in group:
            mask = inside([(x * factor, y * factor) for x, y in patch.corners], frame.camera.intrinsics.shape)
            if not mask.any():
                raise InputError(f"patches: the one in {patch.capture}, frame {index}, has no pixel")
            scores = {name: unevenness(picture, mask) for name, picture in pictures.items()}
            light = scene.photo_light.record()
            rows.append({"frame": index, "material": patch.material, "scores": scores, "light": light})
            border = mask & ~binary_erosion(mask)
            for picture in shown:
                picture[border] = OUTLINE
        sheet.append((f"frame {index}", shown))
    return rows, sheet


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Table of patches, their medians, and sheets."""
    found = of_kind(rows, "patch")
    lines = []
    for row in found:
        light, before = row["light"], row["scores"]["photo"]
        cells = [row["capture"], str(row["frame"]), row["material"], f"{before['deviation']:.3f}"]
        cells += [f"{ratio(row, way):.2f}" for way in WAYS]
        cells += [f"{ratio(row, 'default', 'robust'):.2f}", f"{light['exponent']:g}", f"{light['flatness']:.2f}"]
        lines.append(cells)
    for name, chosen in (("median", np.median), ("worst", np.max)):
        values = [
            float(chosen([ratio(row, way, score) for row in found]))
            for way, score in (*((way, "deviation") for way in WAYS), ("default", "robust"))
        ]
        lines.append([name, "", f"{len(found)} patches", "", *(f"{value:.2f}" for value in values), "", ""])
    header = ["", "frame", "material", "photo", *WAYS, "default, robust", "exponent", "flatness"]
    caption = (
        "Unevenness of patches of one material: of the photo, and relit evenly, as a share of the photo's; 0 would "
        "be even, 1 as uneven as before. *Exponent* and *flatness*: of the capture's estimate of its light."
    )
    sheets = [
        Picture(folder / f"{name}.png", f"Patches of {name}.")
        for name in dict.fromkeys(row["capture"] for row in found)
    ]
    return [Table(caption, header, lines, 3), *sheets]


def ratio(row: Row, way: str, score: str = "deviation") -> float:
    """Unevenness of a relit patch as a share of the photo's."""
    scores = row["scores"]
    return float(scores[way][score] / max(scores["photo"][score], 1e-9))


if __name__ == "__main__":
    run(main)
