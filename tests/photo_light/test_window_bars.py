"""Bars of windows found in pictures."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from jaxtyping import Float

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.light.emission import Emitters, emission, source_pixels
from hyjax.light.gbuffer import GBuffer
from hyjax.light.panes import NO_BAR, Bars
from hyjax.photo_light.sources import PhotoWindow
from hyjax.photo_light.window_bars import shows, window_bars

UP = np.array([0.0, 0.0, 1.0])
WINDOW = PhotoWindow.facing("window-1", np.array([0.0, 3.0, 1.5]), np.array([0.0, -1.0, 0.0]), UP, 2.0, 1.4)
LENS = Intrinsics(320, 240, 260.0, 260.0, 160.0, 120.0)
EYES = [(-1.2, 0.2, 1.5), (-0.5, 0.0, 1.3), (0.1, 0.3, 1.6), (0.7, 0.1, 1.4), (1.3, 0.4, 1.5)]
FRAME_WIDTH = 0.06


def views(
    bars: list[tuple[float, float]],
    *,
    recess: float = 0.0,
    value: float = 0.95,
    eyes: list[tuple[float, float, float]] = EYES,
) -> list[tuple[Frame, GBuffer]]:
    """Pictures of the window: upright bars (middle, half width) and a frame round it, before a view outside."""
    made = []
    for eye in eyes:
        camera = Camera(LENS, look_at(np.array(eye), WINDOW.center + np.array([0.2 * eye[0], 0.0, 0.0]), UP))
        rays = camera.rays()

        def at(depth: float, rays: np.ndarray = rays, camera: Camera = camera) -> Float[np.ndarray, "h w 3"]:
            return camera.origin + (depth - camera.origin[1]) / rays[..., 1:2] * rays

        far, near = at(WINDOW.center[1] + 12.0), at(WINDOW.center[1] + recess)
        x, z = near[..., 0], near[..., 2] - WINDOW.center[2]
        picture = 0.6 + 0.2 * np.sin(1.7 * far[..., 0]) * np.sin(1.1 * far[..., 2])
        picture = np.where((np.abs(x) > 1.0 - FRAME_WIDTH) | (np.abs(z) > 0.7 - FRAME_WIDTH), value, picture)
        for middle, half in bars:
            picture = np.where(np.abs(x - middle) < half, value, picture)
        wall = at(WINDOW.center[1])
        hit = (np.abs(wall[..., 0]) > 1.0) | (np.abs(wall[..., 2] - WINDOW.center[2]) > 0.7)
        picture = np.where(hit, 0.4, picture)
        depth = np.where(hit, (wall - camera.origin) @ camera.pose[:3, 2], 0.0)
        image = np.repeat(picture[..., None], 3, axis=-1).astype(np.float32)
        points = (jnp.asarray(p, jnp.float32) for p in (wall, np.broadcast_to(WINDOW.normal, wall.shape), depth))
        made.append((Frame("view", image, camera, 0.0), GBuffer(*points, jnp.asarray(hit))))
    return made


def inner_bars(bars: Bars, axis: int = 0) -> np.ndarray:
    """Middle and half width of the bars of an axis, without the frame's."""
    spans = np.asarray(bars.spans)[0, axis]
    return spans[(spans[:, 1] > 0) & (spans[:, 1] < 0.1)]


@settings(deadline=None, max_examples=12, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    st.floats(-0.6, -0.1),
    st.floats(0.1, 0.6),
    st.floats(0.02, 0.05),
    st.sampled_from((0.0, 0.06, 0.12)),
    st.sampled_from((0.95, 0.15)),
)
def test_bars_are_found_where_they_are(
    first: float, second: float, half: float, recess: float, value: float
) -> None:
    bars = window_bars([WINDOW], views([(first, half), (second, half)], recess=recess, value=value))
    found = inner_bars(bars)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[:, 0], [first, second], atol=0.015)
    np.testing.assert_allclose(found[:, 1], half, atol=0.015)
    assert abs(float(bars.recess[0]) - recess) <= 0.031
    assert len(inner_bars(bars, axis=1)) == 0


def test_a_frame_in_the_plane_of_the_wall_is_a_bar_on_each_side() -> None:
    spans = np.asarray(window_bars([WINDOW], views([])).spans)[0]
    for axis, half in ((0, 1.0), (1, 0.7)):
        found = spans[axis][spans[axis, :, 1] > 0]
        inner = np.abs(found[:, 0]) - found[:, 1]
        assert len(found) == 2
        np.testing.assert_allclose(inner, half - FRAME_WIDTH, atol=0.02)


def test_what_lies_outside_is_no_bar() -> None:
    pictures = []
    for frame, gbuffer in views([]):
        rays = frame.camera.rays()
        far = frame.camera.origin + (13.0 - frame.camera.origin[1]) / rays[..., 1:2] * rays
        trunk = (np.abs(far[..., 0] - 0.4) < 0.4) & ~np.asarray(gbuffer.hit)
        image = np.where(trunk[..., None], 0.2, frame.image).astype(np.float32)
        pictures.append((Frame("trunk", image, frame.camera, 0.0), gbuffer))
    assert len(inner_bars(window_bars([WINDOW], pictures))) == 0


@pytest.mark.parametrize("eyes", [EYES[:1], [EYES[0], (-1.15, 0.2, 1.5)], [(0.0, 6.0, 1.5), (0.5, 6.0, 1.5)]])
def test_pictures_from_one_place_or_from_outside_tell_nothing(eyes: list[tuple[float, float, float]]) -> None:
    found = window_bars([WINDOW], views([(0.0, 0.04)], eyes=eyes))
    np.testing.assert_array_equal(found.spans, Bars.none(1).spans)


def test_pixels_that_are_not_finite_hide_no_bar() -> None:
    made = views([(0.1, 0.04)])
    expected = inner_bars(window_bars([WINDOW], made))
    made[2][0].image[100:140, 120:180] = np.nan
    np.testing.assert_allclose(inner_bars(window_bars([WINDOW], made)), expected, atol=0.011)


@pytest.mark.parametrize(
    "eye, towards, seen",
    [
        ((0.3, 2.8, 1.5), (0.3, 3.0, 1.5), True),  # no corner and no middle is in the picture
        ((0.0, 0.0, 1.5), (0.0, -1.0, 1.5), False),
        ((0.0, 0.0, 1.5), (3.0, 0.0, 1.5), False),
        ((0.0, 6.0, 1.5), (0.0, 3.0, 1.5), False),
    ],
)
def test_a_window_is_seen_from_the_room(
    eye: tuple[float, float, float], towards: tuple[float, float, float], seen: bool
) -> None:
    camera = Camera(LENS, look_at(np.array(eye), np.array(towards), UP))
    assert shows(WINDOW, Frame("view", np.zeros((*LENS.shape, 3), np.float32), camera, 0.0)) == seen


def test_of_too_many_bars_the_frame_is_left() -> None:
    spans = np.asarray(window_bars([WINDOW], views([(x, 0.025) for x in np.arange(-0.75, 0.76, 0.25)])).spans)[0, 0]
    assert (spans[:, 1] > 0.1).sum() == 2 and len(spans) == 2


def test_a_blind_is_no_bar() -> None:
    slats = [(x, 0.02) for x in np.arange(-0.8, 0.81, 0.08)]
    assert len(inner_bars(window_bars([WINDOW], views(slats)))) == 0


def test_bars_do_not_shine() -> None:
    ((frame, gbuffer),) = views([(0.0, 0.05)], eyes=[(0.0, 0.0, 1.5)])
    bars = Bars(jnp.array([[[[0.0, 0.05]], [[0.0, NO_BAR]]]]), jnp.zeros(1))
    pane = np.stack([WINDOW.center, WINDOW.right, WINDOW.up])[None]
    light = np.ones((1, 3)), np.zeros((1, 3)), np.ones(3), np.full((1, 3), 0.6)
    pane, *rest = (jnp.asarray(a, jnp.float32) for a in (pane, np.zeros((0, 4)), *light))
    own = Emitters(pane, bars, *rest)
    camera = (jnp.asarray(m, jnp.float32) for m in (frame.camera.pose, LENS.matrix))
    weight = np.asarray(source_pixels(own, jnp.asarray(frame.image), gbuffer.open_depth, *camera).weight)[120, :, 0]
    # A pixel is 1.15 cm wide there: the bar is some nine pixels, in the middle.
    assert (weight[157:163] == 0).all()
    assert (weight[100:154] == 1).all()
    assert (weight[166:220] == 1).all()


def test_burnt_out_bars_are_white_paint_at_most() -> None:
    ((frame, gbuffer),) = views([(0.0, 0.05)], eyes=[(0.0, 0.0, 1.5)])
    bars = Bars(jnp.array([[[[0.0, 0.05]], [[0.0, NO_BAR]]]]), jnp.zeros(1))
    pane = jnp.asarray(np.stack([WINDOW.center, WINDOW.right, WINDOW.up])[None], jnp.float32)
    camera = [jnp.asarray(m, jnp.float32) for m in (frame.camera.pose, LENS.matrix)]
    picture = jnp.asarray(frame.image)
    for kept, least in ((0.0, 0.95 / (0.8 * 0.5)), (0.3, 0.0)):
        light = jnp.ones((1, 3)), jnp.full((1, 3), kept), jnp.full(3, 0.5), jnp.full((1, 3), 0.6)
        found = emission(Emitters(pane, bars, jnp.zeros((0, 4)), *light), picture, gbuffer.open_depth, *camera)
        frame_light = np.asarray(found.frame_light)
        np.testing.assert_allclose(frame_light[120, 158:162], least, rtol=1e-5)
        assert (frame_light[120, 100:154] == 0).all() and (frame_light[:10] == 0).all()
