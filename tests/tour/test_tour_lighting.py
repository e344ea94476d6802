"""Lights of a plan: sky, sun, lamps, and the camera's exposure."""

from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from reference.tour_plans import SURFACE, UP, afternoon, lamps

from hyjax.light.kinds import AmbientLight, DirectionalLight, PointLight, RectLight, SpotLight
from hyjax.light.setup import LightSetup, geometry_key
from hyjax.tour.lighting import GLASS_TRANSMITTANCE, flicker, lights_of, setup_of
from hyjax.tour.plan import KINDS, TourPlan


def test_every_lamp_becomes_a_light_of_its_lumen() -> None:
    setup = setup_of(afternoon(windows=(), lamps=lamps(*KINDS)), UP, SURFACE)
    found = {type(light): light for light in setup.lights}
    assert {PointLight, SpotLight, RectLight} < set(found)
    powers = sorted(float(light.luminous_flux) for light in setup.lights if hasattr(light, "luminous_flux"))
    assert powers == pytest.approx(sorted(kind.lumen for kind in KINDS.values()))


def suns(plan: TourPlan) -> list[DirectionalLight]:
    return [light for light in lights_of(plan, UP, SURFACE) if isinstance(light, DirectionalLight)]


def test_the_afternoon_sun_comes_through_a_western_window_only() -> None:
    assert len(suns(afternoon())) == 1
    morning = afternoon(hour=8.0)
    assert not suns(morning)
    assert isinstance(lights_of(morning, UP, SURFACE)[0], RectLight), "but its sky does"


def test_the_sun_shines_into_the_room_and_down() -> None:
    (sun,) = suns(afternoon())
    assert float(sun.direction[0]) < -0.5 and float(sun.direction[2]) < 0


def test_a_window_lets_half_of_an_open_sky_in() -> None:
    plan = afternoon(weather="cloudy")
    light = lights_of(plan, UP, SURFACE)[0]
    assert isinstance(light, RectLight)
    assert float(light.luminous_flux) == pytest.approx(
        GLASS_TRANSMITTANCE * (0.5 + 0.5 * 0.2) * plan.sky().sky * 2.0
    )


def test_at_night_the_camera_takes_longer_but_it_stays_darker() -> None:
    day, night = (setup_of(afternoon(hour=h), UP, SURFACE) for h in (13.0, 1.0))

    def brightness(setup: LightSetup) -> float:
        ambient = setup.lights[-1]
        assert isinstance(ambient, AmbientLight)
        return float(ambient.illuminance) / setup.reference_lux

    assert night.reference_lux < 1e-3 * day.reference_lux
    assert 0.05 < brightness(night) / brightness(day) < 0.7


def test_exposure_is_in_stops() -> None:
    one, two = (setup_of(afternoon(exposure=e), UP, SURFACE).reference_lux for e in (0.0, 1.0))
    assert one == pytest.approx(2 * two)


def test_lights_that_flicker_leave_the_exposure_alone() -> None:
    plan = afternoon(hour=0.0, lamps=lamps("candle"))
    still, moving = setup_of(plan, UP, SURFACE), setup_of(plan, UP, SURFACE, {0: 1.2})
    assert moving.reference_lux == still.reference_lux
    (candle,) = (light for light in moving.lights if isinstance(light, PointLight))
    assert float(candle.luminous_flux) == pytest.approx(1.2 * KINDS["candle"].lumen)
    waves = [flicker(t / 50, 0) for t in range(5000)]
    assert np.mean(waves) == pytest.approx(1, abs=0.02) and min(waves) > 0.7 and max(waves) < 1.3


def test_strength_and_colour_do_not_change_the_key_of_a_light() -> None:
    def keys(**changes: Any) -> list[Any]:
        plan = afternoon(weather="cloudy", lamps=(replace(lamps("spot")[0], **changes),))
        return [geometry_key(light) for light in lights_of(plan, UP, SURFACE)]

    assert keys() == keys(lumen=10.0, kelvin=5000.0)
    assert [a == b for a, b in zip(keys(), keys(position=(0.0, 0.1, 1.0)), strict=True)] == [True, False, True]
