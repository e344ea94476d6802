"""Live scene: frames that join it, pictures relit on it, the chair that is taken away."""

import dataclasses
import logging

import numpy as np
import pytest
from boxes import K, frames, looking, room

import hyjax
from experiments.live import FPS, around_the_chair, chair_shadow, frames_of, visible, without_chair
from hyjax.configuration import Configuration
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_map import DepthReading
from hyjax.light.kinds import AmbientLight, PointLight
from hyjax.live.follow import Follower
from hyjax.live.scene import LiveScene, thinned
from hyjax.scene.relighter import Relighter
from hyjax.synthetic.room import make_room
from hyjax.util.errors import InputError

WHITE = np.ones(3, np.float32)
LIGHTS = (
    PointLight(np.array([1.0, -1.0, 1.8], np.float32), np.float32(800.0), WHITE),
    AmbientLight(np.float32(20.0), WHITE),
)
MIDDLE = (0.0, 0.0, 0.2)
SCHEDULE = hyjax.Schedule.preset("paper-50")


@pytest.fixture(scope="module")
def seen() -> list[Frame]:
    return frames(room(far=False), looking(MIDDLE, 12))


def relit_as_they_come(scene: LiveScene, seen: list[Frame]) -> list[np.ndarray]:
    """Each frame relit on the surface that is known by then, which is renewed with every sixth."""
    relighter, relit = Relighter(scene, LIGHTS, SCHEDULE), []
    for number, frame in enumerate(seen):
        assert scene.add(frame)
        if number % 6 == 0:
            scene.update()
        relit.append(np.asarray(relighter.relit(frame).image))
    return relit


def test_frames_are_relit_as_the_surface_grows(seen: list[Frame]) -> None:
    scene = LiveScene(voxel=0.05)
    relit = relit_as_they_come(scene, seen)
    assert scene.revision == 2, "after each sixth frame"
    own = Configuration.of(SCHEDULE).sampled()
    view = hyjax.Relighter(scene, LIGHTS, SCHEDULE).view(seen[-1])
    shaded = view.shade(LIGHTS, shadow_maps=scene.shadow_maps(LIGHTS), interleave=2)
    whole = hyjax.relight(view, shaded, view.display, own.schedule, shadow_schedule=own.shadow_schedule)
    np.testing.assert_array_equal(whole.image, relit[-1])
    assert float(view.gbuffer.hit.mean()) > 0.6 and len(scene.mesh.faces) > 1000
    again = relit_as_they_come(LiveScene(voxel=0.05), seen)
    np.testing.assert_array_equal(again[-1], relit[-1])


def test_unusable_frames_are_skipped_with_a_line(seen: list[Frame], caplog: pytest.LogCaptureFixture) -> None:
    scene = LiveScene(voxel=0.05)
    with pytest.raises(InputError, match="no surface yet"):
        scene.view(seen[0])
    assert scene.update() is None
    assert scene.add(seen[3])
    nowhere = Camera(K, np.eye(4))
    nowhere.pose[0, 3] = np.nan
    small = dataclasses.replace(seen[5], depth=np.ones((4, 4), np.float32))
    with caplog.at_level(logging.WARNING):
        assert not scene.add(seen[2]), "comes before"
        assert not scene.add(dataclasses.replace(seen[4], time=float("nan")))
        assert not scene.add(dataclasses.replace(seen[4], depth=None))
        assert not scene.add(dataclasses.replace(seen[4], camera=nowhere))
        assert not scene.add(small)
        for _ in range(50):
            scene.add(seen[1])
    assert scene.volume.frames == 1 and sum(scene.skipped.values()) == 55
    assert len(caplog.records) == 4, "a line for each reason, not for each frame"
    assert scene.add(seen[4])
    empty = dataclasses.replace(seen[6], depth=np.zeros_like(seen[6].depth))
    assert scene.add(empty) and scene.update() is not None


def test_a_reason_is_told_again_after_a_hundred_frames(seen: list[Frame], caplog: pytest.LogCaptureFixture) -> None:
    scene = LiveScene(voxel=0.05)
    for _ in range(100):
        scene.add(dataclasses.replace(seen[0], depth=None))
    assert len(caplog.records) == 2 and "100 so far" in caplog.text


def test_a_large_depth_map_is_thinned_in_place() -> None:
    lens = Intrinsics(960, 720, 800.0, 810.0, 470.0, 365.0)
    depth = np.random.default_rng(0).uniform(1.0, 2.0, (720, 960)).astype(np.float32)
    small = thinned(DepthReading(depth, Camera(lens, np.eye(4))))
    assert small.depth.shape == (240, 320) == small.camera.intrinsics.shape
    points, few = Camera(lens, np.eye(4)).unproject(depth), small.camera.unproject(small.depth)
    np.testing.assert_allclose(few, points[1::3, 1::3], atol=1e-9)
    reading = DepthReading(depth[:200, :300], Camera(lens.crop(0, 0, 200, 300), np.eye(4)))
    assert thinned(reading) is reading


def test_a_follower_takes_frames_and_ends_with_them(seen: list[Frame]) -> None:
    scene, told = LiveScene(voxel=0.05), []
    odd = dataclasses.replace(seen[3], depth=None)
    follower = Follower(scene, iter([*seen[:3], odd, *seen[4:]]), lambda frame: told.append(frame.name), drop=False)
    assert follower.start().wait(60.0)
    assert follower.frames == len(seen) - 1 and follower.dropped == 0
    assert told[-1] == seen[-1].name and follower.newest is seen[-1]
    assert scene.surface is not None and 0 < follower.updates <= len(seen)


def test_a_follower_outlives_errors_and_stops(seen: list[Frame], caplog: pytest.LogCaptureFixture) -> None:
    def failing(frame: Frame) -> None:
        raise RuntimeError("a viewer has gone")

    def source():  # type: ignore[no-untyped-def]
        yield from seen[:2]
        raise InputError("the phone has gone")

    follower = Follower(LiveScene(voxel=0.05), source(), failing).start()
    assert follower.wait(60.0) and follower.frames > 0
    assert "no more frames are read" in caplog.text and "a viewer has gone" in caplog.text
    follower.stop()


@pytest.mark.slow
def test_the_shadow_of_a_chair_goes_with_the_chair() -> None:
    """Within two seconds of frames, by their own time; the rest of the picture keeps its light."""
    mesh = make_room().mesh
    without = without_chair(mesh)
    cameras = around_the_chair(120)
    shadow = chair_shadow(mesh, without, cameras[60])
    assert shadow.sum() > 300
    scene = LiveScene()
    before = None
    for number, frame in enumerate([*frames_of(mesh, cameras[:60]), *frames_of(without, cameras[60:], 60)]):
        if number == 60:
            before = visible(scene, cameras[60])
            assert (1.0 - before[shadow]).mean() > 0.3, "at 4 cm its legs are lost, its seat is not"
        assert scene.add(frame)
        if number % 6 == 5:
            scene.update()
    assert scene.volume.frames / FPS == 4.0 and before is not None
    after = visible(scene, cameras[60])
    assert (1.0 - after[shadow]).mean() < 0.05
    elsewhere = np.ones_like(shadow)
    elsewhere[shadow] = False
    changed = np.abs(after - before) > 0.5
    assert (changed & elsewhere).mean() < 0.05
