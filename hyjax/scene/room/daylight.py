"""What is outside: a hazy sky over a garden."""

import numpy as np
from jaxtyping import Float

# Towards the hidden sun, as seen through the window (which looks along -x).
SUN = np.array([-0.72, 0.42, 0.55]) / np.linalg.norm([-0.72, 0.42, 0.55])
HORIZON = np.array([1.00, 1.00, 1.00], dtype=np.float32)
ZENITH = np.array([0.72, 0.88, 1.15], dtype=np.float32)
GLOW = np.array([5.2, 4.5, 3.5], dtype=np.float32)
GARDEN = np.array([0.20, 0.23, 0.15], dtype=np.float32)


def sky_radiance(direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Smooth radiance by unit direction, for lighting the room."""
    up = direction[:, 2:]
    sky = HORIZON + (ZENITH - HORIZON) * np.clip(up, 0, 1) ** 0.6
    toward = np.clip(direction @ SUN.astype(np.float32), 0, 1)[:, None]
    sky = sky + GLOW * toward**14
    ground = np.clip(0.5 - up / 0.08, 0, 1)
    return (sky * (1 - ground) + GARDEN * ground).astype(np.float32)


def view_radiance(direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The same with trees against the sky, for eyes and mirrors."""
    radiance = sky_radiance(direction)
    azimuth = np.arctan2(direction[:, 1], -direction[:, 0])
    wave = np.zeros_like(azimuth)
    for k, (rate, height) in enumerate(((3.1, 0.07), (7.3, 0.045), (17.0, 0.022), (41.0, 0.012), (97.0, 0.007))):
        wave += height * np.sin(rate * azimuth + 1.7 * k)
    crown = np.clip((0.12 + wave - direction[:, 2]) / 0.015, 0, 1)[:, None]
    leaves = np.array([0.30, 0.40, 0.22], np.float32) * (0.8 + 0.3 * np.sin(60 * wave))[:, None]
    return (radiance * (1 - 0.85 * crown) + 0.85 * leaves * crown).astype(np.float32)
