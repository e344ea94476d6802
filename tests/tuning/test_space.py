"""The space of configurations: every choice in it makes a configuration that can be run and read back."""

import json
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hyjax.configuration import PRESETS, Configuration
from hyjax.sweep.spec import random_configurations
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.space import Parameter, Space, key_of, structure
from hyjax.util.errors import InputError

SPACES = [Space.of(truth=True), Space.of(truth=False), Space.of(truth=True, paper=True)]


@st.composite
def chosen(draw: st.DrawFn) -> tuple[Space, dict[str, Any]]:
    """A space with some choices of it, inactive ones among them."""
    space = draw(st.sampled_from(SPACES))
    some = draw(st.lists(st.sampled_from(space.parameters), unique_by=lambda p: p.name))
    return space, {p.name: draw(_value(p)) for p in some}


def _value(parameter: Parameter) -> st.SearchStrategy[Any]:
    if parameter.factor:
        return st.integers(0, MOST_STEPS)
    if parameter.continuous:
        own = st.floats(*parameter.values)
        return own | st.lists(own, min_size=1, max_size=4).map(tuple)
    return st.sampled_from(parameter.values)


@given(chosen())
def test_choices_make_configurations(given: tuple[Space, dict[str, Any]]) -> None:
    space, some = given
    choices = space.complete(some)
    assert space.complete(choices) == choices
    sampling = {"sampling": choices["sampling"]} if "sampling" in choices else {}
    asked = {n: v for n, v in some.items() if n in choices and not isinstance(v, tuple)} | sampling
    assert asked.items() <= choices.items() and choices.get("sampling", 1) <= some.get("sampling", 2)
    configuration = space.configuration(choices)
    assert configuration.light.sampling == choices.get("sampling", 1), "what is asked is what runs"
    again = Configuration.from_json(configuration.to_json())
    assert again.to_json() == configuration.to_json()
    assert space.complete(json.loads(json.dumps(choices))) == choices, "a journal keeps them as JSON"


@given(chosen())
def test_what_is_inactive_is_dropped(given: tuple[Space, dict[str, Any]]) -> None:
    """And only that; it decides on nothing."""
    space, some = given
    some = {name: value for name, value in some.items() if not isinstance(value, tuple)}
    choices = space.complete(some)
    whole = {p.name: p.default for p in space.parameters} | some
    for parameter in space.parameters:
        assert (parameter.name in choices) == bool(parameter.active(space.seen(whole)))
    configuration = space.configuration(choices)
    assert space.configuration({name: whole[name] for name in choices}).to_json() == configuration.to_json()


@given(chosen(), st.integers(0, 2**31), st.floats(0, 1))
def test_mutations_and_changes_are_valid(given: tuple[Space, dict[str, Any]], seed: int, rate: float) -> None:
    space, some = given
    choices = space.complete(some)
    mutated = space.mutated(choices, np.random.default_rng(seed), rate)
    assert space.complete(mutated) == mutated
    assert space.mutated(choices, np.random.default_rng(seed), 0.0) == choices
    discrete = [p for p in space.parameters if not p.continuous and p.name in choices]
    changes = space.changes(choices)
    asked = [p for p in discrete if p.name != "sampling"]
    counts = [sum(len(p.others(choices[p.name])) for p in several) for several in (asked, discrete)]
    assert counts[0] <= len(changes) <= counts[1]
    for change in changes:
        assert space.complete(change) == change and change != choices
        changed = [p.name for p in discrete if p.name in change and change[p.name] != choices[p.name]]
        if len(changed) > 1:  # the cascades of the other do not allow the sampling
            assert change["sampling"] < choices["sampling"] and "sampling" in changed
            changed.remove("sampling")
        assert len(changed) == 1


@given(st.sampled_from([p for space in SPACES for p in space.parameters if p.continuous]), st.floats(-1, 2))
def test_places_of_ranges(parameter: Parameter, place: float) -> None:
    low, high = parameter.values
    value = parameter.at(place)
    assert low <= value <= high
    assert parameter.place(value) == pytest.approx(np.clip(place, 0, 1), abs=1e-9)


def test_the_default_is_the_default() -> None:
    space = SPACES[0]
    made = json.loads(space.configuration(space.default, "default").to_json())
    usual = json.loads(Configuration().to_json())
    for name in ("light", "shadows", "guide", "mode", "scale"):
        assert made[name] == usual[name]
    for name in ("schedule", "shadow_schedule"):
        assert made[name]["levels"] == usual[name]["levels"]
    for parameter in ("pooling", "upsampling", "norm"):
        assert made["schedule"][parameter] == usual["schedule"][parameter]


def test_what_is_inactive_by_default() -> None:
    space = SPACES[0]
    assert "guide_size" not in space.default and "kappa" in space.default
    plain = space.complete({"guide": "none", "photo_light": "kept", "data_term": False, "fidelity": 0.5})
    gone = {"kappa", "norm", "pooling", "upsampling", "bounces", "bounce_gain", "photo_exponent", "fidelity"}
    assert not gone & plain.keys()
    assert space.complete({"guide": "small", "guide_size": 128})["guide_size"] == 128


@pytest.mark.parametrize(
    ("choices", "named"),
    [
        ({"kapa": 0.1}, "no parameter 'kapa'"),
        ({"scale": 7}, "scale 7"),
        ({"kappa": 5.0}, "kappa 5.0"),
        ({"kappa": float("nan")}, "kappa nan"),
        ({"guide": "large"}, "guide 'large'"),
        ({"kappa": "much"}, "kappa 'much'"),
        ({"kappa": (0.1, 5.0)}, r"kappa \(0.1, 5.0\)"),
        ({"cascade_8": 65}, "cascade_8 65"),
        ({"cascade": "64:3"}, "cascade has no level of factor 64"),
        ({"cascade": "8-3"}, "cascade '8-3'"),
    ],
)
def test_errors_name_the_parameter(choices: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named) as caught:
        SPACES[0].complete(choices)
    assert "\n" not in str(caught.value)


def test_keys_tell_choices_apart() -> None:
    space = SPACES[0]
    one, other = space.complete({"kappa": 0.1}), space.complete({"kappa": 0.2})
    assert key_of(one) != key_of(other) and structure(one, space) == structure(other, space)
    assert key_of(dict(reversed(one.items()))) == key_of(one)
    assert structure(space.complete({"scale": 2}), space) != structure(one, space)


def test_levels_are_parameters() -> None:
    """Any steps of any level, with one number for all of them or one for each; text of both cascades is taken."""
    space = SPACES[0]
    choices = space.complete({"cascade": "8:5 2:7", "shadow_pass": "none", "kappa": (0.1, 0.2)})
    assert (choices["cascade_16"], choices["cascade_8"], choices["cascade_2"]) == (0, 5, 7)
    assert choices["sampling"] == 1 and "shadow_kappa" not in choices
    own = space.configuration(choices)
    assert own.value("cascade") == "8:5 2:7" and own.value("shadow_pass") == "none"
    np.testing.assert_allclose(own.value("kappa"), (0.1, 0.2), rtol=1e-6)
    assert space.choices_of(own)["cascade_8"] == 5 and len(space.choices_of(own)["kappa"]) == 2
    assert space.complete(choices | {"cascade_4": 3})["kappa"] == pytest.approx(0.1 * 2**0.5)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_in_the_space(name: str) -> None:
    own = Configuration.preset(name)
    again = SPACES[0].configuration(SPACES[0].choices_of(own))
    for choice in ("cascade", "shadow_pass", "scale", "map_scale", "views", "norm", "photo_exponent"):
        assert again.value(choice) == own.value(choice), choice
    np.testing.assert_allclose(again.value("kappa"), own.value("kappa"), rtol=1e-5)


def test_random_configurations_are_the_same_for_a_seed() -> None:
    made = [[c.to_json() for c in random_configurations(4, seed)] for seed in (3, 3, 4)]
    assert made[0] == made[1] != made[2] and len(set(made[0])) == 4


def test_held_choices_keep_their_value() -> None:
    space = Space.of(truth=True, held={"light_edges": False, "photo_exponent": 1.1, "scale": 2})
    assert not {"light_edges", "photo_exponent", "scale"} & space.named.keys()
    rng = np.random.default_rng(0)
    for choices in (space.default, space.random(rng), space.choices_of(Configuration.preset("quality"))):
        own = space.configuration(choices)
        assert (own.light.edges, own.light.photo_exponent, own.scale) == (False, 1.1, 2)


def test_a_page_is_offered_what_it_follows() -> None:
    page, tour = (Space.of(truth=True, renderer=renderer) for renderer in ("page", "tour"))
    followed = [p for p in SPACES[0].parameters if p.name != "light_edges"]
    assert list(tour.parameters) == followed and tour.fixed == {"light_edges": False}, "a tour follows all others"
    left = SPACES[0].named.keys() - page.named.keys()
    assert {"scale", "guide", "views", "least_share", "photo_light"} <= left and "kappa" in page.named
    rng = np.random.default_rng(0)
    for choices in (
        page.default,
        *(page.random(rng) for _ in range(20)),
        page.choices_of(Configuration.preset("fast")),
    ):
        own = page.configuration(choices)
        assert own.followed_by("page", say=False) == own and own.scale == 1
    assert all(page.configuration(c).guide.name == "rgb" for c in page.changes(page.default))
