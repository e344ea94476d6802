"""Shadow maps are cast of new places of lights only."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import hyjax
from hyjax.light.kinds import Light
from hyjax.scene.kept_maps import KeptMaps


def lamp(x: float, flux: float = 600.0) -> hyjax.PointLight:
    return hyjax.PointLight(np.array([x, 0.0, 1.0]), flux, np.ones(3))


def test_a_dimmed_light_keeps_its_map_and_a_moved_one_is_cast() -> None:
    cast: list[float] = []

    def maps(lights: Sequence[Light]) -> Any:
        places = [float(light.position[0]) for light in lights]  # type: ignore[attr-defined]
        cast.extend(places)
        return tuple(f"map of {place}" for place in places)

    kept = KeptMaps()
    first = kept.of("fine", [lamp(1.0), lamp(2.0)], maps)
    assert kept.of("fine", [lamp(1.0), lamp(2.0, 30.0)], maps) is first and cast == [1.0, 2.0]
    assert kept.of("fine", [lamp(1.0), lamp(3.0)], maps) == ("map of 1.0", "map of 3.0")
    assert cast == [1.0, 2.0, 3.0]
    twice = kept.of("coarse", [lamp(1.0), lamp(1.0)], maps)  # another kind, of two lights at one place
    assert kept.of("coarse", [lamp(1.0), lamp(1.0)], maps) is twice and cast[3:] == [1.0]
    kept.of("fine", [lamp(2.0)], maps)  # of the first set, which is no longer kept
    assert cast[4:] == [2.0]
