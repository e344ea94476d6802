"""Rooms of known truth: the photo comes back, light adds up, no energy is made, lights are what they say."""

import dataclasses

import numpy as np
import pytest

from hyjax.data.truth_room import load_truth_room
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture, DirectionalLight, PointLight, RectLight, SkyLight
from hyjax.light.setup import LightSetup
from hyjax.synthetic.room import camera_path, make_room, photographs
from hyjax.synthetic.shapes import panel
from hyjax.synthetic.surface import Builder, Surface
from hyjax.synthetic.truth import DEVELOPMENT_ROOMS, TEST_ROOMS, TruthRoom, lit_builtin_room, lit_room
from hyjax.synthetic.truth.room import source_key, truth_exposure
from hyjax.synthetic.truth.source import Daylight, direct, unshadowed
from hyjax.synthetic.truth.transport import TexelTransport
from hyjax.util.errors import InputError

LOW = 0.15
WHITE = np.ones(3, np.float32)


@pytest.fixture(scope="module")
def builtin() -> TruthRoom:
    return lit_builtin_room(0, LOW)


@pytest.fixture(scope="module")
def random() -> TruthRoom:
    return lit_room("random-5-2-both", LOW)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2) + 1e-12))


def test_the_photo_comes_back(builtin: TruthRoom) -> None:
    room = make_room(0)
    camera = camera_path(24, 160, 120)[12]
    photo, again = next(photographs(room, [camera], LOW)), builtin.photograph(builtin.photo_light, camera, 0)
    assert psnr(photo, again) > 50
    np.testing.assert_array_equal(room.mesh.triangles, builtin.mesh.triangles)


@pytest.mark.slow
def test_light_adds_up(random: TruthRoom) -> None:
    """All sources at once give what each gives alone, in light maps and at single points."""
    together = random.photo_light
    parts = [random.bake([source]) for source in random.sources]
    for name in ("soft", "hard", "bounce"):
        total = sum(getattr(part.maps, name) for part in parts)
        off = np.abs(total - getattr(together.maps, name)) > 1e-3 * total.max()
        assert off.mean() < 1e-3, name  # a texel inside a solid is filled from lit neighbours
    points = random.transport.texels.position[::50]
    normals = random.transport.texels.normal[::50]
    both = [random.irradiance(part, points, normals) for part in (together, *parts)]
    for k in (0, 1):
        total = sum(part[k] for part in both[1:])
        np.testing.assert_allclose(total, both[0][k], atol=0.02 * total.max())


def test_random_room_photographs(random: TruthRoom) -> None:
    camera = random.walks.photos(3, 96, 72)[1]
    photo = random.photograph(random.photo_light, camera, 1)
    hits = random.caster.cast(camera.origin, camera.rays().reshape(-1, 3))
    assert photo.shape == (72, 96, 3) and 0.1 < photo.mean() < 0.9 and hits.hit.mean() > 0.7
    kinds = {type(source) for source in random.sources}
    assert Daylight in kinds and len(kinds) > 1
    assert {"window_0", "lamp_0"} <= set(random.anchors)
    # light of R lux stands for the photos' mean light
    mean = random.mean_light(random.photo_light, [camera])
    np.testing.assert_allclose(truth_exposure(random.white, mean, np.pi) / random.white, mean, rtol=1e-5)


def closed_box() -> tuple[Surface, RayCaster]:
    build, e, a = Builder(0), 0.01, 2.02
    for origin, s, t in (
        ((-e, -e, 0), (a, 0, 0), (0, a, 0)), ((-e, -e, 2), (0, a, 0), (a, 0, 0)),
        ((0, -e, -e), (0, a, 0), (0, 0, a)), ((2, -e, -e), (0, 0, a), (0, a, 0)),
        ((-e, 0, -e), (0, 0, a), (a, 0, 0)), ((-e, 2, -e), (a, 0, 0), (0, 0, a)),
    ):  # fmt: skip
        panel(build, origin, s, t, 0, texel=0.1)
    surface = build.finish()
    return surface, RayCaster(surface.mesh)


def test_white_furnace() -> None:
    """A lamp in a closed box: Φ in all on the walls, and after each bounce its albedo's share of that."""
    surface, caster = closed_box()
    albedo = np.full((len(surface.nodes), 3), 0.5, np.float32)
    transport = TexelTransport(surface, caster, albedo, [], 1.0, 5, 0)
    lamp = PointLight(np.ones(3, np.float32), 1000.0, WHITE)
    maps = transport.light(None, [], [lamp])
    area = np.bincount(surface.chart, surface.mesh.area_faces)[transport.texels.chart]
    area = area / np.bincount(transport.texels.chart)[transport.texels.chart]
    flux = np.pi * (maps.hard * area[:, None]).sum(axis=0)
    np.testing.assert_allclose(flux, 1000.0, rtol=0.03)
    bounced = np.pi * (maps.bounce * area[:, None]).sum(axis=0)
    np.testing.assert_allclose(bounced / flux, sum(0.5**k for k in range(1, 7)), rtol=0.03)


def test_lights_are_what_they_say(builtin: TruthRoom) -> None:
    """In the open, light is `illuminance_at`; under the table or beside the aperture's beam there is none."""
    table = np.array(builtin.anchors["table"]["position"], np.float32)
    points = table + np.array([[0.2, 0.3, 0.01], [0.2, 0.3, -0.4]], np.float32)
    up = np.array([[0.0, 0, 1], [0, 0, 1]], np.float32)
    turn = np.random.default_rng(0).random((2, 2))
    above = table + np.array([0, 0, 0.5], np.float32)
    down = np.array([0.0, 0, -1], np.float32)
    hole = Aperture.facing(above, down, (0.0, 1.0, 0.0), 1.0, 1.0)
    aside = dataclasses.replace(hole, center=hole.center + np.array([3.0, 0, 0], np.float32))
    for light in (
        PointLight(above, 100.0, WHITE, 0.05),
        RectLight.filling(hole, 100.0, WHITE),
        DirectionalLight(down, 100.0, WHITE, 0.005, hole),
    ):
        lux = direct(light, builtin.caster, points, up, 16, turn) * np.pi
        np.testing.assert_allclose(lux[0], unshadowed(light, points, up)[0], rtol=0.02)
        assert lux[0, 0] > 10 and lux[1, 0] < 0.2 * lux[0, 0]
    beside = DirectionalLight(down, 100.0, WHITE, 0.005, aside)
    assert not direct(beside, builtin.caster, points, up, 16, turn).any()


def test_windows_show_the_light_that_fills_them(builtin: TruthRoom) -> None:
    anchor = builtin.anchors["window_0"]
    opening = Aperture.facing(*(tuple(anchor[k]) for k in ("center", "normal")), (0, 0, 1), 2.4, 1.4)
    sky = RectLight.filling(opening, 2.4 * 1.4 * np.pi, WHITE)
    panes = builtin._panes((sky,))
    assert 0.3 < panes.mean() < 1.5 and not builtin._panes(()).any()
    dome = builtin.bake([SkyLight(np.array([0.0, 0, 1], np.float32), 1000.0, WHITE)])
    assert dome.maps.soft.mean() > 0


def test_names_and_keys(builtin: TruthRoom) -> None:
    assert len(set(DEVELOPMENT_ROOMS) | set(TEST_ROOMS)) == len(DEVELOPMENT_ROOMS) + len(TEST_ROOMS)
    for name in ("", "builtin", "random-1-2", "random-1-2-night"):
        with pytest.raises(InputError, match="no room"):
            lit_room(name)
    with pytest.raises(InputError, match="quality"):
        lit_room("builtin-0", 0.01)
    lamps = [PointLight(np.zeros(3, np.float32), x, WHITE) for x in (1.0, 2.0)]
    assert len({source_key([x]) for x in lamps}) == 2 and source_key(lamps) == source_key(list(lamps))


@pytest.mark.slow
def test_capture(tmp_path) -> None:
    name = "random-5-6-day"
    capture = load_truth_room(name, 3, 80, 60, tmp_path, LOW)
    again = load_truth_room(name, 3, 80, 60, tmp_path, LOW)
    assert again.fingerprint == capture.fingerprint and len(again) == 3
    assert capture.reference() is not None and len(capture.scan_input()[0]) == 64
    setup = LightSetup((PointLight(np.array([1.5, 1.5, 1.5], np.float32), 1500.0, WHITE),), 100.0)
    first, second = again.truth(setup, [0, 2])
    assert first.shape == (60, 80, 3) and 0.02 < first.mean() < 0.98 and not np.array_equal(first, second)
    photo = again.room.photograph(again.photo_light(), again[0].camera, 0, again.exposure)
    np.testing.assert_allclose(photo, again[0].image, atol=1 / 255)
