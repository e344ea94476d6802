"""Live tour: capture, renderer and viewers follow frames that arrive; no browser."""

import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

sys.path.append(str(Path(__file__).parents[1] / "live"))

from boxes import UP, frames, looking, room
from visits import visiting

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, look_at
from hyjax.live.scene import LiveScene
from hyjax.scene.light_places import survey_capture
from hyjax.scene.settings import SceneSettings
from hyjax.tour.arriving import Arriving
from hyjax.tour.live import LiveCapture, LiveRenderer
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import TourPlan
from hyjax.tour.settings import TourSettings
from hyjax.tour.tour import Tour
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.errors import InputError

PAPER = Schedule.preset("paper-50")
MIDDLE = (0.0, 0.0, 0.2)
PLAN = TourPlan(hour=0.0, lamps=(place_lamp("bulb", np.array([0.9, -0.6, 1.4]), UP),)).check()


def test_a_capture_forgets_every_second_frame_when_it_is_full() -> None:
    capture = LiveCapture(UP, most=4)
    seen = frames(room(), looking(MIDDLE, 6))
    assert [capture.append(frame) for frame in seen] == [False, False, False, False, True, False]
    assert [frame.name for frame in capture] == ["0000", "0002", "0004", "0005"]
    np.testing.assert_allclose(capture[3].image, seen[5].image, atol=1 / 255)
    assert capture[3].depth is None


@pytest.fixture(scope="module")
def scanned() -> LiveScene:
    scene = LiveScene(voxel=0.05)
    for frame in frames(room(), looking(MIDDLE, 4)):
        scene.add(frame)
    assert scene.update() is not None
    return scene


def test_exposed_anew_as_often_as_twice_as_many_frames_have_arrived(scanned: LiveScene) -> None:
    """Those that were forgotten count."""
    frame, capture = frames(room(), looking(MIDDLE, 1))[0], LiveCapture(UP, most=2)
    capture.append(frame)
    renderer = LiveRenderer(scanned, capture)
    exposed, lighting = [], renderer.lighting
    for _ in range(8):
        capture.append(frame)
        renderer.follow()
        if renderer.lighting is not lighting:
            exposed.append(capture.arrived)
            lighting = renderer.lighting
    assert exposed == [2, 4, 8] and len(capture) == 2


def test_a_scan_that_has_only_begun_opens_no_sky() -> None:
    """Its walls may still come."""
    (frame,), scene, capture = frames(room(), looking(MIDDLE, 1)), LiveScene(voxel=0.05), LiveCapture(UP)
    scene.add(frame)
    scene.update()
    capture.append(frame)
    renderer = LiveRenderer(scene, capture)
    assert survey_capture(scene.caster, capture).open_sky
    plan = renderer.first_plan()
    assert plan.windows and not plan.open_sky


def test_frames_that_look_beside_the_surface_leave_the_exposure(scanned: LiveScene) -> None:
    (frame,) = frames(room(), looking(MIDDLE, 1))
    above = Camera(frame.camera.intrinsics, look_at(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.1, 9.0]), UP))
    beside, capture = dataclasses.replace(frame, camera=above), LiveCapture(UP, most=2)
    capture.append(beside)
    with pytest.raises(InputError, match="no camera sees"):
        LiveRenderer(scanned, capture)
    capture.append(frame)
    renderer = LiveRenderer(scanned, capture)
    lighting = renderer.lighting
    for _ in range(6):
        capture.append(beside)
        renderer.forget_frames()
        renderer.follow()
    assert renderer.lighting is lighting
    for _ in range(2):
        capture.append(frame)
    renderer.forget_frames()
    renderer.follow()
    assert renderer.lighting is not lighting


@pytest.mark.slow
def test_pictures_follow_the_surface(tmp_path: Path) -> None:
    scene, cameras = LiveScene(voxel=0.05), looking(MIDDLE, 20)
    before, after = frames(room(), cameras), frames(room(box=False), cameras, first=20)
    for frame in before:
        scene.add(frame)
    surface = scene.update()
    assert surface is not None
    capture = LiveCapture(UP)
    capture.append(before[-1])
    renderer = LiveRenderer(scene, capture, folder=tmp_path)
    assert renderer.live and renderer.photo_light is None
    view = Viewpoint(0, "raw filter", PAPER)  # grey pictures have no edges: diffusion blurs all
    first = renderer.render(PLAN, view, draft=True)
    assert first.draft
    fine = renderer.render(PLAN, view)
    assert not fine.draft and not renderer.render(PLAN, view, draft=True).draft, "fine maps are there"
    for frame in after:
        scene.add(frame)
    for _ in range(5):
        surface = scene.update()
    assert surface is not None and not scene.pieces.waiting
    renderer.follow()
    capture.append(after[-1])
    second = renderer.render(PLAN, view, draft=True)
    assert second.draft, "the surface has changed"
    other = LiveRenderer(scene, capture)
    assert other.lighting is not renderer.lighting, "exposed for as many frames as there are"
    other.lighting = renderer.lighting
    np.testing.assert_array_equal(renderer.render(PLAN, view).picture, other.render(PLAN, view).picture)
    assert np.abs(second.picture.astype(int) - fine.picture).max() > 50, "the box has gone"
    newest = renderer.render(replace(PLAN, exposure=1.0), Viewpoint(1, "relit", PAPER))
    assert newest.frame.name == after[-1].name
    renderer.follow()
    assert renderer.lighting is not other.lighting, "twice as many frames: exposed anew"
    renderer.forget_frames()
    assert renderer.render(PLAN, view).picture.shape == second.picture.shape


def slowly(seen: list[Frame]) -> Iterator[Frame]:
    for frame in seen:
        time.sleep(0.02)
        yield frame


def test_frames_arrive_in_the_renderer() -> None:
    seen = frames(room(), looking(MIDDLE, 40))
    arriving = Arriving(LiveScene(voxel=0.05), slowly(seen), size=None, widest=80)
    told: list[int] = []
    renderer = arriving.first_renderer(Path(), Configuration())
    first, early = renderer.capture[0].name, [frame.name for frame in arriving._early]
    assert len(early) > 1 and first == early[0], "any one of them may look beside the surface"
    arriving.on_frame = lambda forgotten: told.append(len(renderer.capture))
    assert renderer.frame(0).image.shape == (60, 80, 3)
    assert arriving._follower.wait(60.0)
    assert told and told[-1] == len(renderer.capture) > 1
    assert renderer.capture[len(renderer.capture) - 1].name == seen[-1].name
    assert renderer.up @ UP > 0.5, "the mean of the cameras"
    arriving.stop()


def test_a_tour_of_nothing_is_refused(tmp_path: Path) -> None:
    arriving = Arriving(LiveScene(), iter([]), size=None, widest=640)
    with pytest.raises(InputError, match="ended before there was a surface"):
        arriving.first_renderer(tmp_path, Configuration())
    with pytest.raises(InputError, match="leave --capture and --mesh out"):
        TourSettings(SceneSettings(capture=tmp_path), live="-").check()


@pytest.mark.slow
def test_visitors_are_told_of_frames_that_arrive(tmp_path: Path) -> None:
    """Pictures are of the newest frame that a visitor asks for, on the surface that it has renewed."""
    scene, seen = LiveScene(voxel=0.05), frames(room(), looking(MIDDLE, 6))
    for frame in seen[:4]:
        scene.add(frame)
    scene.update()
    capture = LiveCapture(UP, most=4)
    for frame in seen[:3]:
        capture.append(frame)
    renderer = LiveRenderer(scene, capture)
    tour = Tour(renderer, {"paper-50": PAPER}, tmp_path, port=0)
    try:
        with visiting(tour) as visit:
            first = visit.picture(PLAN, frame=2)
            for number, forgotten in ((3, False), (4, True)):
                assert capture.append(seen[number]) == forgotten
                if forgotten:
                    renderer.forget_frames()
                tour._frame_arrived(forgotten)
                news = visit.receive()[0]
                assert news["frames"] == len(capture) and len(news["entries"]) == (3 if forgotten else 1)
                assert news["numbering"] == (2 if forgotten else 1)
            newest = visit.picture(PLAN, frame=len(capture) - 1)
            assert newest.shape == first.shape and np.abs(newest.astype(float) - first).mean() > 1
    finally:
        tour.stop()
