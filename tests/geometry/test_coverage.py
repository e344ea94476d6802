"""How much of what was measured a mesh has."""

import numpy as np
import pytest
import trimesh

from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.raycast import RayCaster

LENS = Intrinsics(80, 60, 60.0, 60.0, 40.0, 30.0)
CAMERA = Camera(LENS, np.eye(4))


def wall(distance: float, left: float = -20.0) -> RayCaster:
    corners = [[left, -20, distance], [20, -20, distance], [20, 20, distance], [left, 20, distance]]
    return RayCaster(trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False))


def reading(depth: float = 2.0) -> DepthReading:
    return DepthReading(np.full(LENS.shape, depth, np.float32), CAMERA)


def test_a_mesh_on_the_readings_covers_them() -> None:
    found = Coverage.of(wall(2.01), [reading(), reading()])
    assert found.measured == found.covered == found.hit == 1.0 and found.distance == pytest.approx(0.01, abs=1e-4)


def test_a_mesh_elsewhere_is_hit_and_covers_nothing() -> None:
    found = Coverage.of(wall(2.5), [reading()])
    assert found.covered == 0 and found.hit == 1.0 and found.distance == pytest.approx(0.5, abs=1e-4)


def test_half_a_wall_covers_half() -> None:
    assert Coverage.of(wall(2.0, left=0.0), [reading()]).covered == pytest.approx(0.5, abs=0.02)


def test_pixels_without_reading_or_confidence_do_not_count() -> None:
    depth, camera, _ = reading()
    depth[:30], confidence = 0, np.ones(LENS.shape)
    confidence[:, :40] = 0
    found = Coverage.of(wall(2.0), [DepthReading(depth, camera, confidence)])
    assert found.measured == pytest.approx(0.25, abs=0.02) and found.covered == 1.0


def test_without_a_mesh_nothing_is_covered() -> None:
    found = Coverage.of(None, [reading()])
    assert (found.measured, found.covered, found.hit) == (1.0, 0.0, 0.0) and np.isnan(found.distance)
