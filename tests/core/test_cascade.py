"""Eq. 4 against the literal loops, the schedules that drive it, and its gradients."""

import dataclasses
import itertools
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import paper
from reference.differences import assert_gradients

from hyjax import (
    InputError,
    Level,
    Schedule,
    cascade,
    conductance,
    diffuse,
    downsample,
    guided_upsample,
    level_edges,
    step_cycle,
    upsample,
)
from hyjax.core.cycles import longest_time
from hyjax.core.schedule import PRESETS

pytestmark = pytest.mark.usefixtures("strict_ranks")


def picture(seed: int, size: tuple[int, int], channels: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 2.0, (*size, channels))


def schedule_of(factors: list[tuple[int, int]], seed: int, **options: Any) -> Schedule:
    """Random λ for every step and random κ for every level."""
    rng = np.random.default_rng(seed)
    levels = [Level(f, rng.uniform(0.02, 0.249, n), rng.uniform(0.2, 2.0)) for f, n in factors]
    return Schedule(tuple(levels), **options)


def guided_schedule(factors: list[tuple[int, int]], seed: int) -> Schedule:
    """Ours: guides pooled and upsampled under, and a random α for every level but the second."""
    schedule = schedule_of(factors, seed, pooling="guide", upsampling="guide")
    pulls = np.random.default_rng(seed).uniform(0.05, 2.0, len(factors))
    levels = [
        dataclasses.replace(level, fidelity=None if k == 1 else pull)
        for k, (level, pull) in enumerate(zip(schedule.levels, pulls, strict=True))
    ]
    return dataclasses.replace(schedule, levels=tuple(levels))


def guided(y: np.ndarray, guide: np.ndarray, schedule: Schedule) -> np.ndarray:
    """`cascade` of any schedule: guided upsampling, no equation of the paper's, relies on rank promotion."""
    with jax.numpy_rank_promotion("allow"):
        return np.asarray(cascade(jnp.asarray(y), jnp.asarray(guide), schedule))


CASES = [
    ((17, 13), [(8, 3), (4, 2), (2, 4)]),
    ((9, 14), [(6, 2), (3, 0), (1, 3)]),
    ((5, 7), [(16, 2), (4, 2)]),
    ((1, 11), [(2, 3)]),
]


@pytest.mark.parametrize(("pooling", "norm"), [("edges", "l2"), ("guide", "l2"), ("edges", "mean_abs")])
@pytest.mark.parametrize("case", CASES)
def test_against_the_literal_form(case: tuple, pooling: str, norm: str) -> None:
    size, factors = case
    y, guide = picture(0, size, 3), picture(9, size, 2)
    schedule = schedule_of(factors, 0, pooling=pooling, norm=norm)
    levels = [(level.factor, level.step_sizes, level.kappa) for level in schedule.levels]
    expected = paper.cascade(y, guide, levels, pooling, norm)
    with jax.enable_x64(True):
        got = cascade(jnp.asarray(y), jnp.asarray(guide), schedule)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-12)
    got = cascade(jnp.asarray(y, jnp.float32), jnp.asarray(guide, jnp.float32), schedule)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.parametrize("pooling", ["edges", "guide"])
def test_level_edges_are_the_literal_ones(pooling: str) -> None:
    guide = picture(0, (17, 13), 3)
    schedule = schedule_of([(8, 1), (2, 1)], 0, pooling=pooling)
    with jax.enable_x64(True):
        for level, edges in zip(schedule.levels, level_edges(jnp.asarray(guide), schedule), strict=True):
            if pooling == "edges":
                want = paper.min_pool(paper.conductance(guide, level.kappa), level.factor)
            else:
                want = paper.conductance(paper.downsample(guide, level.factor), level.kappa)
            for a, b in zip(edges, want, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-12)


def test_naive_is_plain_diffusion_between_down_and_up() -> None:
    size = (18, 27)
    y, guide = (jnp.asarray(picture(k, size, 3), jnp.float32) for k in (0, 1))
    schedule = dataclasses.replace(Schedule.preset("naive-50", kappa=0.6), pooling="guide")
    plain = diffuse(downsample(y, 2), conductance(downsample(guide, 2), 0.6), np.full(50, 0.24, np.float32))
    np.testing.assert_allclose(cascade(y, guide, schedule), upsample(plain, 2, size), atol=2e-6)


def test_flip_symmetry() -> None:
    size = (16, 24)
    y, guide = (picture(k, size, 2) for k in (0, 1))
    schedule = schedule_of([(8, 3), (2, 3)], 0)
    with jax.enable_x64(True):
        plain = np.asarray(cascade(jnp.asarray(y), jnp.asarray(guide), schedule))
        for turn in (lambda a: a[::-1], lambda a: a[:, ::-1], lambda a: a.transpose(1, 0, 2)):
            got = cascade(jnp.asarray(turn(y)), jnp.asarray(turn(guide)), schedule)
            np.testing.assert_allclose(got, turn(plain), rtol=1e-11, atol=1e-13)


def test_range_and_mean_are_kept() -> None:
    y, guide = (jnp.asarray(picture(k, (16, 24), 3), jnp.float32) for k in (0, 1))
    out = np.asarray(cascade(y, guide, Schedule.uniform([(8, 9), (4, 9)])))
    assert out.min() >= y.min() and out.max() <= y.max()
    np.testing.assert_allclose(out.mean((0, 1)), np.mean(y, (0, 1)), atol=1e-5)


@pytest.mark.parametrize("kind", ["edges", "guide", "ours"])
def test_gradients_reach_everything(kind: str) -> None:
    """λ of every step, κ and α of every level, the guide and the filter, for both readings of the pooling."""
    size = (7, 10)
    y, guide, target = (picture(k, size, 2) for k in (0, 1, 2))
    factors = [(4, 2), (2, 3)]
    schedule = guided_schedule(factors, 3) if kind == "ours" else schedule_of(factors, 3, pooling=kind)

    def loss(y: jax.Array, guide: jax.Array, schedule: Schedule) -> jax.Array:
        return jnp.sum((cascade(y, guide, schedule) - target) ** 2)

    with jax.enable_x64(True), jax.numpy_rank_promotion("allow" if kind == "ours" else "raise"):
        *_, gradient = assert_gradients(loss, y, guide, schedule)
        # every single entry: each step and each level matters
        for level in gradient.levels:
            assert np.all(np.asarray(level.step_sizes) != 0) and level.kappa != 0
        assert (gradient.levels[0].fidelity is not None) == (kind == "ours")


# ---- beyond the paper: a data term, guided upsampling, cycles ----


def test_our_cascade_is_made_of_its_pieces() -> None:
    """Each level holds on to its own cell means; interpolation follows the κ of the level it comes from."""
    size, schedule = (9, 14), guided_schedule([(6, 2), (3, 0), (1, 3)], 1)
    with jax.enable_x64(True), jax.numpy_rank_promotion("allow"):
        y, guide = jnp.asarray(picture(0, size, 3)), jnp.asarray(picture(1, size, 2))
        before, state = schedule.levels[0], downsample(y, schedule.levels[0].factor)
        for level in schedule.levels:
            features = downsample(guide, level.factor)
            state = guided_upsample(state, before.factor // level.factor, features, before.kappa)
            held = {"fidelity": level.fidelity, "source": downsample(y, level.factor)}
            options = {} if level.fidelity is None else held
            state = diffuse(state, conductance(features, level.kappa), level.step_sizes, **options)
            before = level
        expected = guided_upsample(state, before.factor, guide, before.kappa)
        np.testing.assert_allclose(guided(y, guide, schedule), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(
    ("size", "factors"),
    [((17, 13), [(4, 2), (2, 4)]), ((9, 14), [(6, 2), (1, 3)]), ((1, 11), [(4, 2)]), ((1, 1), [(16, 2)])],
)
def test_our_cascade_is_linear_and_keeps_range_and_constants(
    size: tuple[int, int], factors: list[tuple[int, int]]
) -> None:
    """At every size, under a rough guide."""
    schedule = guided_schedule(factors, 2)
    with jax.enable_x64(True):
        one, two, guide = (picture(k, size, 3) for k in (0, 1, 2))
        first, second, mixed = (guided(y, guide, schedule) for y in (one, two, 2.0 * one - 0.3 * two))
        np.testing.assert_allclose(mixed, 2.0 * first - 0.3 * second, rtol=1e-10, atol=1e-12)
        assert np.all(first >= one.min((0, 1)) - 1e-12) and np.all(first <= one.max((0, 1)) + 1e-12)
        np.testing.assert_allclose(guided(np.full_like(one, 0.3), guide, schedule), 0.3, rtol=1e-12)


def test_our_cascade_of_a_mirrored_picture_is_mirrored() -> None:
    schedule = guided_schedule([(4, 2), (2, 3)], 0)
    with jax.enable_x64(True):
        y, guide = (picture(k, (8, 12), 2) for k in (0, 1))
        plain = guided(y, guide, schedule)
        for turn in (lambda a: a[::-1], lambda a: a[:, ::-1]):
            np.testing.assert_allclose(guided(turn(y), turn(guide), schedule), turn(plain), rtol=1e-11, atol=1e-13)


def test_the_data_term_brings_back_what_coarse_levels_lost() -> None:
    """The more, the larger α; with α → ∞ at full resolution all of it. α = 0 is no data term."""
    y, guide = (picture(k, (16, 24), 2).astype(np.float32) for k in (0, 1))

    def lost(pull: float | None) -> float:
        schedule = Schedule.uniform([(4, 3), (1, 3)], kappa=1.0, fidelity=pull)
        return float(np.abs(guided(y, guide, schedule) - y).mean())

    errors = [lost(pull) for pull in (None, 0.1, 1.0, 10.0, 1e6)]
    assert all(a > 1.05 * b for a, b in itertools.pairwise(errors)) and errors[-1] < 1e-5
    assert lost(0.0) == pytest.approx(errors[0], rel=1e-5)


def test_guided_upsampling_does_not_leak() -> None:
    """Two halves of different value, whose border is one of cells: guided they stay apart to the pixel."""
    side = (np.arange(24) >= 8)[None, :, None] * np.ones((16, 1, 1), np.float32)
    sharp, bilinear = (
        guided(side, side, Schedule.uniform([(8, 3)], kappa=0.01, upsampling=upsampling))
        for upsampling in ("guide", "bilinear")
    )
    np.testing.assert_allclose(sharp, side, atol=2e-3)
    assert np.abs(bilinear - side).max() > 0.3


def test_cycles_in_a_schedule() -> None:
    """Taken by `check`, kept by JSON, and run as `diffuse` runs them."""
    cycles = [step_cycle(n, longest_time(n)) for n in (30, 7)]
    assert all(cycle.max() > 0.25 for cycle in cycles)
    schedule = Schedule((Level(4, cycles[0], 1e6), Level(2, cycles[1], 1e6, np.float32(0.25)))).check()
    again = Schedule.from_json(schedule.to_json())
    for a, b in zip(again.levels, cycles, strict=True):
        np.testing.assert_array_equal(a.step_sizes, b)
    y = jnp.asarray(picture(0, (16, 24), 2), jnp.float32)
    open_edges = [conductance(downsample(y, factor), 1e6) for factor in (4, 2)]
    coarse = diffuse(downsample(y, 4), open_edges[0], cycles[0])
    fine = diffuse(upsample(coarse, 2, (8, 12)), open_edges[1], cycles[1], fidelity=0.25, source=downsample(y, 2))
    np.testing.assert_allclose(cascade(y, y, again), upsample(fine, 2, (16, 24)), atol=1e-5)


def test_a_cycle_too_long_for_half_precision_is_refused() -> None:
    """As `diffuse` does."""
    y, schedule = jnp.ones((4, 4, 1)), Schedule((Level(1, step_cycle(54, longest_time(54)), 0.5),))
    with pytest.raises(InputError, match=r"^schedule custom, factor 1, lam: .* too much for float16; use"):
        cascade(y.astype(jnp.float16), y, schedule)
    np.testing.assert_allclose(cascade(y, y.astype(jnp.float16), schedule), y, rtol=1e-5)


def test_our_preset() -> None:
    """Guided throughout, with a data term. κ can be changed by itself."""
    schedule = Schedule.preset("hyjax")
    assert (schedule.pooling, schedule.upsampling, schedule.name) == ("guide", "guide", "hyjax")
    assert all(level.fidelity > 0 for level in schedule.levels) and schedule.levels[-1].factor <= 4
    assert Schedule.from_json(schedule.to_json()).to_json() == schedule.to_json()
    other = Schedule.preset("hyjax", kappa=0.5, lam=0.125)
    for ours, level in zip(schedule.levels, other.levels, strict=True):
        assert level.kappa == 0.5 != ours.kappa and np.all(level.step_sizes == 0.125)
        assert (level.factor, level.steps, level.fidelity) == (ours.factor, ours.steps, ours.fidelity)
    assert other.upsampling == "guide"


# ---- presets, JSON and tables ----


def test_jit_and_vmap() -> None:
    batch = jnp.asarray(np.stack([picture(k, (16, 24), 3) for k in range(3)]), jnp.float32)
    schedule = Schedule.uniform([(8, 9), (4, 9)])
    mapped = jax.jit(jax.vmap(cascade, in_axes=(0, 0, None)))(batch, batch, schedule)
    for one, y in zip(mapped, batch, strict=True):
        np.testing.assert_allclose(one, cascade(y, y, schedule), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("paper-50", {32: 5, 64: 10, 128: 15, 256: 20}),
        ("paper-80", {32: 10, 64: 15, 128: 25, 256: 30}),
        ("naive-50", {256: 50}),
        ("naive-1000", {256: 1000}),
    ],
)
def test_presets_are_the_papers(name: str, sizes: dict[int, int]) -> None:
    """The paper writes size:steps for frames of 512²."""
    schedule = Schedule.preset(name)
    assert [(512 // level.factor, level.steps) for level in schedule.levels] == list(sizes.items())
    assert schedule.name == name and schedule.pooling == "edges" and schedule.norm == "l2"
    assert schedule.upsampling == "bilinear" and all(level.fidelity is None for level in schedule.levels)
    assert name in PRESETS


def test_preset_options_and_refusal() -> None:
    schedule = Schedule.preset("paper-50", kappa=0.5, lam=0.125)
    assert all(level.kappa == 0.5 and np.all(level.step_sizes == 0.125) for level in schedule.levels)
    with pytest.raises(
        InputError, match=r"^schedule: no preset 'paper-5' \(did you mean 'paper-[58]0'\?\); there are hyjax, "
    ):
        Schedule.preset("paper-5")


single = st.lists(st.floats(2**-12, 0.2490234375, width=32), max_size=5).map(lambda x: np.array(x, np.float32))
cycle = st.builds(lambda n, share: step_cycle(n, share * longest_time(n)), st.integers(1, 90), st.floats(0.1, 1.0))
steps = single | cycle


@st.composite
def schedules(draw: st.DrawFn) -> Schedule:
    factor, levels = 1, []
    for _ in range(draw(st.integers(1, 4))):
        kappa = np.float32(draw(st.floats(2**-20, 2**20, width=32)))
        held = draw(st.none() | st.floats(0, 2**20, width=32).map(np.float32))
        levels.append(Level(factor, draw(steps), kappa, held))
        factor *= draw(st.integers(2, 4))
    pooling, norm = draw(st.sampled_from(["edges", "guide"])), draw(st.sampled_from(["l2", "mean_abs"]))
    upsampling = draw(st.sampled_from(["bilinear", "guide"]))
    return Schedule(tuple(levels[::-1]), pooling, norm, draw(st.text(max_size=8)), upsampling)


@settings(max_examples=100)
@given(schedules())
def test_json_round_trip_is_exact(schedule: Schedule) -> None:
    again = Schedule.from_json(schedule.to_json())
    assert (again.pooling, again.norm, again.name) == (schedule.pooling, schedule.norm, schedule.name)
    assert again.upsampling == schedule.upsampling
    for a, b in zip(again.levels, schedule.levels, strict=True):
        assert a.factor == b.factor and a.kappa == b.kappa and a.kappa.dtype == np.float32
        assert a.fidelity == b.fidelity and (a.fidelity is None or a.fidelity.dtype == np.float32)
        assert a.step_sizes.dtype == np.float32
        np.testing.assert_array_equal(a.step_sizes, b.step_sizes)
    assert again.to_json() == schedule.to_json()


def test_json_is_short_and_by_hand() -> None:
    assert json.loads(Schedule.preset("naive-50", kappa=0.05).to_json())["levels"] == [
        {"factor": 2, "steps": 50, "lam": 0.24, "kappa": 0.05}
    ]
    assert set(json.loads(Schedule.preset("paper-50").to_json())) == {"name", "pooling", "norm", "levels"}
    by_hand = Schedule.from_json('{"levels": [{"factor": 2, "steps": 3, "kappa": 1}]}')
    assert by_hand.name == "custom" and np.all(by_hand.levels[0].step_sizes == np.float32(0.24))
    assert by_hand.upsampling == "bilinear" and by_hand.levels[0].fidelity is None


def test_json_tells_the_data_term_and_the_upsampling() -> None:
    schedule = Schedule.uniform([(2, 1)], kappa=1, fidelity=0.1, upsampling="guide")
    content = json.loads(schedule.to_json())
    assert content["upsampling"] == "guide"
    assert content["levels"] == [{"factor": 2, "steps": 1, "lam": 0.24, "kappa": 1.0, "fidelity": 0.1}]
    content["levels"][0]["fidelity"] = None
    assert Schedule.from_json(json.dumps(content)).levels[0].fidelity is None


def test_table() -> None:
    levels = (Level(4, np.array([0.1, 0.2]), 0.5), Level(2, np.zeros(0), 0.25))
    lines = str(Schedule(levels, name="mine")).splitlines()
    assert lines[0] == "mine: 2 steps, pooling edges, norm l2"
    assert [line.split() for line in lines[1:]] == [
        ["factor", "steps", "kappa", "lam"],
        ["4", "2", "0.5", "0.1..0.2"],
        ["2", "0", "0.25", "-"],
    ]
    assert len({len(line) for line in lines[1:]}) == 1, "columns are not aligned"
    seen = []
    jax.jit(lambda s: seen.append(str(s)))(Schedule(levels))
    assert seen[0].splitlines()[2].split() == ["4", "2", "traced", "traced"]


def test_table_of_ours() -> None:
    levels = (Level(4, np.array([0.1, 0.2]), 0.5, 0.125), Level(2, np.zeros(0), 0.25))
    schedule = Schedule(levels, name="mine", upsampling="guide")
    lines = str(schedule).splitlines()
    assert lines[0] == "mine: 2 steps, pooling edges, norm l2, upsampling guide"
    assert [line.split() for line in lines[1:]] == [
        ["factor", "steps", "kappa", "lam", "fidelity"],
        ["4", "2", "0.5", "0.1..0.2", "0.125"],
        ["2", "0", "0.25", "-", "-"],
    ]
    assert len({len(line) for line in lines[1:]}) == 1, "columns are not aligned"
    seen = []
    jax.jit(lambda s: seen.append(str(s)))(schedule)
    assert seen[0].splitlines()[2].split() == ["4", "2", "traced", "traced", "traced"]


LEVEL = Level(2, np.array([0.1]), 0.5)


@pytest.mark.parametrize(
    ("levels", "options", "message"),
    [
        ((), {}, "needs at least one level"),
        ((LEVEL,), {"pooling": "mean"}, "'mean' is unknown; use one of edges, guide"),
        ((LEVEL,), {"norm": "l1"}, "'l1' is unknown; use one of l2, mean_abs"),
        ((LEVEL,), {"upsampling": "nearest"}, "'nearest' is unknown; use one of bilinear, guide"),
        ((Level(0, np.array([0.1]), 0.5),), {}, "a factor is a whole number >= 1, got 0"),
        ((Level(-2, np.array([0.1]), 0.5),), {}, "a factor is a whole number >= 1, got -2"),
        ((Level(2.0, np.array([0.1]), 0.5),), {}, "a factor is a whole number >= 1, got 2.0"),
        ((LEVEL, LEVEL), {}, "coarse to fine, got factor 2 after 2"),
        ((LEVEL, dataclasses.replace(LEVEL, factor=4)), {}, "coarse to fine, got factor 4 after 2"),
        ((dataclasses.replace(LEVEL, factor=5), LEVEL), {}, "factor 5 is no multiple of the next finer factor 2"),
        ((dataclasses.replace(LEVEL, kappa=0.0),), {}, "factor 2, kappa: must be finite and > 0, got 0.0"),
        ((dataclasses.replace(LEVEL, kappa=float("nan")),), {}, "kappa: must be finite and > 0, got nan"),
        ((dataclasses.replace(LEVEL, fidelity=-0.5),), {}, "factor 2, fidelity: must be .* >= 0, got -0.5"),
        ((dataclasses.replace(LEVEL, fidelity=float("nan")),), {}, "factor 2, fidelity: .* got nan"),
        ((dataclasses.replace(LEVEL, fidelity=float("inf")),), {}, "factor 2, fidelity: .* got inf"),
        ((dataclasses.replace(LEVEL, step_sizes=np.array([0.3])),), {}, "factor 2, lam: .* got 0.3"),
        ((dataclasses.replace(LEVEL, step_sizes=np.array([0.25])),), {}, "factor 2, lam: .* got 0.25"),
        ((dataclasses.replace(LEVEL, step_sizes=np.array([0.1, 0.9])),), {}, "factor 2, lam: .* got 0.9"),
        ((dataclasses.replace(LEVEL, step_sizes=np.array([0.1, -1])),), {}, "factor 2, lam: .* got -1"),
    ],
)
def test_check_refuses(levels: tuple, options: dict, message: str) -> None:
    schedule = Schedule(levels, name="bad", **options)
    with pytest.raises(InputError, match=f"^schedule bad.*{message}"):
        schedule.check()
    with pytest.raises(InputError, match=f"^schedule bad.*{message}"):
        cascade(jnp.zeros((8, 8, 1)), jnp.zeros((8, 8, 1)), schedule)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[]", "must be a JSON object, got list"),
        ("{}", "key 'levels' is missing"),
        ('{"levels": 3}', "'levels' must be a list"),
        ('{"levels": [], "pool": 1}', "unknown key 'pool'"),
        ('{"levels": []}', "needs at least one level"),
        ('{"levels": [3]}', "level 0: must be a JSON object, got int"),
        ('{"levels": [{"factor": 2, "steps": 3}]}', "level 0: key 'kappa' is missing"),
        ('{"levels": [{"factor": 2, "steps": 3, "kappa": 1, "lamb": 1}]}', "level 0: unknown key 'lamb'"),
        ('{"levels": [{"factor": 2, "steps": 1.5, "kappa": 1}]}', "'steps' must be a whole number"),
        ('{"levels": [{"factor": 2, "steps": true, "kappa": 1}]}', "'steps' must be a whole number"),
        ('{"levels": [{"factor": 2, "steps": -1, "kappa": 1}]}', "'steps' must be a whole number"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": "x"}]}', "must be numbers"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "lam": [0.1]}]}', "'lam' has 1 entries for 2 steps"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "lam": [[0.1]]}]}', "'lam' must be numbers"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": [1, 2]}]}', "kappa"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": null}]}', "kappa"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "lam": 0.3}]}', "lam.*got 0.3"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": NaN}]}', "kappa.*got nan"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "fidelity": -1}]}', "fidelity: must.*got -1"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "fidelity": NaN}]}', "fidelity: must.*got nan"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "fidelity": "x"}]}', "'fidelity' must be numbers"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1, "fidelity": [1]}]}', "'fidelity' must be numbers"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1}], "upsampling": "cubic"}', "'cubic' is unknown"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1}], "upsampling": null}', "None is unknown"),
        ('{"levels": [{"factor": "2", "steps": 2, "kappa": 1}]}', "whole number >= 1, got '2'"),
        ('{"levels": [{"factor": true, "steps": 2, "kappa": 1}]}', "whole number >= 1, got True"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1}], "norm": ["l2"]}', "unknown"),
        ('{"levels": [{"factor": 2, "steps": 2, "kappa": 1}], "name": 3}', "name"),
    ],
)
def test_bad_json_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^schedule.*{message}"):
        Schedule.from_json(text)


def test_negative_steps_and_sizes_that_differ_are_refused() -> None:
    with pytest.raises(InputError, match=r"^steps: schedule custom must have 0 to 100000 .*, got -1 at factor 2$"):
        Schedule.uniform([(2, -1)])
    for y, guide in (((4, 4, 1), (4, 5, 1)), ((4, 4), (4, 4, 1)), ((4, 4, 1), (4, 4))):
        with pytest.raises(InputError, match=r"^cascade: filter .* same H x W$|^(y|guide): must be a float array"):
            cascade(jnp.zeros(y), jnp.zeros(guide), Schedule.preset("naive-50"))
