"""Panes and lamps that shine by themselves, and what is left of the photo's own light."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.core.schedule import Schedule
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.light.color import WHITE
from hyjax.light.emission import (
    LAMP_BRIGHT,
    LAMP_DARK,
    PANE_REFLECTANCE,
    PANE_SHARE,
    PANE_WHITE,
    Emitters,
    emission,
    radiant_filter,
)
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import AmbientLight, Aperture, Light, PointLight, RectLight
from hyjax.light.panes import Bars
from hyjax.light.photo_light import LEAST_PHOTO_LIGHT, SurfaceLight
from hyjax.light.view import View
from hyjax.pipeline import relight
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0)
PANE = Aperture.facing((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), UP, 1.0, 0.8)
PANES = np.stack([PANE.center, PANE.right, PANE.up])[None].astype(np.float64)
LAMPS = np.array([[1.0, 0.5, 0.2, 0.1]])
NONE = np.zeros((0, 4))
CAMERA = Camera(LENS, look_at(np.zeros(3), np.array([1.0, 0.0, 0.0]), UP))


def wall(depth: float = 2.0, hit: bool = True) -> GBuffer:
    """A wall across the camera's axis, of one triangle."""
    shape = LENS.shape
    position = jnp.asarray(CAMERA.rays() * depth, jnp.float32)
    normal = jnp.broadcast_to(jnp.asarray([-1.0, 0.0, 0.0]), (*shape, 3))
    weights = jnp.broadcast_to(jnp.asarray([1.0, 0.0, 0.0]), (*shape, 3))
    face = jnp.full(shape, 0 if hit else -1, jnp.int32)
    return GBuffer(position, normal, jnp.full(shape, depth), jnp.full(shape, hit), face, weights)


def emitters(sent: np.ndarray, kept: float = 0.0, panes: np.ndarray = PANES, lamps: np.ndarray = NONE) -> Emitters:
    own, bulbs, light = (jnp.asarray(a, jnp.float32) for a in (panes, lamps, sent))
    seen = jnp.full((len(panes), 3), 0.8)
    return Emitters(own, Bars.none(len(panes)), bulbs, light, jnp.full(light.shape, kept), jnp.full(3, 0.5), seen)


def found(source: Emitters, frame: jnp.ndarray, gbuffer: GBuffer):  # type: ignore[no-untyped-def]
    pose, matrix = (jnp.asarray(a, jnp.float32) for a in (CAMERA.pose, LENS.matrix))
    return emission(source, frame, gbuffer.open_depth, pose, matrix)


def test_a_rectangle_in_a_window_makes_its_pane_shine() -> None:
    sky = RectLight.filling(PANE, jnp.float32(160.0), jnp.asarray([1.0, 0.5, 0.25]))
    beside = RectLight.filling(dataclasses.replace(PANE, center=PANE.center + 3 * PANE.right), 160.0, jnp.ones(3))
    lights = [sky, beside, AmbientLight(jnp.float32(9.0), jnp.ones(3))]
    # 160 lumens over 0.8 m² are a radiance times π of 200 lux, over a reference of 100.
    np.testing.assert_allclose(radiant_filter(lights, PANES, NONE, 100.0), [[2.0, 1.0, 0.5]], rtol=1e-5)


def test_a_bulb_within_a_lamp_makes_it_shine() -> None:
    bulb = PointLight(jnp.asarray([1.0, 0.5, 0.25]), jnp.float32(4 * np.pi), jnp.ones(3))
    sent = radiant_filter([bulb], np.zeros((0, 3, 3)), LAMPS, 1.0)
    np.testing.assert_allclose(sent, [[100.0] * 3], rtol=1e-5)
    away = dataclasses.replace(bulb, position=bulb.position + 1.0)
    assert (radiant_filter([away], np.zeros((0, 3, 3)), LAMPS, 1.0) == 0).all()


def test_a_pane_covers_its_pixels_and_no_others() -> None:
    bright = jnp.full((*LENS.shape, 3), 0.8)
    result = found(emitters(np.array([[1.0, 1.0, 1.0]])), bright, wall(hit=False))
    weight = np.asarray(result.weight)[..., 0]
    # 1 m × 0.8 m at 2 m with 20 pixels a unit: 10 × 8 pixels.
    assert weight.sum() == pytest.approx(80, rel=0.02)
    assert weight[12, 16] == 1 and weight[0, 0] == 0
    np.testing.assert_allclose(np.asarray(result.sent)[12, 16], 0.5 * PANE_SHARE, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(result.reflectance)[12, 16], PANE_REFLECTANCE * 0.5, rtol=1e-5)


def test_a_pane_is_as_bright_however_much_of_it_is_in_view() -> None:
    """It is compared with the mean of all photos: panning across a window must not pump its brightness."""
    bright = jnp.full((*LENS.shape, 3), 0.4).at[:, 16:].set(0.9)
    source = emitters(np.array([[1.0, 1.0, 1.0]]))
    half = bright.at[:, 16:].set(0.0)
    both = [np.asarray(found(source, frame, wall(hit=False)).sent)[12, 14] for frame in (bright, half)]
    np.testing.assert_allclose(*both)


def test_a_kind_of_light_that_tells_no_shape_is_left_out() -> None:
    class Glow(PointLight):
        emitter = Light.emitter

    glow = Glow(jnp.asarray([1.0, 0.5, 0.2]), jnp.float32(9.0), jnp.ones(3))
    assert (radiant_filter([glow], PANES, LAMPS, 1.0) == 0).all()


def test_a_kept_lamp_is_not_lit_twice() -> None:
    source = emitters(np.zeros((1, 3)), kept=1.0, panes=np.zeros((0, 3, 3)), lamps=np.array([[2.0, 0, 0, 0.2]]))
    result = found(source, jnp.ones((*LENS.shape, 3)), wall(2.0))
    np.testing.assert_allclose(np.asarray(result.sent)[12, 16], 1.0)
    assert float(result.reflectance.max()) == 0


def test_the_papers_mode_refuses_divided_light() -> None:
    seen = view()
    shaded = seen.shade([PointLight(jnp.zeros(3), 9.0, jnp.ones(3))], surface_light=surface_light(1.0, 1.0))
    with pytest.raises(InputError, match="keep_photo_light"):
        relight(seen, shaded, seen.display, Schedule.preset("paper-80"), mode="paper")


def test_what_stands_before_a_pane_or_is_dark_does_not_shine() -> None:
    source = emitters(np.array([[1.0, 1.0, 1.0]]))
    bright = jnp.full((*LENS.shape, 3), 0.8)
    assert float(found(source, bright, wall(1.5)).weight.max()) == 0
    assert float(found(source, 0.02 * bright, wall(2.0)).weight.max()) == 0
    assert float(found(source, bright, wall(9.0, hit=False)).weight.max()) == 1


def test_a_window_that_was_dark_in_the_photos_shines_as_the_new_sky() -> None:
    """Only where the scan is open: a dark surface in the pane's place stays one, as do bars that lamps lit."""
    source = dataclasses.replace(emitters(np.array([[1.0, 1.0, 1.0]])), pane_means=jnp.zeros((1, 3)))
    dark = jnp.zeros((*LENS.shape, 3)).at[:, 17].set(0.06).at[:, 18].set(0.2)
    shining = found(source, dark, wall(hit=False))
    assert float(shining.weight[12, 16, 0]) == 1 and float(shining.weight[12, 18, 0]) == 0
    np.testing.assert_allclose(np.asarray(shining.sent)[12, 16:18], 0.5 * PANE_SHARE, rtol=1e-4)  # an even sky
    assert float(found(source, dark, wall(2.0)).weight.max()) == 0


def test_a_view_does_not_burn_out_and_keeps_its_contrast() -> None:
    frame = jnp.full((*LENS.shape, 3), 0.6).at[:, 16:].set(0.3)
    noon = dataclasses.replace(emitters(np.array([[20.0, 18.0, 16.0]])), pane_means=jnp.full((1, 3), 0.5))
    sent = np.asarray(found(noon, frame, wall(hit=False)).sent)
    assert 0.5 < sent[12, 14].max() < PANE_WHITE * 0.6 / 0.5
    np.testing.assert_allclose(sent[12, 17] / sent[12, 14], 0.3 / 0.6, rtol=1e-4)
    assert sent[12, 14].min() > 0.95 * sent[12, 14].max()  # a bright sky is white, as in any camera


def test_a_lamp_covers_a_disc_where_the_photo_is_burnt_out() -> None:
    lamps = np.array([[2.0, 0.0, 0.0, 0.2]])
    source = emitters(np.zeros((1, 3)), panes=np.zeros((0, 3, 3)), lamps=lamps)
    white = jnp.full((*LENS.shape, 3), WHITE)
    area = float(found(source, white, wall(2.0)).weight.sum())
    assert area == pytest.approx(np.pi * (0.3 * 10) ** 2, rel=0.1)
    assert float(found(source, 0.5 * white, wall(2.0)).weight.max()) == 0


def view(frame: float = 0.6) -> View:
    return View.of(
        jnp.full((*LENS.shape, 3), frame), wall(), pose=CAMERA.pose.astype(np.float32),
        intrinsics=LENS.matrix.astype(np.float32),
    )  # fmt: skip


def surface_light(photo: float, bounced: float, source: Emitters | None = None) -> SurfaceLight:
    faces = jnp.asarray([[0, 1, 2]])
    return SurfaceLight(jnp.full((3, 3), photo), jnp.full((3, 3), bounced), faces, source)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.3, 4.0])
@pytest.mark.parametrize("photo", [0.03, 0.06, 0.2, 3.0])
def test_light_that_stays_on_is_kept_at_any_power(photo: float, exponent: float) -> None:
    light = dataclasses.replace(surface_light(photo, 0.0), kept=jnp.full((3, 3), max(photo, LEAST_PHOTO_LIGHT)))
    made = light.raised(exponent)
    assert made.kept is not None
    np.testing.assert_allclose(made.kept, jnp.maximum(made.photo_light, LEAST_PHOTO_LIGHT), rtol=1e-5)


def test_a_lamps_rim_goes_out_with_it() -> None:
    """Its pixels are mixed with what lies behind, and less bright."""
    source = emitters(np.zeros((1, 3)), panes=np.zeros((0, 3, 3)), lamps=np.array([[2.0, 0.0, 0.0, 0.5]]))
    photo = np.full((24, 32, 3), 0.1, np.float32)
    photo[9:16, 13:20], photo[10:15, 14:19] = 0.6, WHITE
    weight = np.asarray(found(source, jnp.asarray(photo), wall(2.0)).weight)[..., 0]
    assert weight[9:16, 13:20].min() == 1.0 and weight[7, 16] == weight[12, 10] == 0.0


def test_a_lamp_that_shines_has_the_photos_soft_rim() -> None:
    """Those same pixels would else give it steps as wide as they are, in the bulb's full light."""
    lamp = emitters(np.full((1, 3), 40.0), panes=np.zeros((0, 3, 3)), lamps=np.array([[2.0, 0.0, 0.0, 0.5]]))
    photo = np.full((24, 32, 3), 0.1, np.float32)
    photo[9:16, 13:20], photo[10:15, 14:19], photo[11:14, 15:18] = 0.6, (LAMP_DARK + LAMP_BRIGHT) / 2, WHITE
    shining = found(lamp, jnp.asarray(photo), wall(2.0))
    given = np.asarray(shining.weight * shining.sent)[..., 0]
    assert (given[11:14, 15:18] == 20.0).all() and given[9, 13:20].max() == 0.0
    assert 0.0 < given[10, 16] < 0.5 * 20.0
    weights = [
        float(found(dataclasses.replace(lamp, sent=jnp.full((1, 3), sent)), photo, wall(2.0)).weight[9, 16, 0])
        for sent in (0.0, 0.5, 1.0, 2.0)
    ]
    assert weights == pytest.approx([0.5, 0.375, 0.25, 0.0], abs=1e-5), "from off to on without a step"
    stays_on = dataclasses.replace(lamp, kept=jnp.ones((1, 3)))
    assert float(found(stays_on, photo, wall(2.0)).weight[9, 16, 0]) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize(("bright", "is_lamp"), [(0.77, False), (WHITE, True)])
def test_before_a_pane_a_lamp_has_the_pixels_that_are_more_its_own(bright: float, is_lamp: bool) -> None:
    frame, sent = jnp.full((*LENS.shape, 3), bright), np.array([[2.0] * 3, [0.0] * 3])
    both = found(emitters(sent, lamps=np.array([[1.0, 0.0, 0.0, 0.3]])), frame, wall(hit=False))
    pane = found(emitters(sent[:1]), frame, wall(hit=False))
    assert float(both.weight[12, 16, 0]) == 1.0
    np.testing.assert_allclose(both.sent[12, 16], 0.0 if is_lamp else pane.sent[12, 16])


def test_a_frame_is_divided_by_its_own_light_and_gets_bounces() -> None:
    lamp = PointLight(jnp.zeros(3), jnp.float32(0.0), jnp.ones(3))
    seen = view()
    shaded = seen.shade([lamp], surface_light=surface_light(2.0, 150.0))
    relit = relight(seen, shaded, seen.display, Schedule.preset("hyjax"))
    # 150 lux over a reference of 300, over twice the mean light.
    np.testing.assert_allclose(relit.image, 0.25 * seen.frame, rtol=1e-4)


def test_bounces_stand_in_for_ambient_light_unless_there_is_no_other() -> None:
    ambient, lamp = AmbientLight(jnp.float32(300.0), jnp.ones(3)), PointLight(jnp.zeros(3), 0.0, jnp.ones(3))
    seen, light = view(), surface_light(1.0, 0.0)
    both = seen.shade([lamp, ambient], surface_light=light)
    alone = seen.shade([ambient], surface_light=light)
    assert float(both.illuminance.sum()) == 0
    assert float(alone.illuminance.min()) == 300


def test_a_kept_pane_is_what_the_photo_showed() -> None:
    lamp = PointLight(jnp.zeros(3), jnp.float32(0.0), jnp.ones(3))
    seen = view(1.0)
    shaded = seen.shade([lamp], surface_light=surface_light(1.0, 0.0, emitters(np.zeros((1, 3)), kept=0.5)))
    image = np.asarray(relight(seen, shaded, seen.display, Schedule.preset("hyjax")).image)
    np.testing.assert_allclose(image[12, 16], 0.5 * np.asarray(seen.frame)[12, 16], rtol=1e-4)
    np.testing.assert_allclose(image[0, 0], 0.0, atol=1e-6)


def test_a_surface_without_triangles_is_refused() -> None:
    seen = dataclasses.replace(view(), gbuffer=dataclasses.replace(wall(), face=None, barycentric=None))
    with pytest.raises(InputError, match="triangle"):
        seen.shade([PointLight(jnp.zeros(3), 1.0, jnp.ones(3))], surface_light=surface_light(1.0, 0.0))
