"""Camera path of a visitor: once round the room at eye height, looking across it."""

import numpy as np
from scipy.interpolate import CubicSpline

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.util.errors import InputError

# (eye, target): keep to walkable floor; every target is a piece of furniture across the room.
STATIONS = (
    ((2.75, 0.75, 1.52), (2.35, 5.0, 0.95)),
    ((3.05, 1.10, 1.50), (1.85, 5.0, 0.90)),
    ((3.00, 1.90, 1.48), (0.60, 4.40, 0.85)),
    ((2.95, 2.30, 1.45), (0.20, 2.45, 0.70)),
    ((3.10, 2.60, 1.50), (0.90, 0.90, 0.80)),
    ((2.90, 3.30, 1.55), (1.35, 0.60, 0.85)),
    ((2.30, 4.30, 1.58), (1.90, 0.40, 0.85)),
    ((1.50, 4.30, 1.60), (3.30, 0.60, 0.80)),
    ((1.05, 3.70, 1.55), (4.20, 2.20, 0.70)),
    ((1.00, 3.10, 1.50), (4.20, 3.40, 0.75)),
    ((1.25, 2.75, 1.48), (4.00, 4.70, 0.75)),
    ((1.60, 2.70, 1.50), (2.60, 5.00, 0.85)),
)


def camera_path(n_frames: int = 24, width: int = 640, height: int = 480) -> list[Camera]:
    """Camera path of `n_frames` poses spread evenly over the way: the centred part of 640x480, 62 degrees wide."""
    if n_frames < 1 or width < 16 or height < 16:
        raise InputError(f"room: need at least 1 frame of 16x16 pixels, got {n_frames} of {width}x{height}")
    focal = 525.0 * max(width / 640, height / 480)
    intrinsics = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    knots = np.arange(len(STATIONS))
    stations = np.array(STATIONS)
    eye, target = (CubicSpline(knots, stations[:, k]) for k in (0, 1))
    # Even steps of what the picture shows: a turn of one radian counts as far as a walk of 0.8 m.
    dense = np.linspace(0, len(STATIONS) - 1, 400)
    gaze = target(dense) - eye(dense)
    gaze /= np.linalg.norm(gaze, axis=1, keepdims=True)
    steps = np.hypot(*(np.linalg.norm(np.diff(a, axis=0), axis=1) for a in (eye(dense), 0.8 * gaze)))
    walked = np.concatenate([[0], np.cumsum(steps)])
    cameras = []
    for at in np.interp(np.linspace(0, walked[-1], n_frames), walked, dense):
        sway = 0.010 * np.sin(np.array([2.1, 1.7, 3.9]) * at * 2 + np.array([0.0, 1.0, 2.0]))
        roll = np.array([0.02 * np.sin(2.7 * at), 0.02 * np.sin(1.9 * at + 0.5), 1.0])
        cameras.append(Camera(intrinsics, look_at(eye(at) + sway, target(at), roll)))
    return cameras
