"""The live tour in a real browser: frames arrive in a folder, and the page follows them."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import need
from PIL import Image

need("tour")

from browser import Page, until

from experiments.browser import browser
from hyjax.data.builtin_room import load_room
from hyjax.geometry.raycast import RayCaster
from hyjax.tour.page import Tour
from hyjax.tour.settings import TourSettings
from hyjax.util.images import write_png

FIRST, ALL = 15, 20


@pytest.fixture
def chromium(browser_wanted: None) -> Iterator[Any]:
    with browser() as launched:
        yield launched


class Recording:
    """Frames of the built-in room, written into a folder in the 7-Scenes layout one after the other."""

    def __init__(self, folder: Path) -> None:
        self._room = load_room(n_frames=ALL, width=160, height=120, quality=0.1, progress=False)
        self._caster, self._folder, self._written = RayCaster(self._room.reference()), folder, 0
        np.savetxt(folder / "camera-intrinsics.txt", self._room[0].camera.intrinsics.matrix)
        np.savetxt(folder / "gravity-direction.txt", -self._room.up)

    def write(self, until: int) -> None:
        """Write the frames up to a number."""
        for number in range(self._written, until):
            frame, stem = self._room[number], self._folder / f"frame-{number:06d}"
            depth = np.asarray(self._caster.gbuffer(frame.camera).depth)
            write_png(stem.with_suffix(".color.png"), frame.image)
            Image.fromarray(np.round(1000 * depth).astype(np.uint16)).save(stem.with_suffix(".depth.png"))
            np.savetxt(stem.with_suffix(".pose.txt"), frame.camera.pose)
        self._written = until


@pytest.mark.slow
def test_the_page_follows_a_folder(chromium: Any, tmp_path: Path) -> None:
    """Frames come, the newest is shown; one flies about in the mesh, and back into the picture."""
    folder = tmp_path / "frames"
    folder.mkdir()
    recording = Recording(folder)
    recording.write(FIRST)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    tour = Tour.open(TourSettings(live=str(folder), out=tmp_path / "tour", port=port, quiet=True))
    try:
        page, errors = Page(chromium, tour), []
        page.page.on("pageerror", lambda error: errors.append(str(error)))
        before = page.picture()
        assert before.std() > 10, "there is a picture"

        seen, surface = len(tour.session.renderer.capture), tour.session.renderer.scene
        recording.write(ALL)
        until(lambda: len(tour.session.renderer.capture) > seen)
        (viewer,) = tour.viewers.values()
        until(lambda: viewer.rendered is not None and viewer.rendered.frame.name == f"frame-{ALL - 1:06d}")
        assert tour.session.renderer.scene is not surface
        after = page.picture()
        assert np.abs(after - before).mean() > 3, "another place"

        page.drag((500, 200), (400, 260))  # right of the notices that a new page shows
        page.page.get_by_role("button", name="Back into the picture").wait_for()
        until(lambda: page.picture().std() > 5)
        page.press("Back into the picture")
        assert np.abs(page.picture() - after).mean() < 3
        assert not errors
    finally:
        tour.stop()
