"""Built-in room of known truth under any light."""

import numpy as np

from hyjax.synthetic.room import make_room
from hyjax.synthetic.room.materials import LEAF, Textures
from hyjax.synthetic.room.path import camera_path
from hyjax.synthetic.room.render import white_level
from hyjax.synthetic.room.shell import WALL_THICKNESS, WINDOW
from hyjax.synthetic.truth.opening import Opening
from hyjax.synthetic.truth.picture import Bulb
from hyjax.synthetic.truth.room import TruthLight, TruthRoom, Walks
from hyjax.synthetic.truth.source import Daylight

BULB_RADIUS = 0.036
"""Radius of the lamps' bulbs in metres."""


def lit_builtin_room(seed: int = 0, quality: float = 1.0) -> TruthRoom:
    """Built-in room of a seed; its photos are `hyjax.synthetic.room.photographs`'."""
    room = make_room(seed)
    y0, y1, z0, z1 = WINDOW
    centre = np.array([0.0, (y0 + y1) / 2, (z0 + z1) / 2])
    right, up = np.array([0.0, (y1 - y0) / 2, 0.0]), np.array([0.0, 0.0, (z1 - z0) / 2])
    return TruthRoom(
        f"builtin-{seed}",
        room.surface,
        Textures(seed, quality),
        [Opening(centre, right, up, np.array([1.0, 0.0, 0.0]), WALL_THICKNESS)],
        [Bulb(np.array(room.anchors[lamp]["position"]), BULB_RADIUS) for lamp in ("lamp_0", "lamp_1")],
        (Daylight(0),),
        room.anchors,
        Walks(camera_path, camera_path),
        quality,
        seed,
        LEAF,
        _level,
    )


def _level(room: TruthRoom, light: TruthLight) -> np.ndarray:
    return np.full(3, white_level(light.maps.soft + light.maps.hard + light.maps.bounce))
