"""The lights that a plan makes, as the content of a lights file: what `hyjax relight --lights` takes."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.light_file import LightSetup, parse_lights
from hyjax.pipeline import REFERENCE_LUX
from hyjax.tour.place import compass, unit, upright
from hyjax.tour.plan import KINDS, Lamp, Plan

GLASS = 0.7
"""Share of the light that a window lets in."""
GROUND = 0.2
"""Share of the daylight that the ground outside throws back."""
WALLS = 0.5
"""Share of the light that a room's surfaces throw back, on average."""
BALANCE = 0.43
"""How far a camera's white balance makes up for coloured light, from nothing to all, in reciprocal kelvin."""
NEUTRAL_KELVIN = 6500.0
ADAPTATION = 0.8
"""How far a camera makes up for the dark: 1 shows night as bright as day, 0 leaves it black."""
STRIP = (1.0, 0.03)  # metres


def lights_of(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> list[dict[str, Any]]:
    """The plan's lights as entries of a lights file: for each window its sky and its sun, the lamps, one ambient.

    What the room throws back is one ambient light, E = ρ Φ / (S (1 − ρ)) with all the light Φ that comes in, the
    room's surface S and its mean reflectance ρ: the sphere that photometry integrates in.

    Args:
        plan: what is set up.
        up: against gravity, world axes.
        surface: of the room's walls, floor and ceiling together, square metres.
        flicker: of some lamps by number: what their light is multiplied with just now.
    """
    sky, world = plan.sky(), compass(plan.north, up)
    toward = sky.toward @ world
    entries: list[dict[str, Any]] = []
    flux: list[tuple[float, float]] = []  # lumens and their kelvin
    for number, window in enumerate(plan.windows):
        inward = unit(window.normal)
        opening = {
            "center": (np.asarray(window.center) + 0.01 * inward).tolist(),
            "normal": inward.tolist(),
            "up": upright(inward, up).tolist(),
            "width": float(window.width),
            "height": float(window.height),
        }
        # A tilted surface sees a part of the sky and a part of the ground.
        tilt = float(-inward @ up)
        outside = 0.5 * (1.0 + tilt) * sky.sky + 0.5 * (1.0 - tilt) * GROUND * sky.ground
        area = window.width * window.height
        power = GLASS * outside * area
        entries.append(
            {"kind": "rect", "name": f"window {number}", "power": power, "temperature": _balanced(sky.sky_kelvin)}
            | opening
        )
        flux.append((power, sky.sky_kelvin))
        cosine = float(-inward @ toward)
        if sky.direct > 0 and cosine > 0.02:
            entries.append(
                {
                    "kind": "directional",
                    "name": f"sun in window {number}",
                    "direction": (-toward).tolist(),
                    "illuminance": GLASS * sky.direct,
                    "temperature": _balanced(sky.direct_kelvin),
                    "aperture": opening,
                }
            )
            flux.append((GLASS * sky.direct * cosine * area, sky.direct_kelvin))
    for number, lamp in enumerate(plan.lamps):
        if lamp.on and lamp.lumen > 0:
            lumen = lamp.lumen * (flicker or {}).get(number, 1.0)
            entries.append({"name": f"{lamp.kind} {number}"} | _lamp_entry(lamp, lumen, up))
            flux.append((lumen, lamp.kelvin))
    total = sum(lumen for lumen, _ in flux)
    kelvin = sum(lumen * k for lumen, k in flux) / total if total > 0 else 4000.0
    bounced = WALLS * total / (surface * (1.0 - WALLS))
    # Never quite dark: a picture of nothing helps nobody.
    entries.append({"kind": "ambient", "illuminance": max(bounced, 1e-3), "temperature": _balanced(kelvin)})
    return entries


def reference_lux(entries: Sequence[Mapping[str, Any]], exposure: float) -> float:
    """The illuminance that the camera exposes for, as the lights file's `reference_lux`.

    Light that has bounced is what a room looks like on average, so exposure follows it: by day short, at night
    long, but not all the way, or night would look like day.
    """
    ambient = sum(float(entry["illuminance"]) for entry in entries if entry["kind"] == "ambient")
    return float((2.0 * ambient) ** ADAPTATION * REFERENCE_LUX ** (1.0 - ADAPTATION) * 2.0**-exposure)


def lights_file(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> dict[str, Any]:
    """The plan as the content of a lights file, which `hyjax relight --lights` takes; see `lights_of`.

    The camera does not follow a flicker: exposure is that of steady lamps.
    """
    steady = lights_of(plan, up, surface)
    entries = lights_of(plan, up, surface, flicker) if flicker else steady
    return {"reference_lux": reference_lux(steady, plan.exposure), "lights": entries}


def setup_of(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> tuple[list[dict[str, Any]], LightSetup]:
    """Entries of `lights_file`, and the lights that they make."""
    content = lights_file(plan, up, surface, flicker)
    return content["lights"], parse_lights(content, up, "tour")


def flicker(seconds: float, number: int) -> float:
    """What a candle's light is multiplied with: a few waves of no common period; 1 on average."""
    t = seconds + 13.7 * number
    return 1.0 + 0.08 * math.sin(9.1 * t) + 0.06 * math.sin(14.3 * t + 1.0) + 0.05 * math.sin(3.7 * t + 2.0)


def _lamp_entry(lamp: Lamp, lumen: float, up: Float[np.ndarray, "3"]) -> dict[str, Any]:
    light = {"power": lumen, "temperature": _balanced(lamp.kelvin)}
    position, direction = list(lamp.position), unit(lamp.direction)
    radius = KINDS[lamp.kind].radius
    if lamp.kind in ("bulb", "candle"):
        return {"kind": "point", "position": position, "radius": radius} | light
    if lamp.kind == "spot":
        angles = {"inner_degrees": 20.0, "outer_degrees": 40.0}
        return (
            {"kind": "spot", "position": position, "direction": direction.tolist(), "radius": radius}
            | angles
            | light
        )
    size = {"width": STRIP[0], "height": STRIP[1], "up": upright(direction, up).tolist()}
    return {"kind": "rect", "center": position, "normal": direction.tolist()} | size | light


def _balanced(kelvin: float) -> float:
    """The colour temperature that light has in the picture."""
    neutral = 1.0 / NEUTRAL_KELVIN
    return 1.0 / (neutral + (1.0 - BALANCE) * (1.0 / kelvin - neutral))
