"""Named light set-ups, placed in the room of a capture.

A capture that knows its windows and lamps (the built-in room) gets them lit. Any other gets a virtual window in the
free space beside what the cameras look at, and lamps above it; `survey` finds the places by ray casting.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import blackbody
from hyjax.light.kinds import AmbientLight, Aperture, DirectionalLight, PointLight, RectLight
from hyjax.light.kinds.directional import SUN_DEGREES
from hyjax.light.kinds.file_keys import direction
from hyjax.light.setup import LightSetup
from hyjax.scene.exposure import SeenSurface, exposed, warn_of_missing
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.vectors import perpendicular, reject, unit

Vector = Float[np.ndarray, "3"]
ASIDE = (0.35, -0.35, 0.0, 0.7, -0.7, 1.2, -1.2)
"""Tangents of the angles between the sun's direction and the window's normal, the usual one first."""
ENOUGH_SUN = 0.02
"""Share of the surface that is seen: a sun that falls on this much of it is left where it is."""


@dataclasses.dataclass(frozen=True)
class LightAnchors:
    """Places in a captured room that light can come from. Metres, world axes.

    Attributes:
        up: against gravity.
        focus: what the cameras look at.
        points: two places in free space, above what is looked at and nearer to the viewer.
        lamps: the room's own lamps; `points` where it has none.
        window: centre of a window.
        inward: unit normal of the window, into the room.
        width, height: of the window.
        seen: surface that the cameras see.
    """

    up: Vector
    focus: Vector
    points: list[Vector]
    lamps: list[Vector]
    window: Vector
    inward: Vector
    width: float
    height: float
    seen: SeenSurface


def survey(
    caster: RayCaster, cameras: Sequence[Camera], up: Vector, anchors: Mapping[str, Any] | None = None
) -> LightAnchors:
    """Find places for lights.

    Args:
        caster: the captured surface.
        cameras: a few, spread over the capture.
        up: unit vector against gravity.
        anchors: places the capture knows: `window_0` with center, normal, width, height, and `lamp_0`, `lamp_1`, …
            with position. What is missing is made up.

    Raises:
        InputError: no camera sees any surface.
    """
    seen, eye = SeenSurface.of(caster, cameras)
    focus = np.median(seen.points, axis=0)
    forward = _forward(focus - eye, up)
    anchors = anchors or {}
    points = _points(caster, focus, eye, forward, up)
    lamps = [np.asarray(v["position"], float) for k, v in sorted(anchors.items()) if k.startswith("lamp")] or points
    window = anchors.get("window_0")
    if window:
        center, inward = (np.asarray(window[k], float) for k in ("center", "normal"))
        return LightAnchors(up, focus, points, lamps, center, inward, window["width"], window["height"], seen)
    # Beside the view, on the side with more room, a head above what the cameras look at.
    middle = 0.5 * (focus + eye) + 0.4 * up
    sides = [unit(np.cross(forward, up)) * s for s in (1.0, -1.0)]
    free = [min(_free(caster, middle, side), 2.5) for side in sides]
    best = int(np.argmax(free))
    place = middle + 0.9 * free[best] * sides[best]
    return LightAnchors(up, focus, points, lamps, place, -sides[best], 1.6, 1.2, seen)


def survey_capture(caster: RayCaster, capture: Capture, anchors: Mapping[str, Any] | None = None) -> LightAnchors:
    """`survey` with cameras from the whole capture, so that its frames are lit alike however they are chosen.

    Args:
        caster: the captured surface.
        capture: its cameras, and places that it knows.
        anchors: places that are known in the place of the capture's own.
    """
    cameras = [capture.camera(i) for i in range(0, len(capture), -(-len(capture) // 8))]
    return survey(caster, cameras, capture.up, capture.anchors if anchors is None else anchors)


def noon_window(anchors: LightAnchors) -> LightSetup:
    """A bright day: sky and sun through the window."""
    sky = RectLight.filling(_window(anchors), 3200.0, blackbody(7000.0))
    sun = _through(anchors, (35.0, 30.0, 55.0), 900.0, blackbody(5600.0))
    return LightSetup((sky, AmbientLight(60.0, blackbody(6000.0)), sun), 200.0)


def golden_hour(anchors: LightAnchors) -> LightSetup:
    """Low warm sun."""
    sky = RectLight.filling(_window(anchors), 1000.0, blackbody(9000.0))
    sun = _through(anchors, (13.0, 10.0, 28.0), 700.0, blackbody(3000.0))
    return LightSetup((sky, AmbientLight(28.0, blackbody(4800.0)), sun), 200.0)


def evening_lamps(anchors: LightAnchors) -> LightSetup:
    """Lamps lit, blue dusk outside. The camera's white balance leaves of 2700 K what looks like 3600 K."""
    warm = blackbody(3600.0)
    lamps = [PointLight(lamp, 900.0, warm, radius=0.06, clearance=0.3) for lamp in anchors.lamps[:3]]
    dusk = RectLight.filling(_window(anchors), 120.0, blackbody(12000.0))
    return LightSetup((*lamps, dusk, AmbientLight(8.0, blackbody(4000.0))), 70.0)


def night_moon(anchors: LightAnchors) -> LightSetup:
    """Dark, with moonlight through the window; exposed as a camera at night would."""
    night = np.array([0.62, 0.8, 1.3])
    sky = RectLight.filling(_window(anchors), 7.0, night)
    moon = _through(anchors, (38.0, 30.0, 55.0), 4.0, np.array([0.8, 0.92, 1.15]))
    return LightSetup((sky, AmbientLight(0.15, night), moon), 2.5)


def center_point(anchors: LightAnchors) -> LightSetup:
    """The paper's first benchmark: one bright point in the middle of the room."""
    return LightSetup((PointLight(np.mean(anchors.points, axis=0), 9000.0, np.ones(3)),), 300.0)


def two_colors(anchors: LightAnchors) -> LightSetup:
    """The paper's second benchmark: two dim points of different colours."""
    colors = np.array([[1.0, 0.45, 0.2], [0.2, 0.5, 1.0]])
    points = [PointLight(point, 2500.0, color) for point, color in zip(anchors.points, colors, strict=True)]
    return LightSetup(tuple(points), 300.0)


SETUPS: dict[str, Callable[[LightAnchors], LightSetup]] = {
    "noon-window": noon_window,
    "golden-hour": golden_hour,
    "evening-lamps": evening_lamps,
    "night-moon": night_moon,
    "center-point": center_point,
    "two-colors": two_colors,
}


BENCHMARKS = ("center-point", "two-colors")
"""Set-ups of the paper, whose exposure is fixed."""


def check_setup_name(name: str) -> None:
    """Raise `InputError` unless `name` is one of `SETUPS`."""
    if name not in SETUPS:
        hint = did_you_mean(name, SETUPS)
        raise InputError(
            f"lights: no set-up {name!r}{hint}; there are {', '.join(SETUPS)}, or give a .yaml or .json file"
        )


def named_setup(name: str, anchors: LightAnchors) -> LightSetup:
    """One of `SETUPS`, placed in a room; a light that reaches nothing that the cameras see is told in the log.

    Raises:
        InputError: unknown name.
    """
    check_setup_name(name)
    setup = SETUPS[name](anchors)
    lux = anchors.seen.lux(setup.lights)
    if name not in BENCHMARKS:
        setup = dataclasses.replace(setup, reference_lux=exposed(setup, lux))
    warn_of_missing(setup, lux, name)
    # Converted by NumPy: every conversion of JAX's is a program of its own.
    lights = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), setup.lights))
    return LightSetup(lights, setup.reference_lux)


def _window(anchors: LightAnchors) -> Aperture:
    center = anchors.window + 0.01 * anchors.inward
    return Aperture.facing(center, anchors.inward, anchors.up, anchors.width, anchors.height)


def _through(
    anchors: LightAnchors, elevations: tuple[float, float, float], illuminance: float, color: Any
) -> DirectionalLight:
    """Parallel light that falls through the window onto what the cameras see.

    Args:
        anchors: the window.
        elevations: degrees above the horizon: the usual, the least and the most.
        illuminance: in lux.
        color: linear RGB.
    """
    usual, least, most = elevations
    window = _window(anchors)
    choices = [(aside, usual) for aside in ASIDE]
    choices += [(aside, height) for height in np.linspace(least, most, 5) for aside in ASIDE]
    shares = np.array([anchors.seen.sunlit(window, _travel(anchors, *choice)) for choice in choices])
    # The usual sun where it lands; the nearest to it that does, else.
    best = next((k for k, share in enumerate(shares) if share >= ENOUGH_SUN), int(np.argmax(shares)))
    travel = direction(_travel(anchors, *choices[best if shares[best] > 0 else 0]))
    return DirectionalLight(travel, illuminance, color, np.deg2rad(SUN_DEGREES), window)


def _travel(anchors: LightAnchors, aside: float, elevation: float) -> Vector:
    """Direction of a sun at `elevation` degrees, `aside` of the window's normal (tangent)."""
    angle = np.deg2rad(elevation)
    level = unit(anchors.inward + aside * np.cross(anchors.up, anchors.inward))
    return np.asarray(np.cos(angle) * level - np.sin(angle) * anchors.up)


def _points(caster: RayCaster, focus: Vector, eye: Vector, forward: Vector, up: Vector) -> list[Vector]:
    """Two places in free space: above what is looked at, and above and beside the viewer."""
    aside = unit(np.cross(forward, up))
    starts = [focus - 0.4 * forward + 0.3 * up, 0.5 * (focus + eye) - 0.2 * forward]
    shifts = [0.5 * up + 0.35 * aside, 0.6 * up - 0.9 * aside]
    return [
        start + unit(s) * min(np.linalg.norm(s), 0.7 * _free(caster, start, s)) for start, s in zip(starts, shifts)
    ]


def _free(caster: RayCaster, start: Vector, direction: Vector) -> float:
    """Metres from `start` to the first surface in `direction`."""
    return float(caster.cast(start[None], unit(direction)[None]).distance[0])


def _forward(vector: Vector, up: Vector) -> Vector:
    """The level direction of a vector; any level one if it runs along `up`."""
    level = reject(vector, up)
    return unit(level if np.linalg.norm(level) > 1e-6 else perpendicular(up))
