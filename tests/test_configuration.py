"""Configurations as files: what is written is read back, and what cannot be used is refused in one line."""

import copy
import dataclasses
import json
import pickle
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hyjax.configuration import (
    PRESETS,
    Configuration,
    GuideOptions,
    LightOptions,
    Measured,
    ShadowOptions,
)
from hyjax.core.schedule import Schedule
from hyjax.util.errors import InputError

gains = st.floats(0, 4)
lights = st.builds(
    LightOptions,
    sampling=st.integers(1, 16),
    photo_light=st.sampled_from(["divided", "kept"]),
    bounces=st.booleans(),
    photo_exponent=gains,
    bounce_gain=gains,
)
shadows = st.builds(
    ShadowOptions,
    map_scale=st.floats(0.05, 4),
    views=st.none() | st.integers(1, 64),
    least_share=st.floats(0, 1),
)
guides = st.builds(
    GuideOptions,
    name=st.sampled_from(["rgb", "none", "small", "a folder/guide.safetensors"]),
    size=st.none() | st.integers(32, 4096),
    every=st.integers(1, 64),
)
times = st.floats(0.01, 1e4)
measured = st.builds(
    Measured,
    device=st.text(),
    cores=st.integers(1, 256),
    size=st.tuples(st.integers(1, 9999), st.integers(1, 9999)),
    median_ms=times,
    p95_ms=times,
    default_ms=st.none() | times,
)
schedules = st.sampled_from(
    [Schedule.preset(name) for name in ("hyjax", "paper-50", "paper-80", "shadow", "hyjax-scan-shadow")]
)
configurations = st.builds(
    dict,
    name=st.text(st.characters(codec="utf-8")),
    schedule=schedules,
    shadow_schedule=schedules,
    scale=st.integers(1, 8),
    light=lights,
    shadows=shadows,
    guide=guides,
    measured=st.none() | measured,
)


@given(configurations)
def test_round_trip(fields: dict[str, Any]) -> None:
    configuration = Configuration(**fields)
    again = Configuration.from_json(configuration.to_json())
    for name in ("name", "mode", "scale", "light", "shadows", "guide", "measured"):
        assert getattr(again, name) == getattr(configuration, name)
    assert again.to_json() == configuration.to_json()
    assert again.schedule.to_json() == configuration.schedule.to_json()
    assert again.light.sampling == configuration.light.sampling >= 1


def test_paper_round_trip() -> None:
    paper = Configuration.from_json(Configuration.paper().to_json())
    assert paper.to_json() == Configuration.paper().to_json()
    assert (paper.mode, paper.light.sampling, paper.light.photo_light) == ("paper", 1, "kept")


def changed(*path: str, to: Any) -> str:
    """The default's file with one value changed, or taken away."""
    content = json.loads(Configuration().to_json())
    place = content
    for name in path[:-1]:
        place = place[name]
    if to is None:
        del place[path[-1]]
    else:
        place[path[-1]] = to
    return json.dumps(content)


def refusal(text: str | bytes) -> str:
    with pytest.raises(InputError) as caught:
        Configuration.from_json(text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["colour"], 1, "colour"),
        (["light", "colour"], 1, "colour"),
        (["shadows", "mapscale"], 1, "mapscale"),
        (["guide", "nmae"], "rgb", "nmae"),
        (["format"], 2, "format"),
        (["format"], None, "format"),
        (["schedule"], None, "schedule"),
        (["shadow_schedule"], None, "shadow_schedule"),
        (["mode"], "papers", "mode"),
        (["scale"], 9, "scale"),
        (["scale"], 1.5, "scale"),
        (["scale"], "2", "scale"),
        (["scale"], True, "scale"),
        (["light"], [], "light"),
        (["light", "sampling"], 0, "sampling"),
        (["light", "photo_light"], "left", "photo_light"),
        (["light", "bounces"], 1, "bounces"),
        (["light", "bounce_gain"], -0.1, "bounce_gain"),
        (["light", "photo_exponent"], 5, "photo_exponent"),
        (["shadows", "views"], 0, "views"),
        (["shadows", "least_share"], 1.1, "least_share"),
        (["shadows", "map_scale"], 0, "map_scale"),
        (["guide", "size"], 31, "size"),
        (["guide", "every"], 0, "every"),
        (["schedule"], [], "schedule"),
        (["schedule", "levels"], [], "level"),
        (["schedule", "pooling"], "max", "configuration, schedule: "),
        (["shadow_schedule", "levels"], [{"factor": 1}], "configuration, shadow_schedule: "),
        (["measured"], {"device": "cpu"}, "measured"),
    ],
)
def test_what_does_not_fit_is_named(path: list[str], value: Any, said: str) -> None:
    assert said in refusal(changed(*path, to=value))


@pytest.mark.parametrize(
    "path",
    [["light", "bounce_gain"], ["light", "photo_exponent"], ["shadows", "map_scale"], ["shadows", "least_share"]],
)
@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e400"])
def test_numbers_are_finite(path: list[str], value: str) -> None:
    refusal(changed(*path, to="NUMBER").replace('"NUMBER"', value))


@pytest.mark.parametrize("name", ["kappa", "lam", "fidelity"])
@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "-1"])
def test_numbers_of_schedules_are_finite(name: str, value: str) -> None:
    content = json.loads(Configuration().to_json())
    content["schedule"]["levels"][0][name] = "NUMBER"
    refusal(json.dumps(content).replace('"NUMBER"', value))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, 9.0])
def test_numbers_that_were_made_in_code_are_checked(value: float) -> None:
    """A file of what `check` lets pass can be read."""
    with pytest.raises(InputError, match="bounce_gain"):
        Configuration(light=LightOptions(bounce_gain=value)).check()


def test_a_schedule_is_no_configuration(tmp_path: Path) -> None:
    path = tmp_path / "schedule.json"
    path.write_text(Schedule.preset("hyjax").to_json())
    with pytest.raises(InputError, match="give it as --schedule") as caught:
        Configuration.open(str(path))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "1", "[" * 100_000, b"\xff\xfe", '{"format": 1}'])
def test_what_is_no_configuration(text: str | bytes) -> None:
    assert refusal(text).startswith("configuration: ")


def test_presets_open() -> None:
    for name in PRESETS:
        preset = Configuration.open(name)
        assert preset.name == name and preset.mode == "linear" and preset.check() is preset
    assert Configuration.open("default").to_json() == Configuration().to_json()
    assert Configuration.open("paper").mode == "paper"
    with pytest.raises(InputError, match="'balanced'"):
        Configuration.open("balansed")


def test_files_open(tmp_path: Path) -> None:
    path = tmp_path / "mine.JSON"
    path.write_text(Configuration(name="é", scale=2).to_json(), encoding="utf-8")
    assert Configuration.open(str(path)).scale == 2
    path.write_bytes(b"\xff\xff")
    for bad in (path, tmp_path / "none.json", tmp_path):
        with pytest.raises(InputError, match="configuration") as caught:
            Configuration.open(str(bad))
        assert "\n" not in str(caught.value)


def test_what_the_papers_form_excludes() -> None:
    for change in ({"scale": 2}, {"light": LightOptions(sampling=1)}):
        with pytest.raises(InputError, match="mode 'paper'"):
            Configuration(mode="paper", **({"light": LightOptions(photo_light="kept")} | change)).check()  # type: ignore[arg-type]


def test_configurations_of_the_same_values_are_equal() -> None:
    assert Configuration() == Configuration() and hash(Configuration()) == hash(Configuration())
    assert Schedule.preset("hyjax") == Schedule.preset("hyjax")
    assert Schedule.preset("hyjax") != Schedule.preset("hyjax", kappa=0.3)
    assert Schedule.preset("hyjax") != dataclasses.replace(Schedule.preset("hyjax"), norm="mean_abs")
    assert Configuration() != Configuration().with_choices({"bounces": False})
    assert Configuration.from_json(Configuration.preset("fast").to_json()) == Configuration.preset("fast")


def test_a_changed_configuration_has_another_name() -> None:
    fast = Configuration.preset("fast")
    changed = fast.with_choices({"bounces": not fast.light.bounces})
    assert changed.name == "custom" and changed.measured is None
    assert fast.with_choices({"bounces": fast.light.bounces}) is fast
    assert dataclasses.replace(fast, name="mine").with_choices({"bounce_gain": 3.0}).name == "mine"


def test_a_sampled_configuration_is_made_once_and_follows_its_own() -> None:
    own = Configuration()
    assert own.sampled() is own.sampled() and own == Configuration()
    for other in (copy.deepcopy(own), pickle.loads(pickle.dumps(own))):
        assert other == own and other.sampled() == own.sampled()
    assert dataclasses.replace(own, scale=2).sampled().scale == 2 * own.sampled().scale
    plain = own.with_choices({"sampling": 1})
    assert plain.sampled() is plain
