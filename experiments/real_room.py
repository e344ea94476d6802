"""Pair of pictures of a generated room under two lights, through a camera with an S-curve."""

import numpy as np
from jaxtyping import Float

from hyjax.data.relit_pairs import RelitPair
from hyjax.data.truth_room import load_truth_room
from hyjax.geometry.raycast import RayCaster
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings, parse_size
from hyjax.util.errors import InputError

SETUP = "evening-lamps"
CURVE = 0.6
"""Strength of the S-curve: 0 leaves display values as they are, 1 is a smoothstep."""


def s_curve(display: Float[np.ndarray, "h w 3"], strength: float = CURVE) -> Float[np.ndarray, "h w 3"]:
    """Display values through a camera that darkens shadows and lifts lights."""
    x = np.clip(display, 0.0, 1.0)
    return (1 - strength) * x + strength * x * x * (3 - 2 * x)


def room_pair(name: str, size: str, quality: float = 1.0) -> RelitPair:
    """Pair of a room's first photo and its true picture under other lights.

    Args:
        name: of the room, see `hyjax.synthetic.truth.lit_room`.
        size: width x height.
        quality: of the room's light and textures.

    Raises:
        InputError: no such room, or no size.
    """
    shape = parse_size(size)
    if shape is None:
        raise InputError("room-size: give width x height")
    capture = load_truth_room(name, 2, shape[1], shape[0], quality=quality)
    frame = capture[0]
    setup = Scene.open(SceneSettings(), capture=capture).lights(SETUP)
    truth = capture.truth(setup, [0])[0]
    reference = capture.reference()
    assert reference is not None
    seen = RayCaster(reference).gbuffer_by_rays(frame.camera)
    depth = np.where(np.asarray(seen.hit), np.asarray(seen.depth), 0.0).astype(np.float32)
    pictures = s_curve(np.asarray(frame.image)), s_curve(np.asarray(truth))
    return RelitPair(capture.name, pictures, frame.camera, depth, frame.camera)
