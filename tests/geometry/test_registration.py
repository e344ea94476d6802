"""Registration of depth maps: poses that were moved come back."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.registration import MOST_SHIFT, mean_motion, register, registered
from hyjax.geometry.tsdf import fuse

LENS = Intrinsics(96, 72, 80.0, 80.0, 48.0, 36.0)
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def corner() -> trimesh.Trimesh:
    """A corner of a room with a box in it."""
    room = trimesh.creation.box((4, 4, 3))
    room.invert()
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation([1.2, 1.0, -1.1])
    whole = trimesh.util.concatenate([room, box])
    return whole.subdivide().subdivide()


def seen(corner: trimesh.Trimesh, count: int = 12) -> list[DepthReading]:
    caster, readings = RayCaster(corner), []
    for turn in np.linspace(0.2, 1.3, count):
        eye = np.array([-1.0 + turn, -0.8, 0.2])
        camera = Camera(LENS, look_at(eye, np.array([1.5, 0.5 + turn / 2, -0.8]), UP))
        readings.append(DepthReading(np.asarray(caster.gbuffer(camera).depth), camera))
    return readings


def nudged(pose: np.ndarray, seed: int, metres: float = 0.03, radians: float = 0.01) -> np.ndarray:
    rng, motion = np.random.default_rng(seed), np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(radians * rng.normal(size=3)).as_matrix()
    moved = pose @ motion
    moved[:3, 3] += metres * rng.normal(size=3)
    return moved


def errors(poses: Sequence[np.ndarray], truth: Sequence[np.ndarray]) -> np.ndarray:
    return np.array([np.linalg.norm(a[:3, 3] - b[:3, 3]) for a, b in zip(poses, truth)])


def test_a_depth_map_comes_back_to_the_surface(corner: trimesh.Trimesh) -> None:
    caster = RayCaster(corner)
    for number, reading in enumerate(seen(corner, 4)):
        moved = reading._replace(camera=Camera(LENS, nudged(reading.camera.pose, number)))
        back = registered(moved, caster, 6.0).camera.pose
        assert np.abs(back - reading.camera.pose).max() < 5e-3
        assert np.abs(moved.camera.pose - reading.camera.pose).max() > 1e-2


def test_depth_maps_come_back_to_each_other(corner: trimesh.Trimesh) -> None:
    """But for a motion that all have in common, which depth cannot tell."""
    true = seen(corner)
    moved = [r._replace(camera=Camera(LENS, nudged(r.camera.pose, k))) for k, r in enumerate(true)]
    found = register(moved, lambda maps: fuse(maps, 0.04, max_depth=6.0, progress=False), 6.0, progress=False)
    common = np.linalg.inv(mean_motion([f.camera.pose @ np.linalg.inv(t.camera.pose) for f, t in zip(found, true)]))
    truth = [reading.camera.pose for reading in true]
    before = errors([reading.camera.pose for reading in moved], truth)
    after = errors([common @ reading.camera.pose for reading in found], truth)
    assert np.median(after) < 0.35 * np.median(before) and after.max() < before.max()


def test_the_world_stays_where_it_was(corner: trimesh.Trimesh) -> None:
    moved = [r._replace(camera=Camera(LENS, nudged(r.camera.pose, k))) for k, r in enumerate(seen(corner))]
    found = register(moved, lambda maps: fuse(maps, 0.04, max_depth=6.0, progress=False), 6.0, 1, progress=False)
    drift = mean_motion([f.camera.pose @ np.linalg.inv(m.camera.pose) for f, m in zip(found, moved)])
    np.testing.assert_allclose(drift, np.eye(4), atol=1e-6)


def test_what_is_too_far_away_stays(corner: trimesh.Trimesh) -> None:
    (reading,) = seen(corner, 1)
    caster = RayCaster(corner)
    away = reading.camera.pose.copy()
    away[:3, 3] += (2 * MOST_SHIFT, 0, 0)
    assert registered(reading, caster, 6.0, first=away) is reading
    empty = reading._replace(depth=np.zeros_like(reading.depth))
    assert registered(empty, caster, 6.0) is empty


def test_a_floor_alone_moves_nothing_along_itself() -> None:
    floor = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    caster = RayCaster(floor)
    camera = Camera(LENS, look_at(np.array([0.0, 0, 1.5]), np.array([1.0, 0, 0]), UP))
    reading = DepthReading(np.asarray(caster.gbuffer(camera).depth), camera)
    high = camera.pose.copy()
    high[2, 3] += 0.02
    back = registered(reading._replace(camera=Camera(LENS, high)), caster, 6.0).camera.pose
    assert back[2, 3] == pytest.approx(1.5, abs=1e-3)
    np.testing.assert_allclose(back[:2, 3], 0.0, atol=5e-3)
