"""The paper's other explanatory figure: conductances of the RGB guide and of a learned one.

    python -m experiments.conductances [--guide small] [--pairs SPEC] [--out results/conductances/rooms]

    python -m experiments.conductances --pairs "capture:/data/kitchen?frames=225:300:5&depth=both"

Conductances (Eq. 3) at full size and min-pooled to the cascade's coarser levels. `SPEC` names pictures with depth
as `hyjax.pairs.registry` takes them; default are generated rooms of a seed that no training uses. κ is chosen for
each guide such that the median conductance across depth jumps is `JUMP_CONDUCTANCE`, so that guides can be compared
elsewhere. They are compared at a level of the cascade, where it does not matter that no sensor's borders
are those of the picture to the pixel. Edges of that level are of one of these kinds:

- *jump*: depth changes by more than 5 %;
- *crease*: the normal turns by more than 20°, and there is no jump (only where pairs have normals);
- *texture*: neither, nor next to one, but colour changes by as much as it does at the median jump;
- *plain*: the rest of what is next to neither. Edges without valid depth, or next to such, are left out.

Takes a minute on two cores for the rooms.

Expect: RGB stops light at all texture, as it must by this definition of texture; a learned guide is worth something
if it does not, and if it tells jumps from all other edges more surely (the area under the ROC curve, which no κ
changes)."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, stats

import hyjax
from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import JUMP, summarise
from experiments.records import Row, of_kind
from hyjax.core.diffusion import edge_stopping, guide_distance
from hyjax.core.pyramid import max_pool
from hyjax.core.stencil import Edges, least_around
from hyjax.guide.choose import RGB, open_guide
from hyjax.pairs.depth_pairs import DepthPair
from hyjax.pairs.registry import open_pairs
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

JUMP_CONDUCTANCE = 0.1
FACTORS = (1, 4, 16)
CELL_PIXELS = 4  # pixels a cell is wide
CREASE_COSINE = np.cos(np.deg2rad(20.0))
KINDS = ("jump", "crease", "texture", "plain")

EdgeMask = Bool[np.ndarray, "e"]
EdgeValues = Float[np.ndarray, "e"]


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    pairs: str = "rooms?seed=1001&frames=0:96:4"
    guide: str = "small"
    """Learned guide: name of shipped weights, or a file. `rgb` for none."""
    shown: int = 0
    """Which pair becomes a picture."""


@experiment("Conductances of an RGB guide and of a learned one", "pair")
def main(config: Config, start: Start) -> None:
    guides = [RGB, *([] if config.guide == RGB.name else [open_guide(config.guide)])]
    pairs = open_pairs(config.pairs)
    if not 0 <= config.shown < len(pairs):
        raise InputError(f"shown: {config.shown} is not one of the pairs 0 to {len(pairs) - 1}")
    found: list[tuple[str, Mapping[str, EdgeMask], dict[str, EdgeValues]]] = []
    shown = None
    for number in range(len(pairs)):
        pair = pairs[number]
        distances = {guide.name: guide_distance(guide.features(jnp.asarray(pair.image))) for guide in guides}
        pooled = {name: _flat(max_pool(distance, CELL_PIXELS)) for name, distance in distances.items()}
        found.append((pair.name, kinds(pair, pooled[RGB.name]), pooled))
        if number == config.shown:
            shown = pair, distances
    results = start(pairs.name)
    rows = []
    for guide in guides:
        jumps = np.concatenate([pooled[guide.name][own["jump"]] for _, own, pooled in found])
        if not jumps.size:
            raise InputError(f"{config.pairs}: depth nowhere jumps; choose other pairs")
        squared = float(np.median(jumps))
        kappa = float(np.sqrt(squared * JUMP_CONDUCTANCE / (1.0 - JUMP_CONDUCTANCE)))  # κ²/(κ² + d) = AT_JUMPS
        results.add(kind="guide", guide=guide.name, kappa=kappa, pairs=pairs.name)
        for name, own, pooled in found:
            scores = compare(pooled[guide.name], own, kappa)
            results.add(kind="pair", guide=guide.name, pair=name, **scores)
        if shown is not None:
            pair, distances = shown
            columns = [levels(distances[guide.name], kappa, factor, pair.depth.shape) for factor in FACTORS]
            rows.append((f"{guide.name}, kappa {kappa:.3g}", [pair.image, *columns]))
    headings = ["frame", *(f"conductances at 1/{factor}" for factor in FACTORS)]
    write_contact_sheet(results.out / "conductances.png", rows, headings)


def kinds(pair: DepthPair, colour: EdgeValues) -> Mapping[str, EdgeMask]:
    """The edges of the compared level by kind, see above; `colour` is the RGB guide's distance on them."""
    jump, turn, unknown = [], [], []
    for axis in (0, 1):
        d, v = np.moveaxis(pair.depth, axis, 0), np.moveaxis(pair.valid, axis, 0)
        both = v[1:] & v[:-1]
        far = both & (np.abs(np.diff(d, axis=0)) > JUMP * np.minimum(d[1:], d[:-1]))
        turned = np.zeros_like(both)
        if pair.normal is not None:
            n = np.moveaxis(pair.normal, axis, 0)
            known = (n != 0).any(axis=-1)
            turned = known[1:] & known[:-1] & (np.sum(n[1:] * n[:-1], axis=-1) < CREASE_COSINE)
        for edges, mask in ((jump, far), (turn, turned), (unknown, ~both)):
            edges.append(np.moveaxis(mask, 0, axis))
    jumps, turns, unknowns = ([np.asarray(e) > 0 for e in _pooled(edges)] for edges in (jump, turn, unknown))
    clear = [~ndimage.binary_dilation(j | t | u, np.ones((3, 3))) for j, t, u in zip(jumps, turns, unknowns)]
    is_jump, is_turn, is_clear = _flat(jumps), _flat(turns), _flat(clear)
    typical = np.median(colour[is_jump]) if is_jump.any() else np.inf
    coloured = colour >= typical
    return {
        "jump": is_jump,
        "crease": is_turn & ~is_jump,
        "texture": is_clear & coloured,
        "plain": is_clear & ~coloured,
    }


def compare(squared: EdgeValues, own: Mapping[str, EdgeMask], kappa: float) -> dict[str, float | None]:
    """Median conductance by kind, and the area under the ROC curve of jumps against texture and plain edges."""
    conductance = kappa**2 / (kappa**2 + squared)
    medians = {kind: float(np.median(conductance[own[kind]])) if own[kind].any() else None for kind in KINDS}
    others = own["texture"] | own["plain"]
    stopped = float((conductance[others] < JUMP_CONDUCTANCE).mean()) if others.any() else None
    return medians | {"stopped": stopped, "area": _area(squared[own["jump"]], squared[others])}


def _area(positive: EdgeValues, negative: EdgeValues) -> float | None:
    """Probability that a positive is larger than a negative, from the ranks of all."""
    if not positive.size or not negative.size:
        return None
    ranks = stats.rankdata(np.concatenate([positive, negative]))[: positive.size]
    return float((ranks.mean() - (positive.size + 1) / 2) / negative.size)


def _pooled(edges: Sequence[Bool[np.ndarray, "h w"]]) -> Edges:
    vertical, horizontal = (jnp.asarray(e, jnp.float32) for e in edges)
    return max_pool((vertical, horizontal), CELL_PIXELS)


def _flat(edges: Sequence[np.ndarray] | Edges) -> np.ndarray:
    return np.concatenate([np.asarray(e).ravel() for e in edges])


def levels(distance: Edges, kappa: float, factor: int, shape: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """The conductances of a level as a picture: of each cell, the least on the edges below and to its right."""
    cells = np.asarray(least_around(hyjax.min_pool(edge_stopping(distance, kappa), factor)))
    cells = cells.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(cells[: shape[0], : shape[1], None], 3, axis=-1)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    guides, scores = of_kind(rows, "guide"), of_kind(rows, "pair")
    lines = []
    for guide in guides:
        own = [row for row in scores if row["guide"] == guide["guide"]]
        summaries = [summarise([row[name] for row in own]) for name in (*KINDS, "stopped", "area")]
        texts = ["–" if s is None else s.text(3) for s in summaries]
        lines.append([guide["guide"], f"{guide['kappa']:.3g}", *texts])
    caption = (
        f"Conductances at 1/{CELL_PIXELS} of the resolution of {len({row['pair'] for row in scores})} pictures of "
        f"{guides[0]['pairs']}: means of each picture's median by kind of edge, ± half of the 95 % interval. "
        f"Below {JUMP_CONDUCTANCE:g}: share of texture and plain edges that are as closed as the median jump. "
        "Area: under the ROC curve, jumps against texture and plain edges."
    )
    header = ["", "kappa", *KINDS, f"below {JUMP_CONDUCTANCE:g}", "area"]
    return [
        Table(caption, header, lines),
        Picture(folder / "conductances.png", "White lets light through, black stops it."),
    ]


if __name__ == "__main__":
    run(main)
