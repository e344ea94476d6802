"""Sheets of pictures side by side: stages, levels of the cascade, two pictures; and their JPEG files."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.color import encoded, to_display
from hyjax.light.relit import Relit
from hyjax.util.contact_sheet import BACKGROUND, contact_sheet
from hyjax.util.images import picture_file

QUALITY = 90
"""Quality of the JPEG pictures."""
DIFFERENCE_GAIN = 4.0
"""Factor of the difference of two pictures."""
BRIGHT_VALUE, BRIGHT_QUANTILE = 0.7, 0.98
"""Linear value that a filter's bright quantile is brought to: filters are often above white."""
WIDTH, MOST_IN_A_ROW = 360, 4
"""Width of a picture in pixels, and pictures in a row."""
Sheet = Float[np.ndarray, "h w 3"]


def stages_sheet(photo: Float[np.ndarray, "h w 3"], relit: Relit) -> Sheet:
    """Stages of a relit frame, display-encoded; `photo` is display-encoded, too."""
    filters = {"raw filter": relit.shading, "refined": relit.refined, "with shadows": relit.relight_filter}
    gain = _gain(relit.refined)
    named: dict[str, Any] = {name: _filter(gain * each) for name, each in filters.items()}
    named = {"photo": photo, **named, "visibility": np.asarray(relit.visibility)}
    return _sheet(named | {"frame x raw filter": _display(relit.unrefined), "relit": _display(relit.image)})


def levels_sheet(levels: Sequence[tuple[str, Float[Array, "h w 3"]]]) -> Sheet:
    """Light after each level of a cascade, over the reference."""
    gain = _gain(levels[-1][1])
    return _sheet({name: _filter(gain * light) for name, light in levels})


def compared_sheet(first: tuple[str, Any], second: tuple[str, Any]) -> Sheet:
    """Two pictures of display values with their names, and how they differ."""
    (name, a), (other, b) = ((name, np.asarray(picture)) for name, picture in (first, second))
    difference = np.abs(a - b)
    said = f"difference x {DIFFERENCE_GAIN:g}, largest {difference.max():.3f}"
    return _sheet({name: a, other if other != name else f"{other} ": b, said: DIFFERENCE_GAIN * difference})


def jpeg(display: Any) -> bytes:
    """A picture of display values as a JPEG file."""
    return picture_file(np.nan_to_num(np.asarray(display, np.float32)), quality=QUALITY)


def _gain(light: Any) -> float:
    return BRIGHT_VALUE / max(float(np.quantile(np.asarray(light), BRIGHT_QUANTILE)), 1e-6)


def _filter(ratio: Any) -> Float[np.ndarray, "h w 3"]:
    return np.asarray(jax.jit(encoded)(ratio))


def _display(linear: Any) -> Float[np.ndarray, "h w 3"]:
    return np.asarray(to_display(linear))


def _sheet(named: Mapping[str, Any]) -> Sheet:
    names = list(named)
    count = min(MOST_IN_A_ROW, len(names))
    parts = [names[k : k + count] for k in range(0, len(names), count)]
    rows = [contact_sheet([("", [named[name] for name in part])], part, WIDTH) for part in parts]
    width = max(row.shape[1] for row in rows)
    pads = [((0, 0), (0, width - row.shape[1]), (0, 0)) for row in rows]
    return np.concatenate([np.pad(row, pad, constant_values=BACKGROUND) for row, pad in zip(rows, pads)])
