"""Daylight and moonlight by date, hour and latitude.

Directions are (east, north, up). Illuminances are in lux outside: `direct` on a surface that faces the sun or the
moon, `sky` on open level ground. Hours are local mean solar time: 12 is when the sun is highest, give or take a
quarter of an hour, wherever one is; so no time zone and no longitude are needed.
"""

import dataclasses
import datetime
import math
from typing import Literal

import numpy as np
from jaxtyping import Float

from hyjax.util.extras import optional_module

Weather = Literal["clear", "cloudy", "full moon"]

SOLAR_LUX = 127_500.0
"""Illuminance of the sun outside the atmosphere, at its mean distance."""
FULL_MOON_LUX = 0.32
LOWEST_MOON = 15.0
"""Lowest full moon at any hour, degrees."""
NIGHT_SKY_LUX = 0.002

# A clear sky on level ground while the sun is below the horizon: degrees, lux (Seidelmann, *Explanatory Supplement
# to the Astronomical Almanac*, 1992, table 9.1, the moon left out).
TWILIGHT = ((-18.0, 0.0006), (-12.0, 0.008), (-6.0, 3.4), (-0.8, 450.0), (0.0, 800.0))
# Colour temperature of direct sunlight by the sun's elevation, as seen on a clear day.
SUN_KELVIN = ((0.0, 2000.0), (5.0, 2800.0), (10.0, 3500.0), (20.0, 4500.0), (40.0, 5300.0), (90.0, 5700.0))
# Of the sky's: blue while the sun is low, milder at noon.
SKY_KELVIN = ((-6.0, 15000.0), (0.0, 11000.0), (15.0, 9000.0), (60.0, 7500.0))
CLOUDY_KELVIN, MOON_KELVIN, NIGHT_KELVIN = 6500.0, 7500.0, 12000.0


@dataclasses.dataclass(frozen=True)
class Sky:
    """Light from outside.

    Attributes:
        toward: unit vector to the sun or the moon; (east, north, up).
        direct: lux of it on a surface that faces it; 0 if it is hidden or below the horizon.
        sky: lux of the rest of the sky on open level ground.
    """

    toward: Float[np.ndarray, "3"]
    direct: float
    direct_kelvin: float
    sky: float
    sky_kelvin: float

    @property
    def ground(self) -> float:
        """Lux of everything together on open level ground."""
        return self.sky + self.direct * max(float(self.toward[2]), 0.0)


def sky_at(day: datetime.date, hour: float, latitude: float, weather: Weather) -> Sky:
    """The sky over a place.

    Clear: direct sun E = 127 500 exp(−0.21 m) with the air mass m of Kasten and Young (1989), and a sky of
    800 + 15 500 √sin h (daylight availability of the *IES Lighting Handbook*); after sunset twilight, then the moon
    of that night. Cloudy: 300 + 21 000 sin h, no direct light. Full
    moon: it stands opposite the sun, at least `LOWEST_MOON` above the horizon.

    Args:
        hour: local mean solar time in [0, 24].
        latitude: degrees, north positive.
    """
    astral, sun, moon = (optional_module(name, "tour", "sky") for name in ("astral", "astral.sun", "astral.moon"))
    observer = astral.Observer(latitude=float(np.clip(latitude, -89.8, 89.8)), longitude=0.0)
    midnight = datetime.datetime.combine(day, datetime.time(), datetime.UTC)
    when = midnight + datetime.timedelta(hours=float(hour))
    height, bearing = sun.elevation(observer, when), sun.azimuth(observer, when)
    if weather == "full moon":
        height, bearing = max(-height, LOWEST_MOON), bearing + 180.0
        return Sky(_toward(height, bearing), _moonlight(height, 1.0), MOON_KELVIN, NIGHT_SKY_LUX, NIGHT_KELVIN)
    diffuse = _sky_lux(height, weather)
    if weather == "cloudy":
        return Sky(_toward(height, bearing), 0.0, CLOUDY_KELVIN, diffuse, CLOUDY_KELVIN)
    if height > -0.8:
        kelvin = _interpolate(SUN_KELVIN, height)
        return Sky(_toward(height, bearing), _sunlight(height), kelvin, diffuse, _interpolate(SKY_KELVIN, height))
    height, bearing = moon.elevation(observer, when), moon.azimuth(observer, when)
    lit = 0.5 * (1.0 - math.cos(2.0 * math.pi * moon.phase(day) / 28.0))  # astral's phases run from 0 to 28
    shine = _moonlight(height, lit) if height > 0 else 0.0
    return Sky(_toward(height, bearing), shine, MOON_KELVIN, diffuse + NIGHT_SKY_LUX, NIGHT_KELVIN)


def _sky_lux(height: float, weather: Weather) -> float:
    sine = math.sin(math.radians(max(height, 0.0)))
    below = math.exp(_interpolate([(h, math.log(lux)) for h, lux in TWILIGHT], height)) / TWILIGHT[-1][1]
    if weather == "cloudy":
        return (300.0 + 21_000.0 * sine) * below
    return (800.0 + 15_500.0 * math.sqrt(sine)) * below


def _sunlight(height: float) -> float:
    clipped = max(height, 0.0)
    mass = 1.0 / (math.sin(math.radians(clipped)) + 0.50572 * (clipped + 6.07995) ** -1.6364)
    # Half of the disc has set when its centre is on the horizon.
    return SOLAR_LUX * math.exp(-0.21 * mass) * float(np.clip((height + 0.8) / 1.6, 0.0, 1.0))


def _moonlight(height: float, lit: float) -> float:
    """Moonlight by the lit share of its disc, roughly: near full the moon brightens faster than that share."""
    return FULL_MOON_LUX * lit**2.5 * math.exp(-0.21 / max(math.sin(math.radians(height)), 0.05))


def _interpolate(table: object, x: float) -> float:
    return float(np.interp(x, *np.asarray(table, float).T))


def _toward(height: float, bearing: float) -> Float[np.ndarray, "3"]:
    h, b = math.radians(height), math.radians(bearing)
    return np.array([math.cos(h) * math.sin(b), math.cos(h) * math.cos(b), math.sin(h)])
