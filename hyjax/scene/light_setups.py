"""Named light set-ups, placed in the room of a capture and exposed for it.

A capture that knows its windows and lamps (the built-in room) gets them lit. Any other gets virtual ones along its
walk, whose places `hyjax.scene.light_places` finds by ray casting.
"""

import dataclasses
import itertools
import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.color import blackbody
from hyjax.light.kinds import AmbientLight, DirectionalLight, Light, PointLight, RectLight, SkyLight
from hyjax.light.kinds.directional import SUN_DEGREES
from hyjax.light.kinds.file_keys import direction
from hyjax.light.photo_light import PhotoLight
from hyjax.light.setup import LightSetup
from hyjax.scene.exposure import LARGEST_FILTER, Exposure, bounded, exposed, warn_of_missing
from hyjax.scene.light_places import LightAnchors, Vector, WindowPlace
from hyjax.scene.light_response import assumed_response, measured_response
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.files import is_file
from hyjax.util.programs import run_kept
from hyjax.util.vectors import unit

SUN_TANGENTS = (0.35, -0.35, 0.0, 0.7, -0.7, 1.2, -1.2)
"""Tangents of candidate angles between the sun's direction and the first window's normal, the default first."""
LEAST_SUNLIT_SHARE = 0.02
"""Least sunlit share of the surface in a picture for the sun to count as shown."""
LEAST_SUN_COSINE = 0.3
"""Least cosine of the sun's angle of incidence where a surface counts as sunlit: a grazing sun hardly shows."""
ENOUGH_SUNLIT_RATIO = 0.6
"""Number of pictures with sun, over that of the best sun, from which the more usual sun is kept."""
MOST_SUNS = 3
"""Most windows that the sun shines through."""
MOST_LAMPS = 12
LAMP_LUMENS = 900.0
NOON_SKY, EVENING_SKY, DUSK_SKY, NIGHT_SKY = 950.0, 300.0, 36.0, 2.1
"""Lumens of a square metre of window by noon, by a low sun, at dusk and at night."""
OPEN_SKY_SHARE = 0.25
"""Lux of an open sky for a lumen of a square metre of window: beside the open sun it is darker than in a room."""
LOW_SUN, SUNSET_SKY = 3000.0, 4500.0
"""Colour temperatures of a low sun, and of the sky and ground around it in a window."""
EXPOSURES = {
    "noon-window": Exposure(0.85, 0.3, 1.8, day=True),
    "golden-hour": Exposure(0.6, 0.2, 1.8),
    "evening-lamps": Exposure(0.6, 0.2, 2.0),
    "night-moon": Exposure(0.1, 0.035, 0.6),
}
"""Exposures of the named set-ups, but for those of the paper."""
PAPER_LUX, PAPER_SHARE = 300.0, 0.25
"""Reference of the paper's set-ups, in lux; share of a reference that the median picture gets in its place."""
LEAST_PAPER_SHARE, MOST_DARK_SHARE = 0.02, 0.25
"""Share of the reference below which a picture is dark, and the most pictures that may be."""
DARK_SETUPS = ("night-moon",)
"""Set-ups that are meant to be dark."""
SAME_PLACE = 0.02
"""Distance, in metres, of a light from the place that it was given."""
_log = logging.getLogger(__name__)


def noon_window(anchors: LightAnchors) -> LightSetup:
    """Bright day: sky and sun through the windows."""
    sun = _sun(anchors, (35.0, 30.0, 55.0), 900.0, _hue(5600.0))
    return LightSetup((*_sky(anchors, NOON_SKY, _hue(7000.0)), AmbientLight(60.0, _hue(6000.0)), *sun))


def golden_hour(anchors: LightAnchors) -> LightSetup:
    """Low warm sun."""
    sun = _sun(anchors, (13.0, 10.0, 28.0), 700.0, _hue(LOW_SUN))
    sky = _sky(anchors, EVENING_SKY, _hue(SUNSET_SKY))
    return LightSetup((*sky, AmbientLight(28.0, _hue(4200.0)), *sun))


def evening_lamps(anchors: LightAnchors) -> LightSetup:
    """Lit lamps, blue dusk outside. With the camera's white balance 2700 K looks like 4000 K."""
    warm = _hue(4000.0)
    lamps = [
        PointLight(place, LAMP_LUMENS, warm, radius=0.06, clearance=0.3) for place in anchors.lamps[:MOST_LAMPS]
    ]
    return LightSetup((*lamps, *_sky(anchors, DUSK_SKY, _hue(12000.0)), AmbientLight(8.0, _hue(4300.0))))


def night_moon(anchors: LightAnchors) -> LightSetup:
    """Dark room with moonlight through the windows, exposed as by a camera at night."""
    night = np.array([0.62, 0.8, 1.3])
    moon = _sun(anchors, (38.0, 30.0, 55.0), 4.0, np.array([0.8, 0.92, 1.15]))
    return LightSetup((*_sky(anchors, NIGHT_SKY, night), AmbientLight(0.15, night), *moon))


def center_point(anchors: LightAnchors) -> LightSetup:
    """First benchmark of the paper: one bright point in the middle of the room."""
    return LightSetup((PointLight(anchors.center, 9000.0, np.ones(3)),), PAPER_LUX)


def two_colors(anchors: LightAnchors) -> LightSetup:
    """Second benchmark of the paper: two dim points of different colours."""
    colors = np.array([[1.0, 0.45, 0.2], [0.2, 0.5, 1.0]])
    points = [PointLight(point, 2500.0, color) for point, color in zip(anchors.points, colors, strict=True)]
    return LightSetup(tuple(points), PAPER_LUX)


SETUPS: dict[str, Callable[[LightAnchors], LightSetup]] = {
    "noon-window": noon_window,
    "golden-hour": golden_hour,
    "evening-lamps": evening_lamps,
    "night-moon": night_moon,
    "center-point": center_point,
    "two-colors": two_colors,
}


def check_setup_name(name: str) -> None:
    """Raise `InputError` unless `name` is one of `SETUPS`."""
    if name not in SETUPS:
        if is_file(name):
            raise InputError(f"lights: {name}: a file of lights must end in .yaml or .json")
        hint = did_you_mean(name, SETUPS)
        raise InputError(
            f"lights: no set-up {name!r}{hint}; there are {', '.join(SETUPS)}, or give a .yaml or .json file"
        )


def named_setup(name: str, anchors: LightAnchors, photo: PhotoLight | None = None) -> LightSetup:
    """Place one of `SETUPS` in a room and expose it; a light that reaches no visible surface is logged.

    Args:
        photo: light of the photos where it is divided out; None where it is kept.
    """
    check_setup_name(name)
    setup = SETUPS[name](anchors)
    lux = anchors.seen.lux(setup.lights)
    if name in EXPOSURES:
        seen, lights = anchors.seen, setup.lights
        answer = assumed_response(lights, lux, seen) if photo is None else measured_response(lights, seen, photo)
        setup = exposed(setup, lux, seen, EXPOSURES[name], answer)
    else:
        setup, lux = _not_dark(setup, lux, anchors)
        if photo is not None:
            setup = bounded(setup, lux, anchors.seen, measured_response(setup.lights, anchors.seen, photo))
    warn_of_missing(setup, lux, name)
    return _on_device(setup)


def placed_setup(name: str, anchors: LightAnchors) -> LightSetup:
    """One of `SETUPS` in a room, not exposed for it: lights of the places that `named_setup` gives them."""
    check_setup_name(name)
    setup = SETUPS[name](anchors)
    if name not in EXPOSURES:
        setup, _ = _not_dark(setup, anchors.seen.lux(setup.lights), anchors)
    return _on_device(setup)


def tell_made_up(name: str, anchors: LightAnchors, lights: Sequence[Light]) -> None:
    """Log the places of a set-up's lights that are made up."""
    centers = {
        "lamp": [np.asarray(light.position) for light in lights if isinstance(light, PointLight)],
        "window": [np.asarray(light.center) for light in lights if isinstance(light, RectLight)],
    }
    texts = []
    for kind, places in anchors.made_up.items():
        used = [p for p in places if any(np.linalg.norm(p - center) < SAME_PLACE for center in centers[kind])]
        if used:
            at = ", ".join("({:.1f}, {:.1f}, {:.1f})".format(*place) for place in used)
            texts.append(f"{kind}{'s' * (len(used) > 1)} at {at}")
    if anchors.open_sky and any(isinstance(light, SkyLight) for light in lights):
        _log.warning(
            "%s: no wall for a window was found, and little is above; light from outside comes from an open sky",
            name,
        )
    if texts:
        made_up = " and ".join(texts)
        _log.warning("%s: made up: %s; if yours are elsewhere, give them with --photo-sources FILE", name, made_up)


def _hue(kelvin: float) -> Float[Array, "3"]:
    return run_kept(blackbody, np.float32(kelvin))


def _on_device(setup: LightSetup) -> LightSetup:
    # Converted by NumPy: every conversion of JAX's is a program of its own.
    lights = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), setup.lights))
    return LightSetup(lights, setup.reference_lux)


def _not_dark(
    setup: LightSetup, lux: Float[np.ndarray, "n l"], anchors: LightAnchors
) -> tuple[LightSetup, Float[np.ndarray, "n l"]]:
    """Set-up of the paper and its `lux`: one light a stop, exposed for them, where it leaves many pictures dark."""
    seen = anchors.seen
    lights: tuple[Any, ...] = tuple(setup.lights)
    if (seen.of_cameras(lux.sum(axis=1)) < LEAST_PAPER_SHARE * PAPER_LUX).mean() <= MOST_DARK_SHARE:
        return setup, lux
    if len(anchors.stops) > 1:
        pairs = zip(anchors.stops, itertools.cycle(lights))
        lights = tuple(dataclasses.replace(light, position=stop.lamp) for stop, light in pairs)
        lux = seen.lux(lights)
    every = lux.sum(axis=1)
    median, bright = np.median(seen.of_cameras(every)), np.quantile(every, 0.95)
    least = max(float(bright) / LARGEST_FILTER, LEAST_PAPER_SHARE * PAPER_LUX)
    return LightSetup(lights, max(float(median) / PAPER_SHARE, least)), lux


def _sky(anchors: LightAnchors, exitance: float, color: Any) -> list[Light]:
    """Sky in all windows, `exitance` lumens a square metre; an open sky gives a share of that from all around."""
    if anchors.open_sky:
        return [SkyLight(direction(anchors.up), OPEN_SKY_SHARE * exitance, color)]
    return [
        RectLight.filling(window.opening(anchors.up), exitance * window.width * window.height, color)
        for window in anchors.windows
    ]


def _sun(
    anchors: LightAnchors, elevations: tuple[float, float, float], illuminance: float, color: Any
) -> list[DirectionalLight]:
    """Parallel light through the windows, or from the open sky, from where it falls into many pictures.

    Its elevations are in degrees above the horizon: the usual, the least and the most.
    """
    usual, least, most = elevations
    radius = np.deg2rad(SUN_DEGREES)
    choices = [(aside, usual) for aside in SUN_TANGENTS]
    choices += [(aside, height) for height in np.linspace(least, most, 5) for aside in SUN_TANGENTS]
    found = []
    for first in anchors.windows:
        for choice in choices:
            travel = _travel(anchors.up, first.inward, *choice)
            found.append((travel, *_sunlit(anchors, travel)))
        if len(anchors.windows) > 1 and max(pictures for _, pictures, _ in found) > 0:
            break  # the others only where no sun through the first one shows
    most_pictures = max(pictures for _, pictures, _ in found)
    # The usual sun where it lands; the nearest to it that does, else.
    travel, _, lit = next(each for each in found if each[1] >= ENOUGH_SUNLIT_RATIO * most_pictures)
    if anchors.open_sky:
        return [DirectionalLight(direction(travel), illuminance, color, radius)]
    best_first = sorted(lit, key=lambda each: -each[0])[:MOST_SUNS]
    through = [window for share, window in best_first if share > 0] or [anchors.windows[0]]
    return [
        DirectionalLight(direction(travel), illuminance, color, radius, window.opening(anchors.up))
        for window in through
    ]


def _sunlit(anchors: LightAnchors, travel: Vector) -> tuple[int, list[tuple[float, WindowPlace]]]:
    """Number of pictures that show parallel light along `travel`, and windows with the share that it lights."""
    seen, shares = anchors.seen, list[tuple[float, WindowPlace]]()
    facing = seen.normals @ travel < -LEAST_SUN_COSINE
    every = facing & seen.reached_along(travel) if anchors.open_sky else np.zeros(len(seen.points), bool)
    for window in () if anchors.open_sky else anchors.windows:
        if travel @ window.inward < 0.1:
            continue
        lit = seen.reached_through(window.opening(anchors.up), travel)
        every |= facing & lit
        shares.append((float(lit.mean()), window))
    pictures = [every[seen.camera == camera].mean() >= LEAST_SUNLIT_SHARE for camera in np.unique(seen.camera)]
    return sum(pictures), shares


def _travel(up: Vector, inward: Vector, aside: float, elevation: float) -> Vector:
    """Direction of a sun at `elevation` degrees, `aside` of a window's normal (tangent)."""
    angle = np.deg2rad(elevation)
    level = unit(inward + aside * np.cross(up, inward))
    return np.asarray(np.cos(angle) * level - np.sin(angle) * up)
