"""One frame, whole: the order of the stages, holes, units of light, transformations and gradients."""

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.differences import assert_gradients

from hyjax import (
    AmbientLight,
    DirectionalLight,
    GBuffer,
    InputError,
    Level,
    LightSetup,
    PointLight,
    RectLight,
    Relit,
    Schedule,
    Shaded,
    View,
    cascade,
    cascade_known,
    colored,
    composite,
    relight,
    shade,
    shade_each,
    shadow_pass,
    to_display,
    to_linear,
    visibilities,
)
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.color import encoded
from hyjax.light.setup import REFERENCE_LUX

H, W = 45, 62
seeds = st.integers(0, 2**31)
STAGES = ("shading", "refined", "visibility", "relight_filter", "unrefined", "image")
LIGHTS = (
    PointLight(jnp.array([0.5, -0.8, 2.0]), jnp.array(3000.0), jnp.array([1.0, 0.8, 0.6]), jnp.array(0.0)),
    RectLight(
        jnp.array([-1.5, 0.0, 1.2]),
        jnp.array([0.0, 0.5, 0.0]),
        jnp.array([0.0, 0.0, 0.4]),
        jnp.array(2000.0),
        jnp.ones(3),
    ),
    AmbientLight(jnp.array(40.0), jnp.ones(3)),
)
SCHEDULE = Schedule.uniform([(8, 3), (4, 4), (2, 4)], kappa=0.3)
SHADOWS = Schedule.uniform([(2, 3)], kappa=0.3)


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    """A box on a square floor; from the side the corners of the picture look past the floor."""
    box = trimesh.creation.box(extents=(0.5, 0.4, 0.6)).apply_translation((0.0, 0.0, 0.3))
    floor = trimesh.creation.box(extents=(3.4, 3.4, 0.02)).apply_translation((0.0, 0.0, -0.01))
    mesh = trimesh.util.concatenate([box, floor])
    mesh.unmerge_vertices()
    return RayCaster(mesh)


@pytest.fixture(scope="module")
def gbuffer(caster: RayCaster) -> GBuffer:
    k = Intrinsics(W, H, 50.0, 50.0, W / 2, H / 2)
    return caster.gbuffer(Camera(k, look_at((1.8, -2.0, 1.6), (0.0, 0.0, 0.2), (0, 0, 1))))


@pytest.fixture(scope="module")
def maps(caster: RayCaster) -> tuple:
    return cast_shadow_maps(caster, LIGHTS, 0.1)


@pytest.fixture(scope="module")
def frame() -> jax.Array:
    return jnp.asarray(np.random.default_rng(0).uniform(0.02, 0.98, (H, W, 3)), jnp.float32)


def run(
    frame: jax.Array,
    gbuffer: GBuffer,
    lights: Any,
    guide: jax.Array,
    schedule: Schedule,
    *,
    shadow_maps: Any = None,
    reference_lux: Any = REFERENCE_LUX,
    confidence: jax.Array | None = None,
    illuminance: jax.Array | None = None,
    visibility: jax.Array | None = None,
    **options: Any,
) -> Relit:
    """A linear frame relit by lights, or by light that was rendered elsewhere."""
    view, setup = View(frame, to_display(frame), gbuffer), LightSetup(tuple(lights), reference_lux)
    shaded = view.shade(setup, shadow_maps=shadow_maps, confidence=confidence)
    if illuminance is not None:
        shaded = Shaded.of(setup, illuminance, visibility, gbuffer.hit, confidence=confidence)
    return relight(view, shaded, guide, schedule, **options)


def assert_same(a: Relit, b: dict[str, Any], atol: float = 2e-6, rtol: float = 1e-5) -> None:
    for stage in STAGES:
        np.testing.assert_allclose(getattr(a, stage), b[stage], atol=atol, rtol=rtol, err_msg=stage)


def test_the_scene_has_what_the_tests_need(gbuffer: GBuffer, maps: tuple) -> None:
    assert 0.05 < 1 - np.mean(gbuffer.hit) < 0.5
    assert maps[0].depth.shape[0] == 1 and maps[1].depth.shape[0] > 1 and maps[2] is None


def test_paper_mode_is_the_composition_of_its_pieces(frame: jax.Array, gbuffer: GBuffer, maps: tuple) -> None:
    """Eq. 1 to 4 on display values; the shadow pass by itself, multiplied in last."""
    guide = to_display(frame)
    got = run(
        frame,
        gbuffer,
        LIGHTS,
        guide,
        SCHEDULE,
        shadow_maps=maps,
        shadow_schedule=SHADOWS,
        reference_lux=200.0,
        mode="paper",
    )
    shading = encoded(shade(gbuffer, LIGHTS) / 200.0)
    seen = visibilities(gbuffer, LIGHTS, maps)
    shadowed = encoded(colored(shade_each(gbuffer, LIGHTS) * seen, LIGHTS) / 200.0)
    raw = jnp.where(shading > 0, shadowed / jnp.where(shading > 0, shading, 1.0), 1.0)
    refined, shadows = cascade(shading, guide, SCHEDULE), shadow_pass(raw, guide, SHADOWS)
    expected = {
        "shading": shading,
        "refined": refined,
        "visibility": shadows,
        "relight_filter": refined * shadows,
        "unrefined": to_linear(composite(shadowed, guide)),
        "image": to_linear(composite(refined * shadows, guide)),
    }
    assert_same(got, expected)
    assert np.all(np.asarray(got.shading)[~np.asarray(gbuffer.hit)] == 0)
    assert np.asarray(raw).min() < 0.8  # there is a shadow in the picture (display values)


def test_without_holes_hyjax_mode_is_the_cascade_of_the_shading(frame: jax.Array, maps: tuple) -> None:
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    position = np.stack([x, y, 0.3 + 0 * x], axis=-1)
    normal = rng.normal(size=(H, W, 3)) * 0.1 + [0, 0, 1]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    whole = GBuffer(*(jnp.asarray(a, jnp.float32) for a in (position, normal, 1 + 0 * x)), jnp.ones((H, W), bool))
    got = run(frame, whole, LIGHTS, frame, SCHEDULE, shadow_maps=maps, shadow_schedule=SHADOWS)
    shading = shade(whole, LIGHTS) / 300.0
    each, seen = shade_each(whole, LIGHTS), visibilities(whole, LIGHTS, maps)
    assert np.all(each > 0)  # no light is unknown anywhere, so nothing is filled in
    refined, each_refined = cascade(shading, frame, SCHEDULE), cascade(each, frame, SCHEDULE)
    relight_filter = colored(each_refined * shadow_pass(seen, frame, SHADOWS), LIGHTS) / 300.0
    expected = {
        "shading": shading,
        "refined": refined,
        "visibility": relight_filter / refined,
        "relight_filter": relight_filter,
        "unrefined": colored(each * seen, LIGHTS) / 300.0 * frame,
        "image": relight_filter * frame,
    }
    assert_same(got, expected)
    assert float(jnp.min(got.visibility)) < 0.9


def test_a_shadowed_sun_leaves_no_trace() -> None:
    """Each light has its own channel: one that is wholly shadowed changes nothing, however strong it is."""
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    position = np.stack([x, y, 0.3 + 0 * x], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    floor = GBuffer(*(jnp.asarray(a, jnp.float32) for a in (position, up, 1 + 0 * x)), jnp.ones((H, W), bool))
    roof = trimesh.creation.box(extents=(20, 20, 0.1)).apply_translation((0, 0, 4))
    sun = DirectionalLight(jnp.array([0.1, 0.0, -1.0]), jnp.array(1e5), jnp.ones(3), jnp.array(0.0))
    frame = jnp.full((H, W, 3), 0.4)
    lights = (LIGHTS[2], sun)
    maps = cast_shadow_maps(RayCaster(roof), lights, 0.05)
    both = run(frame, floor, lights, frame, SCHEDULE, shadow_maps=maps)
    alone = run(frame, floor, lights[:1], frame, SCHEDULE)
    np.testing.assert_allclose(both.image, alone.image, rtol=1e-5)


def test_holes_darken_their_surroundings_in_paper_mode_alone(gbuffer: GBuffer) -> None:
    """Uniform light on a grey frame: hyjax gives it back everywhere, the paper's black holes bleed."""
    light = [AmbientLight(jnp.array(300.0), jnp.ones(3))]
    grey = jnp.full((H, W, 3), 0.4)
    ours = run(grey, gbuffer, light, grey, SCHEDULE)
    np.testing.assert_allclose(ours.image, grey, atol=1e-5)
    papers = run(grey, gbuffer, light, grey, SCHEDULE, mode="paper")
    hit = np.asarray(gbuffer.hit)
    bled = np.asarray(papers.refined)[..., 0][hit]
    assert bled.min() < 0.8 and np.mean(bled < 0.99) > 0.05
    assert np.all(np.asarray(papers.unrefined)[~hit] == 0)


def test_cascade_known_fills_from_its_side_of_an_edge() -> None:
    """Two halves of different value, the guide says where they part; a hole takes its own half's value."""
    y = jnp.where(jnp.arange(32) < 16, 1.0, 5.0)[None, :, None] * jnp.ones((24, 1, 1))
    guide = jnp.where(jnp.arange(32) < 16, 0.0, 100.0)[None, :, None] * jnp.ones((24, 1, 1))
    known = np.ones((24, 32, 1), bool)
    known[8:13, 3:9], known[6:10, 20:25] = False, False
    schedule = Schedule.uniform([(4, 30), (2, 30), (1, 30)], kappa=0.01)

    def run(fill: float, known: np.ndarray) -> np.ndarray:
        garbage = jnp.where(jnp.asarray(known), y, fill)
        return np.asarray(cascade_known(garbage, jnp.asarray(known), guide, schedule))

    np.testing.assert_array_equal(run(1e3, known), run(0.0, known))  # what a hole holds does not matter
    np.testing.assert_allclose(run(0.0, known), cascade(y, guide, schedule), rtol=0.08)  # as if there were no hole
    np.testing.assert_allclose(run(0.0, np.ones_like(known)), cascade(y, guide, schedule), rtol=1e-5)
    np.testing.assert_array_equal(run(0.0, np.zeros_like(known)), 0.0)


def test_a_hole_out_of_reach_takes_the_mean() -> None:
    y, known = jnp.full((24, 32, 1), 3.0), np.zeros((24, 32, 1), bool)
    known[:, :4] = True
    y = y.at[:, :2].set(1.0)
    out = cascade_known(y, jnp.asarray(known), y, Schedule.uniform([(1, 2)], kappa=1e6))
    np.testing.assert_allclose(np.asarray(out)[:, 8:], 2.0, rtol=1e-5)


# ---- confidence ----

SMALL = (16, 24)
FILL = Schedule.uniform([(4, 3)], kappa=0.5, fidelity=0.1)


def small(seed: int, channels: int, low: float = 0.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, 1.0, (*SMALL, channels)).astype(np.float32)


def known(y: np.ndarray, confidence: np.ndarray, schedule: Schedule = FILL) -> np.ndarray:
    return np.asarray(cascade_known(jnp.asarray(y), jnp.asarray(confidence), jnp.asarray(small(9, 3)), schedule))


@settings(max_examples=10)
@given(seeds, st.sampled_from([1, 2]))
def test_confidences_count_by_their_ratio(seed: int, channels: int) -> None:
    """Half of each changes nothing but the floor for holes; one of all is the cascade itself; bools are 0 and 1."""
    y, confidence = small(seed, 2), small(seed + 1, channels, low=0.3)
    np.testing.assert_allclose(known(y, confidence / 2), known(y, confidence), atol=5e-3)
    everywhere = known(y, np.ones_like(confidence))
    np.testing.assert_allclose(
        everywhere, cascade(jnp.asarray(y), jnp.asarray(small(9, 3)), FILL), rtol=1e-5, atol=1e-6
    )
    seen = confidence > 0.5
    np.testing.assert_allclose(known(y, seen), known(y, seen.astype(np.float32)), atol=1e-6)


def test_doubtful_values_move_towards_trusted_ones() -> None:
    y, doubtful = np.full((*SMALL, 1), 1.0, np.float32), np.zeros((*SMALL, 1), bool)
    doubtful[6:9, 10:14] = True
    y[doubtful] = 5.0
    got = [known(y, np.where(doubtful, c, 1.0).astype(np.float32))[doubtful].mean() for c in (1.0, 0.3, 0.05, 0.0)]
    assert all(a - 1 > 2 * (b - 1) for a, b in itertools.pairwise(got)), got
    assert got[0] > 1.2 and got[-1] == pytest.approx(1.0, abs=1e-5)


BAD = st.sampled_from([np.nan, np.inf, -np.inf])


@given(seeds, BAD, st.sampled_from([np.nan, -np.inf, -0.5]))
def test_what_is_not_a_number_is_unknown_and_spoils_nothing_else(seed: int, value: float, doubt: float) -> None:
    """Exactly as if its pixel had confidence zero, in the value's own channel where each has its confidence."""
    y, rng = small(seed, 2), np.random.default_rng(seed)
    where = rng.random((*SMALL, 1)) < rng.uniform(0.01, 0.9)
    spoilt = y.copy()
    spoilt[..., :1] = np.where(where, value, y[..., :1])
    together, each = small(seed + 1, 1), small(seed + 1, 2)
    apart = each.copy()
    apart[..., :1] = np.where(where, 0.0, each[..., :1])
    for confidence, without in ((together, np.where(where, np.float32(0.0), together)), (each, apart)):
        expected = known(y, without)
        assert np.all(np.isfinite(expected))
        np.testing.assert_array_equal(known(spoilt, confidence), expected)
        np.testing.assert_array_equal(known(y, np.where(without == 0, np.float32(doubt), confidence)), expected)


def test_confidence_beyond_one_is_one_and_none_at_all_gives_zero() -> None:
    y = small(0, 2)
    above, one = (np.where(small(1, 1) > 0.5, np.float32(c), small(2, 1)) for c in (7.0, 1.0))
    np.testing.assert_array_equal(known(y, above), known(y, one))
    for nothing in (np.zeros((*SMALL, 1), np.float32), np.full((*SMALL, 2), np.nan, np.float32)):
        np.testing.assert_array_equal(known(y, nothing), 0.0)


def test_infinite_confidence_is_none() -> None:
    y, confidence = small(0, 1), np.ones((*SMALL, 1), np.float32)
    expected = known(y, np.where(y > 0.5, np.float32(0.0), confidence))
    np.testing.assert_array_equal(known(y, np.where(y > 0.5, np.float32(np.inf), confidence)), expected)


def test_gradients_of_confidence() -> None:
    """Against differences, beside a value that is not a number; finite where nothing is known."""
    y, confidence, guide, target = (small(k, c, low=0.2)[:5, :6] for k, c in enumerate((2, 1, 3, 2)))
    y[2, 3] = np.nan

    def loss(y: jax.Array, confidence: jax.Array) -> jax.Array:
        return jnp.sum((cascade_known(y, confidence, jnp.asarray(guide), FILL) - target) ** 2)

    with jax.enable_x64(True):
        assert_gradients(loss, y, confidence)
    for slope in jax.jit(jax.grad(loss, argnums=(0, 1)))(jnp.asarray(y), jnp.asarray(0 * confidence)):
        assert np.all(np.isfinite(slope))


@pytest.fixture(scope="module")
def floor() -> GBuffer:
    """With a hole in the middle."""
    x, y = np.meshgrid(np.linspace(-1, 1, SMALL[1]), np.linspace(-1, 1, SMALL[0]))
    position = np.stack([x, y, 0 * x], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    hit = np.ones(SMALL, bool)
    hit[5:9, 8:15] = False
    return GBuffer(*(jnp.asarray(a, jnp.float32) for a in (position, up, 1 + 0 * x)), jnp.asarray(hit))


PICTURE, SHADING, SEEN = jnp.asarray(small(0, 3)), jnp.asarray(300 * small(1, 2)), jnp.asarray(small(2, 2))
LAMPS = (LIGHTS[0], AmbientLight(jnp.array(60.0), jnp.array([1.0, 0.5, 0.2])))


def relit(gbuffer: GBuffer, lights: tuple = LAMPS, **options: Any) -> Relit:
    """By light rendered elsewhere, also in the hole."""
    given = {"illuminance": SHADING, "visibility": SEEN, "shadow_schedule": FILL}
    return run(PICTURE, gbuffer, lights, PICTURE, FILL, **given | options)


def test_hyjax_mode_is_the_composition_of_its_pieces(floor: GBuffer) -> None:
    """Shading trusted by confidence where there is surface, visibility filled where no light falls."""
    shading, confidence = jnp.maximum(SHADING - 100.0, 0.0), jnp.asarray(small(3, 1))
    shadows = Schedule.uniform([(4, 3)], kappa=0.3, fidelity=2.0)
    got = relit(floor, illuminance=shading, confidence=confidence, shadow_schedule=shadows)
    trust = jnp.where(floor.hit[..., None], confidence, 0.0)
    refined = cascade_known(shading, trust, PICTURE, FILL)
    told = (shading > 0) & (trust > 0)
    filled = jnp.where(told, SEEN, cascade_known(SEEN, told, PICTURE, Schedule.preset("hyjax")))
    refined_seen = cascade(filled, PICTURE, shadows)
    unshadowed, relight_filter = (colored(each, LAMPS) / 300.0 for each in (refined, refined * refined_seen))
    expected = {
        "shading": colored(shading, LAMPS) / 300.0,
        "refined": unshadowed,
        "visibility": relight_filter / unshadowed,
        "relight_filter": relight_filter,
        "unrefined": colored(shading * SEEN, LAMPS) / 300.0 * PICTURE,
        "image": relight_filter * PICTURE,
    }
    assert_same(got, expected)


def test_confidence_is_by_default_where_there_is_surface(floor: GBuffer) -> None:
    """Whatever it says of holes."""
    default = relit(floor)
    for hole in (0.0, 1.0, np.nan):
        said = jnp.where(floor.hit[..., None], 1.0, hole)
        assert_same(relit(floor, confidence=said), vars(default))
    doubtful = relit(floor, confidence=jnp.asarray(small(5, 1)))
    assert np.abs(doubtful.image - default.image).max() > 1e-3


@pytest.mark.parametrize(
    ("mode", "name", "other"), [("linear", "hyjax-scan-shadow", "shadow"), ("paper", "shadow", "hyjax")]
)
def test_default_schedule_of_the_visibility(floor: GBuffer, mode: Any, name: str, other: str) -> None:
    def image(**options: Any) -> np.ndarray:
        return np.asarray(relit(floor, mode=mode, **options).image)

    default = image(shadow_schedule=None)
    np.testing.assert_array_equal(default, image(shadow_schedule=Schedule.preset(name)))
    assert np.abs(default - image(shadow_schedule=Schedule.preset(other))).max() > 1e-3


def test_where_nothing_is_known_only_ambient_light_is_used(floor: GBuffer) -> None:
    """The frame itself if there is none; never black, never not a number. It is said aloud."""
    empty = dataclasses.replace(floor, hit=jnp.zeros(SMALL, bool))
    sky = AmbientLight(jnp.array(90.0), jnp.array([0.2, 0.5, 1.0]))
    factor = (60 * np.array([1.0, 0.5, 0.2]) + 90 * np.array([0.2, 0.5, 1.0])) / 300
    for lights, expected in (((sky, LAMPS[1]), PICTURE * jnp.asarray(factor, jnp.float32)), (LIGHTS[:2], PICTURE)):
        for gbuffer, confidence in ((empty, 1.0), (floor, 0.0), (floor, jnp.nan), (empty, None)):
            options = {} if confidence is None else {"confidence": jnp.full((*SMALL, 1), confidence)}
            with pytest.warns(UserWarning, match=r"^relight: nothing of the frame is known; only ambient light"):
                got = relit(gbuffer, lights, **options)
            np.testing.assert_allclose(got.image, expected, rtol=1e-5)
            for stage in ("refined", "visibility", "relight_filter", "image"):
                assert np.all(np.isfinite(getattr(got, stage))), stage


def test_in_paper_mode_no_surface_is_black_and_confidence_does_not_count(floor: GBuffer) -> None:
    empty = dataclasses.replace(floor, hit=jnp.zeros(SMALL, bool))
    with pytest.warns(UserWarning, match="nothing of the frame is known"):
        assert np.all(np.asarray(relit(empty, mode="paper", illuminance=jnp.zeros_like(SHADING)).image) == 0)
    doubtful = relit(floor, confidence=jnp.asarray(small(5, 1)), mode="paper")
    assert_same(doubtful, vars(relit(floor, mode="paper")))


def test_paper_mode_does_not_warn_of_confidence(floor: GBuffer) -> None:
    relit(floor, confidence=jnp.zeros((*SMALL, 1)), mode="paper")


def test_confidence_of_another_shape_is_refused(floor: GBuffer) -> None:
    for shape in ((16, 24), (16, 24, 2), (15, 24, 1), (1, 1, 1)):
        with pytest.raises(InputError, match=r"^(shaded: )?confidence"):
            relit(floor, confidence=jnp.ones(shape))


def test_reference_light_leaves_the_frame(frame: jax.Array, gbuffer: GBuffer) -> None:
    for lux in (300.0, 80.0):
        light = [AmbientLight(jnp.array(lux), jnp.ones(3))]
        got = run(frame, gbuffer, light, frame, SCHEDULE, reference_lux=lux)
        np.testing.assert_allclose(got.image, frame, atol=1e-5)


def test_linear_in_light(frame: jax.Array, gbuffer: GBuffer) -> None:
    """Without shadows the picture is linear: power scales it, lights add."""

    def image(*lights: Any) -> np.ndarray:
        return np.asarray(run(frame, gbuffer, lights, frame, SCHEDULE, shadow_schedule=SHADOWS).image)

    a, b, ambient = LIGHTS
    double = jax.tree.map(lambda x: x, a)
    object.__setattr__(double, "luminous_flux", 2 * a.luminous_flux)
    np.testing.assert_allclose(image(double), 2 * image(a), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(image(a, b, ambient), image(a) + image(b) + image(ambient), rtol=1e-4, atol=1e-5)


def test_jit_and_vmap_over_frames(frame: jax.Array, gbuffer: GBuffer, maps: tuple) -> None:
    frames = jnp.stack([frame, frame[::-1], 0.5 * frame])
    buffers = jax.tree.map(lambda a: jnp.stack([a, a[::-1], a[:, ::-1]]), gbuffer)

    def one(frame: jax.Array, buffer: GBuffer, shadow_maps: Any) -> Relit:
        return run(frame, buffer, LIGHTS, frame, SCHEDULE, shadow_maps=shadow_maps, shadow_schedule=SHADOWS)

    for shadow_maps in (None, maps):
        batch = jax.jit(jax.vmap(lambda f, b, m=shadow_maps: one(f, b, m)))(frames, buffers)
        for k in range(3):
            single = one(frames[k], jax.tree.map(lambda a, k=k: a[k], buffers), shadow_maps)
            error = np.abs(np.asarray(batch.image[k]) - np.asarray(single.image))
            if shadow_maps is None:
                assert error.max() < 1e-5
            else:  # a point at the very border of a texel may be judged differently by the fused program
                assert np.mean(error > 1e-5) < 2e-3 and np.percentile(error, 99.5) < 1e-5
        others = [np.abs(np.asarray(batch.image[0] - batch.image[k])).mean() for k in (1, 2)]
        assert min(others) > 0.01, "each frame is relit by itself"


@pytest.mark.parametrize("mode", ["linear", "paper"])
def test_gradients_reach_everything(frame: jax.Array, gbuffer: GBuffer, mode: str) -> None:
    """Finite, not zero and right: frame, guide, κ and λ of both schedules, and the lights' parameters."""
    small = jax.tree.map(lambda a: a[10:21, 12:26], gbuffer)
    rng = np.random.default_rng(2)
    target = rng.uniform(size=(11, 14, 3))
    seen = rng.uniform(size=(11, 14, 3))
    schedule = Schedule((Level(4, np.array([0.2, 0.1]), 0.4), Level(2, np.array([0.15, 0.05]), 0.3)))
    shadows = Schedule((Level(1, np.array([0.2, 0.1]), 0.5),))

    def loss(
        frame: jax.Array,
        guide: jax.Array,
        schedule: Schedule,
        shadows: Schedule,
        position: jax.Array,
        power: jax.Array,
    ) -> jax.Array:
        lights = (PointLight(position, power, jnp.array([1.0, 0.8, 0.6]), jnp.array(0.0)), LIGHTS[2])
        got = run(
            frame, small, lights, guide, schedule, shadow_schedule=shadows, reference_lux=600.0, mode=mode
        )  # the mesh casts no shadow here: the shadow pass gets its share below
        shadow = shadow_pass(jnp.asarray(seen), guide, shadows)
        return jnp.sum((got.image * shadow - target) ** 2)

    with jax.enable_x64(True):
        small = jax.tree.map(lambda a: jnp.asarray(a, bool if a.dtype == bool else jnp.float64), small)
        arguments = (
            frame[10:21, 12:26],
            frame[8:19, 20:34],
            schedule,
            shadows,
            LIGHTS[0].position,
            LIGHTS[0].luminous_flux,
        )
        # The differences are good to the round-off of a loss of about 100, divided by 2 eps.
        assert_gradients(loss, *arguments, rtol=2e-4, eps=1e-6, atol=5e-7)


def test_refusals(frame: jax.Array, gbuffer: GBuffer, maps: tuple) -> None:
    for change, message in (
        ({"mode": "papers"}, r"^mode: 'papers' is unknown \(did you mean 'paper'\?\); use one of linear, paper$"),
        ({"lights": ()}, r"^lights: none given; give at least one$"),
        ({"frame": frame[1:]}, r"^relight: frame .* must be of one size$"),
        ({"guide": frame[:, 1:]}, r"^relight: frame .* must be of one size$"),
        ({"shadow_maps": maps[:2]}, r"^shade: 2 shadow maps for 3 lights"),
        ({"schedule": Schedule((Level(2, np.array([0.3]), 0.1),))}, r"^schedule custom, factor 2, lam"),
        ({"shadow_schedule": Schedule(())}, r"^schedule custom: needs at least one level"),
    ):
        arguments: dict[str, Any] = {
            "frame": frame,
            "gbuffer": gbuffer,
            "lights": LIGHTS,
            "guide": frame,
            "schedule": SCHEDULE,
        }
        with pytest.raises(InputError, match=message):
            run(**arguments | change)
    view = View.of(frame, gbuffer)
    shaded = view.shade(LIGHTS)
    for change in ({"visibility": shaded.visibility[..., :2]}, {"colors": shaded.colors[:2]}):
        with pytest.raises(InputError, match=r"^shaded.(visibility|colors): .* l is 3 by shaded.illuminance$"):
            relight(view, dataclasses.replace(shaded, **change), frame, SCHEDULE)
    with pytest.raises(InputError, match=r"^view: display \(44, 62\) and gbuffer \(45, 62\) differ in size$"):
        View.of(frame[1:], gbuffer)


@pytest.mark.parametrize("mode", ["linear", "paper"])
def test_light_rendered_elsewhere_takes_the_place_of_ours(
    frame: jax.Array, gbuffer: GBuffer, maps: tuple, mode: Any
) -> None:
    each, seen = shade_each(gbuffer, LIGHTS), visibilities(gbuffer, LIGHTS, maps)
    arguments = (frame, gbuffer, LIGHTS, frame, SCHEDULE)
    ours = run(*arguments, shadow_maps=maps, shadow_schedule=SHADOWS, mode=mode)
    given = run(*arguments, illuminance=each, visibility=seen, shadow_schedule=SHADOWS, mode=mode)
    assert_same(given, vars(ours))
    other = run(*arguments, illuminance=0.5 * each, visibility=seen**2, shadow_schedule=SHADOWS, mode=mode)
    assert np.mean(other.image) < 0.9 * np.mean(ours.image)
    assert np.mean(other.visibility) < np.mean(ours.visibility)


def test_light_rendered_elsewhere_must_fit(gbuffer: GBuffer) -> None:
    each = shade_each(gbuffer, LIGHTS)
    for wrong in (each[..., :2], each[1:]):
        for channels in ((wrong, each), (each, wrong)):
            with pytest.raises(InputError, match=r"^(shaded: )?(illuminance|visibility)(:| is) .*must be"):
                Shaded.of(LIGHTS, *channels, gbuffer.hit)
