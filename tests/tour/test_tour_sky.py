"""The sky over a place: known positions of the sun, and light that follows it."""

import datetime
from typing import get_args

import numpy as np
import pytest
from extras import need
from hypothesis import given
from hypothesis import strategies as st

need("tour")

from hyjax.tour.sky import FULL_MOON_LUX, Weather, sky_at

SUMMER, WINTER, SPRING = (datetime.date(2026, *day) for day in ((6, 21), (12, 21), (3, 20)))


@pytest.mark.parametrize(("day", "declination"), [(SUMMER, 23.44), (WINTER, -23.44), (SPRING, 0.0)])
@pytest.mark.parametrize("latitude", [-35.0, 10.0, 48.0, 60.0])
def test_at_noon_the_sun_is_as_high_as_the_declination_says(
    day: datetime.date, declination: float, latitude: float
) -> None:
    toward = max(
        (sky_at(day, hour, latitude, "cloudy").toward for hour in np.arange(11.5, 12.5, 0.02)), key=lambda t: t[2]
    )
    assert np.degrees(np.arcsin(toward[2])) == pytest.approx(90 - abs(latitude - declination), abs=0.4)
    assert abs(toward[0]) < 0.02, "neither east nor west"
    assert np.sign(toward[1]) == np.sign(declination - latitude), "on the side of the tropics"


def test_the_sun_comes_from_the_east_and_goes_to_the_west() -> None:
    assert sky_at(SPRING, 7.0, 48.0, "clear").toward[0] > 0.9
    assert sky_at(SPRING, 17.0, 48.0, "clear").toward[0] < -0.9


@given(
    st.dates(datetime.date(1990, 1, 1), datetime.date(2060, 1, 1)),
    st.floats(0, 24),
    st.floats(-90, 90),
    st.sampled_from(get_args(Weather)),
)
def test_anywhere_and_anytime_it_makes_sense(
    day: datetime.date, hour: float, latitude: float, weather: Weather
) -> None:
    sky = sky_at(day, hour, latitude, weather)
    assert np.linalg.norm(sky.toward) == pytest.approx(1)
    assert 0 <= sky.direct < 127_500 and 0 < sky.sky < 25_000
    assert 1700 <= sky.direct_kelvin <= 20_000 and 1700 <= sky.sky_kelvin <= 20_000
    if weather == "full moon":
        assert sky.toward[2] > 0.2 and 0 < sky.direct < FULL_MOON_LUX
    if weather == "cloudy":
        assert sky.direct == 0


def test_light_fades_without_a_jump() -> None:
    """Over an evening, in steps of a minute."""
    skies = [sky_at(SUMMER, hour, 48.0, "clear") for hour in np.arange(18.0, 22.0, 1 / 60)]
    ground = np.log([sky.ground for sky in skies])
    assert np.abs(np.diff(ground)).max() < 0.75, "√sin h is steep at the horizon, but no more than that"
    assert skies[0].direct_kelvin > skies[60].direct_kelvin > skies[100].direct_kelvin, "redder as it sinks"


def test_clouds_take_the_sun_and_some_of_the_light() -> None:
    clear, cloudy = (sky_at(SUMMER, 12.0, 48.0, weather) for weather in ("clear", "cloudy"))
    assert 80_000 < clear.ground < 130_000 and 10_000 < cloudy.ground < 25_000
