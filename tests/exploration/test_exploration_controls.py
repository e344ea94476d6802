"""Changes of a configuration by hand, the script of a picture, and the thread of the newest request."""

import threading
import time
from typing import Any, cast

import numpy as np
import pytest

import hyjax
from hyjax.choices.table import CHOICES
from hyjax.exploration.controls import (
    LADDER,
    configuration_code,
    controls,
    ladders,
    script,
    values,
    with_choice,
    with_level,
)
from hyjax.exploration.newest import Newest
from hyjax.exploration.pictures import Pictures, draft_of, filled, slider_ends
from hyjax.light.setup import same_setup

DEFAULT = hyjax.Configuration()


def test_every_choice_has_a_control() -> None:
    shown = {row["name"] for row in controls()}
    in_ladders = {name for name, c in CHOICES.items() if "schedule" in c.part and c.key in LADDER[1:]}
    assert shown | in_ladders == set(CHOICES) and not shown & in_ladders
    for row in controls():
        if row["kind"] == "slider":
            assert row["low"] <= values(DEFAULT)[row["name"]] <= row["high"], row


def test_a_level_changes_alone() -> None:
    changed = with_level(DEFAULT, "schedule", 1, "steps", 7)
    for key, value in (("kappa", 0.2), ("lam", 0.1), ("fidelity", 0.5)):
        changed = with_level(changed, "schedule", 1, key, value)
    before, after = (ladders(each, slider_ends(each))["schedule"] for each in (DEFAULT, changed))
    assert after[0] == before[0] and after[2] == before[2]
    expected = {"factor": 8, "steps": 7, "kappa": 0.2, "lam": 0.1, "fidelity": 0.5, "most_steps": 32}
    assert after[1] == pytest.approx(expected)
    assert changed.name == "custom" and changed.shadow_schedule == DEFAULT.shadow_schedule


@pytest.mark.parametrize("name", ["default", "fast"])
def test_the_value_that_it_has_changes_nothing(name: str) -> None:
    preset = hyjax.Configuration.preset(name)
    row = ladders(preset, slider_ends(preset))["schedule"][0]
    assert with_level(preset, "schedule", 0, "kappa", row["kappa"]) is preset
    assert with_choice(preset, "norm", preset.schedule.norm) is preset
    back = with_level(with_level(preset, "schedule", 0, "kappa", 0.4), "schedule", 0, "kappa", row["kappa"])
    assert configuration_code(back) == f'hyjax.Configuration.preset("{name}")'


def test_a_choice_of_a_cascade() -> None:
    changed = with_choice(DEFAULT, "cascade", "32:2 8:4")
    assert changed.value("cascade") == "32:2 8:4"
    assert with_choice(changed, "data_term", False).value("data_term") is False
    assert with_choice(changed, "norm", "mean_abs").value("norm") == "mean_abs"
    assert with_choice(DEFAULT, "shadow_pass", "none").value("shadow_pass") == "none"
    assert with_choice(DEFAULT, "views", None) == DEFAULT


@pytest.mark.parametrize(
    "change",
    [
        lambda: with_level(DEFAULT, "schedule", 1, "steps", -1),
        lambda: with_level(DEFAULT, "schedule", 1, "steps", float("nan")),
        lambda: with_level(DEFAULT, "schedule", 1, "lam", 0.3),
        lambda: with_level(DEFAULT, "schedule", 1, "kappa", "x"),
        lambda: with_level(DEFAULT, "schedule", 9, "kappa", 0.1),
        lambda: with_level(DEFAULT, "light", 0, "kappa", 0.1),
        lambda: with_choice(DEFAULT, "cascade", "16:3 9:1"),
        lambda: with_choice(DEFAULT, "cascade", "soft"),
        lambda: with_choice(DEFAULT, "cascade", "0:1"),
        lambda: with_choice(DEFAULT, "scale", 99),
        lambda: with_choice(DEFAULT, "norm", "l7"),
        lambda: with_choice(DEFAULT, "kapa", 1.0),
    ],
)
def test_what_cannot_be_is_one_line(change: Any) -> None:
    with pytest.raises(hyjax.InputError):
        change()


def test_a_configuration_is_written_as_code() -> None:
    own = with_level(DEFAULT, "schedule", 0, "kappa", 0.123).with_choices({"bounces": False, "views": 8})
    for configuration in (DEFAULT, own, *map(hyjax.Configuration.preset, ("paper", "fast"))):
        again = eval(configuration_code(configuration), {"hyjax": hyjax})
        for name in CHOICES:
            assert again.value(name) == configuration.value(name), name


def test_settings_and_lights_are_written_as_code() -> None:
    opening = hyjax.Aperture(np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    sun = hyjax.DirectionalLight(np.array([0.6, 0.0, -0.8]), 900.0, np.float32([1, 0.9, 0.7]), 0.01, opening)
    setup = hyjax.LightSetup((sun, hyjax.AmbientLight(60.0, np.ones(3))), 123.4, {"window": (0.1, 0.2, 0.3)})
    settings = hyjax.SceneSettings(size="64x48", seed=3)
    text = script(settings, 2, setup, DEFAULT)
    places: dict[str, Any] = {}
    lines = [line for line in text.splitlines() if line.startswith(("import", "from", "lights"))]
    exec("\n".join(lines), places)
    assert same_setup(places["lights"], setup)
    assert "SceneSettings(size='64x48', seed=3)" in text


def test_drafts_have_the_cells_of_the_whole() -> None:
    small = draft_of(DEFAULT).check()
    assert [level.factor for level in small.schedule.levels] == [4, 2, 1]
    assert small.scale == 2 * DEFAULT.sampled().scale == 4 and small.light.sampling == 1
    assert small.shadows == DEFAULT.shadows  # the photo's light needs them whole
    kept = DEFAULT.with_choices({"photo_light": "kept"})
    assert draft_of(kept).shadows.map_scale < DEFAULT.shadows.map_scale


@pytest.mark.parametrize("first", ["16:3 8:7 4:6", "4:6 2:6", "16:50 4:6", "4:6 1:12"])
def test_all_counts_of_a_slider_have_one_shape(first: str) -> None:
    pictures: Any = Pictures(cast(Any, None))
    pictures.fills, whole, drafts = True, set(), set()
    begun = with_choice(DEFAULT, "cascade", first)
    for index, end in enumerate(pictures.ends(begun)["schedule"]):
        for count in (*range(end + 1), 0):
            changed = with_level(begun, "schedule", index, "steps", count)
            run = pictures._as_run(changed).check()
            whole.add(tuple(level.steps for level in run.schedule.levels))
            drafts.add(tuple(level.steps for level in draft_of(run).check().schedule.levels))
            assert pictures.ends(changed) == pictures.ends(begun)  # where the page's slider ends
    assert len(whole) == 1 == len(drafts)


def test_long_levels_are_filled_no_further_than_others_may_be() -> None:
    long = with_level(DEFAULT, "schedule", 0, "steps", 200)
    assert slider_ends(long)["schedule"][0] == 200
    for count, steps in ((200, 200), (65, 65), (64, 64), (9, 64)):
        changed = with_level(long, "schedule", 0, "steps", count)
        assert filled(changed, slider_ends(long)).schedule.levels[0].steps == steps


def test_the_newest_request_wins() -> None:
    value, begun, go = [0], [], threading.Event()

    def work(draft: bool) -> bool:
        begun.append((value[0], draft))
        go.wait(10.0)
        return draft

    newest = Newest(work)
    newest.request(draft=True)
    while not begun:
        pass
    for number in range(1, 20):
        value[0] = number
        newest.request(draft=True)
    assert not newest.superseded  # what a draft's request began is finished
    go.set()
    assert newest.wait(10.0)
    assert begun == [(0, True), (19, True), (19, False)]  # the last draft at rest, whole


def test_pictures_appear_while_a_control_is_moved() -> None:
    finished = []

    def work(draft: bool) -> bool:
        for _ in range(3):  # stages, each slower than the requests come
            time.sleep(0.01)
            if newest.superseded:
                return False
        finished.append(draft)
        return draft

    newest = Newest(work)
    end = time.monotonic() + 20.0
    while finished.count(True) < 2 and time.monotonic() < end:
        newest.request(draft=True)
        time.sleep(0.002)
    assert finished.count(True) >= 2 and newest.wait(10.0) and finished[-1] is False


def test_a_whole_is_dropped_for_a_newer_request() -> None:
    begun, go, seen = threading.Event(), threading.Event(), []

    def work(draft: bool) -> bool:
        begun.set()
        go.wait(10.0)
        seen.append(newest.superseded)
        return False

    newest = Newest(work)
    newest.request()
    assert begun.wait(10.0)
    newest.request(draft=True)
    go.set()
    assert newest.wait(10.0) and seen == [True, False]


def test_work_that_fails_is_done_and_its_thread_waits_not_for_itself() -> None:
    waited: list[bool] = []

    def work(draft: bool) -> bool:
        if draft:
            raise RuntimeError("of a test")
        waited.append(newest.wait())
        return False

    newest = Newest(work)
    newest.request(draft=True)
    assert newest.wait(10.0)
    newest.request()
    assert newest.wait(10.0) and waited == [False]
