"""Random furnished rooms and photographs of them, for training: image, exact depth and exact normals."""

import dataclasses

import numpy as np

from hyjax.scene.random_room.layout import RandomRoom, furnish
from hyjax.scene.random_room.light import Lighting, draw_lighting
from hyjax.scene.random_room.render import Shot, shoot
from hyjax.scene.random_room.views import draw_view
from hyjax.scene.raycast import RayCaster

__all__ = ["LitRoom", "Shot", "make_random_room", "photograph"]


@dataclasses.dataclass(frozen=True)
class LitRoom:
    """A random room ready for photographs.

    Attributes:
        seed, number: what it was drawn from.
        room: geometry and looks.
        caster: its rays.
        lighting: its lights.
    """

    seed: int
    number: int
    room: RandomRoom
    caster: RayCaster
    lighting: Lighting


def make_random_room(seed: int, number: int) -> LitRoom:
    """Furnish and light room `number` of a seed."""
    room = furnish(seed, number)
    lighting = draw_lighting(room, np.random.default_rng((seed, number, 1)))
    return LitRoom(seed, number, room, RayCaster(room.furnished.mesh), lighting)


def photograph(lit: LitRoom, view: int, size: int) -> Shot:
    """View `view` of a room, `size` pixels square."""
    rng = np.random.default_rng((lit.seed, lit.number, 2, view))
    camera = draw_view(lit.room, lit.caster, size, rng)
    return shoot(lit.room, lit.caster, lit.lighting, camera, rng)
