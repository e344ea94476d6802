"""Named set-ups, placed in whatever room a capture shows.

A capture that knows its windows and lamps (the built-in room) gets them lit. Any other gets a virtual window in the
free space beside what the cameras look at, and lamps above it; `survey` finds the places by ray casting.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture
from hyjax.data.frames import spread
from hyjax.data.light_file import LightSetup, parse_lights
from hyjax.errors import InputError, did_you_mean
from hyjax.scene.camera import Camera
from hyjax.scene.raycast import RayCaster

Vector = Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True)
class Stage:
    """Where light can come from in a captured room. Metres, world axes.

    Attributes:
        up: against gravity.
        focus: what the cameras look at.
        points: two places in free space, above what is looked at and nearer to the viewer.
        lamps: the room's own lamps; `points` where it has none.
        window: centre of a window.
        inward: unit normal of the window, into the room.
        width, height: of the window.
    """

    up: Vector
    focus: Vector
    points: list[Vector]
    lamps: list[Vector]
    window: Vector
    inward: Vector
    width: float
    height: float


def survey(
    caster: RayCaster, cameras: Sequence[Camera], up: Vector, anchors: dict[str, dict[str, Any]] | None = None
) -> Stage:
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
    focus, eye = _focus(caster, cameras)
    forward = _unit(_level(focus - eye, up))
    anchors = anchors or {}
    points = _points(caster, focus, eye, forward, up)
    lamps = [np.asarray(v["position"], float) for k, v in sorted(anchors.items()) if k.startswith("lamp")] or points
    window = anchors.get("window_0")
    if window:
        center, inward = (np.asarray(window[k], float) for k in ("center", "normal"))
        return Stage(up, focus, points, lamps, center, inward, window["width"], window["height"])
    # Beside the view, on the side with more room, a head above what the cameras look at.
    middle = 0.5 * (focus + eye) + 0.4 * up
    sides = [_unit(np.cross(forward, up)) * s for s in (1.0, -1.0)]
    free = [min(_free(caster, middle, side), 2.5) for side in sides]
    best = int(np.argmax(free))
    return Stage(up, focus, points, lamps, middle + 0.9 * free[best] * sides[best], -sides[best], 1.6, 1.2)


def survey_capture(caster: RayCaster, capture: Capture) -> Stage:
    """`survey` with cameras from the whole capture, so that its frames are lit alike however they are chosen."""
    cameras = [capture[i].camera for i in range(0, len(capture), -(-len(capture) // 8))]
    return survey(caster, cameras, capture.up, getattr(capture, "anchors", None))


def noon_window(stage: Stage) -> dict[str, Any]:
    """A bright day: sky and sun through the window."""
    lights = [
        _window_light(stage, 3200.0, 7000),
        {"kind": "ambient", "illuminance": 60, "temperature": 6000},
        _through(stage, 35.0, 900.0) | {"temperature": 5600},
    ]
    return {"reference_lux": 200, "lights": lights}


def golden_hour(stage: Stage) -> dict[str, Any]:
    """Low warm sun."""
    lights = [
        _window_light(stage, 1000.0, 9000),
        {"kind": "ambient", "illuminance": 28, "temperature": 4800},
        _through(stage, 13.0, 700.0) | {"temperature": 3000},
    ]
    return {"reference_lux": 200, "lights": lights}


def evening_lamps(stage: Stage) -> dict[str, Any]:
    """Lamps lit, blue dusk outside. The camera's white balance leaves of 2700 K what looks like 3600 K."""
    lamps = [
        {"kind": "point", "position": lamp.tolist(), "power": 900, "temperature": 3600}
        | {"radius": 0.06, "clearance": 0.3}
        for lamp in stage.lamps[:3]
    ]
    rest = [_window_light(stage, 120.0, 12000), {"kind": "ambient", "illuminance": 8, "temperature": 4000}]
    return {"reference_lux": 70, "lights": lamps + rest}


def night_moon(stage: Stage) -> dict[str, Any]:
    """Dark, with moonlight through the window; exposed as a camera at night would."""
    night = {"color": [0.62, 0.8, 1.3]}
    lights = [
        _window_light(stage, 7.0, None) | night,
        {"kind": "ambient", "illuminance": 0.15} | night,
        _through(stage, 38.0, 4.0) | {"color": [0.8, 0.92, 1.15]},
    ]
    return {"reference_lux": 2.5, "lights": lights}


def center_point(stage: Stage) -> dict[str, Any]:
    """The paper's first benchmark: one bright point in the middle of the room."""
    light = {"kind": "point", "position": np.mean(stage.points, axis=0).tolist(), "power": 9000}
    return {"reference_lux": 300, "lights": [light]}


def two_colors(stage: Stage) -> dict[str, Any]:
    """The paper's second benchmark: two dim points of different colours."""
    a, b = stage.points
    return {
        "reference_lux": 300,
        "lights": [
            {"kind": "point", "position": a.tolist(), "power": 2500, "color": [1.0, 0.45, 0.2]},
            {"kind": "point", "position": b.tolist(), "power": 2500, "color": [0.2, 0.5, 1.0]},
        ],
    }


SETUPS: dict[str, Callable[[Stage], dict[str, Any]]] = {
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
        hint = did_you_mean(name, SETUPS)
        raise InputError(
            f"lights: no set-up {name!r}{hint}; there are {', '.join(SETUPS)}, or give a .yaml or .json file"
        )


def named_setup(name: str, stage: Stage) -> LightSetup:
    """Place one of `SETUPS` on a stage.

    Raises:
        InputError: unknown name.
    """
    check_setup_name(name)
    return parse_lights(SETUPS[name](stage), stage.up, name)


def _window_light(stage: Stage, power: float, kelvin: float | None) -> dict[str, Any]:
    tint = {} if kelvin is None else {"temperature": kelvin}
    return {"kind": "rect", "power": power} | _window(stage) | tint


def _window(stage: Stage) -> dict[str, Any]:
    return {
        "center": (stage.window + 0.01 * stage.inward).tolist(),
        "normal": stage.inward.tolist(),
        "up": stage.up.tolist(),
        "width": stage.width,
        "height": stage.height,
    }


def _through(stage: Stage, elevation: float, illuminance: float) -> dict[str, Any]:
    """Parallel light that falls through the window from `elevation` degrees, a little from one side."""
    aside = np.cross(stage.up, stage.inward)
    level = np.deg2rad(elevation)
    direction = np.cos(level) * _unit(stage.inward + 0.35 * aside) - np.sin(level) * stage.up
    return {
        "kind": "directional",
        "direction": direction.tolist(),
        "illuminance": illuminance,
        "aperture": _window(stage),
    }


def _focus(caster: RayCaster, cameras: Sequence[Camera]) -> tuple[Vector, Vector]:
    """Median of the surface points that a few cameras see, and the cameras' mean position."""
    chosen, points = spread(cameras, 8), []
    for camera in chosen:
        small = camera.intrinsics.resize(24, 32)
        rays = Camera(small, camera.pose).rays().reshape(-1, 3)
        hits = caster.cast(camera.origin, rays)
        points.append(camera.origin + rays[hits.hit] * hits.distance[hits.hit, None])
    seen = np.concatenate(points)
    if not len(seen):
        raise InputError("no camera sees the mesh; are the mesh and the poses in the same coordinates (metres)?")
    return np.median(seen, axis=0), np.mean([c.origin for c in chosen], axis=0)


def _points(caster: RayCaster, focus: Vector, eye: Vector, forward: Vector, up: Vector) -> list[Vector]:
    """Two places in free space: above what is looked at, and above and beside the viewer."""
    aside = _unit(np.cross(forward, up))
    starts = [focus - 0.4 * forward + 0.3 * up, 0.5 * (focus + eye) - 0.2 * forward]
    shifts = [0.5 * up + 0.35 * aside, 0.6 * up - 0.9 * aside]
    return [
        start + _unit(s) * min(np.linalg.norm(s), 0.7 * _free(caster, start, s)) for start, s in zip(starts, shifts)
    ]


def _free(caster: RayCaster, start: Vector, direction: Vector) -> float:
    """Metres from `start` to the first surface in `direction`."""
    return float(caster.cast(start[None], _unit(direction)[None]).distance[0])


def _level(vector: Vector, up: Vector) -> Vector:
    flat = vector - np.dot(vector, up) * up
    return flat if np.linalg.norm(flat) > 1e-6 else np.cross(up, np.eye(3)[np.argmin(np.abs(up))])


def _unit(vector: Vector) -> Vector:
    return vector / np.linalg.norm(vector)
