"""Pictures of a relit frame: the files that are written, and its row of the contact sheet."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from hyjax.data.capture import Frame
from hyjax.light.color import decoded, encoded, to_display
from hyjax.light.relit import Relit
from hyjax.pipeline import Mode
from hyjax.relighting.settings import RelightSettings
from hyjax.util.clock import StageClock
from hyjax.util.images import write_exr, write_png
from hyjax.util.programs import run_kept

COLUMNS = {
    "frame": "frame",
    "relit": "relit = frame x refined filter x visibility",
    "raw": "raw filter: the scan, lit without shadows",
    "refined": "refined filter: after the cascade",
    "visibility": "visibility: share that shadows leave",
    "unrefined": "frame x raw filter, with shadows",
}
"""Headings of the contact sheet's columns, by their names."""


def written_pictures(
    image: Float[Array, "h w 3"], relit: Relit | None, settings: RelightSettings
) -> dict[str, Float[Array, "h w 3"]]:
    """Pictures to write of a frame, by kind; nothing else is kept until then.

    Args:
        relit: all stages; None where the settings ask for none.
    """
    pictures = {"relit": image}
    if relit is not None and settings.save_filters:
        pictures |= {"filter": relit.shading, "refined": relit.refined}
    if relit is not None and settings.save_visibility:
        pictures |= {"visibility": relit.visibility}
    return pictures


def write_frame(
    clock: StageClock,
    out: Path,
    name: str,
    pictures: dict[str, Float[Array, "h w 3"]],
    mode: Mode,
    *,
    exr: bool = False,
) -> dict[str, Float[np.ndarray, "h w 3"]]:
    """Write a PNG to look at of each picture, and an EXR with linear values if so; returns what the PNGs show."""
    shown = {}
    with clock("write"):
        for kind, picture in pictures.items():
            if kind == "visibility":
                shown[kind] = np.asarray(picture)
            else:
                shown[kind] = _shown(picture) if kind == "relit" else _shown_filter(picture, mode)
            write_png(out / f"{name}.{kind}.png", shown[kind])
            if exr:
                encoded_filter = mode == "paper" and kind in ("filter", "refined")
                linear = np.asarray(run_kept(decoded, picture) if encoded_filter else picture)
                write_exr(out / f"{name}.{kind}.exr", linear)
    return shown


def sheet_row(frame: Frame, relit: Relit, mode: Mode) -> dict[str, Float[np.ndarray, "h w 3"]]:
    """Pictures of a frame by the names in `COLUMNS`."""
    paper = mode == "paper"
    # Filters brighter than white are dimmed, both alike, until their structure shows.
    dim = 1.0 if paper else max(1.0, float(np.percentile(np.asarray(relit.refined)[::4, ::4], 98)))
    return {
        "frame": frame.image,
        "relit": _shown(relit.image),
        "raw": _shown_filter(np.asarray(relit.shading) / np.float32(dim), mode),
        "refined": _shown_filter(np.asarray(relit.refined) / np.float32(dim), mode),
        "visibility": np.asarray(relit.visibility),
        "unrefined": _shown(relit.unrefined),
    }


def _shown(picture: Any) -> Float[np.ndarray, "h w 3"]:
    return np.asarray(run_kept(to_display, picture))


def _shown_filter(picture: Any, mode: Mode) -> Float[np.ndarray, "h w 3"]:
    """A filter, which is no light; the paper's is display values as it is."""
    return np.asarray(picture if mode == "paper" else run_kept(encoded, picture))
