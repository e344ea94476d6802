"""Guide of a video: a network runs on every n-th frame, and its features move with the surface in between."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.core.refine import FILLING_PRESET, cascade_known
from hyjax.core.schedule import Schedule
from hyjax.light.view import View
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete
from hyjax.video.temporal_filter import Memory, fill_depth, recall

LEAST_FOUND_SHARE = 0.6
"""Least share of a frame's points seen before; with fewer the network runs again."""


@dataclasses.dataclass
class CarriedGuide:
    """Features of a video's frames, computed every few frames and carried along the surface in between.

    Example:
        carried = CarriedGuide(every=4)
        for view in views:
            features = carried.features(view, lambda: guide.features(view.display))

    Attributes:
        every: number of frames per run of the network.
        memory: features of the last frame of the network; None before the first.
    """

    every: int
    memory: Memory | None = None
    _age: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.every, bool) or not isinstance(self.every, int) or self.every < 1:
            raise InputError(f"every: must be a whole number of 1 or more, got {shown(self.every)}")

    @checked_arguments
    def features(self, view: View, make: Callable[[], Float[Array, "h w f"]]) -> Float[Array, "h w f"]:
        """Features of the next frame.

        Args:
            view: of the frame, with its pose and intrinsics.
            make: computes them.

        Raises:
            InputError: the view has no pose or no intrinsics.
        """
        if view.pose is None or view.intrinsics is None:
            raise InputError("video: the view needs the camera's pose and intrinsics")
        camera = jnp.asarray(view.pose, jnp.float32), jnp.asarray(view.intrinsics, jnp.float32)
        schedule = Schedule.preset(FILLING_PRESET)
        depth = fill_depth(view.gbuffer, view.display, schedule)
        self._age += 1
        if self.memory is not None and self._age < self.every and self.memory.depth.shape == depth.shape:
            carried, found = recall(self.memory, depth, *camera)
            seen = concrete(jnp.mean(found))
            if seen is not None and seen >= LEAST_FOUND_SHARE:
                filled = cascade_known(carried, found[..., None], view.display, schedule)
                return jnp.where(found[..., None], carried, filled)
        features, self._age = make(), 0
        self.memory = Memory(features, depth, *camera, ())
        return features
