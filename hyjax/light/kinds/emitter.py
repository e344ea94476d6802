"""Lights for another renderer: plain numbers of a shape that it knows."""

import dataclasses
from typing import Any, Literal

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class Emitter:
    """Light in plain numbers.

    Attributes:
        kind: the shape that emits.
        strength: lumens; of directional light and a sky lux on a surface that faces it.
        position: of a point or spot, or the centre of a rectangle; world metres.
        direction: unit; of a spot's axis or of directional light as it travels, or up to the sky.
        right, up: half-axes of a rectangle, which emits to the side of their cross product.
        extent: radius of a bulb in metres, or of the sun's disc in radians.
        clearance: nothing nearer casts a shadow, metres.
        inner_angle, outer_angle: half angles of a spot's cone, radians.
        aperture: the `Aperture` that directional light comes through.
    """

    kind: Literal["point", "spot", "directional", "rect", "sky"]
    strength: float
    position: Float[np.ndarray, "3"] | None = None
    direction: Float[np.ndarray, "3"] | None = None
    right: Float[np.ndarray, "3"] | None = None
    up: Float[np.ndarray, "3"] | None = None
    extent: float = 0.0
    clearance: float = 0.0
    inner_angle: float = 0.0
    outer_angle: float = 0.0
    aperture: Any = None
