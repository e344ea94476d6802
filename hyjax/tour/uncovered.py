"""Uncovered surface: what the photo of a frame does not show once furniture has moved, from pixels of other frames.

A pixel is drawn anew where the furnished room has another surface than the scanned one. Its point is followed to
where it was scanned, found in frames that saw it there, and their pixels are divided by the light that they were
taken under. Where the scan has a hole, the planes of floor, walls and ceiling go on. What no frame saw is grey, and
so are meshes that were brought in.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import to_linear
from hyjax.light.gbuffer import GBuffer
from hyjax.light.photo_light import on_pixels
from hyjax.light.setup import LightSetup
from hyjax.scene.relighter import configured_light
from hyjax.tour.arrangement import Arrangement
from hyjax.tour.furniture import Plane
from hyjax.tour.layers import lit_surface
from hyjax.tour.picture import enlarged
from hyjax.util.errors import InputError

LEAST_UNSEEN = 0.02
"""Share of what furniture uncovers, that no photo shows, from which it is said."""
GREY = 0.18
"""Linear value, under the light of the photo, of what no frame saw."""
LEAST_STEP = 0.02
"""Metres between places of the scan in a pixel from which they are two."""
SAME_WEIGHT = 1e-4
"""Difference of the weights of a triangle's corners up to which two places in it are one."""
MARGIN = 1 / 200
"""Width, over that of the picture, of the rim that is drawn anew, too: edges of photo and scan differ."""
MOST_FRAMES = 6
"""Most frames that pixels are taken of."""
RANKED_POINTS = 1000
"""Most points, spread over all, by which frames are ranked."""
ROW = 4096
"""Pixels of a row that is lit at once."""
SLACK, OFFSET = 1.03, 0.03
"""Factor on the depth of a pixel, and metres, within which it shows a point."""
STEP = 0.1
"""Share of its depth by which a neighbour of a pixel is nearer from which it may show that, too."""


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """A frame as pixels are taken of it: linear colours, and the depth up to which a pixel shows what is there."""

    picture: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]

    @classmethod
    def of(cls, read: Callable[[], Frame], caster: RayCaster) -> "Source | None":
        """Source of a frame that shows a scan; None if it cannot be read.

        Where the scan has a step, the nearer side takes a rim.
        """
        try:
            frame = read()
        except InputError:  # told when the frame is shown
            return None
        seen = caster.gbuffer(frame.camera)
        depth = np.where(np.asarray(seen.hit), np.asarray(seen.depth), np.inf)
        nearest = ndimage.minimum_filter(depth, 1 + 2 * max(1, round(MARGIN * depth.shape[1])))
        own = np.where(nearest < (1.0 - STEP) * depth, nearest, depth)
        return cls(np.asarray(to_linear(jnp.asarray(frame.image))), SLACK * own + OFFSET)


def with_uncovered(
    relit: Float[Array, "h w 3"],
    place: Arrangement,
    setup: LightSetup,
    camera: Camera,
    planes: Sequence[Plane],
    cameras: Mapping[int, Camera],
    source: Callable[[int], Source | None],
) -> tuple[Float[Array, "h w 3"], bool]:
    """Relit picture where what the photo does not show is drawn, and whether some of that was never seen.

    Args:
        camera: of the frame, at the size that it is drawn at, the picture's or a part of it.
        planes: on which the surface goes on.
        cameras: of the frames that pixels may be taken of, by number.
        source: see `seen_elsewhere`.
    """
    now = place.gbuffer(camera)
    chosen = uncovered_pixels(now, place.scanned(camera), place.caster)
    brought = np.asarray(now.hit) & (np.asarray(now.face) < 0)
    now = extend_planes(now, chosen, camera, planes)
    chosen &= np.asarray(now.hit)
    scanned = ~brought[chosen]
    if not chosen.any():
        return relit, False
    light = None
    if place.knows_photo_light:
        light = configured_light(place.surface_light(setup), place.configuration)
    color, seen = seen_elsewhere(*scanned_points(now, chosen, place.caster), cameras, source)
    rows = rows_of_pixels(now, chosen)
    shown = np.zeros((len(rows) * ROW, 3), np.float32)
    shown[: len(color)] = np.where((seen & scanned)[:, None], color, np.nan)
    lit = []
    for row, colors in zip(rows, shown.reshape(-1, 1, ROW, 3), strict=True):
        divisor = 1.0 if light is None else on_pixels(light.photo_light, light.faces, row)
        reflectance = np.where(np.isnan(colors), np.float32(GREY), colors / divisor)
        shaded = place.shade_surface(row, setup, light)
        lit.append(np.asarray(lit_surface(shaded, reflectance, setup.reference_lux))[0])
    drawn = np.zeros((*chosen.shape, 3), np.float32)
    drawn[chosen] = np.concatenate(lit)[: len(color)]
    picture = jnp.where(enlarged(chosen[..., None], relit.shape), enlarged(drawn, relit.shape), relit)
    return picture, bool((~seen & scanned).mean() > LEAST_UNSEEN)


def uncovered_pixels(now: GBuffer, scanned: GBuffer, caster: RayCaster) -> Bool[np.ndarray, "h w"]:
    """Pixels that show another place of the scan than when the room was scanned, or none of it, with a rim."""
    hit, was_hit = np.asarray(now.hit), np.asarray(scanned.hit)
    of_scan = hit & was_hit & (np.asarray(now.face) >= 0)
    changed = (hit | was_hit) & ~of_scan
    first, second, _ = np.moveaxis(np.abs(np.asarray(now.barycentric) - np.asarray(scanned.barycentric)), -1, 0)
    alike = (np.asarray(now.face) == np.asarray(scanned.face)) & (first < SAME_WEIGHT) & (second < SAME_WEIGHT)
    other = of_scan & ~alike
    points, _ = scanned_points(now, other, caster)
    changed[other] = np.linalg.norm(points - np.asarray(scanned.position)[other], axis=1) > LEAST_STEP
    return ndimage.binary_dilation(changed, iterations=max(1, round(MARGIN * changed.shape[1])))


def extend_planes(
    now: GBuffer,
    chosen: Bool[np.ndarray, "h w"],
    camera: Camera,
    planes: Sequence[Plane],
) -> GBuffer:
    """Surface whose holes, where they are chosen, show the nearest of some planes.

    Args:
        chosen: pixels.
    """
    holes = chosen & ~np.asarray(now.hit)
    if not planes or not holes.any():
        return now
    normals, places = np.array([plane.normal for plane in planes]), np.array([plane.place for plane in planes])
    rays = camera.rays()[holes]
    toward = rays @ normals.T
    with np.errstate(divide="ignore"):
        depth = np.where(toward < 0, (places - normals @ camera.origin) / toward, np.inf)
    depth = np.where(depth > 0, depth, np.inf)
    first = depth.argmin(axis=1)
    nearest = depth.min(axis=1)
    met = np.isfinite(nearest)
    holes[holes] = met
    arrays = {name: np.array(getattr(now, name)) for name in ("position", "normal", "depth", "hit")}
    arrays["position"][holes] = camera.origin + nearest[met, None] * rays[met]
    arrays["normal"][holes], arrays["depth"][holes] = normals[first[met]], nearest[met]
    arrays["hit"] |= holes
    return dataclasses.replace(now, **jax.device_put(arrays))


def rows_of_pixels(gbuffer: GBuffer, chosen: Bool[np.ndarray, "h w"]) -> list[GBuffer]:
    """Chosen pixels in rows of one length, so that one size is compiled for; misses fill the last one up."""
    pixels = np.flatnonzero(chosen)
    rows = np.zeros((-(-len(pixels) // ROW), ROW), int)
    rows.reshape(-1)[: len(pixels)] = pixels
    filled = np.arange(rows.size).reshape(rows.shape) < len(pixels)

    def row(number: int) -> GBuffer:
        taken = jax.tree.map(lambda x: np.asarray(x).reshape(-1, *x.shape[2:])[rows[number][None]], gbuffer)
        return dataclasses.replace(taken, hit=taken.hit & filled[number])

    return [row(number) for number in range(len(rows))]


def scanned_points(
    now: GBuffer, chosen: Bool[np.ndarray, "h w"], caster: RayCaster
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Points of chosen pixels, with their normals, where they were when the room was scanned."""
    face, weights = np.asarray(now.face)[chosen], np.asarray(now.barycentric, float)[chosen]
    points, normals = (np.asarray(array, float)[chosen] for array in (now.position, now.normal))
    of_scan = face >= 0
    corners = np.asarray(caster.arrays.faces)[face[of_scan]]
    points[of_scan] = np.einsum("nk,nkc->nc", weights[of_scan], np.asarray(caster.arrays.vertices, float)[corners])
    normals[of_scan] = np.asarray(caster.arrays.face_normals, float)[face[of_scan]]
    return points, normals


def seen_elsewhere(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    cameras: Mapping[int, Camera],
    source: Callable[[int], Source | None],
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, "n"]]:
    """Linear colours of points of the scan in the frames that see them best, and whether any does.

    Args:
        source: a frame by its number; None if it cannot be read, and the next is taken.
    """
    total, weight, left = np.zeros((len(points), 3)), np.zeros(len(points)), MOST_FRAMES
    few = slice(None, None, max(1, -(-len(points) // RANKED_POINTS)))

    def worth_of(number: int) -> float:
        return float(np.sqrt(_views(points[few], normals[few], cameras[number])[-1]).sum())

    for number in sorted(cameras, key=worth_of, reverse=True):
        if not left:
            break
        inside, places, depth, worth = _views(points, normals, cameras[number])
        if not worth.any() or (of := source(number)) is None:
            continue
        left -= 1
        rows, columns = np.round(places).astype(int).T
        shown = (depth < of.depth[rows, columns]) & (worth > 0)
        chosen, places, worth = inside[shown], places[shown], worth[shown]
        colors = [ndimage.map_coordinates(of.picture[..., k], places.T, order=1) for k in range(3)]
        total[chosen] += worth[:, None] * np.stack(colors, axis=-1)
        weight[chosen] += worth
    seen = weight > 0
    return total / np.where(seen, weight, 1.0)[:, None], seen


def _views(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], camera: Camera
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m 2"], Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Points that a camera has in view: their numbers, rows and columns, depths, and how well it sees them."""
    pixels, depth = camera.project(points)
    far = np.array(camera.intrinsics.shape[::-1]) - 0.5
    inside = np.flatnonzero((depth > 0) & ((pixels > 0.5) & (pixels < far)).all(axis=1))
    to = camera.origin - points[inside]
    distance = np.maximum(np.linalg.norm(to, axis=1), 0.1)
    slope = np.abs(np.einsum("nk,nk->n", normals[inside], to)) / distance
    # To a power: the best frame rules, and the next take over gradually.
    return inside, pixels[inside, ::-1] - 0.5, depth[inside], (slope / distance) ** 4
