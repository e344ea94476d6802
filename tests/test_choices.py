"""Table of choices: a row is all that a new choice needs, and what does not follow it says so."""

import dataclasses
import logging
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
import pytest

import hyjax
from hyjax.choices.choice import RENDERERS, Choice, Tried
from hyjax.choices.table import CHOICES, register_choice
from hyjax.configuration import PRESETS, Configuration, LightOptions
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import load_room
from hyjax.info import print_choices
from hyjax.light.photo_light import SurfaceLight
from hyjax.relighting.settings import RelightSettings
from hyjax.sweep.spec import random_configurations
from hyjax.tuning.report_text import configuration_text
from hyjax.tuning.space import Space
from hyjax.util.errors import InputError


def tinted(light: SurfaceLight, tint: float) -> SurfaceLight:
    """Light whose bounces are more colourful, or less."""
    if light.bounced is None or tint == 1.0:
        return light
    grey = jnp.mean(light.bounced, axis=-1, keepdims=True)
    return dataclasses.replace(light, bounced=jnp.maximum(grey + tint * (light.bounced - grey), 0.0))


TINT = Choice(
    "bounce_tint",
    "light.bounce_tint",
    float,
    1.0,
    "How colourful bounces are.",
    bounds=(0.0, 4.0),
    tried=Tried((0.0, 2.0), scale="linear"),
    truth=True,
    active=lambda values: values["photo_light"] == "divided" and values["bounces"],
    said=("webgpu", "page"),
    use=tinted,
)


@pytest.fixture
def row() -> Iterator[Choice]:
    """A choice from outside."""
    before = Configuration()
    register_choice(TINT)
    assert before.light.bounce_tint == 1.0 and before.light == Configuration().light
    yield TINT
    del CHOICES[TINT.name]


@pytest.mark.slow
def test_a_choice_from_outside_is_relit(row: Choice) -> None:
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    scene = hyjax.Scene.open(hyjax.SceneSettings(), capture=room)

    def picture(tint: float) -> np.ndarray:
        configuration = Configuration().with_choices({"bounce_tint": tint})
        return np.asarray(scene.relit(0, "evening-lamps", configuration).image)

    usual = np.asarray(scene.relit(0, "evening-lamps").image)
    np.testing.assert_array_equal(picture(1.0), usual)
    change = [float(np.abs(picture(tint) - usual).mean()) for tint in (0.5, 0.0)]
    assert 0 < change[0] < change[1]


def test_a_choice_from_outside_is_written_and_read(row: Choice) -> None:
    own = Configuration().with_choices({"bounce_tint": 0.25})
    assert '"bounce_tint": 0.25' in own.to_json()
    assert Configuration.from_json(own.to_json()).light == own.light != Configuration().light
    for bad in (9.0, "much", True, float("nan")):
        with pytest.raises(InputError, match="bounce_tint"):
            Configuration().with_choices({"bounce_tint": bad})
    with pytest.raises(InputError, match="bounce_tint"):
        Configuration.from_json(own.to_json().replace("0.25", "9.0"))


def test_a_choice_from_outside_is_an_option(row: Choice) -> None:
    settings = RelightSettings(choices=("bounce_tint=0.5", "bounces=true", "views=4")).check()
    light = settings.open_configuration().light
    assert (light.bounce_tint, light.bounces) == (0.5, True)
    assert settings.open_configuration().shadows.views == 4


def test_a_choice_from_outside_is_searched_and_reported(row: Choice) -> None:
    space = Space.of(truth=True)
    assert space.default["bounce_tint"] == 1.0 and "bounce_tint" not in Space.of(truth=False).default
    choices = space.complete({"bounce_tint": 0.0})
    made = space.configuration(choices)
    assert made.light.bounce_tint == 0.0 and "bounce_tint 0" in configuration_text(made)
    assert "bounce_tint" not in space.complete({"bounces": False, "bounce_tint": 0.5})
    drawn = [made.light.bounce_tint for made in random_configurations(40, 0)]
    assert min(drawn) < 0.5 and max(drawn) > 1.5 and all(0 <= value <= 2 for value in drawn)


def test_what_is_not_followed_is_said_once(row: Choice, caplog: pytest.LogCaptureFixture) -> None:
    own = Configuration(name="mine").with_choices({"bounce_tint": 0.5, "photo_exponent": 1.2, "views": 4})
    with caplog.at_level(logging.WARNING):
        page = own.followed_by("page")
    (line,) = caplog.messages
    assert line == "configuration mine: not followed by exported pages: views, bounce_tint"
    assert (page.light.bounce_tint, page.light.photo_exponent, page.shadows.views) == (1.0, 1.2, None)
    assert own.followed_by("tour").light.bounce_tint == 0.5


def test_rows_are_added_once_and_have_a_part(row: Choice) -> None:
    with pytest.raises(InputError, match="there already"):
        register_choice(row)
    for field in ("sound.other", "other", "schedule.other"):
        with pytest.raises(InputError, match=r"must be in one of light\., shadows\., guide\."):
            register_choice(dataclasses.replace(row, name="other", field=field))
    with pytest.raises(InputError, match="'values' cannot be the name of an option"):
        register_choice(dataclasses.replace(row, name="other", field="light.values"))
    with pytest.raises(InputError, match=r"its default 9.0 is not within 0.0 to 4.0"):
        register_choice(dataclasses.replace(row, name="other", field="light.other", default=9.0))


@pytest.mark.parametrize(
    "configuration", [5, 0, {}, Configuration(scale=0), Configuration(light=LightOptions(photo_light="left"))]
)
def test_what_is_no_configuration_is_refused(configuration: object) -> None:
    with pytest.raises(InputError, match=r"^configuration"):
        Configuration.of(configuration)  # type: ignore[arg-type]


def test_text_of_options_and_numbers_of_numpy_are_taken() -> None:
    chosen = Configuration().with_choices({"views": "none", "scale": np.int64(2)})
    assert chosen.shadows.views is None and chosen.scale == 2


def test_defaults_are_those_of_the_default() -> None:
    """Of the cascades too, which the table and the presets of schedules both tell."""
    default, space = Configuration(), Space.of(truth=True)
    for name, choice in CHOICES.items():
        value = default.value(name)
        values = set(np.round(value, 6)) if isinstance(value, tuple) else {value}
        assert values == {choice.default}, name
    assert {p.cascade or p.name for p in space.parameters} <= CHOICES.keys()


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"bounce": False}, "did you mean"),
        ({"scale": 9}, "scale"),
        ({"sampling": 0}, "sampling"),
        ({"light_edges": "maybe"}, "true or false"),
        ({"photo_light": "left"}, "photo_light"),
        ({"kappa": 0.1}, "give another schedule"),
    ],
)
def test_bad_choices_are_one_line(choices: dict, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        Configuration().with_choices(choices)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["bounces", "bounces=perhaps", "=1", "bounce=true"])
def test_bad_options_are_one_line(text: str) -> None:
    with pytest.raises(InputError, match="choices: "):
        RelightSettings(choices=(text,)).check()


def test_what_a_renderer_refuses() -> None:
    for renderer in RENDERERS:
        if renderer not in ("blender", "frames"):
            with pytest.raises(InputError, match="mode paper is not for"):
                Configuration.paper().followed_by(renderer)
    with pytest.raises(InputError, match="scale 2 is not for --video"):
        RelightSettings(video=True, choices=("scale=2",)).check()
    with pytest.raises(InputError, match="photo_light kept is not for exported pages"):
        Configuration().with_choices({"photo_light": "kept"}).followed_by("page")


def test_a_configuration_says_the_sampling_that_runs() -> None:
    assert [Configuration.preset(name).light.sampling for name in PRESETS] == [2, 2, 2]
    fine = Configuration.of(Schedule.preset("naive-50"))
    assert (
        fine.light.sampling
        == 1
        == Configuration(mode="paper", light=LightOptions(photo_light="kept")).light.sampling
    )
    assert Configuration(light=LightOptions(sampling=16)).light.sampling == 2


def test_files_say_what_they_do_not_follow(caplog: pytest.LogCaptureFixture) -> None:
    own = Configuration().with_choices({"map_scale": 0.5, "bounce_gain": 2.0})
    own.followed_by("file")
    assert "custom: not followed by files for other runtimes: map_scale, bounce_gain" in caplog.text


def test_choices_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    print_choices()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(CHOICES)
    assert all(choice.help in line for line, choice in zip(lines, CHOICES.values(), strict=True))
