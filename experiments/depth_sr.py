"""Guided depth super-resolution: gain by each guide on depth that is in no training and no tuning.

    python -m experiments.depth_sr [--guides rgb small] [--pairs SPEC ...] [--tuning SPEC ...]

    python -m experiments.depth_sr --pairs middlebury:/data/middlebury2005 "mosd:/data/mosd?frames=3:40:4" \\
        "capture:/data/kitchen?frames=225:300:5"
    python -m experiments.depth_sr --protocol dada --pairs SPEC ...

Depth is coarsened by 4, 8, 16 and 32 and super-resolved under the colour frame: bicubic interpolation, OpenCV's
guided filter and fast global smoother, and diffusion with adjustment under the frame itself and under learned
guides, each at full size as Metzger et al. do and through the cascade. `SPEC` names pairs as
`hyjax.pairs.registry` takes them; default are generated rooms of seeds that no training uses. Parameters (κ of
each guide, those of the filters) are chosen by factor on the tuning pairs alone.

Takes minutes on two cores for the rooms. Metzger's convention (CVPR 2023, section 4, and the published code): depth
is cut into tiles of 256² pixels from the top left corner, each of which is a picture of its own; sources are means
of the valid pixels of their cells; squared and absolute errors are means over the valid pixels of a tile and then
over tiles, in cm² and cm; every step is followed by an adjustment. So they are here, but for tiles with less than
30 % valid pixels, which are left out, and disparities, which stay as they are.

`--protocol dada` runs their method without a learned guide as their code does: 8000 steps (`--steps`) at full size,
κ 0.03 for the mean of absolute differences of normalised colours and of the depth that it starts from, which is
interpolated between valid cells; every tile with four valid cells counts; nothing is tuned. What remains: their
means are over batches of tiles, depth is divided by NYU's standard deviation whatever the pairs, NYU's depth counts
only where it was read, and their test scenes are not at hand (Middlebury: Reindeer, Bowling1, Bowling2,
Adirondack-perfect, Motorcycle-perfect; NYU's by a list of theirs, give `nyu:FILE.mat?frames=...`).

Results are adjusted to every cell with a valid pixel, as theirs are. `--least` asks for more valid pixels; expect
diffusion to do worse then on depth with holes, since cells that are not adjusted to drift away.

Expect: all guided methods ahead of bicubic in the rooms, by most beside depth jumps and at ×4 and ×8; at ×32 a
cell holds several objects. Where borders are exact, diffusion at full size is ahead of the cascade, whose finest
level has half the resolution; on a depth camera's borders, which are off by pixels, the cascade may be ahead. κ
chosen on the rooms is not the best for other pairs: choose it on pairs of the same kind where there are some.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from experiments.blocks import Block, Picture, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.depth_methods import DADA_STEPS, Method, Options, Task, make_task, methods, published_methods
from experiments.judging import beside_jump, summarise
from experiments.plotting import panels
from experiments.records import Results, Row, of_kind
from hyjax.core.schedule import Schedule
from hyjax.guide.choose import FrameGuide, open_guide
from hyjax.pairs.depth_pairs import Unit
from hyjax.pairs.registry import open_pairs
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

Protocol = Literal["tuned", "dada"]
LEAST_VALID = 0.3  # share of a tile
FEWEST_CELLS = 4  # of a tile that counts
STEPS = 1000
BORDER_PIXELS = 3  # pixels around a depth jump
UNITS = {"metres": ("cm", 100.0), "disparity": ("px", 1.0)}  # as reported
WHITE_ERROR = 3.0  # error that is white in pictures, in multiples of the bicubic RMSE


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    pairs: tuple[str, ...] = ("rooms?seed=1001&frames=0:96:4",)
    """Reported on."""
    tuning: tuple[str, ...] = ("rooms?seed=1002&frames=0:32:4",)
    """Pairs that parameters are chosen on."""
    guides: tuple[str, ...] = ("rgb", "small")
    """Compared: `rgb`, names of shipped weights, files."""
    factors: tuple[int, ...] = (4, 8, 16, 32)
    schedule: str = "paper-80"
    steps: int | None = None
    """At full size. Default: 1000, by the protocol dada 8000."""
    protocol: Protocol = "tuned"
    """`dada`: Metzger's published evaluation of diffusion without a learned guide, see above."""
    tile: int = 256
    """Pixels a side."""
    least: float = 0.0
    """Share of a cell's pixels that must be valid for the result to be adjusted to it; one pixel at any rate."""
    peers: bool = True
    """With OpenCV's filters."""


class Tile(NamedTuple):
    """A square of a pair."""

    pairs: str
    pair: str
    index: int
    unit: Unit
    image: Float[np.ndarray, "s s 3"]
    depth: Float[np.ndarray, "s s"]
    valid: Bool[np.ndarray, "s s"]


@experiment("Guided depth super-resolution", "score")
def main(config: Config, start: Start) -> None:
    check(config)
    published = config.protocol == "dada"
    guides = [] if published else [open_guide(name) for name in config.guides]
    if len({guide.name for guide in guides}) < len(guides):
        raise InputError(f"guides: {', '.join(guide.name for guide in guides)}; give each a file name of its own")
    least = 0.0 if published else LEAST_VALID
    if published:
        compared, tuning = published_methods(config.steps or DADA_STEPS), []
    else:
        named, schedule = [guide.name for guide in guides], Schedule.preset(config.schedule)
        compared = methods(named, schedule, config.steps or STEPS, config.peers)
        tuning = [tile for text in config.tuning for tile in tiles(text, config.tile, least)]
    reported = [tile for text in config.pairs for tile in tiles(text, config.tile, least)]
    results = start()
    chosen = choose(results, list(tasks(tuning, guides, config)), config.factors, compared)
    sheet: dict[tuple[str, int], tuple[float, str, list[Float[np.ndarray, "s s 3"]]]] = {}
    for task, tile in tasks(reported, guides, config):
        factor = task.factor
        if int(task.known.sum()) < FEWEST_CELLS:
            continue
        estimates = {m.name: np.asarray(m.run(task, chosen[factor, m.name]))[..., 0] for m in compared}
        scores = {name: errors(estimate, tile) for name, estimate in estimates.items()}
        for name, values in scores.items():
            place = {"pairs": tile.pairs, "unit": tile.unit, "pair": tile.pair, "tile": tile.index}
            results.add(kind="score", **place, factor=factor, method=name, **values)
        worst, key = scores["bicubic"]["mse"], (tile.pairs, factor)
        if key not in sheet or worst > sheet[key][0]:
            sheet[key] = worst, f"{tile.pair}, x{factor}", pictures(tile, estimates)
    shown = [(label, columns) for _, label, columns in sheet.values()]
    headings = ["frame", "depth", *(f"error: {m.name}" for m in compared)]
    write_contact_sheet(results.out / "errors.png", shown, headings)


def check(config: Config) -> None:
    """Raise `InputError` for settings that cannot be run."""
    if both := sorted({*config.pairs} & {*config.tuning}):
        raise InputError(f"tuning: {both[0]} is reported on as well; choose parameters on other pairs")
    if not config.pairs or not config.tuning or not config.factors or not config.guides:
        raise InputError("pairs, tuning, guides, factors: each needs at least one")
    if config.steps is not None and config.steps < 1:
        raise InputError(f"steps: must be at least 1, got {config.steps}")
    levels = [level.factor for level in Schedule.preset(config.schedule).levels]
    for factor in config.factors:
        if factor < 2 or config.tile < 2 * factor or config.tile % factor:
            raise InputError(
                f"factors: {factor} must be at least 2 and divide the tile of {config.tile} into several cells"
            )
        if wrong := [level for level in levels if factor % level and level % factor]:
            raise InputError(f"factors: {factor} and the schedule's level {wrong[0]} must divide one another")


def tiles(text: str, size: int, least: float = LEAST_VALID) -> list[Tile]:
    """Squares side by side from the top left corner of each pair, where so much of their depth is valid.

    Raises:
        InputError: there is none, or what `open_pairs` finds wrong.
    """
    found = []
    pairs = open_pairs(text)
    for number in range(len(pairs)):
        pair = pairs[number]
        h, w = pair.depth.shape
        for index, (i, j) in enumerate(np.ndindex(h // size, w // size)):
            cut = slice(i * size, (i + 1) * size), slice(j * size, (j + 1) * size)
            if pair.valid[cut].mean() >= max(least, 1 / size**2):
                found.append(
                    Tile(text, pair.name, index, pair.unit, pair.image[cut], pair.depth[cut], pair.valid[cut])
                )
    if not found:
        raise InputError(f"{text}: no tile of {size} pixels a side with {least:.0%} of valid depth")
    return found


def tasks(tiles: Sequence[Tile], guides: Sequence[FrameGuide], config: Config) -> Iterator[tuple[Task, Tile]]:
    """Every tile at every factor."""
    for tile in tiles:
        features = {guide.name: guide.features(jnp.asarray(tile.image)) for guide in guides}
        for factor in config.factors:
            yield make_task(tile.image, tile.depth, tile.valid, features, factor, config.least), tile


def choose(
    results: Results, tuning: Sequence[tuple[Task, Tile]], factors: Sequence[int], compared: Sequence[Method]
) -> dict[tuple[int, str], Options]:
    """Candidate with the least RMSE for each factor and method, with a row for every candidate.

    Without tuning pairs it is the first. The mean over tiles is the geometric one, so that no single tile decides.
    """
    chosen = {}
    for factor in factors:
        own = [(task, tile) for task, tile in tuning if task.factor == factor]
        for method in compared:
            means = []
            for options in method.candidates if own else ():
                squared = [errors(np.asarray(method.run(task, options))[..., 0], tile)["mse"] for task, tile in own]
                means.append(float(np.exp(0.5 * np.mean(np.log(np.add(squared, 1e-12))))))
                results.add(kind="tuning", factor=factor, method=method.name, options=options, rmse=means[-1])
            chosen[factor, method.name] = method.candidates[int(np.argmin(means)) if means else 0]
            results.add(kind="chosen", factor=factor, method=method.name, options=chosen[factor, method.name])
    return chosen


def errors(estimate: Float[np.ndarray, "s s"], tile: Tile) -> dict[str, float | None]:
    """Mean squared and mean absolute error of the valid pixels, and mean squared error of those at a depth jump."""
    error = np.abs(estimate.astype(np.float64) - tile.depth)
    borders = tile.valid & beside_jump(tile.depth, BORDER_PIXELS)
    found = {"mse": error[tile.valid] ** 2, "mae": error[tile.valid], "mse_borders": error[borders] ** 2}
    return {name: float(values.mean()) if values.size else None for name, values in found.items()}


def pictures(tile: Tile, estimates: Mapping[str, Float[np.ndarray, "s s"]]) -> list[Float[np.ndarray, "s s 3"]]:
    """The frame, its depth, and the error of each method; black where invalid."""
    near, far = tile.depth[tile.valid].min(), tile.depth[tile.valid].max()
    depth = (tile.depth - near) / max(far - near, 1e-6)
    white = max(WHITE_ERROR * float(np.sqrt(np.mean((estimates["bicubic"] - tile.depth)[tile.valid] ** 2))), 1e-6)
    shown = [depth, *(np.abs(estimate - tile.depth) / white for estimate in estimates.values())]
    return [tile.image, *(np.repeat(np.where(tile.valid, x, 0)[..., None], 3, axis=-1) for x in shown)]


def per_pair(rows: Sequence[Row], measure: str) -> dict[str, float]:
    """Means over the tiles of each pair."""
    there = [row for row in rows if row[measure] is not None]
    names = dict.fromkeys(row["pair"] for row in there)
    return {name: float(np.mean([row[measure] for row in there if row["pair"] == name])) for name in names}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """A table for each source of pairs, a figure, and the errors as pictures."""
    scores = of_kind(rows, "score")
    options = {(row["factor"], row["method"]): row["options"] for row in of_kind(rows, "chosen")}
    tables = [table(text, own, options) for text, own in by_source(scores).items()]
    return [
        *tables,
        Plot(main.name, "RMSE against the factor between source and result.", figure(scores)),
        Picture(
            folder / "errors.png",
            f"The tile of each source on which bicubic errs most; white is {WHITE_ERROR:g} times its RMSE.",
        ),
    ]


def by_source(scores: Sequence[Row]) -> dict[str, list[Row]]:
    """Scores by the source that the pairs are from."""
    return {text: [r for r in scores if r["pairs"] == text] for text in dict.fromkeys(r["pairs"] for r in scores)}


def by_method(scores: Sequence[Row]) -> dict[tuple[int, str], list[Row]]:
    """Scores by factor and method."""
    keys = dict.fromkeys((row["factor"], row["method"]) for row in scores)
    return {key: [row for row in scores if (row["factor"], row["method"]) == key] for key in keys}


def table(text: str, scores: Sequence[Row], options: Mapping[tuple[int, str], Options]) -> Table:
    """Scores on one source."""
    unit, scale = UNITS[scores[0]["unit"]]
    lines = []
    groups = by_method(scores)
    for (factor, method), own in groups.items():
        squared, absolute, borders = (per_pair(own, name) for name in ("mse", "mae", "mse_borders"))
        bicubic = per_pair(groups[factor, "bicubic"], "mse")
        columns = [
            [scale * np.sqrt(mean) for mean in squared.values()],
            [scale * mean for mean in absolute.values()],
            [scale * np.sqrt(mean) for mean in borders.values()],
            [np.sqrt(mean / bicubic[pair]) for pair, mean in squared.items() if bicubic[pair] > 0],
        ]
        shown = ", ".join(f"{name} {value:g}" for name, value in options[factor, method].items())
        texts = ["–" if s is None else s.text(2) for s in map(summarise, columns)]
        over_tiles = scale**2 * np.mean([row["mse"] for row in own])
        lines.append([f"x{factor}", method, shown, *texts, f"{over_tiles:.1f}"])
    pairs, count = len({row["pair"] for row in scores}), len({(row["pair"], row["tile"]) for row in scores})
    caption = (
        f"{text}: {pairs} pairs, {count} tiles of {scores[0]['settings']['tile']}² pixels. Means over pairs ± half "
        "of the 95 % interval; of a pair, RMSE is the root of the mean of its tiles' MSE. Borders: within "
        f"{BORDER_PIXELS} pixels of a depth jump. MSE: mean over tiles."
    )
    header = ["factor", "method", "parameters", f"RMSE {unit}", f"MAE {unit}", "RMSE at borders", "of bicubic RMSE"]
    header += [f"MSE {unit}²"]
    return Table(caption, header, lines, names=3)


def figure(scores: Sequence[Row]) -> Figure:
    """A panel for each source, a curve for each method."""
    shown: dict[str, dict[str, Any]] = {}
    for text, own in by_source(scores).items():
        unit, scale = UNITS[own[0]["unit"]]
        curves: dict[str, tuple[list[float], list[float]]] = {}
        for (factor, method), rows in by_method(own).items():
            x, y = curves.setdefault(method, ([], []))
            x.append(factor)
            y.append(scale * np.mean(np.sqrt(list(per_pair(rows, "mse").values()))))
        shown[f"{text.partition('?')[0]}, {unit}"] = curves
    return panels(shown, xscale="log", yscale="log", xlabel="factor", ylabel="RMSE")


if __name__ == "__main__":
    run(main)
