"""Upright rectangles in space: openings that let light in, windows and panels that emit it."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from hyjax.light.kinds.base import Vector, pytree
from hyjax.light.kinds.file_keys import FileKey, Triple, direction, plain
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.vectors import perpendicular, reject, unit

PARALLEL_SINE = 1e-3
"""Length of the component of `up` across the normal below which the two count as parallel."""


@pytree
class Aperture:
    """Opening, such as a window: the rectangle with corners centre ± right ± up.

    Attributes:
        center: world metres.
        right: half-axis in metres.
        up: half-axis in metres.
    """

    center: Vector
    right: Vector
    up: Vector

    @classmethod
    @checked_arguments
    def facing(
        cls,
        center: Triple,
        normal: Triple,
        up: Triple,
        width: float,
        height: float,
    ) -> Self:
        """Rectangle with right × up along `normal` and `up` as upright as can be; metres, float32.

        Where the normal and `up` are parallel (a ceiling panel) it lies any way round.

        Raises:
            InputError: the normal or `up` is zero.
        """
        outward = np.asarray(direction(normal, "normal"), np.float64)
        across = reject(np.asarray(direction(up, "up"), np.float64), outward)
        if np.linalg.norm(across) < PARALLEL_SINE:
            across = perpendicular(outward)
        across /= np.linalg.norm(across)
        half_axes = np.cross(across, outward) * (0.5 * width), across * (0.5 * height)
        return cls(*(np.asarray(vector, np.float32) for vector in (center, *half_axes)))

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        """Rectangle from the values of `RECTANGLE`.

        Raises:
            InputError: the normal or `up` is zero, or they are parallel.
        """
        center, normal, up = values["center"], values["normal"], values["up"]
        if up is not None:
            axis = direction(normal, "normal").astype(np.float64)
            if np.linalg.norm(reject(direction(up, "up").astype(np.float64), axis)) < PARALLEL_SINE:
                raise InputError("'up' must not be parallel to 'normal'")
        return cls.facing(center, normal, world_up if up is None else up, values["width"], values["height"])

    def to_entry(self) -> dict[str, Any]:
        """Rectangle as plain numbers; the inverse of `from_entry`."""
        right, up = np.asarray(self.right, np.float64), np.asarray(self.up, np.float64)
        return {
            "center": plain(self.center),
            "normal": plain(unit(np.cross(right, up))),
            "up": plain(unit(up)),
            "width": plain(2 * np.linalg.norm(right)),
            "height": plain(2 * np.linalg.norm(up)),
        }


RECTANGLE = (
    FileKey("center", "vector"),
    FileKey("normal", "direction"),
    FileKey("up", "direction", default=None),
    FileKey("width", positive=True),
    FileKey("height", positive=True),
)
