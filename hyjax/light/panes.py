"""Panes of windows in a frame: the pixels that show them."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.util.geometry import cross, dot, unit

PANE_UNLIT, PANE_LIT = 0.05, 0.1
"""Linear means of panes in the photos between which they turn from dark, where dark pixels before holes of the scan
are open, to bright, where bright ones are; and values between which a pixel of a dark pane becomes a bar."""
PANE_SLACK = 0.12
"""Distance before a pane, in metres, within which a scanned surface belongs to it: bars, blinds, noise."""
PANE_DARK, PANE_BRIGHT = 0.1, 0.3
"""Linear values of the photo between which a pixel of a pane begins to shine."""
MOST_BARS = 8
"""Largest number of bars of a pane in each direction, the two sides of its frame among them."""
NO_BAR = -1e3
"""Half width that stands for no bar."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Bars:
    """Bars of panes.

    Attributes:
        spans: of each pane, along its axes to the right and up: middle and half width of each bar, in metres from
            the centre; a half width of `NO_BAR` for none.
        recess: distance of the bars behind each pane, in metres.
    """

    spans: Float[Array, "n 2 b 2"]
    recess: Float[Array, "n"]

    @classmethod
    def none(cls, count: int) -> "Bars":
        """Bars of so many panes that have none."""
        return cls(jnp.zeros((count, 2, 0, 2)), jnp.zeros(count))


@jax.jit
def pane_shares(
    panes: Float[Array, "n 3 3"],
    bars: Bars,
    means: Float[Array, "n 3"],
    frame: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
) -> tuple[Float[Array, "n h w"], Float[Array, "n h w"]]:
    """Weight of each pane in each pixel, in [0, 1]; and how far the pixel belongs to its frame and bars.

    Args:
        depth: of the surface, infinite in its holes.
    """
    glass, openings = _covers(panes, bars, depth, pose, intrinsics)
    brightness = jnp.min(frame, axis=-1)
    bright = ramp(brightness, PANE_DARK, PANE_BRIGHT)
    dark = jnp.where(jnp.isfinite(depth), 0.0, 1.0 - ramp(brightness, PANE_UNLIT, PANE_LIT))
    lit = lit_degree(means)[:, None, None]
    return glass * (lit * bright + (1.0 - lit) * dark), openings - glass


@jax.jit
def open_shares(
    panes: Float[Array, "n 3 3"],
    bars: Bars,
    frame: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
) -> Float[Array, "n h w"]:
    """Share of each pane in each pixel, in [0, 1], where it is bright or the scan has a hole; see `pane_shares`."""
    shown = jnp.where(jnp.isfinite(depth), ramp(jnp.min(frame, axis=-1), PANE_DARK, PANE_BRIGHT), 1.0)
    return _covers(panes, bars, depth, pose, intrinsics)[0] * shown


def lit_degree(means: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Degree to which panes of such means are bright ones."""
    return ramp(jnp.min(means, axis=-1), PANE_UNLIT, PANE_LIT)


def _covers(
    panes: Float[Array, "n 3 3"],
    bars: Bars,
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
) -> tuple[Float[Array, "n h w"], Float[Array, "n h w"]]:
    """Share of each pane's glass in each pixel, and of its whole opening, with nothing before it."""
    ray, pixel = pixel_rays(depth.shape, pose, intrinsics)
    shares = []
    for (center, right, up), spans, recess in zip(panes, bars.spans, bars.recess, strict=True):
        normal = cross(right, up)
        slope = dot(ray, normal)
        distance = dot(center - pose[:3, 3], normal) / jnp.where(jnp.abs(slope) > 1e-9, slope, 1e-9)
        place = pose[:3, 3] + distance[..., None] * ray - center
        # Metres inside the border, over the width of a pixel there: a border without stairs.
        deeper = recess * jnp.sqrt(dot(normal, normal)) / jnp.where(slope < -1e-9, -slope, jnp.inf)
        behind = place + deeper[..., None] * ray
        border = [jnp.sqrt(dot(axis, axis)) - jnp.abs(dot(place, unit(axis))) for axis in (right, up)]
        beside = [
            jnp.abs(dot(behind, unit(axis)) - middle) - half
            for axis, across in zip((right, up), spans, strict=True)
            for middle, half in across
        ]
        width, free = pixel * jnp.maximum(distance, 1e-3), (distance > 0) & (slope < 0)
        free &= depth > distance - PANE_SLACK
        opening = jnp.minimum(*border)
        glass = functools.reduce(jnp.minimum, beside, opening)
        both = jnp.stack([glass, opening]) / width + 0.5
        shares.append(jnp.clip(both, 0.0, 1.0) * free)
    found = jnp.stack(shares, axis=1) if shares else jnp.zeros((2, 0, *depth.shape))
    return found[0], found[1]


def pixel_rays(
    shape: tuple[int, ...], pose: Float[Array, "4 4"], intrinsics: Float[Array, "3 3"]
) -> tuple[Float[Array, "h w 3"], Float[Array, ""]]:
    """Rays of unit depth, and width of a pixel at unit depth."""
    x, y = jnp.meshgrid(jnp.arange(shape[1]) + 0.5, jnp.arange(shape[0]) + 0.5)
    local = [(x - intrinsics[0, 2]) / intrinsics[0, 0], (y - intrinsics[1, 2]) / intrinsics[1, 1], jnp.ones_like(x)]
    ray = jnp.stack([sum(pose[i, k] * local[k] for k in range(3)) for i in range(3)], axis=-1)
    return ray, 1.0 / intrinsics[0, 0]


def ramp(x: Float[Array, "*s"], low: float, high: float) -> Float[Array, "*s"]:
    """Smooth step from 0 at `low` to 1 at `high`."""
    t = jnp.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
