"""Bars of windows, from the photos: where they divide the glass, and how deep they stand in the opening.

A window's frame and bars reflect the light of the room, and stay where they are while the view moves behind them.
In pictures brought onto their plane they are straight edges along the window's sides, at the same places in all
frames; on any other plane they are blurred.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hyjax.core.finite import finite_or_zero
from hyjax.data.capture import Frame
from hyjax.data.frames import shrink, spread
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import WHITE, to_linear
from hyjax.light.gbuffer import GBuffer
from hyjax.light.panes import MOST_BARS, NO_BAR, PANE_SLACK, Bars, open_shares
from hyjax.photo_light.sources import PhotoWindow
from hyjax.util.cache import Arrays

SURFACE_WIDTH = 320
"""Longer side, in pixels, at which the surface before windows is seen."""
MEAN_FRAMES = 12
"""Number of frames for the means of panes."""
STEP = 0.01
"""Metres between points across an edge."""
EDGE_POINTS = 24
"""Points along each edge."""
RECESSES = np.arange(0.0, 0.25, 0.03)
"""Distances in metres of the frame behind the wall that are tried."""
EDGE_CONTRAST = 0.02
"""Display value by which the picture changes at an edge."""
EDGE_SHARE = 0.6
"""Share of an edge's points at which it is seen, in the mean of the frames."""
PEAK_SHARE = 0.3
"""Share of the largest change within a bar from which another is a side of it, and no noise."""
SEEN_SHARE = 0.3
"""Share of an edge's points that a frame must see to count for it."""
WIDEST_BAR, NARROWEST_BAR = 0.14, 0.02
"""Metres; what is wider is no bar but a blind, or the edge of something behind."""
WIDEST_FRAME, LARGEST_RIM = 0.15, 0.3
"""Largest width, in metres, of the outermost bars, the frame itself, and as a share of the window's half."""
BEYOND = 1.0
"""Distance in metres beyond the opening to which the frame counts."""
LEAST_COSINE, LARGEST_PIXEL = 0.25, 0.02
"""Cosine of the view onto a window, and width in metres of a pixel on it, beyond which a picture shows no bars."""
LEAST_BASELINE = 0.2
"""Extent in metres of the cameras that see an edge: from one place, what lies outside stands still, too."""


def pane_arrays(windows: Sequence[PhotoWindow], frames: Sequence[Frame], caster: RayCaster) -> Arrays:
    """Bars of windows, and the mean radiance of their panes in the frames.

    Returns:
        `bar_spans` and `bar_recess`, see `Bars`, and `pane_means`, linear.
    """
    seeing = [frame for frame in frames if any(shows(window, frame) for window in windows)]
    small = [shrink(frame, SURFACE_WIDTH) for frame in seeing]
    gbuffers = [caster.gbuffer(frame.camera) for frame in small]
    bars = window_bars(windows, list(zip(seeing, gbuffers, strict=True)))
    panes = np.array([(w.center, w.right, w.up) for w in windows], np.float32).reshape(-1, 3, 3)
    total, weight = np.zeros((len(windows), 3)), np.full(len(windows), 1e-6)
    for frame, gbuffer in spread(list(zip(small, gbuffers, strict=True)), MEAN_FRAMES):
        linear = finite_or_zero(to_linear(jnp.asarray(frame.image)))
        camera = (jnp.asarray(m, jnp.float32) for m in (frame.camera.pose, frame.camera.intrinsics.matrix))
        for number, share in enumerate(open_shares(jnp.asarray(panes), bars, linear, gbuffer.open_depth, *camera)):
            total[number] += np.einsum("hw,hwc->c", share, linear)
            weight[number] += float(share.sum())
    means = np.where((weight > 1.0)[:, None], total / weight[:, None], WHITE).astype(np.float32)
    return {"bar_spans": np.asarray(bars.spans), "bar_recess": np.asarray(bars.recess), "pane_means": means}


def window_bars(windows: Sequence[PhotoWindow], views: Sequence[tuple[Frame, GBuffer]]) -> Bars:
    """Bars of windows as frames show them; none where too few frames see a window.

    Args:
        views: frames with the surface that they see, of any size.
    """
    spans, recesses = np.zeros((len(windows), 2, MOST_BARS, 2), np.float32), np.zeros(len(windows), np.float32)
    spans[..., 1] = NO_BAR
    for which, window in enumerate(windows):
        seeing = [(frame, gbuffer) for frame, gbuffer in views if shows(window, frame) and _resolves(window, frame)]
        pictures = [
            (frame, np.nan_to_num(frame.image.mean(-1), posinf=0.0, neginf=0.0), gbuffer)
            for frame, gbuffer in seeing
        ]
        found = [[_edges(window, axis, recess, pictures) for axis in (0, 1)] for recess in RECESSES]
        best = int(np.argmax([sum(float((shares**3).sum()) for shares, _ in edges) for edges in found]))
        for axis, (side, edges) in enumerate(zip((window.right, window.up), found[best], strict=True)):
            for number, (first, last) in enumerate(_bars(float(np.linalg.norm(side)), edges)):
                spans[which, axis, number] = (first + last) / 2, (last - first) / 2
        recesses[which] = RECESSES[best]
    most = int((spans[..., 1] != NO_BAR).sum(axis=-1).max(initial=0))
    return Bars(jnp.asarray(spans[:, :, :most]), jnp.asarray(recesses))


def shows(window: PhotoWindow, frame: Frame) -> bool:
    """Whether a frame shows some of a window, from the room."""
    camera, k = frame.camera, frame.camera.intrinsics
    if (camera.origin - window.center) @ window.normal <= 0:
        return False
    x, y, z = ((window.corners - camera.origin) @ camera.pose[:3, :3]).T
    x, y = k.fx * x + k.cx * z, k.fy * y + k.cy * z
    # Out of view are those of which all corners lie beyond one side of it.
    return all((side > 0).any() for side in (x, k.width * z - x, y, k.height * z - y))


def _resolves(window: PhotoWindow, frame: Frame) -> bool:
    """Whether a frame looks straight enough at a window, and from near enough, to show its bars."""
    away = frame.camera.origin - window.center
    distance = float(np.linalg.norm(away))
    cosine = float(away @ window.normal) / distance
    return cosine > LEAST_COSINE and distance / frame.camera.intrinsics.fx / cosine < LARGEST_PIXEL


def _places(half: float) -> Float[np.ndarray, "n"]:
    """Places across a window of which edges are looked for, metres from its middle."""
    return np.arange(-half - 2 * STEP, half + 2 * STEP, STEP)


def _edges(
    window: PhotoWindow,
    axis: int,
    recess: float,
    pictures: Sequence[tuple[Frame, Float[np.ndarray, "h w"], GBuffer]],
) -> Float[np.ndarray, "2 n"]:
    """Share of the points along the other axis at which the pictures change at each place of one, and by how much.

    Both are means of the frames.
    """
    along, across = (window.right, window.up) if axis == 0 else (window.up, window.right)
    half = float(np.linalg.norm(along))
    places = _places(half)
    total, count = np.zeros((2, len(places))), np.zeros(len(places))
    nearest, farthest = (np.full((len(places), 3), sign * np.inf) for sign in (1, -1))
    lines = np.linspace(-0.95, 0.95, EDGE_POINTS)
    points = window.center - recess * window.normal
    points = points + places[:, None, None] * (along / half) + lines[:, None] * across
    for frame, picture, gbuffer in pictures:
        values, seen = _seen(points, window, recess, frame, picture, gbuffer)
        change, valid = np.abs(values[2:] - values[:-2]), seen[2:] & seen[:-2]
        points_seen = valid.sum(axis=1)
        counts = points_seen >= SEEN_SHARE * EDGE_POINTS
        for row, of_points in enumerate((change > EDGE_CONTRAST, change)):
            total[row, 1:-1] += np.where(counts, (of_points * valid).sum(axis=1) / np.maximum(points_seen, 1), 0.0)
        count[1:-1] += counts
        eye = np.where(counts[:, None], frame.camera.origin, np.nan)
        nearest[1:-1], farthest[1:-1] = np.fmin(nearest[1:-1], eye), np.fmax(farthest[1:-1], eye)
    # Without the edge of the opening itself: that is sharpest on the plane of the wall.
    counted = (count > 0) & (np.abs(places) < half - 2 * STEP)
    counted[counted] = np.linalg.norm(farthest[counted] - nearest[counted], axis=1) >= LEAST_BASELINE
    return np.where(counted, total / np.maximum(count, 1), 0.0)


def _seen(
    points: Float[np.ndarray, "n m 3"],
    window: PhotoWindow,
    recess: float,
    frame: Frame,
    picture: Float[np.ndarray, "h w"],
    gbuffer: GBuffer,
) -> tuple[Float[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """Values of a picture at points of a window's frame, and whether nothing stands before them."""
    from scipy import ndimage  # SciPy is slow to load

    camera, (height, width) = frame.camera, picture.shape
    pixels, depth = camera.project(points)
    x, y = np.moveaxis(pixels, -1, 0)
    inside = (depth > 0.1) & (x >= 0.5) & (x < width - 0.5) & (y >= 0.5) & (y < height - 0.5)
    x, y = (np.where(inside, c, 0.5) for c in (x, y))
    values = ndimage.map_coordinates(picture, [y - 0.5, x - 0.5], order=1, mode="nearest")
    hit, seen_depth = np.asarray(gbuffer.hit), np.asarray(gbuffer.depth)
    scale = hit.shape[0] / height
    pixel = tuple(np.minimum(c * scale, n - 1).astype(int) for c, n in zip((y, x), hit.shape, strict=True))
    away = camera.origin - window.center
    slack = (PANE_SLACK + recess) / max(float(away @ window.normal) / float(np.linalg.norm(away)), LEAST_COSINE)
    free = np.where(hit, seen_depth, np.inf)[pixel] > depth - slack
    return values, inside & free


def _bars(half: float, edges: Float[np.ndarray, "2 n"]) -> list[tuple[float, float]]:
    """First and last place of each bar across an axis, from `_edges`, the outermost ones being the frame's."""
    places, (shares, change) = _places(half), edges
    change = np.where(shares > EDGE_SHARE, change, 0.0)
    low, high, width = -half, half, min(WIDEST_FRAME, LARGEST_RIM * half)
    inner: list[tuple[float, float]] = []
    if (side := np.where(places < width - half, change, 0.0)).any():
        low = float(places[side.argmax()])
    if (side := np.where(places > half - width, change, 0.0)).any():
        high = float(places[side.argmax()])
    if low > -half or high < half:  # a frame is as wide on the side where it is not seen
        low, high = (low if low > -half else -high), (high if high < half else -low)
    frame = [(-half - BEYOND, low), (high, half + BEYOND)] if low > -half else []
    inside = np.flatnonzero((change > 0) & (places > low + NARROWEST_BAR) & (places < high - NARROWEST_BAR))
    for run in np.split(inside, np.flatnonzero(np.diff(places[inside]) > WIDEST_BAR) + 1) if len(inside) else []:
        first, last = _outermost(places[run[0] : run[-1] + 1], change[run[0] : run[-1] + 1])
        if NARROWEST_BAR <= last - first <= WIDEST_BAR:
            inner.append((first, last))
    return frame + inner if len(frame) + len(inner) <= MOST_BARS else frame


def _outermost(places: Float[np.ndarray, "n"], change: Float[np.ndarray, "n"]) -> tuple[float, float]:
    """First and last place where the change is largest nearby."""
    around = np.pad(change, 1)
    peaks = (change >= around[:-2]) & (change >= around[2:]) & (change >= PEAK_SHARE * change.max())
    found = places[peaks]
    return float(found[0]), float(found[-1])
