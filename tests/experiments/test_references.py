"""Which pixels of an accurate surface are relied on."""

import dataclasses

import numpy as np
import pytest
import trimesh

from experiments.references import Reference, cleaned, open_reference
from hyjax.data.builtin_room import load_room
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.raycast import RayCaster
from hyjax.util.errors import InputError

LENS = Intrinsics(40, 30, 40.0, 40.0, 20.0, 15.0)
CAMERA = Camera(LENS, np.eye(4))


def wall(wave: float = 0.0) -> trimesh.Trimesh:
    """A wall two metres off, of 5 cm triangles; to the right of x = 0.5 there are waves in it, 40 cm long."""
    x, y = np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-2, 2, 81))
    z = 2.0 + wave * np.sin(2 * np.pi * x / 0.4) * (x > 0.5)
    corner = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    upper, lower = [0, 81, 1], [1, 81, 82]
    faces = np.concatenate([corner[:, None] + upper, corner[:, None] + lower])
    return trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, process=False)


def frame(depth: np.ndarray | None) -> Frame:
    return Frame("0", np.zeros((30, 40, 3), np.float32), CAMERA, 0.0, depth)


def reliable(reference: Reference, depth: np.ndarray | None) -> np.ndarray:
    return reference.reliable(frame(depth), CAMERA, reference.gbuffer(CAMERA))


def test_a_flat_wall_is_relied_on() -> None:
    assert reliable(cleaned("wall", wall()), None).all()


def test_where_the_sensor_disagrees_it_is_not_and_no_reading_says_nothing() -> None:
    depth = np.full((30, 40), 2.0)
    depth[:, :10] = 2.5
    depth[:, 30:] = 0.0
    found = reliable(cleaned("wall", wall()), depth)
    assert not found[:, :10].any() and found[:, 10:].all()
    strict = dataclasses.replace(cleaned("wall", wall()), unread=False)
    assert not reliable(strict, depth)[:, 30:].any() and reliable(strict, depth)[:, 10:30].all()
    own = Reference("true", wall(), RayCaster(wall()).gbuffer, measured=False)
    assert reliable(own, depth).all()


def test_bumps_are_not() -> None:
    found = reliable(cleaned("wall", wall(wave=0.1)), None)
    edge = round(LENS.cx + LENS.fx * 0.5 / 2.0)
    assert found[:, : edge - 5].all()
    assert 0.02 < (~found[:, edge:]).mean() < 0.9


def test_grazing_views_are_not() -> None:
    turned = trimesh.transformations.rotation_matrix(np.deg2rad(84), (0, 1, 0))
    turned[:3, 3] = -1.9, 0.0, 1.7
    reference, camera = cleaned("wall", wall()), Camera(LENS, turned)
    seen = reference.gbuffer(camera)
    cosine = -np.sum(np.asarray(seen.normal) * camera.rays(), -1) / np.linalg.norm(camera.rays(), axis=-1)
    found = reference.reliable(frame(None), camera, seen)
    np.testing.assert_array_equal(found, np.asarray(seen.hit) & (cosine > 0.15))
    assert found.any() and (np.asarray(seen.hit) & ~found).any()


def test_holes_are_not() -> None:
    half = wall()
    half = trimesh.Trimesh(half.vertices, half.faces[half.triangles_center[:, 0] < 0], process=False)
    reference = Reference("half", half, RayCaster(half).gbuffer)
    found = reliable(reference, None)
    assert found[:, :18].all() and not found[:, 22:].any()


def test_the_room_has_its_own() -> None:
    room = load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)
    assert open_reference(room).description == "true mesh"
    with pytest.raises(InputError, match="no laser scans"):
        open_reference(room, "laser")
    for name in ("scan", "lasre"):  # a rough surface is no reference
        with pytest.raises(InputError, match=f"reference: {name}: no such file.*true, laser, fused"):
            open_reference(room, name)
