"""Memory of a long visit: what a renderer keeps has one limit; once it is full, the process grows no more."""

import gc
from pathlib import Path

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from box_room import BoxCapture, box_room

from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import UP
from hyjax.geometry.raycast import RayCaster
from hyjax.scene.scene import Scene
from hyjax.tour import layers
from hyjax.tour.editable_scene import FACE_BYTES, PARTS_MIB, EditableScene
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import Piece, TourPlan, Window
from hyjax.tour.renderer import Renderer
from hyjax.tour.viewpoint import Viewpoint

VIEW = Viewpoint(0, "relit", Schedule.preset("hyjax"))
WINDOW = Window((1.98, 0.0, 1.3), (-1.0, 0.0, 0.0))
FULL_AFTER, CHANGES = 16, 52


def resident() -> float:
    """MiB of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


@pytest.mark.slow
def test_a_long_visit_stays_within_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller limit is full sooner; without any, so many shadow maps take ten times as much."""
    monkeypatch.setattr(layers, "KEPT_MIB", 16)
    renderer, random = Renderer(Scene(BoxCapture(), box_room())), np.random.default_rng(0)
    plan, sizes = TourPlan(windows=(WINDOW,)).check(), []
    gc.freeze()  # what the whole session holds would be looked through for each size
    for number in range(CHANGES):
        angle = random.uniform(0, 2 * np.pi)
        lamp = place_lamp("bulb", np.array([np.cos(angle), np.sin(angle), 1.4]), UP)
        changed = replace(plan, hour=float(random.uniform(7, 19)), lamps=(lamp,))
        renderer.render(changed, VIEW, draft=number % 3 == 0)
        if number >= FULL_AFTER:
            gc.collect()
            sizes.append(resident())
    gc.unfreeze()
    assert np.median(sizes[-12:]) < 1.05 * np.median(sizes[:12])


def test_parts_of_the_room_are_kept_by_their_memory() -> None:
    """Each piece that is taken out leaves a room of its own."""
    room = box_room()
    scene = EditableScene(RayCaster(room), UP, Path())
    limit = scene._parts._results.maxsize
    assert limit == max(PARTS_MIB, 4 * FACE_BYTES * (1 + len(room.faces)) / 2**20)
    scene.apply(TourPlan(pieces=(Piece((0.5, 0.4, 0.7), removed=True),)))
    assert 2 * len(room.faces) * FACE_BYTES / 2**20 > scene._parts._results.currsize > 0
