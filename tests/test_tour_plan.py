"""What a person sets up becomes a lights file; nonsense is refused before anything is done with it."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("astral", reason="needs the extra 'tour'")

from hyjax.data.light_file import parse_lights
from hyjax.errors import InputError
from hyjax.lights import DirectionalLight, PointLight, RectLight, SpotLight
from hyjax.tour.lighting import GLASS, flicker, lights_file, lights_of, setup_of
from hyjax.tour.place import facing, place_lamp
from hyjax.tour.plan import KINDS, MOST_LAMPS, Lamp, Piece, Plan, Window

UP = np.array([0.0, 0.0, 1.0])
WEST = Window((2.0, 0.0, 1.5), (-1.0, 0.0, 0.0), 1.0, 2.0)  # in the wall at x = 2, looks out along +x
SURFACE = 80.0


def afternoon(**changes: Any) -> Plan:
    plan = Plan(hour=16.0, windows=(WEST,), north=facing(WEST, 260.0, UP))
    return dataclasses.replace(plan, **changes).check()


def lamps(*kinds: str) -> tuple[Lamp, ...]:
    return tuple(place_lamp(kind, np.array([0.5 * k, 0.0, 1.0]), UP) for k, kind in enumerate(kinds))  # type: ignore[arg-type]


def test_every_lamp_becomes_a_light_of_its_lumen() -> None:
    setup = parse_lights(lights_file(afternoon(windows=(), lamps=lamps(*KINDS)), UP, SURFACE), UP)
    found = {type(light): light for light in setup.lights}
    assert {PointLight, SpotLight, RectLight} < set(found)
    powers = sorted(float(light.power) for light in setup.lights if hasattr(light, "power"))
    assert powers == pytest.approx(sorted(kind.lumen for kind in KINDS.values()))


def test_the_afternoon_sun_comes_through_a_western_window_only() -> None:
    names = [entry.get("name", "") for entry in lights_of(afternoon(), UP, SURFACE)]
    assert "sun in window 0" in names
    names = [entry.get("name", "") for entry in lights_of(afternoon(hour=8.0), UP, SURFACE)]
    assert "window 0" in names and "sun in window 0" not in names


def test_the_sun_shines_into_the_room_and_down() -> None:
    setup = parse_lights(lights_file(afternoon(), UP, SURFACE), UP)
    (sun,) = (light for light in setup.lights if isinstance(light, DirectionalLight))
    assert float(sun.direction[0]) < -0.5 and float(sun.direction[2]) < 0


def test_a_window_lets_half_of_an_open_sky_in() -> None:
    plan = afternoon(weather="cloudy")
    entry = lights_of(plan, UP, SURFACE)[0]
    sky = plan.sky().sky
    assert entry["power"] == pytest.approx(GLASS * (0.5 + 0.5 * 0.2) * sky * 2.0)


def test_at_night_the_camera_takes_longer_but_it_stays_darker() -> None:
    day, night = (lights_file(afternoon(hour=h), UP, SURFACE) for h in (13.0, 1.0))

    def brightness(content: dict[str, Any]) -> float:
        return content["lights"][-1]["illuminance"] / content["reference_lux"]

    assert night["reference_lux"] < 1e-3 * day["reference_lux"]
    assert 0.05 < brightness(night) / brightness(day) < 0.7


def test_exposure_is_in_stops() -> None:
    one, two = (lights_file(afternoon(exposure=e), UP, SURFACE)["reference_lux"] for e in (0.0, 1.0))
    assert one == pytest.approx(2 * two)


def test_lights_that_flicker_leave_the_exposure_alone() -> None:
    plan = afternoon(hour=0.0, lamps=lamps("candle"))
    (_, still), (entries, moving) = setup_of(plan, UP, SURFACE), setup_of(plan, UP, SURFACE, {0: 1.2})
    assert moving.reference_lux == still.reference_lux
    assert next(e for e in entries if e["kind"] == "point")["power"] == pytest.approx(1.2 * KINDS["candle"].lumen)
    waves = [flicker(t / 50, 0) for t in range(5000)]
    assert np.mean(waves) == pytest.approx(1, abs=0.02) and min(waves) > 0.7 and max(waves) < 1.3


def test_a_plan_survives_its_file() -> None:
    plan = afternoon(
        lamps=lamps("bulb", "spot"), pieces=(Piece((1.0, 2.0, 0.5), removed=True),), weather="full moon"
    )
    assert Plan.from_json(plan.to_json()) == plan


NAN, FAR = float("nan"), 1e9
NONSENSE = {
    "hour": {"hour": 24.5},
    "hour: .*nan": {"hour": NAN},
    "hour: .*'noon'": {"hour": "noon"},
    "years 1900": {"day": "9999-12-31"},
    "exposure": {"exposure": 7.0},
    "day": {"day": "tomorrow"},
    "latitude": {"latitude": -100.0},
    "weather": {"weather": "rain"},
    "lumen": {"lamps": (dataclasses.replace(lamps("bulb")[0], lumen=NAN),)},
    "lumen: .*-1": {"lamps": (dataclasses.replace(lamps("bulb")[0], lumen=-1.0),)},
    "kelvin": {"lamps": (dataclasses.replace(lamps("bulb")[0], kelvin=10.0),)},
    "kind": {"lamps": (dataclasses.replace(lamps("bulb")[0], kind="torch"),)},
    "position": {"lamps": (dataclasses.replace(lamps("bulb")[0], position=(0.0, FAR, 0.0)),)},
    "at most 16": {"lamps": lamps(*["bulb"] * (MOST_LAMPS + 1))},
    "at most 8": {"windows": (WEST,) * 1000},
    "zero vector": {"windows": (dataclasses.replace(WEST, normal=(0.0, 0.0, 0.0)),)},
    "width": {"windows": (dataclasses.replace(WEST, width=0.0),)},
    "move and turn": {"pieces": (Piece((0.0, 0.0, 0.0), pose=tuple((2 * np.eye(4)).reshape(-1).tolist())),)},
    "16 numbers": {"pieces": (Piece((0.0, 0.0, 0.0), pose=(1.0,)),)},
    "name of a file": {"pieces": (Piece((0.0, 0.0, 0.0), file="../../etc/passwd"),)},
}


@pytest.mark.parametrize("word", NONSENSE)
def test_nonsense_is_refused(word: str) -> None:
    with pytest.raises(InputError, match=word):
        afternoon(**NONSENSE[word])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{", "not JSON"),
        ("[]", "JSON object"),
        ('{"hours": 3}', "hours"),
        ('{"lamps": [{"kind": "bulb"}]}', "position"),
        ('{"lamps": 3}', "lamps"),
    ],
)
def test_damaged_files_are_refused(text: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        Plan.from_json(text)


def test_the_file_is_plain_json() -> None:
    assert json.loads(afternoon().to_json())["windows"][0]["width"] == 1.0
