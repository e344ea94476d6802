"""Plan: it survives its file, and nonsense is refused before anything is done with it."""

import json
from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from reference.tour_plans import WEST, afternoon, lamps

from hyjax.tour.plan import MOST_LAMPS, Piece, TourPlan
from hyjax.util.errors import InputError


def test_a_plan_survives_its_file() -> None:
    plan = afternoon(
        lamps=lamps("bulb", "spot"),
        pieces=(Piece((1.0, 2.0, 0.5), removed=True),),
        weather="full moon",
        existing={"window-1": 0.2},
    )
    assert TourPlan.from_json(plan.to_json()) == plan


NAN, FAR = float("nan"), 1e9
NONSENSE = {
    "hour": {"hour": 24.5},
    "'hour' .*nan": {"hour": NAN},
    "'hour' .*'noon'": {"hour": "noon"},
    "years 1900": {"day": "9999-12-31"},
    "exposure": {"exposure": 7.0},
    "day": {"day": "tomorrow"},
    "latitude": {"latitude": -100.0},
    "weather": {"weather": "rain"},
    "lumen": {"lamps": (replace(lamps("bulb")[0], lumen=NAN),)},
    "'lumen' .*-1": {"lamps": (replace(lamps("bulb")[0], lumen=-1.0),)},
    "kelvin": {"lamps": (replace(lamps("bulb")[0], kelvin=10.0),)},
    "kind": {"lamps": (replace(lamps("bulb")[0], kind="torch"),)},
    "position": {"lamps": (replace(lamps("bulb")[0], position=(0.0, FAR, 0.0)),)},
    "at most 16": {"lamps": lamps(*["bulb"] * (MOST_LAMPS + 1))},
    "at most 8": {"windows": (WEST,) * 1000},
    "zero vector": {"windows": (replace(WEST, normal=(0.0, 0.0, 0.0)),)},
    "width": {"windows": (replace(WEST, width=0.0),)},
    "pose: last row": {"pieces": (Piece((0.0, 0.0, 0.0), pose=tuple((2 * np.eye(4)).reshape(-1).tolist())),)},
    "16 numbers": {"pieces": (Piece((0.0, 0.0, 0.0), pose=(1.0,)),)},
    "in 0..1.5 each": {"existing": {"ceiling": 2.0}},
    "'existing' .*nan": {"existing": {"ceiling": NAN}},
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
        ("[]", "must be a mapping with hour"),
        ('{"hours": 3}', "hours"),
        ('{"lamps": [{"kind": "bulb"}]}', "position"),
        ('{"lamps": 3}', "lamps"),
    ],
)
def test_damaged_files_are_refused(text: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        TourPlan.from_json(text)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"hourr": 3}, "plan: unknown key 'hourr' (did you mean 'hour'?); there are hour, day, "),
        ({"hour": 25}, "plan: 'hour' must be a number <= 24.0, got 25"),
        ({"lamps": 3}, "plan: 'lamps' must be a list, got 3"),
        ({"lamps": [3]}, "lamps[0]: must be a mapping with kind, position, "),
        ({"lamps": [{"kind": "bulb"}]}, "lamps[0]: key 'position' is missing"),
        ({"windows": [{"centre": [0, 0, 0]}]}, "windows[0]: unknown key 'centre' (did you mean 'center'?)"),
        (
            {"lamps": [{"kind": "bulp", "position": [0, 0, 0]}]},
            "lamps[0]: 'kind' must be one of bulb, spot, candle, strip, got 'bulp'",
        ),
        (
            {"lamps": [{"kind": "bulb", "position": [0, 0]}]},
            "lamps[0]: 'position' must be three numbers in metres, got [0, 0]",
        ),
        ({"pieces": [{"seed": [0, 0, 0], "removed": 1}]}, "pieces[0]: 'removed' must be true or false, got 1"),
        (
            {"existing": 3},
            "plan: 'existing' must be names of the photo's sources with a number in 0..1.5 each, got 3",
        ),
        ({"day": 3}, "plan: 'day' must be a date such as 2026-06-21, got 3"),
    ],
)
def test_messages_name_place_and_remedy(content: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        TourPlan.from_json(json.dumps(content))
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_the_file_is_plain_json() -> None:
    assert json.loads(afternoon().to_json())["windows"][0]["width"] == 1.0
