"""Photo's light of a scene: kept with its sources, so that the next start reads no frame for it."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from hyjax import AmbientLight, LightSetup, PointLight, Scene
from hyjax.configuration import Configuration, LightOptions
from hyjax.data import frames
from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.light.photo_light import SurfaceLight
from hyjax.photo_light.estimate import filled_share
from hyjax.photo_light.source_arrays import sources_from_arrays, sources_to_arrays
from hyjax.photo_light.sources import PhotoLamp, PhotoSources, PhotoWindow
from hyjax.scene import photo_light
from hyjax.scene.relighter import Relighter
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(16, 12, 10.0, 10.0, 8.0, 6.0)
WINDOW = "windows: [{center: [0, 2, 0], normal: [0, -1, 0], width: 1, height: 1}]"
SETUP = LightSetup((PointLight(jnp.zeros(3), jnp.asarray(9.0), jnp.ones(3)),))


class Room(Capture):
    """Two pictures in a box, which counts how often one is read."""

    name = "room"

    def __init__(self, fingerprint: str = "room", anchors: Any = None) -> None:
        self.up, self.anchors, self._fingerprint, self.read = UP, anchors or {}, fingerprint, 0

    @property
    def fingerprint(self) -> str:
        return self._fingerprint

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> Frame:
        self.read += 1
        image = np.random.default_rng(index).uniform(0.3, 0.9, (*LENS.shape, 3)).astype(np.float32)
        camera = Camera(LENS, look_at(np.array([0.2 * index, -1.0, 0.1]), np.array([0.0, 2.0, 0.0]), UP))
        return Frame(f"f{index}", image, camera, float(index))


def walls(side: float = 4.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((side, 4, 3))
    mesh.invert()
    return mesh


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def named(tmp_path: Path) -> Path:
    file = tmp_path / "windows.yaml"
    file.write_text(WINDOW)
    return file


def light(scene: Scene) -> Any:
    return scene.photo_light.surface_light(SETUP, None)


@pytest.mark.parametrize("from_file", [True, False])
def test_the_next_start_reads_no_frame_and_finds_the_same(from_file: bool, named: Path) -> None:
    file = named if from_file else None
    first, second = Room(), Room()
    made, kept = (Scene(room, walls(), photo_sources=file) for room in (first, second))
    before, after = light(made), light(kept)
    assert first.read and not second.read
    assert kept.photo_light.record() == made.photo_light.record()
    assert (made.photo_light.sources.origin == "file") == from_file
    np.testing.assert_array_equal(after.photo_light, before.photo_light)
    np.testing.assert_array_equal(after.bounced, before.bounced)
    if from_file:
        np.testing.assert_array_equal(after.emitters.pane_means, before.emitters.pane_means)
        assert 0.05 < float(after.emitters.pane_means.min()) < float(after.emitters.pane_means.max()) < 0.9


def test_another_size_of_large_pictures_takes_the_kept_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one of other proportions: the light is estimated from whole pictures."""
    for module in (frames, photo_light):
        monkeypatch.setattr(module, "SMALL_WIDTH", LENS.width // 2)
    sizes = (None, (LENS.height // 2, LENS.width // 2), (LENS.width, LENS.width), (3, 4), (2, 4))
    rooms = [Room() for _ in sizes]
    scenes = [Scene(room, walls(), size=size) for room, size in zip(rooms, sizes, strict=True)]
    found = [scene.photo_light.estimate for scene in scenes]
    assert [bool(room.read) for room in rooms] == [True, False, False, True, False]
    np.testing.assert_array_equal(found[0].light.illuminance, found[2].light.illuminance)
    (shape,) = {frame.image.shape[:2] for frame in scenes[0].photo_light._frames}
    assert shape == (LENS.height // 2, LENS.width // 2)


def test_a_light_begun_on_another_thread_is_the_same_and_begun_once(named: Path) -> None:
    ahead, plain = (Scene(Room(), walls(), photo_sources=named) for _ in range(2))
    assert ahead.photo_light.begin() and not ahead.photo_light.begin()
    found = light(ahead)
    assert not plain.photo_light.begin(), "it is kept"
    np.testing.assert_array_equal(found.photo_light, light(plain).photo_light)
    np.testing.assert_array_equal(found.emitters.pane_means, light(plain).emitters.pane_means)


def test_whatever_decides_on_the_light_is_in_its_key(named: Path) -> None:
    light(Scene(Room(), walls(), photo_sources=named))
    lamp = {"lamp_0": {"position": np.array([0.0, 0.0, 1.0])}}
    others = [
        (Room("other"), walls(), {}),
        (Room(anchors=lamp), walls(), {}),
        (Room(), walls(4.1), {}),
        (Room(), walls(), {"size": (6, 8)}),
    ]
    for room, mesh, options in others:
        light(Scene(room, mesh, photo_sources=named, **options))
        assert room.read, options
    named.write_text(WINDOW.replace("width: 1", "width: 1.2"))
    room = Room()
    light(Scene(room, walls(), photo_sources=named))
    assert room.read
    light(Scene(room := Room(), walls()))
    assert room.read


def test_where_nothing_is_believed_the_picture_is_that_of_the_kept_light() -> None:
    scene, lamp = Scene(Room(), walls()), PointLight(jnp.array([0.5, 0.0, 0.5]), 900.0, jnp.ones(3))
    ambient = AmbientLight(jnp.float32(40.0), jnp.array([1.0, 0.8, 0.6]))
    assert scene.photo_light.estimate.exponent == 0
    for lights in ([lamp, ambient], [lamp], [ambient]):
        setup = LightSetup(tuple(lights), 100.0)
        divided, kept = (
            Relighter(scene, setup, Configuration(light=LightOptions(photo_light=photo_light))).relit(0)
            for photo_light in ("divided", "kept")
        )
        np.testing.assert_allclose(divided.image, kept.image, atol=1e-5)


@pytest.mark.parametrize("choices", [{}, {"bounces": False}, {"bounce_gain": 0.7}, {"photo_exponent": 1.3}])
def test_with_all_sources_kept_and_no_other_light_there_is_the_photo(choices: dict[str, Any], named: Path) -> None:
    scene = Scene(Room(), walls(), photo_sources=named)
    kept = dict.fromkeys(scene.photo_light.estimate.names, (1.0, 1.0, 1.0))
    setup = LightSetup((PointLight(jnp.zeros(3), jnp.asarray(1e-6), jnp.ones(3)),), existing=kept)
    relit = Relighter(scene, setup, Configuration().with_choices(choices)).relit(0)
    np.testing.assert_allclose(relit.image, scene.view(0).frame, atol=1e-5)


def test_what_is_kept_of_uneven_light_follows_its_exponent() -> None:
    even, uneven = jnp.full((3, 3), 300.0), jnp.array([[0.5] * 3, [1.0] * 3, [2.0] * 3])
    light = SurfaceLight(uneven, None, jnp.zeros((1, 3), jnp.int32), kept=300.0 * uneven).raised(1.4)
    assert light.kept is not None
    np.testing.assert_allclose(light.kept / light.photo_light, even, rtol=1e-5)


def test_a_lamp_of_unknown_form_lights_and_is_not_drawn() -> None:
    scene, places = Scene(Room(), walls()), (np.array([0.5, 0.2, 0.8]), np.array([-0.5, 0.3, 0.7]))
    lamps = tuple(PhotoLamp(f"lamp-{n}", p, r) for n, (p, r) in enumerate(zip(places, (0.0, 0.1))))
    photo_light = scene.photo_light
    photo_light._sources = PhotoSources((), lamps, "file")
    assert photo_light.estimate.names[:2] == ("lamp-0", "lamp-1")
    emitters = photo_light.emitters(LightSetup(SETUP.lights, existing={"lamp-1": (0.5, 0.5, 0.5)}))
    assert emitters is not None
    np.testing.assert_allclose(emitters.lamps, [[*places[1], 0.1]], rtol=1e-6)
    np.testing.assert_allclose(emitters.kept, [[0.5] * 3])


def test_sources_come_back_from_their_arrays() -> None:
    window = PhotoWindow.facing("balcony", np.array([0.0, 2.0, 0.1]), np.array([0.0, -1.0, 0.0]), UP, 1.0, 1.3)
    lamps = (
        PhotoLamp("pendant", np.array([0.0, 0.1, 1.0]), 0.07),
        PhotoLamp("shade", np.array([1.0, 0.1, 1.0]), 0.05),
    )
    back = sources_from_arrays(sources_to_arrays(PhotoSources((window,), lamps, "found")))
    assert back.origin == "found" and repr(back) == repr(PhotoSources((window,), lamps, "found"))
    none = sources_from_arrays(sources_to_arrays(PhotoSources((), (), "none")))
    assert none == PhotoSources((), (), "none")


def test_its_shapes_are_known_before_the_fit(named: Path) -> None:
    """Programs that are compiled while it is fitted are those that are run."""
    scene = Scene(Room(), walls(), photo_sources=named)
    assert scene.photo_light.expected() is None, "none was begun"
    assert scene.photo_light.begin()
    expected = scene.photo_light.expected()
    assert expected is not None
    estimate = scene.photo_light.estimate
    believed = dataclasses.replace(
        estimate.light, transport=estimate.transport, filled_share=filled_share(estimate.transport)
    )
    assert jax.tree.structure(expected) == jax.tree.structure(believed)
    assert [(x.shape, x.dtype) for x in jax.tree.leaves(expected)] == [
        (x.shape, x.dtype) for x in jax.tree.leaves(believed)
    ]


def test_enlarged_pictures_are_taken_as_they_were() -> None:
    """Sources are found in what the camera saw: enlarged, a bright patch of wall came out as a window."""
    for size in (LENS.shape, (4 * LENS.height, 4 * LENS.width), (LENS.height // 2, LENS.width // 2)):
        scene = Scene(Room(), walls(), size=size)
        shapes = {frame.image.shape[:2] for frame in scene.photo_light._frames}
        assert scene.frame(0).image.shape[:2] == size and shapes == {min(size, LENS.shape)}


def test_an_estimate_that_fails_is_waited_for_no_longer(tmp_path: Path) -> None:
    file = tmp_path / "windows.yaml"
    file.write_text("windows: 3")
    scene = Scene(Room(), walls(), photo_sources=file)
    assert scene.photo_light.begin() and scene.photo_light.expected() is None
    with pytest.raises(InputError, match="windows"):
        _ = scene.photo_light.estimate
