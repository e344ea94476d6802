"""Real places under two lights: error of a relit photo against the other picture, by ours and by simple methods.

    python -m experiments.real [--folder DIR] [--pairs Piano Djembe Art] [--geometries true rough] [--resume]

Frozen protocol: pictures of some 350 pixels across; pixels burnt in either of them left out; a checkerboard of
32 px, fitted on one half and scored on the other; new lights of one family for every method (ambient, twelve
distant lights with shadows, two lamps that help most of a grid of 36), strengths ≥ 0 for red, green and blue by
non-negative least squares, then L-BFGS in display values. Both directions; true geometry, and one as rough as a
headset's.
*Best 15 lights* are ambient and the 14 that help most of all: the family, lamps with shades (each lamp's light
upwards, and downwards), and the glow of 24 patches of the box round the scan; beside them stands exp(polynomial 7)
of its 15 terms that help most. *glow* adds all patches: 39 unknowns in the place of 15; beside it stands the whole
polynomial of order 7, with 36. Piano was chosen on, the others are reported on.

PSNR, SSIM, LPIPS where its weights are there, SIE and LFE (`experiments.real_scores`). `--rooms` adds generated
rooms whose pictures went through a camera with an S-curve; with `--pairs` of nothing no folder is needed.

Takes about a minute for each direction and geometry on two cores.

Expect: something smooth without geometry (exp(polynomial 4)) is hard to beat.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any, get_args

from tqdm import tqdm

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import weights_or_none
from experiments.real_bench import Geometry, RealPlace, named_pairs
from experiments.real_methods import KEPT, METHODS, NEW, PHOTO, SMOOTH, pictures
from experiments.real_room import room_pair
from experiments.real_scores import scores
from experiments.records import Row, of_kind
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

CHOSEN_ON = ("Piano",)
DIGITS = {"psnr": 2, "ssim": 3, "lpips": 3, "sie": 3, "lfe": 4}
LABELS = {"psnr": "PSNR dB", "ssim": "SSIM", "lpips": "LPIPS", "sie": "SIE", "lfe": "LFE"}
SHEET = (PHOTO, SMOOTH, KEPT, NEW, "target")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    folder: Path = Path("../shared/data/middlebury_relit")
    """Pairs, see `hyjax.data.relit_pairs`."""
    pairs: tuple[str, ...] = ("Piano", "Djembe", "Art")
    """Their names; none for rooms alone."""
    rooms: tuple[str, ...] = ()
    """Generated rooms, see `hyjax.synthetic.truth.lit_room`."""
    geometries: tuple[Geometry, ...] = ("true", "rough")
    """Surfaces."""
    room_size: str = "320x240"
    """Width x height of pictures of generated rooms."""
    quality: float = 1.0
    """Of the light and textures of generated rooms."""
    weights: Path | None = None
    """LPIPS weights. Default: those converted of the extra `lpips`; without them there is no LPIPS."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("Real places under two lights", "picture")
def main(config: Config, start: Start) -> None:
    if unknown := [name for name in config.geometries if name not in get_args(Geometry)]:
        raise InputError(f"geometries: {unknown[0]!r} is neither true nor rough")
    pairs = named_pairs(config.folder, config.pairs) if config.pairs else []
    chosen = [*pairs, *(room_pair(name, config.room_size, config.quality) for name in config.rooms)]
    if not chosen or not config.geometries:
        raise InputError("real: give at least one pair or room, and a geometry")
    weights, results = weights_or_none(config.weights), start()
    done = {(row["pair"], row["direction"], row["geometry"]) for row in of_kind(results.rows, "picture")}
    places = list(itertools.product(chosen, config.geometries, (False, True)))
    for pair, geometry, flipped in tqdm(places, unit="picture"):
        direction = "b → a" if flipped else "a → b"
        if (pair.name, direction, geometry) in done:
            continue
        place = RealPlace(pair, flipped, geometry)
        made = dict(pictures(place))
        results.add(
            kind="picture",
            pair=pair.name,
            direction=direction,
            geometry=geometry,
            methods=scores(place, made, weights),
            unknowns={name: one.unknowns for name, one in made.items()},
            light=place.scene.photo_light.record(),
            valid=float(place.valid.mean()),
        )
        shown = [made[name].display if name in made else place.target for name in SHEET]
        sheet = results.out / f"{pair.name}-{geometry}-{'ba' if flipped else 'ab'}.png"
        write_contact_sheet(sheet, [(direction.replace("→", "to"), shown)], SHEET)


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Tables and sheets from the rows."""
    found = of_kind(rows, "picture")
    made: list[Block] = []
    for metrics in (("psnr",), ("ssim", "lpips", "sie", "lfe")):
        for geometry in dict.fromkeys(row["geometry"] for row in found):
            made.append(_table([row for row in found if row["geometry"] == geometry], metrics, geometry))
    made.append(_lights(found))
    for row in found:
        name = f"{row['pair']}-{row['geometry']}-{'ab' if row['direction'] == 'a → b' else 'ba'}.png"
        made.append(Picture(folder / name, f"{row['pair']}, {row['direction']}, {row['geometry']} geometry."))
    return made


def _table(rows: list[Row], metrics: tuple[str, ...], geometry: str) -> Table:
    """A line for each method, a column for each directed pair."""
    metrics = tuple(m for m in metrics if any(m in row["methods"][PHOTO] for row in rows))
    lines = []
    for name in METHODS:
        cells = [f"**{name}**" if name == NEW else name]
        cells.append(str(rows[0]["unknowns"].get(name, "")))
        for row in rows:
            own = row["methods"].get(name, {})
            cells.append(" / ".join(f"{own[m]:.{DIGITS[m]}f}" if own.get(m) is not None else "" for m in metrics))
        lines.append(cells)
    heads = [f"{row['pair']} {row['direction']}" for row in rows]
    labels = " / ".join(LABELS[m] for m in metrics)
    caption = (
        f"{labels}, {geometry} geometry, on blocks that nothing was fitted on. {', '.join(CHOSEN_ON)}: chosen on. "
        "*Oracle* and *true ratio* are told the target itself; the default is in bold."
    )
    return Table(caption, ["", "unknowns a channel", *heads], lines)


def _lights(rows: list[Row]) -> Table:
    """Photo's own light as it was estimated."""
    lines: list[list[str]] = []
    for row in rows:
        light: dict[str, Any] = row["light"]
        better = row["methods"][NEW]["psnr"] - row["methods"][KEPT]["psnr"]
        cells = [f"{row['pair']} {row['direction']}", row["geometry"], light["origin"], f"{light['exponent']:g}"]
        lines.append([*cells, f"{light['flatness']:.2f}", f"{better:+.2f}", f"{100 * (1 - row['valid']):.0f} %"])
    header = ["", "geometry", "sources", "exponent", "flatness", "default over 0.1, dB", "burnt"]
    return Table(
        "The photo's own light as the default estimates it, and the share of burnt pixels.", header, lines, 3
    )


if __name__ == "__main__":
    run(main)
