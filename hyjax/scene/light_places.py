"""Places for light sources in a captured room: the windows and lamps that it knows, or made-up ones along the walk.

A *stop* is a part of the walk: cameras that look at one place. Every stop has a lamp in free space and a window
that reaches what is seen there; a room that is seen from one spot is a single stop.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from hyjax.data.capture import Capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import Hits, RayCaster
from hyjax.light.kinds import Aperture, RectLight
from hyjax.photo_light.sources import Vector
from hyjax.scene.seen_surface import SeenSurface
from hyjax.util.vectors import fibonacci_sphere, perpendicular, reject, unit

SURVEY_CAMERAS = 24
"""Most cameras of a survey."""
STOP_DISTANCE = 4.0
"""Least distance, in metres, between the lamps of two stops of which one would light what is seen at the other."""
SAME_PLACE_SHARE = 0.5
"""Least share of what a camera sees that the lamp of a stop reaches for the camera to belong to it."""
LAMP_CLEARANCE = 1.0
"""Wanted distance, in metres, of a made-up lamp from any surface, which it would burn a spot into."""
CLEARANCE_WEIGHT = 3.0
"""Way, in metres, that a made-up lamp is moved for a metre of clearance that it lacks."""
KEPT_DISTANCE_SHARE = 0.7
"""Least share of their distance that two lamps keep when they are moved."""
CLEARANCE_RAYS = 200
"""Number of rays around a place that its distance from surfaces is found by."""
LAMP_SHIFTS = (np.linspace(-1.4, 1.4, 9), np.linspace(-1.4, 1.4, 9), np.linspace(-0.7, 0.7, 5))
"""Ways, in metres, that a made-up lamp is moved by to have it: ahead, aside and up."""
MOST_STOPS, MOST_WINDOWS = 8, 4
"""Most stops of a walk, and most windows that are made up along it."""
LAMP_REACH = 3.0
"""Largest distance, in metres, of a known lamp from where a stop would have its own."""
SHADE_RADIUS = 0.35
"""Radius around a known lamp, in metres, within which a surface is its own shade."""
LEAST_REACHED = 0.15
"""Least share of a stop's points that a known window must reach for the stop to need no other."""
WINDOW_WIDTH, WINDOW_HEIGHT = 1.6, 1.2
"""Size, in metres, of a window that is made up."""
WALL_DISTANCES = (0.6, 6.0)
"""Least and largest distance, in metres, of a wall for a window from the middle of a stop."""
LARGEST_RELIEF, RELIEF_RAYS = 0.25, 41
"""Largest height, in metres, of what stands out of a window's wall; number of rays along each side that find it."""
OUTER_DEPTH = (0.15, 3.0)
"""Depths, in metres, behind an outer wall between which nothing was scanned."""
LEAST_OPEN = 0.5
"""Least share of the seen surface with nothing above it for a place without walls to lie under the open sky."""
MOST_AROUND = 0.25
"""Largest share of directions in which something was scanned around an open place."""
AZIMUTHS = 16
"""Number of directions in which walls are looked for."""


@dataclasses.dataclass(frozen=True)
class WindowPlace:
    """Window of a room.

    Attributes:
        inward: unit normal, into the room.
        width, height: in metres.
        in_free_space: whether it is made up where no wall for it was found.
    """

    center: Vector
    inward: Vector
    width: float
    height: float
    in_free_space: bool = False

    def opening(self, up: Vector) -> Aperture:
        """Opening of the window, a centimetre inside its wall."""
        return Aperture.facing(self.center + 0.01 * self.inward, self.inward, up, self.width, self.height)


@dataclasses.dataclass(frozen=True)
class Stop:
    """Part of a walk: cameras that look at one place.

    Attributes:
        focus: median point of the surface that they see.
        eye: mean position of the cameras.
        lamp: place in free space above the focus, or near there, clear of surfaces.
        points: which points of the seen surface they see.
    """

    focus: Vector
    eye: Vector
    lamp: Vector
    points: Bool[np.ndarray, "n"]


@dataclasses.dataclass(frozen=True)
class LightAnchors:
    """Places for light sources in a captured room. Metres, world axes.

    Attributes:
        focus: median point of the visible surface.
        points: two places in free space, clear of surfaces, above the focus and nearer to the viewer.
        center: place in free space between the two, clear of surfaces.
        lamps: the room's own lamps, and those of the stops that have none; `points` where there is a single stop
            without any.
        windows: the room's own windows, and those of the stops that none of these reaches.
        made_up: places of the lamps and windows that are not the room's own.
        open_sky: whether light from outside comes from all around: no window is known, no wall for one was found,
            there is little around, and most of what is seen has nothing above it.
    """

    up: Vector
    focus: Vector
    points: list[Vector]
    center: Vector
    lamps: list[Vector]
    windows: list[WindowPlace]
    stops: list[Stop]
    seen: SeenSurface
    made_up: dict[str, list[Vector]]
    open_sky: bool


def survey(
    caster: RayCaster, cameras: Sequence[Camera], up: Vector, anchors: Mapping[str, Any] | None = None
) -> LightAnchors:
    """Find places for lights.

    Args:
        up: unit vector against gravity.
        anchors: places the capture knows: `window_0`, `window_1`, … with center, normal, width, height, and
            `lamp_0`, `lamp_1`, … with position. What is missing is made up.
    """
    seen, eyes = SeenSurface.of(caster, cameras, SURVEY_CAMERAS)
    given = anchors or {}
    # Two places for the whole capture, by few cameras: those of the paper's benchmarks.
    few, few_eyes = SeenSurface.of(caster, cameras)
    focus, eye = np.median(few.points, axis=0), few_eyes.mean(axis=0)
    viewer, pair = _nearest(few_eyes, eye), _points(caster, focus, eye, up)
    points = [_cleared(caster, pair[0], viewer, up)]
    least = KEPT_DISTANCE_SHARE * float(np.linalg.norm(pair[1] - pair[0]))
    points.append(_cleared(caster, pair[1], viewer, up, apart=(points[0], least)))
    center = _cleared(caster, np.mean(pair, axis=0), viewer, up)
    stops = _stops(caster, seen, eyes, up)
    names = sorted(given, key=lambda name: (len(name), name))  # window_2 before window_10
    lamps = [np.asarray(given[name]["position"], float) for name in names if name.startswith("lamp")]
    if lamps or len(stops) > 1:
        lamps += [stop.lamp for stop in stops if not _has_lamp(caster, stop, lamps)]
    windows = [_known_window(given[name]) for name in names if name.startswith("window")]
    own_lamps, own_windows = sum(name.startswith("lamp") for name in given), len(windows)
    dark = [stop for stop in stops if not _has_window(seen, stop, windows, up)]
    chosen = dark if len(dark) <= MOST_WINDOWS else dark[:: -(-len(dark) // MOST_WINDOWS)]
    if windows and len(stops) == 1:
        chosen = []
    windows += [_made_up_window(caster, seen, stop, up) for stop in chosen]
    if not lamps:
        lamps = points
    made_up = {"lamp": lamps[own_lamps:], "window": [window.center for window in windows[own_windows:]]}
    bare = all(window.in_free_space for window in windows) and seen.under_open_sky(up) >= LEAST_OPEN
    # A room whose ceiling was not scanned, in the middle of others, has nothing above and no outer wall.
    open_sky = bare and float(np.mean([_around(caster, stop, up)[2].hit.mean() for stop in stops])) < MOST_AROUND
    return LightAnchors(up, focus, points, center, lamps, windows, stops, seen, made_up, open_sky)


def survey_capture(caster: RayCaster, capture: Capture, anchors: Mapping[str, Any] | None = None) -> LightAnchors:
    """Survey with cameras from the whole capture, so that any choice of its frames is lit alike.

    Args:
        anchors: places that are known in the place of the capture's own.
    """
    cameras = [capture.camera(i) for i in range(0, len(capture), -(-len(capture) // SURVEY_CAMERAS))]
    return survey(caster, cameras, capture.up, capture.anchors if anchors is None else anchors)


def _stops(caster: RayCaster, seen: SeenSurface, eyes: Float[np.ndarray, "c 3"], up: Vector) -> list[Stop]:
    """Stops of the walk, in its order."""
    found: list[tuple[Vector, list[int]]] = []
    for camera, eye in enumerate(eyes):
        stop_points = seen.points[seen.camera == camera]
        if not len(stop_points):
            continue
        lamp = _points(caster, np.median(stop_points, axis=0), eye, up)[0]
        near = [n for n, (earlier, _) in enumerate(found) if _together(caster, earlier, lamp, stop_points)]
        if near:
            found[min(near, key=lambda n: float(np.linalg.norm(found[n][0] - lamp)))][1].append(camera)
        else:
            found.append((lamp, [camera]))
    stops = []
    for _, members in found[:: -(-len(found) // MOST_STOPS)]:
        chosen = np.isin(seen.camera, members)
        focus, eye = np.median(seen.points[chosen], axis=0), eyes[members].mean(axis=0)
        lamp = _cleared(caster, _points(caster, focus, eye, up)[0], _nearest(eyes[members], eye), up)
        stops.append(Stop(focus, eye, lamp, chosen))
    return stops


def _nearest(eyes: Float[np.ndarray, "c 3"], mean: Vector) -> Vector:
    """Eye of a camera: their mean may lie in a wall."""
    return eyes[np.argmin(np.linalg.norm(eyes - mean, axis=1))]


def _together(caster: RayCaster, place: Vector, lamp: Vector, seen: Float[np.ndarray, "n 3"]) -> bool:
    """Whether the lamp at a place would light what a camera sees, or its own lamp at least."""
    if np.linalg.norm(lamp - place) >= STOP_DISTANCE:
        return False
    hidden = caster.occluded(place, np.vstack([lamp, seen]) - place, 0.98)
    return bool(not hidden[0] or (~hidden[1:]).mean() >= SAME_PLACE_SHARE)


def _has_lamp(caster: RayCaster, stop: Stop, lamps: Sequence[Vector]) -> bool:
    for lamp in lamps:
        to = lamp - stop.lamp
        length = float(np.linalg.norm(to))
        before_shade = max(1.0 - SHADE_RADIUS / max(length, 1e-6), 0.0)
        if length < LAMP_REACH and not caster.occluded(stop.lamp[None], to[None], before_shade)[0]:
            return True
    return False


def _known_window(place: Mapping[str, Any]) -> WindowPlace:
    center, inward = (np.asarray(place[key], float) for key in ("center", "normal"))
    return WindowPlace(center, unit(inward), float(place["width"]), float(place["height"]))


def _has_window(seen: SeenSurface, stop: Stop, windows: Sequence[WindowPlace], up: Vector) -> bool:
    """Whether known windows light a good part of the surface seen at a stop."""
    lights = [RectLight.filling(window.opening(up), 1000.0, np.ones(3)) for window in windows]
    if not lights:
        return False
    lux = seen.chosen(stop.points).lux(lights).sum(axis=1)
    return bool((lux > 1.0).mean() > LEAST_REACHED)


def _made_up_window(caster: RayCaster, seen: SeenSurface, stop: Stop, up: Vector) -> WindowPlace:
    """Window in the outer wall from where it lights most of a stop evenly; in free space where there is no wall."""
    middle, rays, hits = _around(caster, stop, up)
    places = []
    for ray, distance, face in zip(rays, hits.distance, hits.face, strict=True):
        if not WALL_DISTANCES[0] < distance < WALL_DISTANCES[1]:
            continue
        normal = np.asarray(caster.arrays.face_normals[face], float)
        normal = normal if normal @ ray < 0 else -normal
        if abs(normal @ up) > 0.3 or normal @ ray > -0.3:
            continue
        inward = level_direction(normal, up)
        center = middle + (distance - 0.02) * ray
        behind = center - OUTER_DEPTH[0] * inward
        if _free(caster, behind, -inward) > OUTER_DEPTH[1]:
            place = WindowPlace(center, inward, WINDOW_WIDTH, WINDOW_HEIGHT)
            places.append(_before_relief(caster, place, up))
    if not places:  # beside the view, to the side with more room
        for side in rays[[AZIMUTHS // 4, 3 * AZIMUTHS // 4]]:
            reach = min(_free(caster, middle, side), 2.5)
            places.append(
                WindowPlace(middle + 0.9 * reach * side, -side, WINDOW_WIDTH, WINDOW_HEIGHT, in_free_space=True)
            )
    lights = [RectLight.filling(place.opening(up), 1000.0, np.ones(3)) for place in places]
    lux = seen.chosen(stop.points).lux(lights)
    return places[int(np.argmax(np.log(lux + 1.0).mean(axis=0)))]


def _before_relief(caster: RayCaster, window: WindowPlace, up: Vector) -> WindowPlace:
    """Window before all of its uneven wall, which would cut its light to patches."""
    opening, ticks = window.opening(up), np.linspace(-1.0, 1.0, RELIEF_RAYS)
    shares = np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2)
    middle, ways = window.center + LARGEST_RELIEF * window.inward, shares @ np.stack([opening.right, opening.up])
    starts = middle + ways[~caster.occluded(middle, ways, 1.0)]  # not in the next room
    distance = caster.cast(starts, np.broadcast_to(-window.inward, starts.shape)).distance
    relief = max(0.0, LARGEST_RELIEF - float(distance.min(initial=np.inf)))
    return dataclasses.replace(window, center=window.center + relief * window.inward)


def _around(caster: RayCaster, stop: Stop, up: Vector) -> tuple[Vector, Float[np.ndarray, "a 3"], Hits]:
    """Middle of a stop, level rays from it all around, the first ahead, and what they hit."""
    forward = level_direction(stop.focus - stop.eye, up)
    middle = 0.5 * (stop.focus + stop.eye)
    middle += min(0.4, 0.7 * _free(caster, middle, up)) * up
    angles = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    rays = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * np.cross(forward, up)
    return middle, rays, caster.cast(np.broadcast_to(middle, rays.shape), rays)


def _points(caster: RayCaster, focus: Vector, eye: Vector, up: Vector) -> list[Vector]:
    """Two places in free space: above the focus, and above and to the side of the viewer."""
    forward = level_direction(focus - eye, up)
    aside = unit(np.cross(forward, up))
    starts = [focus - 0.4 * forward + 0.3 * up, 0.5 * (focus + eye) - 0.2 * forward]
    shifts = [0.5 * up + 0.35 * aside, 0.6 * up - 0.9 * aside]
    return [
        start + unit(s) * min(np.linalg.norm(s), 0.7 * _free(caster, start, s)) for start, s in zip(starts, shifts)
    ]


def _cleared(
    caster: RayCaster, lamp: Vector, viewer: Vector, up: Vector, *, apart: tuple[Vector, float] | None = None
) -> Vector:
    """Place for a lamp, moved within the viewer's sight, over a surface, as far as its clearance is worth it.

    Args:
        apart: place of another lamp, and least distance from it, in metres.
    """
    if _clearances(caster, lamp[None])[0] >= LAMP_CLEARANCE:
        return lamp
    ahead = level_direction(lamp - viewer, up)
    shifts = np.stack(np.meshgrid(*LAMP_SHIFTS, indexing="ij"), -1).reshape(-1, 3)
    places = lamp + shifts @ np.stack([ahead, np.cross(ahead, up), up])
    places = places[~caster.occluded(viewer, places - viewer, 1.0)]
    places = places[caster.cast(places, np.broadcast_to(-up, places.shape)).hit]
    if apart is not None:
        places = places[np.linalg.norm(places - apart[0], axis=1) >= apart[1]]
    places = np.vstack([lamp, places])
    missing = np.maximum(LAMP_CLEARANCE - _clearances(caster, places), 0.0)
    return places[np.argmin(np.linalg.norm(places - lamp, axis=1) + CLEARANCE_WEIGHT * missing)]


def _clearances(caster: RayCaster, places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distance in metres from each place to the nearest surface, by rays all around, which miss what is thin."""
    rays = fibonacci_sphere(CLEARANCE_RAYS)
    starts = np.repeat(places, len(rays), axis=0)
    return caster.cast(starts, np.tile(rays, (len(places), 1))).distance.reshape(len(places), -1).min(axis=1)


def _free(caster: RayCaster, start: Vector, direction: Vector) -> float:
    """Distance in metres from `start` to the first surface in `direction`."""
    return float(caster.cast(start[None], unit(direction)[None]).distance[0])


def level_direction(vector: Vector, up: Vector) -> Vector:
    """Horizontal direction of a vector; any horizontal one if it runs along `up`."""
    level = reject(vector, up)
    return unit(level if np.linalg.norm(level) > 1e-6 else perpendicular(up))
