"""Lights of a plan: sky, sun, lamps, and the camera's exposure."""

from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from box_room import BoxCapture, box_room
from reference.tour_plans import UP, afternoon, lamps

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import AmbientLight, DirectionalLight, PointLight, RectLight, SpotLight
from hyjax.light.setup import LightSetup, geometry_key
from hyjax.scene.seen_surface import SeenSurface
from hyjax.tour.lighting import GLASS_TRANSMITTANCE, Lighting, flicker
from hyjax.tour.plan import KINDS, TourPlan

LIGHTING = Lighting(RayCaster(box_room()), [BoxCapture().camera(0)], UP)


def test_every_lamp_becomes_a_light_of_its_lumen() -> None:
    setup = LIGHTING.setup(afternoon(windows=(), lamps=lamps(*KINDS)))
    found = {type(light): light for light in setup.lights}
    assert {PointLight, SpotLight, RectLight} < set(found)
    powers = sorted(float(light.luminous_flux) for light in setup.lights if hasattr(light, "luminous_flux"))
    assert powers == pytest.approx(sorted(kind.lumen for kind in KINDS.values()))


def suns(plan: TourPlan) -> list[DirectionalLight]:
    return [light for light in LIGHTING.setup(plan).lights if isinstance(light, DirectionalLight)]


def test_the_afternoon_sun_comes_through_a_western_window_only() -> None:
    assert len(suns(afternoon())) == 1
    morning = afternoon(hour=8.0)
    assert not suns(morning)
    assert isinstance(LIGHTING.setup(morning).lights[0], RectLight), "but its sky does"


def test_the_sun_shines_into_the_room_and_down() -> None:
    (sun,) = suns(afternoon())
    assert float(sun.direction[0]) < -0.5 and float(sun.direction[2]) < 0


def test_a_window_lets_half_of_an_open_sky_in() -> None:
    plan = afternoon(weather="cloudy")
    light = LIGHTING.setup(plan).lights[0]
    assert isinstance(light, RectLight)
    assert float(light.luminous_flux) == pytest.approx(
        GLASS_TRANSMITTANCE * (0.5 + 0.5 * 0.2) * plan.sky().sky * 2.0
    )


@pytest.mark.parametrize("hour", [9.0, 12.0, 16.0, 19.0])
def test_by_day_the_median_picture_keeps_its_brightness_and_the_sun_burns_nothing_out(hour: float) -> None:
    setup = LIGHTING.setup(afternoon(hour=hour))
    seen, _ = SeenSurface.of(RayCaster(box_room()), [BoxCapture().camera(0)])
    light = seen.lux(setup.lights).sum(axis=1) / setup.reference_lux
    assert 0.5 < np.median(light) < 1.5
    for sun in setup.lights:
        if isinstance(sun, DirectionalLight):
            assert float(sun.illuminance) < 4 * setup.reference_lux


def test_at_night_the_camera_takes_longer_but_it_stays_darker() -> None:
    day, night = (LIGHTING.setup(afternoon(hour=h)) for h in (13.0, 1.0))

    def brightness(setup: LightSetup) -> float:
        ambient = setup.lights[-1]
        assert isinstance(ambient, AmbientLight)
        return float(ambient.illuminance) / setup.reference_lux

    assert night.reference_lux < 1e-3 * day.reference_lux
    assert 0.05 < brightness(night) / brightness(day) < 0.7


def test_exposure_is_in_stops() -> None:
    one, two = (LIGHTING.setup(afternoon(exposure=e)).reference_lux for e in (0.0, 1.0))
    assert one == pytest.approx(2 * two)


def test_lights_that_flicker_leave_the_exposure_alone() -> None:
    plan = afternoon(hour=0.0, lamps=lamps("candle"))
    still, moving = LIGHTING.setup(plan), LIGHTING.setup(plan, {0: 1.2})
    assert moving.reference_lux == still.reference_lux
    (candle,) = (light for light in moving.lights if isinstance(light, PointLight))
    assert float(candle.luminous_flux) == pytest.approx(1.2 * KINDS["candle"].lumen)
    waves = [flicker(t / 50, 0) for t in range(5000)]
    assert np.mean(waves) == pytest.approx(1, abs=0.02) and min(waves) > 0.7 and max(waves) < 1.3


def test_strength_and_colour_do_not_change_the_key_of_a_light() -> None:
    def keys(**changes: Any) -> list[Any]:
        plan = afternoon(weather="cloudy", lamps=(replace(lamps("spot")[0], **changes),))
        return [geometry_key(light) for light in LIGHTING.setup(plan).lights]

    assert keys() == keys(lumen=10.0, kelvin=5000.0)
    assert [a == b for a, b in zip(keys(), keys(position=(0.0, 0.1, 1.0)), strict=True)] == [True, False, True]
