"""View outside: a hazy sky over a garden."""

import numpy as np
from jaxtyping import Float

# Towards the hidden sun, as seen through the window (which looks along -x).
SUN = np.array([-0.72, 0.42, 0.55]) / np.linalg.norm([-0.72, 0.42, 0.55])
HORIZON = np.array([1.00, 1.00, 1.00], dtype=np.float32)
ZENITH = np.array([0.72, 0.88, 1.15], dtype=np.float32)
GLOW = np.array([5.2, 4.5, 3.5], dtype=np.float32)
GARDEN = np.array([0.20, 0.23, 0.15], dtype=np.float32)


def sky_radiance(direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Smooth radiance of the sky by unit direction, for lighting the room."""
    up = direction[:, 2:]
    sky = HORIZON + (ZENITH - HORIZON) * np.clip(up, 0, 1) ** 0.6
    toward = np.clip(direction @ SUN.astype(np.float32), 0, 1)[:, None]
    sky = sky + GLOW * toward**14
    ground = np.clip(0.5 - up / 0.08, 0, 1)
    return (sky * (1 - ground) + GARDEN * ground).astype(np.float32)


def view(direction: Float[np.ndarray, "n 3"], foliage: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """View outside in a camera exposed for the room, in multiples of white: a washed-out garden, blank sky."""
    azimuth = np.arctan2(direction[:, 1], -direction[:, 0])
    crown_edge = 0.05 + 0.6 * (foliage[:, 1] - 0.2)
    for k, (rate, height) in enumerate(((3.1, 0.09), (7.3, 0.05), (17.0, 0.03), (41.0, 0.015))):
        crown_edge = crown_edge + height * np.sin(rate * azimuth + 1.7 * k)
    crown = np.clip((crown_edge - direction[:, 2]) / 0.045, 0, 1)[:, None]
    lawn = np.clip((-0.20 - direction[:, 2]) / 0.03, 0, 1)[:, None]
    sky = np.array([1.7, 1.85, 2.0], np.float32)
    shade = np.clip(1.15 + 2.2 * (direction[:, 2:] - crown_edge[:, None]), 0.6, 1.2)
    leaves = 2.4 * foliage * np.array([1.1, 0.8, 1.2], np.float32)
    trees = (np.array([0.60, 0.62, 0.54], np.float32) + leaves) * shade
    grass = np.array([0.92, 0.98, 0.80], np.float32) + 0.6 * foliage
    return ((sky * (1 - crown) + trees * crown) * (1 - lawn) + grass * lawn).astype(np.float32)
