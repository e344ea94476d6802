"""NumPy vectors of space: unit vectors, frames, evenly spread points. All compute in float64."""

import numpy as np
from jaxtyping import ArrayLike, Float

SHORTEST_LENGTH = 1e-20
"""Length below which a sum of normals has no direction."""


def unit(vector: Float[ArrayLike, "*s 3"], least: float = 0.0) -> Float[np.ndarray, "*s 3"]:
    """Vectors divided by their lengths; by `least` where they are shorter, so that zero stays zero."""
    v = np.asarray(vector, np.float64)
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), least)


def reject(vector: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The part of a vector across a unit axis."""
    return vector - np.dot(vector, axis) * axis


def perpendicular(vector: Float[np.ndarray, "*s 3"]) -> Float[np.ndarray, "*s 3"]:
    """A vector across each vector: its cross product with the world axis that it leans to least. Not unit."""
    return np.cross(vector, np.eye(3)[np.argmin(np.abs(vector), axis=-1)])


def orthonormal_frame(direction: Float[ArrayLike, "*s 3"]) -> Float[np.ndarray, "*s 3 3"]:
    """Right-handed frames; rows are x, y and z, with z along `direction`."""
    z = unit(direction)
    x = unit(-perpendicular(z))
    return np.stack([x, np.cross(z, x), z], axis=-2)


def fibonacci_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spread unit vectors, from +z down to −z."""
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    angle = k * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)


def fibonacci_disc(count: int) -> Float[np.ndarray, "n 2"]:
    """Evenly spread points of the unit disc."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def r2_sequence(count: int) -> Float[np.ndarray, "n 2"]:
    """Evenly spread points of the unit square, no two in a row or column (Roberts 2018)."""
    plastic = 1.32471795724474602596
    return (0.5 + np.arange(count)[:, None] * [1.0 / plastic, 1.0 / plastic**2]) % 1.0
