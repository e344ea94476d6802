"""Light kept still from frame to frame: what is found again, what is kept of it, when all starts anew."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax import AmbientLight, GBuffer, InputError, LightSetup, PointLight, Schedule, Shaded, View, relight
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.video.temporal_filter import (
    KEEP_WEIGHT,
    LEAST_FOUND_SHARE,
    Memory,
    Video,
    fill_depth,
    recall,
    remembers,
    steady,
)

SIZE = (24, 32)
INTRINSICS = Intrinsics(SIZE[1], SIZE[0], 30.0, 30.0, 16.0, 12.0)
SCHEDULE = Schedule.preset("hyjax")
LIGHTS = (
    PointLight(jnp.array([0.0, 0.0, -1.0]), jnp.asarray(900.0), jnp.ones(3)),
    AmbientLight(jnp.asarray(50.0), jnp.ones(3)),
)


def camera(x: float = 0.0, turn: float = 0.0) -> Camera:
    """Before a wall in the plane z = 3."""
    return Camera(INTRINSICS, look_at((x, 0.0, 0.0), (x + turn, 0.0, 3.0), (0.0, -1.0, 0.0)))


def wall(cam: Camera) -> GBuffer:
    rays = cam.rays()
    depth = (3.0 - cam.origin[2]) / rays[..., 2]
    position = cam.unproject(depth)
    normal = np.broadcast_to([0.0, 0.0, -1.0], position.shape)
    arrays = (jnp.asarray(x, jnp.float32) for x in (position, normal, depth))
    return GBuffer(*arrays, jnp.ones(SIZE, bool))


def view(cam: Camera) -> tuple[jax.Array, jax.Array]:
    return jnp.asarray(cam.pose, jnp.float32), jnp.asarray(cam.intrinsics.matrix, jnp.float32)


def painted(cam: Camera) -> jax.Array:
    """A picture on the wall that is linear in x and y, so that bilinear samples of it are nearly exact."""
    position = wall(cam).position
    return jnp.stack([position[..., 0], 0.5 * position[..., 1] + 1.0], axis=-1)


def memory(cam: Camera, channels: jax.Array | None = None) -> Memory:
    return Memory(painted(cam) if channels is None else channels, wall(cam).depth, *view(cam), LIGHTS)


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.4, 0.4), st.floats(-0.3, 0.3))
def test_a_surface_point_is_found_again_from_elsewhere(x: float, turn: float) -> None:
    now, then = camera(x, turn), camera()
    found_channels, found = recall(memory(then), wall(now).depth, *view(now))
    assert found.mean() > 0.5
    error = np.abs(found_channels - painted(now))[np.asarray(found)]
    assert error.max() < 0.06, "half a pixel, at the border"
    assert np.median(error) < 1e-3


def test_what_was_hidden_or_outside_is_not_found() -> None:
    then, now = camera(), camera(0.6)
    _, found = recall(memory(then), wall(now).depth, *view(now))
    xy, _ = then.project(np.asarray(wall(now).position, float))
    np.testing.assert_array_equal(found, (xy[..., 0] > 0) & (xy[..., 0] < SIZE[1]))
    assert 0 < found.mean() < 1
    before = dataclasses.replace(memory(then), depth=jnp.full(SIZE, 2.0))  # something stood there
    assert not recall(before, wall(now).depth, *view(now))[1].any()
    nothing = jnp.zeros(SIZE)
    assert not recall(memory(then), nothing, *view(now))[1].any(), "unknown depth is nowhere"
    behind = dataclasses.replace(memory(then), pose=jnp.asarray(np.diag([-1.0, 1.0, -1.0, 1.0]), jnp.float32))
    assert not recall(behind, wall(now).depth, *view(now))[1].any()


def test_the_same_view_returns_the_same_picture() -> None:
    noise = jnp.asarray(np.random.default_rng(0).random((*SIZE, 3)), jnp.float32)
    channels, found = recall(memory(camera(), noise), wall(camera()).depth, *view(camera()))
    assert found.all()
    np.testing.assert_allclose(channels, noise, atol=1e-4)


def test_steady_averages_what_is_found_and_only_that() -> None:
    now, then = camera(0.6), camera()
    ones, old = jnp.ones((*SIZE, 2)), memory(then, jnp.zeros((*SIZE, 2)))
    _, found = recall(old, wall(now).depth, *view(now))
    got = steady(ones, wall(now).depth, *view(now), old, 0.75)
    np.testing.assert_allclose(got[found], 0.25)
    np.testing.assert_array_equal(got[~np.asarray(found)], 1.0)


def test_light_does_not_bleed_across_a_silhouette() -> None:
    """A near half before a far one, seen again from 0.4 pixels beside: each keeps its own light."""
    near = np.arange(SIZE[1]) < 16
    depth = jnp.asarray(np.where(near, 1.0, 3.0) * np.ones(SIZE), jnp.float32)
    light = jnp.asarray(near * np.ones(SIZE), jnp.float32)[..., None]
    pose, matrix = view(camera())
    old = Memory(light, depth, pose, matrix, LIGHTS)
    moved = pose.at[0, 3].add(0.4 / 30.0)
    channels, found = recall(old, depth, moved, matrix)
    assert found[:, :15].all() and found[:, 17:].all()
    np.testing.assert_allclose(channels[..., 0][found], np.asarray(light[..., 0])[found], atol=1e-6)


def test_a_frame_that_is_not_a_number_is_forgotten() -> None:
    old, now = memory(camera(), jnp.ones((*SIZE, 2))), camera()
    nothing = jnp.full((*SIZE, 2), jnp.nan)
    got = steady(nothing, wall(now).depth, *view(now), old)
    np.testing.assert_allclose(got, 1.0, atol=1e-5)
    bad = dataclasses.replace(old, channels=nothing)
    np.testing.assert_array_equal(steady(jnp.ones((*SIZE, 2)), wall(now).depth, *view(now), bad), 1.0)


def test_after_a_jump_all_starts_anew() -> None:
    now, old = camera(3.1), memory(camera(), jnp.zeros((*SIZE, 2)))
    _, found = recall(old, wall(now).depth, *view(now))
    assert 0 < found.mean() < LEAST_FOUND_SHARE
    np.testing.assert_array_equal(steady(jnp.ones((*SIZE, 2)), wall(now).depth, *view(now), old), 1.0)


def test_what_was_not_finite_before_spoils_nothing_that_is_not_found() -> None:
    now = camera(0.6)
    old = memory(camera(), jnp.full((*SIZE, 2), jnp.nan))
    _, found = recall(old, wall(now).depth, *view(now))
    got = steady(jnp.ones((*SIZE, 2)), wall(now).depth, *view(now), old)
    assert np.isfinite(got[~np.asarray(found)]).all()


def test_depth_of_holes_continues_the_wall() -> None:
    seen = wall(camera(turn=1.0))
    hit = np.ones(SIZE, bool)
    hit[8:14, 10:18] = False
    holed = dataclasses.replace(seen, depth=jnp.where(hit, seen.depth, 0.0), hit=jnp.asarray(hit))
    filled = fill_depth(holed, jnp.zeros((*SIZE, 1)), SCHEDULE)
    np.testing.assert_array_equal(filled[hit], seen.depth[hit])
    np.testing.assert_allclose(filled, seen.depth, rtol=0.1)
    empty = dataclasses.replace(seen, hit=jnp.zeros(SIZE, bool))
    np.testing.assert_array_equal(fill_depth(empty, jnp.zeros((*SIZE, 1)), SCHEDULE), 0.0)


def test_remembers_only_the_same_size_and_lights() -> None:
    own = memory(camera())
    assert remembers(own, (*SIZE, 2), LIGHTS)
    assert not remembers(None, (*SIZE, 2), LIGHTS)
    assert not remembers(own, (*SIZE, 4), LIGHTS) and not remembers(own, (12, 16, 2), LIGHTS)
    brighter = (LIGHTS[0], AmbientLight(jnp.asarray(51.0), jnp.ones(3)))
    assert not remembers(own, (*SIZE, 2), brighter) and not remembers(own, (*SIZE, 2), LIGHTS[:1])


def viewed(frame: jax.Array, seen: GBuffer, camera: Camera) -> View:
    pose, intrinsics = (jnp.asarray(m, jnp.float32) for m in (camera.pose, camera.intrinsics.matrix))
    return View(frame, frame, seen, pose, intrinsics)


def test_a_video_of_a_noisy_guide_is_stiller_and_as_bright() -> None:
    rng, video, kept, free = np.random.default_rng(0), Video(), [], []
    rough = jnp.asarray(rng.uniform(50.0, 150.0, (*SIZE, 2)), jnp.float32)  # the mesh's noise, the same every time
    hit = rng.random(SIZE) > 0.4
    seen = dataclasses.replace(wall(camera()), hit=jnp.asarray(hit))
    for _ in range(8):
        frame = jnp.asarray(np.clip(0.5 + 0.2 * rng.standard_normal((*SIZE, 3)), 0, 1), jnp.float32)
        view = viewed(frame, seen, camera())
        shaded = Shaded.of(LIGHTS, rough, jnp.ones_like(rough), seen.hit)
        keep_still = video.filter(view, LIGHTS, frame, SCHEDULE)
        kept.append(relight(view, shaded, frame, SCHEDULE, temporal_filter=keep_still).refined)
        free.append(relight(view, shaded, frame, SCHEDULE).refined)
    still, restless = (np.abs(np.diff(np.stack(f[3:]), axis=0)).mean() for f in (kept, free))
    # An exponential mean that keeps k of the last changes by (1-k)/sqrt(1+k) of what independent frames do.
    assert still < 1.1 * (1 - KEEP_WEIGHT) * restless
    assert abs(np.mean(kept[-1]) / np.mean(free[-1]) - 1.0) < 0.02


def test_a_frame_of_another_size_starts_anew() -> None:
    video = Video(memory=memory(camera(), jnp.zeros((*SIZE, 4))))
    small = Intrinsics(16, 12, 15.0, 15.0, 8.0, 6.0)
    seen = jax.tree.map(lambda x: x[::2, ::2], wall(camera()))
    frame = jnp.full((12, 16, 3), 0.5)
    view = viewed(frame, seen, Camera(small, camera().pose))
    keep_still, shaded = video.filter(view, LIGHTS, frame, SCHEDULE), view.shade(LIGHTS)
    with_memory = relight(view, shaded, frame, SCHEDULE, temporal_filter=keep_still)
    np.testing.assert_array_equal(with_memory.image, relight(view, shaded, frame, SCHEDULE).image)
    assert video.memory is not None and video.memory.channels.shape == (12, 16, 4)


@pytest.mark.parametrize(
    "other", [LightSetup(LIGHTS, existing={"walls": (0.5, 0.5, 0.5)}), LightSetup(LIGHTS, reference_lux=100.0)]
)
def test_a_frame_under_another_set_up_of_the_same_lights_starts_anew(other: LightSetup) -> None:
    """What is left of the photo's light, and how bright it was, are in the channels too."""
    video, frame = Video(memory=memory(camera(), jnp.zeros((*SIZE, 4)))), jnp.full((*SIZE, 3), 0.5)
    view = viewed(frame, wall(camera()), camera())
    free = relight(view, view.shade(other), frame, SCHEDULE)
    with_memory = relight(
        view, view.shade(other), frame, SCHEDULE, temporal_filter=video.filter(view, other, frame, SCHEDULE)
    )
    np.testing.assert_array_equal(with_memory.image, free.image)
    assert video.memory is not None and remembers(video.memory, (*SIZE, 4), other)
    assert not remembers(video.memory, (*SIZE, 4), LIGHTS)
    again = video.filter(view, other, frame, SCHEDULE)
    relight(view, view.shade(other), frame, SCHEDULE, temporal_filter=again)


def test_refusals() -> None:
    for keep in (-0.1, 1.0, float("nan")):
        with pytest.raises(InputError, match=r"^keep: must lie in \[0, 1\), got"):
            Video(keep=keep)
    frame, seen = jnp.zeros((*SIZE, 3)), wall(camera())
    with pytest.raises(InputError, match=r"^relight: temporal_filter works on channels of lights"):
        view = viewed(frame, seen, camera())
        relight(view, view.shade(LIGHTS), frame, SCHEDULE, temporal_filter=lambda a, b: (a, b), mode="paper")
    with pytest.raises(InputError, match=r"^video: the view needs the camera's pose and intrinsics$"):
        Video().filter(View.of(frame, seen), LIGHTS, frame, SCHEDULE)
