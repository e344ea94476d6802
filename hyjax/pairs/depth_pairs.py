"""Pictures with depth to train and evaluate guides: pairs, sources of pairs, and kinds of sources.

Depth is in metres or it is a disparity (larger is nearer, of no absolute scale); a source has one or the other,
and the two are never converted into each other. Pixels without a reading are masked: files mark them by 0, 65535,
NaN or infinity."""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np
from jaxtyping import Bool, Float

from hyjax.data.frames import select_frames
from hyjax.util.errors import InputError
from hyjax.util.files import digest

Unit = Literal["metres", "disparity"]


@dataclasses.dataclass(frozen=True, eq=False)
class DepthPair:
    """Picture with its depth, pixel by pixel.

    Attributes:
        name: short and unique within its source.
        image: display-encoded (sRGB) colours in [0, 1].
        depth: in `unit`, 0 where invalid.
        valid: where the depth may be relied on.
        unit: `"metres"` along the camera's axis, or `"disparity"`.
        normal: unit vectors in camera axes (+x right, +y down, +z forward) towards the camera, 0 where unknown;
            None if nowhere known.
    """

    name: str
    image: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    valid: Bool[np.ndarray, "h w"]
    unit: Unit
    normal: Float[np.ndarray, "h w 3"] | None = None


class DepthPairs(Protocol):
    """Source of pairs, which are read on demand, so that large sources fit in memory."""

    name: str
    unit: Unit

    @property
    def fingerprint(self) -> str:
        """Hash of the content, the same for a copy of the files elsewhere."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> DepthPair: ...


Options = Mapping[str, str]
SELECTION_OPTIONS = ("frames", "without")
"""Options of every kind: positions to take and to leave out, see `hyjax.data.frames.select_frames`."""


@dataclasses.dataclass(frozen=True)
class PairsKind:
    """Kind of source of pairs.

    Attributes:
        name: `KIND` of `KIND:PATH?OPTION=VALUE`.
        open: opens a source from its path and options; raises `InputError` if it cannot be used.
        options: names of the options that `open` reads, besides `SELECTION_OPTIONS`.
        has_path: whether the source is read from a path.
        selects: whether `open` applies `SELECTION_OPTIONS` itself.
    """

    name: str
    open: Callable[[Path, Options], DepthPairs]
    options: tuple[str, ...] = ()
    has_path: bool = True
    selects: bool = False


def selected(options: Options, count: int) -> list[int]:
    """Positions below `count` in the option `frames` but not in the option `without`.

    Raises:
        InputError: malformed options, or nothing is left.
    """
    left_out = set(select_frames(options["without"], count)) if "without" in options else set()
    chosen = [i for i in select_frames(options.get("frames", "all"), count) if i not in left_out]
    if not chosen:
        raise InputError(f"pairs: frames without {options['without']} leave none of 0 to {count - 1}")
    return chosen


def masked_pair(
    name: str,
    image: Float[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "h w"],
    unit: Unit,
    *,
    where: Path | str,
    valid: Bool[np.ndarray, "h w"] | None = None,
    normal: Float[np.ndarray, "h w 3"] | None = None,
) -> DepthPair:
    """Pair with pixels masked where depth is not finite or not positive, or `valid` is false.

    Args:
        name, image, depth, unit, normal: see `DepthPair`; depth may hold anything where it is invalid.
        where: its place in messages.
        valid: where depth may be relied on; everywhere if not given.

    Raises:
        InputError: sizes differ, an unknown unit, or no valid pixel at all.
    """
    if unit not in get_args(Unit):
        raise InputError(f"{where}: depth is in unknown unit {unit!r}; use one of {', '.join(get_args(Unit))}")
    if image.shape[:2] != depth.shape:
        raise InputError(
            f"{where}: depth is {depth.shape[1]}x{depth.shape[0]} but the picture is "
            f"{image.shape[1]}x{image.shape[0]}; depth must be registered to the picture"
        )
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(depth) & (depth > 0)
    if valid is not None:
        usable &= valid
    if not usable.any():
        raise InputError(f"{where}: no valid depth at all (only 0, 65535, NaN or infinity); remove this pair")
    depth = np.where(usable, depth, 0).astype(np.float32)
    if normal is not None:
        normal = np.where(usable[..., None], normal, 0).astype(np.float32)
    return DepthPair(name, image.astype(np.float32, copy=False), depth, usable, unit, normal)


class ChosenPairs:
    """Selection of a source's pairs, in a given order."""

    def __init__(self, pairs: DepthPairs, indices: Sequence[int]) -> None:
        self.name, self.unit = pairs.name, pairs.unit
        self._pairs, self._indices = pairs, list(indices)

    @property
    def fingerprint(self) -> str:
        return digest([self._pairs.fingerprint, *map(str, self._indices)])

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> DepthPair:
        return self._pairs[self._indices[index]]


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Natural sorting key: learn2 comes before learn10."""
    return tuple((0, int(p), "") if p.isdigit() else (1, 0, p) for p in re.split(r"(\d+)", name) if p)
