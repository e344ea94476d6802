"""Rooms of known truth: photos under their own light, and true pictures of them under new lights.

    room = lit_room("builtin-0")                       # or "random-5-2-both"
    mean = room.mean_light(room.photo_light, cameras)  # K
    photo = room.photograph(room.photo_light, cameras[0], 0)
    light = room.bake(setup.lights)
    truth = room.photograph(light, cameras[0], 0, truth_exposure(room.white, mean, setup.reference_lux))
    direct, bounce = room.irradiance(room.photo_light, mesh.vertices, mesh.vertex_normals)

The light of every source is baked into light maps with six bounces, and what comes straight from bulbs and the sun
is traced to every pixel. The camera is the built-in room's.
"""

import re

from hyjax.synthetic.truth.builtin import lit_builtin_room
from hyjax.synthetic.truth.generated import lit_random_room
from hyjax.synthetic.truth.room import TruthLight, TruthRoom
from hyjax.util.errors import InputError

__all__ = ["DEVELOPMENT_ROOMS", "TEST_ROOMS", "TruthLight", "TruthRoom", "lit_builtin_room", "lit_room"]

DEVELOPMENT_ROOMS: tuple[str, ...] = ("builtin-0", "random-5-6-day", "random-11-0-both", "random-23-6-lamps")
TEST_ROOMS: tuple[str, ...] = ("builtin-3", "random-5-7-day", "random-5-2-both", "random-23-1-lamps")
"""Rooms for development and for test; their plans, windows and lamps differ."""


def lit_room(name: str, quality: float = 1.0) -> TruthRoom:
    """Room by name: `builtin-SEED`, or `random-SEED-NUMBER-BY` with BY the light of its photos.

    Args:
        name: of the room; BY is `day`, `lamps` or `both`.
        quality: of light and textures; 1 for pictures to look at.
    """
    if not 0.1 <= quality <= 2:
        raise InputError(f"room: quality is {quality}, must lie in [0.1, 2]")
    if match := re.fullmatch(r"builtin-(\d+)", name):
        return lit_builtin_room(int(match[1]), quality)
    if match := re.fullmatch(r"random-(\d+)-(\d+)-(day|lamps|both)", name):
        return lit_random_room(int(match[1]), int(match[2]), match[3], quality)
    raise InputError(f"room: no room {name!r}; name one like builtin-0 or random-5-2-both")
