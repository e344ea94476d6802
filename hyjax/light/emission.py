"""Emitters in a frame: window panes and lamps, which show the new sky or bulb.

Their pixels are not a surface that light falls on. A pane shows the sky that the new lights put there, bright at
noon and dark at night, patterned as the photo's was; a lamp that is off is white in the light of the room.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from hyjax.core.finite import finite_or_zero
from hyjax.core.upsampling import guided_upsample
from hyjax.light.color import WHITE
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.panes import PANE_SLACK, Bars, lit_degree, pane_shares, pixel_rays, ramp
from hyjax.util.geometry import TINY, dot
from hyjax.util.tracing import concrete

PANE_REFLECTANCE, LAMP_REFLECTANCE = 0.04, 0.6
FRAME_REFLECTANCE = 0.8
"""Share of light that frames and bars of windows reflect at most: in the photo the sky beside burns them out."""
PANE_SHARE = 0.4
"""Brightness of the view through a pane over the mean light that it lets in: the horizon is darker than the sky
above. Chosen on two of the rooms that `experiments.truth` chooses on."""
PANE_WHITE = 0.75
"""Linear value that the mean of a pane stays below, unless it was brighter in the photos: exposed for the room,
a view would burn out with all that is in it."""
SOURCE_RADIUS = 0.1
"""Distance from a source, in metres, within which a new light makes it shine."""
LAMP_DARK, LAMP_BRIGHT = 0.75, 1.09
"""Linear values of the photo between which a pixel of a lamp begins to shine."""
LAMP_REACH = 1.5
"""Distance from a lamp's middle, in its radii, up to which bright pixels belong to it."""
CORE_EXPONENT = 4
"""Power of the share by which a pixel of a lamp shines, for what is brighter than white."""
RIM_WIDTH = 640
"""Width of a picture, in pixels, for each pixel of a lamp's rim."""
BORDER_WIDTH = 0.05
"""Width, in metres, of the soft border around a source."""
SURFACE_KAPPA = 0.05
"""κ by which a surface is brought to the size of a picture, in display values."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Emitters:
    """Panes and lamps of a place, with their radiance under new lights.

    Attributes:
        panes: centre, half-axis to the right and half-axis up of each pane.
        bars: of the panes, which do not shine.
        lamps: position and radius of each lamp.
        sent: radiance times π of panes, then lamps, as a filter: 1 stands for white in the photo's mean light.
        kept: remaining factor of the light that each sent when the photo was taken.
        mean: K, see `hyjax.light.photo_light.PhotoLight`.
        pane_means: linear mean of each pane in the photos.
    """

    panes: Float[Array, "n 3 3"]
    bars: Bars
    lamps: Float[Array, "m 4"]
    sent: Float[Array, "k 3"]
    kept: Float[Array, "k 3"]
    mean: Float[Array, "3"]
    pane_means: Float[Array, "n 3"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Emission:
    """Pixels that emit.

    Attributes:
        weight: how far a pixel belongs to a source, in [0, 1].
        sent: emitted light, linear.
        reflectance: share of the incident light that it shows, in units of a white surface's picture.
        frame_light: least light of the photo at pixels of windows' frames and bars, over its mean; 0 elsewhere.
    """

    weight: Float[Array, "h w 1"]
    sent: Float[Array, "h w 3"]
    reflectance: Float[Array, "h w 3"]
    frame_light: Float[Array, "h w 3"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class SourcePixels:
    """Pixels of a frame that belong to panes and lamps, independent of their radiance.

    Attributes:
        weight: how far a pixel belongs to a source, in [0, 1].
        source: which one, panes first; -1 for none.
        pattern: of its light, relative to its mean; of a lamp, how far the photo's pixel is burnt out.
        framed: how far a pixel belongs to the frame or the bars of a window.
    """

    weight: Float[Array, "h w 1"]
    source: Int[Array, "h w"]
    pattern: Float[Array, "h w 3"]
    framed: Float[Array, "h w 1"]


def radiant_filter(
    lights: Sequence[Light],
    panes: Float[np.ndarray, "n 3 3"],
    lamps: Float[np.ndarray, "m 4"],
    reference_lux: float,
) -> Float[np.ndarray, "k 3"]:
    """Radiance of panes and lamps under new lights, times π over the reference illuminance.

    Args:
        lights: a rectangle in a pane's opening, or a bulb within a lamp, makes it shine.
    """
    sent = np.zeros((len(panes) + len(lamps), 3))
    for light in lights:
        if type(light).emitter is Light.emitter:
            continue  # of a kind without a known shape
        emitter, color = light.emitter(), np.asarray(light.color)
        if emitter is None:
            continue
        if emitter.kind == "rect":
            area = 4 * np.linalg.norm(np.cross(np.asarray(emitter.right), np.asarray(emitter.up)))
            for k, (center, right, up) in enumerate(panes):
                away = emitter.position - center
                normal = np.cross(right, up)
                off = abs(away @ normal) / np.linalg.norm(normal)
                if off < SOURCE_RADIUS and abs(away @ right) <= right @ right and abs(away @ up) <= up @ up:
                    sent[k] += emitter.strength / area * color
        elif emitter.kind in ("point", "spot"):
            for k, (*place, radius) in enumerate(lamps):
                if np.linalg.norm(emitter.position - place) < radius + SOURCE_RADIUS:
                    sent[len(panes) + k] += emitter.strength / (4 * np.pi * radius**2) * color
        elif emitter.kind == "sky":
            sent[: len(panes)] += emitter.strength * color
    return sent / reference_lux


def may_show(
    emitters: Emitters,
    size: tuple[int, int],
    pose: Float[ArrayLike, "4 4"],
    intrinsics: Float[ArrayLike, "3 3"],
) -> bool:
    """Whether a camera can have a pane or a lamp in its picture; true for traced arguments."""
    known = [concrete(x) for x in (emitters.panes, emitters.lamps, pose, intrinsics)]
    if any(x is None for x in known):
        return True
    panes, lamps, pose, k = (np.asarray(x, np.float64) for x in known)
    h, w = size
    # Inward normals of the four sides of what the camera sees, in its own axes.
    (fx, _, cx), (_, fy, cy) = k[:2]
    sides = np.array([[fx, 0, cx], [-fx, 0, w - cx], [0, fy, cy], [0, -fy, h - cy]])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    signs = np.array([(1, a, b) for a in (-1, 1) for b in (-1, 1)])
    corners = np.einsum("sk,nkd->nsd", signs, panes)
    lit = [(p[None, :3], LAMP_REACH * p[3] + BORDER_WIDTH) for p in lamps]
    for points, radius in [(pane, BORDER_WIDTH) for pane in corners] + lit:
        inside = (points - pose[:3, 3]) @ pose[:3, :3] @ sides.T > -radius
        if inside.any(axis=0).all():
            return True
    return False


@jax.jit
def emission(
    emitters: Emitters,
    frame: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
) -> Emission:
    """Pixels of a view that emit, see `source_pixels`."""
    frame = finite_or_zero(frame)
    return shine(emitters, source_pixels(emitters, frame, depth, pose, intrinsics), frame)


@functools.partial(jax.jit, static_argnames="factor")
def upscaled_depth(
    gbuffer: GBuffer, full: Float[Array, "fh fw 3"], display: Float[Array, "h w 3"], *, factor: int
) -> Float[Array, "fh fw"]:
    """Depth of a surface, infinite in its holes, at the size of a picture `factor` times larger, and under it.

    Args:
        full: the picture, display-encoded.
        display: the same at the G-buffer's size.
    """
    nearness = jnp.where(gbuffer.hit, 1.0 / jnp.where(gbuffer.hit, gbuffer.depth, 1.0), 0.0)
    seen = jnp.stack([gbuffer.hit.astype(nearness.dtype), nearness], axis=-1)
    hit, nearness = jnp.moveaxis(guided_upsample(seen, factor, full, SURFACE_KAPPA, coarse=display), -1, 0)
    return jnp.where(hit > 0.5, hit / jnp.maximum(nearness, TINY), jnp.inf)


@jax.jit
def shine(emitters: Emitters, pixels: SourcePixels, frame: Float[Array, "h w 3"]) -> Emission:
    """Emission of the pixels of panes and lamps under new lights."""
    sent, reflectance, weight = jnp.zeros_like(frame), jnp.zeros_like(frame), pixels.weight
    shares = [PANE_REFLECTANCE] * len(emitters.panes) + [LAMP_REFLECTANCE] * len(emitters.lamps)
    count, light = len(emitters.panes), emitters.sent * emitters.mean
    light = jnp.concatenate([_view_light(light[:count], emitters.pane_means), light[count:]])
    for k, share in enumerate(shares):  # a few; gathering from a table takes longer
        here = pixels.source[..., None] == k
        own = light[k] * pixels.pattern if k < count else _bulb_light(light[k], pixels.pattern)
        sent = jnp.where(here, own + emitters.kept[k] * frame, sent)
        # The kept part of the photo holds its reflections, too.
        reflected = share * emitters.mean * jnp.maximum(1.0 - emitters.kept[k], 0.0)
        reflectance = jnp.where(here, reflected, reflectance)
        if k >= count:  # a lamp that goes on has the photo's soft rim
            lit = jnp.clip(jnp.max(light[k]), 0.0, 1.0) * jnp.clip(1.0 - jnp.max(emitters.kept[k]), 0.0, 1.0)
            weight = jnp.where(here, weight * (1.0 + lit * (pixels.pattern[..., :1] - 1.0)), weight)
    # White paint at most, lit by the sky beside it. Not where panes shine on: their frames are the photo's, too.
    framed = pixels.framed * jnp.all(emitters.kept[:count] == 0)
    return Emission(weight, sent, reflectance, framed * frame / (FRAME_REFLECTANCE * emitters.mean))


@jax.jit
def source_pixels(
    emitters: Emitters,
    frame: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    pose: Float[Array, "4 4"],
    intrinsics: Float[Array, "3 3"],
) -> SourcePixels:
    """Pixels of a view that belong to panes and lamps.

    Args:
        emitters: of the place; where they are, not what they send.
        frame: the photo, linear.
        depth: of the surface, infinite in its holes; what lies before a pane hides it.
        pose: camera-to-world.
        intrinsics: calibration matrix.
    """
    ray, pixel = pixel_rays(depth.shape, pose, intrinsics)
    weight, pattern = jnp.zeros(depth.shape), jnp.ones((*depth.shape, 3))
    source = jnp.full(depth.shape, -1)
    panes = emitters.panes, emitters.bars, emitters.pane_means
    glass, framed = pane_shares(*panes, frame, depth, pose, intrinsics)
    shares = list(glass)
    # A dark lamp's rim is mixed with what lies behind it, and would stay as a bright ring.
    brightness, rim = jnp.min(frame, axis=-1), 2 * -(-frame.shape[1] // RIM_WIDTH) + 1
    burnt = ramp(brightness, LAMP_DARK, LAMP_BRIGHT)[..., None]
    for window in ((rim, 1), (1, rim)):
        brightness = jax.lax.reduce_window(brightness, -jnp.inf, jax.lax.max, window, (1, 1), "SAME")
    for *place, radius in emitters.lamps:
        toward = jnp.stack(place) - pose[:3, 3]
        along = dot(toward, ray) / dot(ray, ray)
        away = jnp.sqrt(jnp.maximum(dot(toward, toward) - along**2 * dot(ray, ray), 1e-12))
        cover = jnp.clip((LAMP_REACH * radius - away) / (pixel * jnp.maximum(along, 1e-3)) + 0.5, 0.0, 1.0)
        cover *= (along > 0) & (depth > along - 2 * radius - PANE_SLACK)
        shares.append(cover * ramp(brightness, LAMP_DARK, LAMP_BRIGHT))
    for k, share in enumerate(shares):
        shown = burnt
        if k < len(emitters.panes):
            mean = emitters.pane_means[k]
            shown = 1.0 + lit_degree(mean) * (frame / jnp.maximum(mean, 1e-3) - 1.0)  # of a dark pane, an even sky
        largest = (share > 0) & (share >= weight)  # of equals the later one: lamps stand before panes
        weight = jnp.maximum(weight, share)
        source = jnp.where(largest, k, source)
        pattern = jnp.where(largest[..., None], shown, pattern)
    return SourcePixels(weight[..., None], source, pattern, jnp.max(framed, axis=0, initial=0.0)[..., None])


def _bulb_light(light: Float[Array, "3"], burnt: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """Light of a lamp's pixels: beyond white at its core alone, or its rim would burn out, too."""
    white = jnp.minimum(light, WHITE)
    return white + (light - white) * burnt**CORE_EXPONENT


def _view_light(light: Float[Array, "n 3"], means: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Mean of the view through each pane by the light that comes in; a shoulder holds it below white."""
    light, white = PANE_SHARE * light, jnp.maximum(means, PANE_WHITE)
    return jnp.where(2 * light < white, light, white * (1.0 - 0.5 * jnp.exp(1.0 - 2 * light / white)))
