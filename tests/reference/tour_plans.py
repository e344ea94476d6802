"""Plans of a tour in a room of 4 m whose window faces west."""

from typing import Any

import numpy as np
from msgspec.structs import replace

from hyjax.tour.placement import north_for_bearing, place_lamp
from hyjax.tour.plan import Lamp, TourPlan, Window

UP = np.array([0.0, 0.0, 1.0])
WEST = Window((2.0, 0.0, 1.5), (-1.0, 0.0, 0.0), 1.0, 2.0)  # in the wall at x = 2, looks out along +x
SURFACE = 80.0


def afternoon(**changes: Any) -> TourPlan:
    plan = TourPlan(hour=16.0, windows=(WEST,), north=north_for_bearing(WEST, 260.0, UP))
    return replace(plan, **changes).check()


def lamps(*kinds: str) -> tuple[Lamp, ...]:
    return tuple(place_lamp(kind, np.array([0.5 * k, 0.0, 1.0]), UP) for k, kind in enumerate(kinds))  # type: ignore[arg-type]
