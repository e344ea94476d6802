"""Lights of a plan: sky and sun through its windows, its lamps, and bounces of the room."""

import functools
import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from hyjax.light.color import blackbody, luminance
from hyjax.light.kinds import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    Light,
    PointLight,
    RectLight,
    SpotLight,
)
from hyjax.light.setup import REFERENCE_LUX, LightSetup
from hyjax.tour.placement import as_point, compass, upright
from hyjax.tour.plan import KINDS, Lamp, Point, TourPlan
from hyjax.util.vectors import unit

GLASS_TRANSMITTANCE = 0.7
"""Share of the light that a window lets in."""
GROUND_REFLECTANCE = 0.2
"""Share of the daylight that the ground outside throws back."""
WALL_REFLECTANCE = 0.5
"""Share of the light that a room's surfaces throw back, on average."""
BALANCE_SHARE = 0.43
"""Share of a light's distance from neutral, in reciprocal kelvin, that a camera's white balance makes up for."""
NEUTRAL_KELVIN = 6500.0
ADAPTATION = 0.8
"""Exponent by which a camera makes up for the dark: 1 shows night as bright as day, 0 leaves it black."""
STRIP_SIZE = (1.0, 0.03)  # metres
SPOT_DEGREES = 20.0, 40.0
"""Half angles of a spot's cone: fully lit inside the first, dark outside the second."""
SUN_RADIUS = np.asarray(np.deg2rad(0.27), np.float32)
LEAST_AMBIENT = 1e-3
"""Lux: a picture is never entirely dark."""


def setup_of(
    plan: TourPlan, up: Float[np.ndarray, "3"], surface_area: float, flicker: Mapping[int, float] | None = None
) -> LightSetup:
    """Lights of a plan and the illuminance that the camera exposes for; see `lights_of`.

    The camera does not follow a flicker: exposure is that of steady lamps.
    """
    steady = lights_of(plan, up, surface_area)
    lights = lights_of(plan, up, surface_area, flicker) if flicker else steady
    existing = {name: (factor, factor, factor) for name, factor in plan.existing.items()}
    return LightSetup(lights, reference_lux(steady, plan.exposure), existing)


def lights_of(
    plan: TourPlan, up: Float[np.ndarray, "3"], surface_area: float, flicker: Mapping[int, float] | None = None
) -> tuple[Light, ...]:
    """Lights of a plan: for each window its sky and its sun, the lamps, one ambient light.

    What the room throws back is one ambient light, E = ρ Φ / (S (1 − ρ)) with all the light Φ that comes in, the
    room's surface S and its mean reflectance ρ: the sphere that photometry integrates in.

    Args:
        plan: what is set up.
        up: against gravity, world axes.
        surface_area: of the room's walls, floor and ceiling together, square metres.
        flicker: factors on the light of some lamps, by their number.
    """
    lights, flux = lights_from_outside(plan, up)
    for number, lamp in enumerate(plan.lamps):
        if lamp.on and lamp.lumen > 0:
            lumen = lamp.lumen * (flicker or {}).get(number, 1.0)
            lights.append(_lamp_light(lamp, lumen, up))
            flux.append((lumen, lamp.kelvin))
    total, kelvin = mixed(flux)
    bounced = WALL_REFLECTANCE * total / (surface_area * (1.0 - WALL_REFLECTANCE))
    lights.append(AmbientLight(_float32(max(bounced, LEAST_AMBIENT)), _color(kelvin)))
    return tuple(lights)


def mixed(flux: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Lumens of several lights together, and their mean kelvin."""
    total = sum(lumen for lumen, _ in flux)
    return total, sum(lumen * kelvin for lumen, kelvin in flux) / total if total > 0 else 4000.0


def lights_from_outside(
    plan: TourPlan, up: Float[np.ndarray, "3"]
) -> tuple[list[Light], list[tuple[float, float]]]:
    """Sky and sun of each window, and the lumens with their kelvin that they let in."""
    sky = plan.sky()
    toward = sky.toward @ compass(plan.north, up)
    lights: list[Light] = []
    flux: list[tuple[float, float]] = []
    for window in plan.windows:
        inward, area = unit(np.asarray(window.normal)), window.width * window.height
        center = as_point(np.asarray(window.center) + 0.01 * inward)
        opening = _rectangle(center, as_point(inward), window.width, window.height, as_point(up))
        # A tilted surface sees a part of the sky and a part of the ground.
        tilt = float(-inward @ up)
        outside = 0.5 * (1.0 + tilt) * sky.sky + 0.5 * (1.0 - tilt) * GROUND_REFLECTANCE * sky.ground
        lumen = GLASS_TRANSMITTANCE * outside * area
        lights.append(RectLight.filling(opening, _float32(lumen), _color(sky.sky_kelvin)))
        flux.append((lumen, sky.sky_kelvin))
        cosine = float(-inward @ toward)
        if sky.direct > 0 and cosine > 0.02:
            lux, direction = GLASS_TRANSMITTANCE * sky.direct, _float32(unit(-toward))
            color = _color(sky.direct_kelvin)
            lights.append(DirectionalLight(direction, _float32(lux), color, SUN_RADIUS, opening))
            flux.append((lux * cosine * area, sky.direct_kelvin))
    return lights, flux


def reference_lux(lights: Sequence[Light], exposure: float) -> float:
    """The illuminance that the camera exposes for.

    Light that has bounced is what a room looks like on average, so exposure follows it: by day short, at night
    long, but not all the way, or night would look like day.
    """
    ambient = sum(float(getattr(light, light.STRENGTH)) for light in lights if light.UNIFORM)
    return float((2.0 * ambient) ** ADAPTATION * REFERENCE_LUX ** (1.0 - ADAPTATION) * 2.0**-exposure)


def flicker(seconds: float, number: int) -> float:
    """Factor on a candle's light: a few waves of no common period; 1 on average."""
    t = seconds + 13.7 * number
    return 1.0 + 0.08 * math.sin(9.1 * t) + 0.06 * math.sin(14.3 * t + 1.0) + 0.05 * math.sin(3.7 * t + 2.0)


def _lamp_light(lamp: Lamp, lumen: float, up: Float[np.ndarray, "3"]) -> Light:
    flux, color = _float32(lumen), _color(lamp.kelvin)
    if lamp.color is not None and (brightness := float(luminance(jnp.asarray(lamp.color)))) > 0:
        color = _float32(np.asarray(lamp.color) / brightness)
    position, direction = _float32(lamp.position), unit(np.asarray(lamp.direction))
    radius, none = _float32(KINDS[lamp.kind].radius), _float32(0.0)
    if lamp.kind in ("bulb", "candle"):
        return PointLight(position, flux, color, radius, none)
    if lamp.kind == "spot":
        inner, outer = (_float32(np.deg2rad(degrees)) for degrees in SPOT_DEGREES)
        return SpotLight(position, _float32(direction), flux, color, inner, outer, radius, none)
    return RectLight.filling(_rectangle(lamp.position, as_point(direction), *STRIP_SIZE, as_point(up)), flux, color)


@functools.lru_cache(maxsize=256)
def _rectangle(center: Point, normal: Point, width: float, height: float, up: Point) -> Aperture:
    axis = np.asarray(normal)
    return Aperture.facing(np.asarray(center), axis, upright(axis, np.asarray(up)), width, height)


def _color(kelvin: float) -> Float[np.ndarray, "3"]:
    return _blackbody(round(_balanced(kelvin), 0))


@functools.lru_cache(maxsize=4096)
def _blackbody(kelvin: float) -> Float[np.ndarray, "3"]:
    return _float32(blackbody(kelvin))


def _float32(value: ArrayLike | Point) -> Float[np.ndarray, "*s"]:
    return np.asarray(value, np.float32)


def _balanced(kelvin: float) -> float:
    """The colour temperature that light has in the picture."""
    neutral = 1.0 / NEUTRAL_KELVIN
    return 1.0 / (neutral + (1.0 - BALANCE_SHARE) * (1.0 / kelvin - neutral))
