"""Daylight of a plan in words: date, hour, sun or moon, and where the windows look."""

import math

import numpy as np
from jaxtyping import Float

from hyjax.tour.placement import north_for_bearing
from hyjax.tour.plan import TourPlan

COMPASS_POINTS = "north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"


def describe_daylight(plan: TourPlan, up: Float[np.ndarray, "3"]) -> str:
    """Date, hour, sun or moon, and where the windows look, or the open sky, as one line."""
    sky = plan.sky()
    h = plan.hour
    clock = f"{int(h):02d}:{int(h * 60 % 60):02d}"
    height = float(sky.toward[2])
    if plan.weather == "clear" and sky.direct > 1 and height > -0.02:
        light = f"sun {max(0.0, math.degrees(math.asin(height))):.0f}° high, {sky.direct:,.0f} lux"
    elif sky.sky > 1:
        light = f"{sky.sky:,.0f} lux from the sky"
    elif sky.direct > 0:
        light = f"moonlight, {sky.direct:.2g} lux"
    else:
        light = "dark outside"
    looks = [(plan.north - north_for_bearing(window, 0.0, up)) % 360 for window in plan.windows]
    points = [COMPASS_POINTS[round(bearing / 45) % 8] for bearing in looks]
    through = [f"; window {number} looks {point}" for number, point in enumerate(points, 1)]
    return f"{plan.date():%-d %B}, {clock} solar time: {light}{'; open sky' if plan.open_sky else ''.join(through)}"
