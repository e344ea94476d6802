"""Temporal filter: an exponential mean of refined light along the surface, against flicker.

The guide is a camera's picture, noisy and never twice the same, and so is what it lets through; a mesh is fixed in
the world, and so is the light on it as long as no lamp moves. So each pixel's surface point is looked up in the
last frame, and where it was seen there, its refined light is averaged with what it was: an exponential mean over
the frames, along the surface instead of along the pixels.

Holes have no surface to look up. Their depth is filled as their light is, by diffusion under the guide.

Source of the reprojection: Nehab et al., *Accelerating real-time shading with reverse reprojection caching*, 2007;
Yang et al., *A survey of temporal antialiasing techniques*, 2020.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.core.refine import cascade_known
from hyjax.core.schedule import Schedule
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.setup import REFERENCE_LUX, LightSetup, same_setup
from hyjax.light.view import View
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

KEEP_WEIGHT = 0.8
"""Weight of the last frame. An error is down to a tenth after ten frames."""
SAME_DEPTH = 0.05
"""Largest relative difference of depth between two frames at the same point."""
LEAST_WEIGHT = 1e-3
"""Least weight of the bilinear neighbours on the same surface; below it a point was not seen."""
LEAST_FOUND_SHARE = 0.1
"""Least share of pixels found again; below it the camera has jumped, and all starts anew."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Memory:
    """Memory of one frame's refined light, kept for the next.

    Attributes:
        channels: refined lux and visibility of each light.
        depth: metres along the camera's axis, filled in holes; 0 where nothing is known.
        pose: camera-to-world.
        intrinsics: of the camera, as `Intrinsics.matrix`.
        lights: that the channels belong to.
        reference_lux, existing: of the set-up, see `LightSetup`.
    """

    channels: Float[Array, "h w c"]
    depth: Float[Array, "h w"]
    pose: Float[Array, "4 4"]
    intrinsics: Float[Array, "3 3"]
    lights: tuple[Light, ...]
    reference_lux: float = REFERENCE_LUX
    existing: Mapping[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)


@checked_arguments
def fill_depth(gbuffer: GBuffer, guide: Float[Array, "h w f"], schedule: Schedule | str) -> Float[Array, "h w"]:
    """Fill depth, in metres, in holes from their surroundings; 0 if no pixel has any.

    The diffused quantity is 1/depth, which on a plane is linear in the picture.
    """
    return _fill_depth(gbuffer, guide, Schedule.of(schedule))


@jax.jit
def _fill_depth(gbuffer: GBuffer, guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w"]:
    hit = gbuffer.hit
    inverse = jnp.where(hit, 1.0 / jnp.where(hit, gbuffer.depth, 1.0), 0.0)[..., None]
    filled = cascade_known(inverse, hit[..., None], guide, schedule)[..., 0]
    return jnp.where(hit, gbuffer.depth, jnp.where(filled > 0, 1.0 / jnp.where(filled > 0, filled, 1.0), 0.0))


@checked_arguments
@jax.jit
def recall(
    memory: Memory, depth: Float[Array, "h w"], pose: Float[Array, "4 4"], intrinsics: Float[Array, "3 3"]
) -> tuple[Float[Array, "h w c"], Bool[Array, "h w"]]:
    """Sample an earlier frame's light at this frame's surface points.

    Args:
        memory: of that frame.
        depth: of this one, see `fill_depth`.
        pose: of this one's camera.
        intrinsics: likewise.

    Returns:
        (channels, found): bilinear samples of the memory, of those neighbours that lie on the same surface; and
        whether that frame saw the point at all.
    """
    h, w = depth.shape
    x, y = jnp.meshgrid(jnp.arange(w) + 0.5, jnp.arange(h) + 0.5)
    local = [
        (x - intrinsics[0, 2]) / intrinsics[0, 0] * depth,
        (y - intrinsics[1, 2]) / intrinsics[1, 1] * depth,
        depth,
    ]
    # From this camera straight to that one's: coordinates stay small, whatever the world's.
    turn = memory.pose[:3, :3].T @ pose[:3, :3]
    shift = memory.pose[:3, :3].T @ (pose[:3, 3] - memory.pose[:3, 3])
    there = [sum(turn[i, k] * local[k] for k in range(3)) + shift[i] for i in range(3)]
    z, then = there[2], memory.intrinsics
    ahead = (depth > 0) & (z > 0)
    scale = 1.0 / jnp.where(ahead, z, 1.0)
    column = there[0] * scale * then[0, 0] + then[0, 2] - 0.5
    row = there[1] * scale * then[1, 1] + then[1, 2] - 0.5
    rows, columns = memory.depth.shape
    inside = ahead & (row >= -0.5) & (row <= rows - 0.5) & (column >= -0.5) & (column <= columns - 0.5)
    top, left = (
        jnp.clip(jnp.floor(at), 0.0, n - 1).astype(jnp.int32) for at, n in ((row, rows), (column, columns))
    )
    down, right = row - top, column - left
    total, weights = jnp.zeros((h, w, memory.channels.shape[-1])), jnp.zeros((h, w))
    flat, depths = memory.channels.reshape(rows * columns, -1), memory.depth.reshape(-1)
    for below, beside in itertools.product((0, 1), repeat=2):
        pixel = jnp.minimum(top + below, rows - 1) * columns + jnp.minimum(left + beside, columns - 1)
        share = (down if below else 1.0 - down) * (right if beside else 1.0 - right)
        # A neighbour across a silhouette is another surface, whose light must not bleed into this one's.
        share = jnp.where(jnp.abs(depths[pixel] - z) < SAME_DEPTH * z, jnp.maximum(share, 0.0), 0.0)
        total, weights = total + share[..., None] * flat[pixel], weights + share
    found = inside & (weights > LEAST_WEIGHT)
    return total / jnp.where(found, weights, 1.0)[..., None], found


@checked_arguments
@jax.jit
def steady(
    channels: Float[Array, "h w c"],
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
    memory: Memory,
    keep: Float[ArrayLike, ""] = KEEP_WEIGHT,
) -> Float[Array, "h w c"]:
    """Average a frame's channels with the last frame's at the same surface points.

    Args:
        channels: refined, of this frame.
        depth: see `recall`.
        pose: see `recall`.
        intrinsics: see `recall`.
        memory: of the last frame, of the same channels.
        keep: share of the last frame, 0 to below 1.

    Returns:
        Points that the last frame did not see as they were given; all of them if it saw hardly any.
    """
    kept, count = memory.channels.shape[-1], channels.shape[-1]
    if kept != count:
        raise InputError(f"channels: {count} of this frame, {kept} in the memory; they must be as many")
    before, found = recall(memory, depth, pose, intrinsics)
    usable = (found & (jnp.mean(found) >= LEAST_FOUND_SHARE))[..., None] & jnp.isfinite(before)
    mean = jnp.where(jnp.isfinite(channels), channels + keep * (before - channels), before)
    return jnp.where(usable, mean, channels)


def remembers(memory: Memory | None, shape: tuple[int, ...], lights: LightSetup | Sequence[Light] | Light) -> bool:
    """Whether a memory is of frames of this size under the same set-up."""
    if memory is None or memory.channels.shape != shape:
        return False
    return same_setup(LightSetup(memory.lights, memory.reference_lux, memory.existing), LightSetup.of(lights))


@dataclasses.dataclass
class Video:
    """Temporal filter of a video, for `relight(temporal_filter=...)`.

    Example:
        video = Video()
        for view in views:
            temporal_filter = video.filter(view, lights, guide, schedule)
            relit = hyjax.relight(view, view.shade(lights), guide, schedule, temporal_filter=temporal_filter)

    Attributes:
        keep: share of the last frame, 0 to below 1.
        memory: of the last frame; None before the first. A frame of another size or under another set-up starts
            anew.
    """

    keep: float = KEEP_WEIGHT
    memory: Memory | None = None

    def __post_init__(self) -> None:
        if isinstance(self.keep, bool) or not isinstance(self.keep, int | float) or not 0 <= self.keep < 1:
            raise InputError(f"keep: must lie in [0, 1), got {shown(self.keep)}")

    @checked_arguments
    def filter(
        self,
        view: View,
        lights: LightSetup | Sequence[Light] | Light,
        guide: Float[Array, "h w f"],
        schedule: Schedule | str,
    ) -> Callable[[Array, Array], tuple[Array, Array]]:
        """Return a function that filters the next frame's refined illuminance and visibility, and remembers them.

        Args:
            view: of the next frame, with its pose and intrinsics.
            lights: that it is shaded by.
            guide: see `fill_depth`.
            schedule: see `fill_depth`.

        Raises:
            InputError: the view has no pose or no intrinsics.
        """
        if view.pose is None or view.intrinsics is None:
            raise InputError("video: the view needs the camera's pose and intrinsics")
        camera = jnp.asarray(view.pose, jnp.float32), jnp.asarray(view.intrinsics, jnp.float32)
        setup = LightSetup.of(lights)

        def filtered(illuminance: Array, visibility: Array) -> tuple[Array, Array]:
            channels, count = jnp.concatenate([illuminance, visibility], axis=-1), illuminance.shape[-1]
            depth = fill_depth(view.gbuffer, guide, schedule)
            memory = self.memory
            if memory is not None and remembers(memory, channels.shape, setup):
                channels = steady(channels, depth, *camera, memory, self.keep)
            # Nothing traced outlives its trace, and a dark frame is not worth keeping.
            lit = concrete(jnp.any(illuminance != 0))
            if lit is not None and lit:
                self.memory = Memory(
                    channels, depth, *camera, tuple(setup.lights), setup.reference_lux, dict(setup.existing)
                )
            return channels[..., :count], channels[..., count:]

        return filtered
