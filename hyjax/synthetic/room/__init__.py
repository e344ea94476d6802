"""Built-in furnished room: its exact surface, and photographs of it.

`make_room` builds the geometry, `camera_path` a walk through it, and `photographs` takes pictures along the way.
The pictures come from a small renderer: daylight is baked into light maps by ray casting with several bounces,
and every frame is then albedo × light plus mirror reflections, seen through a slightly imperfect camera.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.pool import ThreadPool

import numpy as np
import trimesh
from jaxtyping import Float

from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.room.layout import arrange
from hyjax.synthetic.room.light import WORKERS, bake
from hyjax.synthetic.room.lightmap import Texels
from hyjax.synthetic.room.materials import Textures
from hyjax.synthetic.room.path import camera_path
from hyjax.synthetic.room.render import BakedRoom, photograph, white_level
from hyjax.synthetic.surface import Surface
from hyjax.util.errors import InputError
from hyjax.util.progress import StepBar

__all__ = ["Room", "camera_path", "make_room", "photographs"]
Irradiance = Float[np.ndarray, "t 3"]
Keep = Callable[[Callable[[], Irradiance]], Irradiance]


@dataclasses.dataclass(frozen=True)
class Room:
    """Built-in room: metres, z up.

    Attributes:
        seed: of its small details.
        surface: triangles with materials and light-map charts.
        anchors: named places as plain numbers: `window_0` (center, right and up half-axes, inward normal,
            width, height), `lamp_0`, `lamp_1`, `sofa`, `table`, `bookcase`, `room_center` (position), `bounds`
            (low, high).
    """

    seed: int
    surface: Surface
    anchors: dict[str, dict[str, object]]

    @property
    def mesh(self) -> trimesh.Trimesh:
        """Exact surface; normals point into the room."""
        return self.surface.mesh


def make_room(seed: int = 0) -> Room:
    """Build the room's surface; the seed varies books, colours and small placements."""
    surface, anchors = arrange(seed)
    return Room(seed, surface, anchors)


def photographs(
    room: Room,
    cameras: Sequence[Camera],
    quality: float = 1.0,
    progress: bool = False,
    keep: Keep = lambda bake: bake(),
) -> Iterator[Float[np.ndarray, "h w 3"]]:
    """Photograph the room, picture by picture.

    Args:
        room: from `make_room`.
        cameras: one for each picture.
        quality: 1 for pictures to look at; 0.25 builds much sooner and shows it.
        progress: show a bar on stderr.
        keep: returns the irradiance / π of all texels: one that was kept, or made by the function that it gets.

    Returns:
        For each camera the display-encoded (sRGB) picture in 8-bit steps, float32 in [0, 1].
    """
    if not 0.1 <= quality <= 2:
        raise InputError(f"room: quality is {quality}, must lie in [0.1, 2]")
    with StepBar[None](desc="built-in room: light", total=len(cameras), unit="frame", disable=not progress) as bar:
        baked = _bake(room, quality, keep)
        bar.set_description("built-in room: frames")

        def shoot(number: int) -> np.ndarray:
            picture = photograph(baked, cameras[number], number)
            bar.update()
            return picture

        with ThreadPool(WORKERS) as pool:  # whose threads end with the process
            yield from pool.imap(shoot, range(len(cameras)))


def _bake(room: Room, quality: float, keep: Keep = lambda bake: bake()) -> BakedRoom:
    surface, caster, textures = room.surface, RayCaster(room.mesh), Textures(room.seed, quality)
    texels, side = Texels(surface, 1 / quality), max(2, round(7 * np.sqrt(quality)))
    albedo = np.zeros((len(surface.nodes), 3), np.float32)
    albedo[surface.chart] = textures.mean[surface.material] * surface.tint
    light = keep(lambda: bake(surface, caster, texels, albedo, side, room.seed))
    corners = np.concatenate([surface.uv, surface.st], axis=-1)
    return BakedRoom(surface, corners, caster, textures, white_level(light), room.seed, texels, light)
