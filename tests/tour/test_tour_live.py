"""Live tour: capture, renderer and viewers follow frames that arrive; no browser."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

sys.path.append(str(Path(__file__).parents[1] / "live"))

from boxes import UP, frames, looking, room

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.live.scene import LiveScene
from hyjax.scene.settings import SceneSettings
from hyjax.tour.arriving import Arriving
from hyjax.tour.live import LiveCapture, LiveRenderer
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import TourPlan
from hyjax.tour.settings import TourSettings
from hyjax.tour.viewer import Viewer
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
    np.testing.assert_array_equal(
        renderer.render(PLAN, view).picture, LiveRenderer(scene, capture).render(PLAN, view).picture
    )
    assert np.abs(second.picture.astype(int) - fine.picture).max() > 50, "the box has gone"
    newest = renderer.render(replace(PLAN, exposure=1.0), Viewpoint(1, "relit", PAPER))
    assert newest.frame.name == after[-1].name
    assert len(renderer.lit_mesh(PLAN).faces) > 1000
    renderer.forget_frames()
    assert renderer.render(PLAN, view).picture.shape == second.picture.shape


class FakeQueue:
    def __init__(self) -> None:
        self.requests: list[Any] = []

    def request(self, *viewers: Any, interactive: bool = True) -> None:
        self.requests.append((viewers, interactive))


def viewer_of(queue: FakeQueue, count: int, *, follow: bool, in_picture: bool = True) -> Any:
    """A viewer without its browser."""
    viewer: Any = Viewer.__new__(Viewer)
    capture = [None] * count
    viewer.session = SimpleNamespace(renderer=SimpleNamespace(capture=capture), queue=queue)
    viewer.client = SimpleNamespace(client_id=7)
    viewer.controls = SimpleNamespace(follow=follow, frame=0, set_frames=lambda n: viewer.counts.append(n))
    viewer.counts, viewer._closed, viewer._in_picture, viewer._redrawn_at = [], False, in_picture, 0.0
    viewer.outdated = []
    viewer._free_view = SimpleNamespace(outdate=lambda: viewer.outdated.append(True))
    viewer._enter, viewer.redraw_soon = lambda: None, lambda: None
    return viewer


def test_viewers_follow_or_stay_where_they_are() -> None:
    queue = FakeQueue()
    following, staying = viewer_of(queue, 5, follow=True), viewer_of(queue, 5, follow=False)
    flying = viewer_of(queue, 5, follow=True, in_picture=False)
    for viewer in (following, staying, flying):
        viewer.frame_arrived()
        assert viewer.counts == [5]
    assert following.controls.frame == 4 and staying.controls.frame == 0
    assert queue.requests == [((7,), True)] * 2
    flying.frame_arrived()
    assert flying.outdated == [True], "not drawn again at once"


def slowly(seen: list[Frame]) -> Iterator[Frame]:
    for frame in seen:
        time.sleep(0.02)
        yield frame


def test_frames_arrive_in_the_renderer() -> None:
    seen = frames(room(), looking(MIDDLE, 40))
    arriving = Arriving(LiveScene(voxel=0.05), slowly(seen), size=None, widest=80)
    told: list[int] = []
    renderer = arriving.first_renderer(Path(), Configuration())
    arriving.on_frame = lambda: told.append(len(renderer.capture))
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
