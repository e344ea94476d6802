"""Frames that are relit at a part of their size: schedules, shadow views that blocks share, sources in sight."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hyjax
from hyjax.configuration import Configuration
from hyjax.core.cascade import entries, largest_sampling, sampled_schedule
from hyjax.core.refine import fill_visibility
from hyjax.core.schedule import PRESETS, Schedule
from hyjax.light.emission import Emitters, may_show, source_pixels
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import PointLight, RectLight
from hyjax.light.panes import Bars
from hyjax.light.shadow_map import ShadowMap, visibility
from hyjax.util.geometry import angle

SIZES = st.sampled_from([(16, 24), (17, 9), (33, 30)])
SEEDS = st.integers(0, 2**31)


def random(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, np.float32)


def repeat(x: Any, k: int) -> np.ndarray:
    return np.repeat(np.repeat(np.asarray(x), k, axis=0), k, axis=1)


def gbuffer_of(position: np.ndarray, normal: np.ndarray, hit: np.ndarray) -> GBuffer:
    depth = np.where(hit, 1.0 + position[..., 2], 0.0).astype(np.float32)
    return GBuffer(*(jnp.asarray(x) for x in (position, normal, depth, hit)))


@given(
    factors=st.lists(st.integers(2, 4), min_size=1, max_size=4),
    finest=st.sampled_from([1, 2, 3, 4]),
    sampling=st.integers(1, 4),
)
def test_cells_of_a_smaller_picture_cover_as_much(factors: list[int], finest: int, sampling: int) -> None:
    """As far as its pixels allow; and the schedule can be run."""
    levels = [(int(finest * np.prod(factors[k:])), 1 + k) for k in range(len(factors) + 1)]
    schedule = Schedule.uniform(levels)
    own = sampled_schedule(schedule, sampling).check()
    kept = dict(levels)
    for level in own.levels:
        whole = level.factor * sampling
        assert kept[whole] == level.steps if whole in kept else level.factor == 1
    expected = {factor for factor in kept if factor % sampling == 0}
    assert expected <= {level.factor * sampling for level in own.levels}
    assert sampled_schedule(schedule, 1).to_json() == schedule.to_json()


@settings(deadline=None, max_examples=10)
@given(size=SIZES, seed=SEEDS)
def test_filling_keeps_what_is_known(size: tuple[int, int], seed: int) -> None:
    h, w = size
    raw, guide = random(seed, h, w, 2), random(seed + 1, h, w, 3)
    known = random(seed + 2, *raw.shape) > 0.5
    filled = np.asarray(fill_visibility(jnp.asarray(raw), jnp.asarray(known), jnp.asarray(guide)))
    assert np.array_equal(filled[known], raw[known])
    assert filled.min() >= 0.0 and filled.max() <= raw.max() + 1e-5


def test_a_schedule_says_how_sparse_its_picture_may_be() -> None:
    ours, shadow = Schedule.preset("hyjax"), Schedule.preset("hyjax-scan-shadow")
    assert entries(ours) == [16, 8, 4] and entries(shadow) == [4]
    assert [largest_sampling([ours, shadow], most) for most in (1, 2, 4, 9)] == [1, 2, 2, 2]
    assert largest_sampling([Schedule.preset("paper-50")], 16) == 2, "or levels would be lost"
    assert largest_sampling([Schedule.uniform([(8, 8), (2, 8), (1, 20)])], 2) == 1, "likewise"
    for name in PRESETS:
        assert largest_sampling([Schedule.preset(name)], 1) == 1


@settings(deadline=None, max_examples=8)
@given(seed=SEEDS, kind=st.sampled_from(["point", "rect"]))
def test_interleaved_views_add_up(seed: int, kind: str) -> None:
    """Where the pixels of a block are alike, their shares of the views make all views."""
    count, size, shape = 8, 18, (6, 10)
    position, normal = random(seed, *shape, 3) * 2 - 1, random(seed + 1, *shape, 3) * 2 - 1
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lamp: Any = PointLight(np.zeros(3), 100.0, np.ones(3), radius=0.1)
    if kind == "rect":
        lamp = RectLight(np.array([0, 0, -2.0]), np.array([0.5, 0, 0]), np.array([0, 0.5, 0]), 100.0, np.ones(3))
    views = lamp.shadow_views()
    shadow_map = ShadowMap(
        jnp.asarray(random(seed + 2, views.count, size, size) * 3),
        jnp.asarray(views.origins, jnp.float32),
        jnp.asarray(np.broadcast_to(views.axes, (views.count, 3, 3)), jnp.float32),
        jnp.float32(views.extent / (size - 2)),
        views.projection,
    )
    assert views.count % 4 == 0 and views.count >= count
    hit = random(seed + 3, *shape) > 0.2
    plain = np.asarray(visibility(gbuffer_of(position, normal, hit), lamp, shadow_map))
    blocks = gbuffer_of(repeat(position, 2), repeat(normal, 2), repeat(hit, 2))
    assert np.allclose(visibility(blocks, lamp, shadow_map, interleave=2), repeat(plain, 2), atol=1e-5)
    assert np.array_equal(
        visibility(blocks, lamp, shadow_map, interleave=5), visibility(blocks, lamp, shadow_map)
    ), "views that make no equal shares are all asked"


def window_map(seed: int) -> tuple[RectLight, ShadowMap]:
    """A window of 16 views, with a random map."""
    lamp = RectLight(np.array([0, 0, -2.0]), np.array([0.5, 0, 0]), np.array([0, 0.5, 0]), 100.0, np.ones(3))
    views, size = lamp.shadow_views(), 18
    return lamp, ShadowMap(
        jnp.asarray(random(seed, views.count, size, size) * 5),
        jnp.asarray(views.origins, jnp.float32),
        jnp.asarray(np.broadcast_to(views.axes, (views.count, 3, 3)), jnp.float32),
        jnp.float32(views.extent / (size - 2)),
        views.projection,
    )


def test_views_are_shared_on_one_surface_alone() -> None:
    """Blocks across the edge of two walls: each side has the views of its own two pixels."""
    lamp, whole = window_map(3)
    sides = [
        (np.array([-0.3, 0.1, 1.0]), np.array([0.0, 0.0, -1.0])),
        (np.array([0.3, 0.1, 1.0]), np.array([-0.9, 0.0, -0.4359])),
    ]
    position = np.stack([place for place, _ in sides])[None].repeat(2, axis=0).astype(np.float32)
    normal = np.stack([facing for _, facing in sides])[None].repeat(2, axis=0).astype(np.float32)
    hit = np.ones((2, 2), bool)
    found = np.asarray(visibility(gbuffer_of(position, normal, hit), lamp, whole, interleave=2))
    for column, groups in enumerate([(0, 2), (1, 3)]):
        own = [k for k in range(16) if k % 4 in groups]
        views = (x[jnp.array(own)] for x in (whole.depth, whole.origin, whole.axes))
        part = ShadowMap(*views, whole.texel, whole.projection)
        alone = gbuffer_of(position[:1, column : column + 1], normal[:1, column : column + 1], hit[:1, :1])
        assert np.allclose(found[:, column], np.asarray(visibility(alone, lamp, part))[0, 0], atol=1e-5)
    assert abs(found[0, 0] - found[0, 1]) > 0.01


@settings(deadline=None, max_examples=10)
@given(seed=SEEDS, size=st.sampled_from([(6, 8), (7, 5)]))
def test_what_all_views_say_is_dark_is_not_lit(seed: int, size: tuple[int, int]) -> None:
    """A map that shadows everything: no pixel is lit for having looked up views that see it from behind."""
    lamp, whole = window_map(seed)
    dark = dataclasses.replace(whole, depth=jnp.full_like(whole.depth, -np.inf))
    position, normal = random(seed, *size, 3) * 2 - 1, random(seed + 1, *size, 3) * 2 - 1
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    surface = gbuffer_of(position, normal, np.ones(size, bool))
    plain = np.asarray(visibility(surface, lamp, dark))
    shared = np.asarray(visibility(surface, lamp, dark, interleave=2))
    blocks = [(i, j) for i in range(0, size[0], 2) for j in range(0, size[1], 2)]
    for i, j in blocks:
        block = np.s_[i : i + 2, j : j + 2]
        if plain[block].max() == 0.0:
            assert shared[block].max() == 0.0


@pytest.mark.slow
def test_a_relit_frame_hardly_changes() -> None:
    """At half its size, with a quarter of the views: what a smooth room shows stays."""
    from hyjax.data.builtin_room import load_room

    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    scene = hyjax.Scene.open(hyjax.SceneSettings(), capture=room)
    pictures = []
    for sampling in (1, 2):
        relighter = hyjax.Relighter(scene, "noon-window", Configuration().with_choices({"sampling": sampling}))
        assert relighter.view(0).frame.shape[:2] == (120 // sampling, 160 // sampling)
        relit = relighter.relit(0)
        assert relit.unrefined.shape == relit.shading.shape == relit.image.shape == (120, 160, 3)
        pictures.append(np.asarray(hyjax.to_display(relit.image)))
    difference = pictures[0] - pictures[1]
    assert 0 < np.sqrt((difference**2).mean()) < 0.02


@settings(deadline=None, max_examples=60)
@given(seed=SEEDS)
def test_sources_that_cannot_show_do_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4, dtype=np.float32)
    pose[:3, :3], pose[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.normal(size=3)
    h, w = 12, 16
    intrinsics = np.array([[14, 0, rng.uniform(4, 12)], [0, 14, rng.uniform(3, 9)], [0, 0, 1]], np.float32)
    panes = np.concatenate([rng.normal(size=(1, 1, 3)) * 2, rng.normal(size=(1, 2, 3)) * 0.5], axis=1)
    panes[:, 2] -= panes[:, 1] * np.sum(panes[:, 1] * panes[:, 2]) / np.sum(panes[:, 1] ** 2)
    lamps = np.concatenate([rng.normal(size=(1, 3)) * 2, rng.uniform(0.05, 0.3, (1, 1))], axis=1)
    arrays = [lamps, np.ones((2, 3)), np.zeros((2, 3)), np.ones(3), np.ones((1, 3))]
    own, *rest = (jnp.asarray(a, jnp.float32) for a in (panes, *arrays))
    emitters = Emitters(own, Bars.none(1), *rest)
    nothing = GBuffer(
        jnp.zeros((h, w, 3)), jnp.zeros((h, w, 3)), jnp.zeros((h, w)), jnp.zeros((h, w), bool)
    )  # nothing stands before the sources
    camera = jnp.asarray(pose), jnp.asarray(intrinsics)
    shown = bool((source_pixels(emitters, jnp.ones((h, w, 3)), nothing.open_depth, *camera).weight > 0).any())
    assert may_show(emitters, (h, w), pose, intrinsics) or not shown


def test_a_source_behind_the_camera_cannot_show() -> None:
    pane = jnp.array([[[0.0, 0.0, -3.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]])
    rest = Bars.none(1), jnp.zeros((0, 4)), jnp.ones((1, 3)), jnp.zeros((1, 3)), jnp.ones(3), jnp.ones((1, 3))
    intrinsics = np.array([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]])
    assert not may_show(Emitters(pane, *rest), (10, 10), np.eye(4), intrinsics)
    assert may_show(Emitters(-pane, *rest), (10, 10), np.eye(4), intrinsics)
    assert jax.jit(lambda pose: jnp.float32(may_show(Emitters(pane, *rest), (10, 10), pose, intrinsics)))(np.eye(4))


slope_of_angle = jax.jit(jax.grad(lambda x: angle(jnp.sin(x), jnp.cos(x))))


@settings(deadline=None, max_examples=50)
@example(turn=np.pi / 4, scale=np.sqrt(2.0))
@example(turn=3 * np.pi / 4, scale=1.0)
@given(turn=st.floats(0.0, np.pi), scale=st.floats(1e-6, 1e6))
def test_angle(turn: float, scale: float) -> None:
    sine, cosine = np.float32(scale * np.sin(turn)), np.float32(scale * np.cos(turn))
    sine = max(sine, np.float32(0.0))
    expected = np.arctan2(np.float64(sine), np.float64(cosine))
    assert abs(float(angle(jnp.float32(sine), jnp.float32(cosine))) - expected) < 5e-7
    slope = slope_of_angle(jnp.float32(np.clip(turn, 0.01, 3.13)))
    assert abs(float(slope) - 1.0) < 1e-4
    assert float(angle(jnp.float32(0.0), jnp.float32(0.0))) == 0.0
