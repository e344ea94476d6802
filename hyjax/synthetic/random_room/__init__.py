"""Random furnished rooms and photographs of them, for training: image, exact depth and exact normals."""

import dataclasses

import numpy as np

from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.random_room.bank import Bank, painted
from hyjax.synthetic.random_room.layout import RandomRoom, furnish
from hyjax.synthetic.random_room.light import Lighting, draw_lighting
from hyjax.synthetic.random_room.looks import PHOTOGRAPHS
from hyjax.synthetic.random_room.render import RenderedView, shoot
from hyjax.synthetic.random_room.views import draw_view
from hyjax.util.lru_cache import LruCache

__all__ = ["LitRoom", "RenderedView", "make_random_room", "photograph"]

ALBUM_COUNTS, ALBUM_SIZE = (4, 4), 128
"""Photographs on walls, pictures of other rooms: (number of rooms, views of each), and side in pixels."""


@dataclasses.dataclass(frozen=True)
class LitRoom:
    """A random room ready for photographs.

    Attributes:
        key: of the random views.
        room: geometry and looks.
        caster: its rays.
        lighting: its lights.
    """

    key: tuple[int, ...]
    room: RandomRoom
    caster: RayCaster
    lighting: Lighting


def make_random_room(seed: int, number: int) -> LitRoom:
    """Furnish and light room `number` of a seed. The first room of a seed in a process draws its patterns, too."""
    return _make((seed, number), bank_of(seed))


def bank_of(seed: int) -> Bank:
    """Bank of patterns for the rooms of a seed; drawn once in a process."""
    return _banks(seed, lambda: _draw_bank(seed))


def photograph(lit: LitRoom, view: int, size: int) -> RenderedView:
    """Photograph view `view` of a room, `size` pixels square."""
    rng = np.random.default_rng((*lit.key, 2, view))
    camera = draw_view(lit.room, lit.caster, size, rng)
    return shoot(lit.room, lit.caster, lit.lighting, camera, rng)


def _make(key: tuple[int, ...], patterns: Bank) -> LitRoom:
    room = furnish(np.random.default_rng(key), patterns)
    lighting = draw_lighting(room, np.random.default_rng((*key, 1)))
    return LitRoom(key, room, RayCaster(room.surface.mesh), lighting)


def _draw_bank(seed: int) -> Bank:
    """Draw the bank of patterns for a seed, which takes seconds."""
    images = painted(seed)
    plain = Bank(images)
    rooms = [_make((seed, number, 3), plain) for number in range(ALBUM_COUNTS[0])]
    shots = [photograph(room, view, ALBUM_SIZE) for room in rooms for view in range(ALBUM_COUNTS[1])]
    images[PHOTOGRAPHS] = [shot.image**2.2 for shot in shots]
    return Bank(images)


_banks = LruCache(2)
