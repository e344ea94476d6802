"""What a photo does not show once furniture has moved: drawn from other frames; grey where none saw it."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from extras import need
from msgspec.structs import replace

need("tour")

from box_room import CUBE, TOP, moved

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import UP
from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import to_display
from hyjax.scene.scene import Scene
from hyjax.tour.arrangement import Arrangement
from hyjax.tour.editable_scene import EditableScene
from hyjax.tour.layers import Caches
from hyjax.tour.plan import Piece, TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.uncovered import GREY, uncovered_pixels
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.errors import InputError

VIEW = Viewpoint(0, "relit", Schedule.preset("paper-50"))
LIFT = np.array([0.0, 0.0, 0.4])
"""Of the cube, so that others see the floor beneath it."""
CUBE_PIECE = Piece(tuple((TOP + LIFT).tolist()))
GONE = TourPlan(hour=0.0, pieces=(replace(CUBE_PIECE, removed=True),))
K = Intrinsics(96, 72, 60.0, 60.0, 48.0, 36.0)


def box_with_cube(hole: bool = False) -> trimesh.Trimesh:
    walls = trimesh.creation.box(bounds=[[-2, -2.5, 0], [2, 2.5, 2.5]])
    walls.invert()
    cube = trimesh.creation.box((0.7, 0.7, 0.7), trimesh.transformations.translation_matrix(CUBE + LIFT))
    walls, cube = (mesh.subdivide_to_size(0.12) for mesh in (walls, cube))
    if hole:  # no scanner sees the floor beneath a cube
        centres = walls.triangles_center
        walls.update_faces((np.abs(centres[:, :2] - CUBE[:2]).max(axis=1) > 0.3) | (centres[:, 2] > 0.1))
    mesh = trimesh.util.concatenate([walls, cube])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def painted(camera: Camera, *, cube: bool = True, by: Any = 0.0) -> np.ndarray:
    """Linear picture of walls whose colour is a smooth function of the place, and of a red cube."""
    mesh = box_with_cube()
    room = len(mesh.faces) - len(trimesh.creation.box((0.7, 0.7, 0.7)).subdivide_to_size(0.12).faces)
    if not cube:
        mesh.update_faces(np.arange(len(mesh.faces)) < room)
    else:
        mesh.vertices[np.unique(mesh.faces[room:])] += by
    rays = camera.rays().reshape(-1, 3)
    hits = RayCaster(mesh).cast(np.broadcast_to(camera.origin, rays.shape), rays)
    places = camera.origin + hits.distance[:, None] * rays
    color = 0.3 + 0.2 * np.sin(np.pi * places)
    color[hits.face >= room] = 0.5, 0.05, 0.05
    return color.reshape(*camera.intrinsics.shape, 3)


class Painted(Capture):
    """Frames of that room, all under the same light."""

    name, up, fingerprint = "painted", UP, "painted"
    eyes = (-1.2, -2.2, 1.5), (1.7, -1.0, 1.6), (-1.7, 1.5, 1.6), (1.6, 2.0, 1.8), (0.0, 2.2, 2.0)

    def __init__(self, count: int = 5, damaged: int | None = None) -> None:
        self.count, self.damaged = count, damaged

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Any:
        if index == self.damaged:
            raise InputError("damaged")
        camera = Camera(K, look_at(np.array(self.eyes[index]), CUBE, UP))
        image = np.asarray(to_display(painted(camera).astype(np.float32)))
        return Frame(f"{index}", image, camera, float(index))


def relit(plan: TourPlan, *, count: int = 5, hole: bool = False, folder: Path = Path()) -> tuple[np.ndarray, bool]:
    """Picture over that of the untouched room, under ambient light alone; and whether some was never seen."""
    renderer = Renderer(Scene(Painted(count), box_with_cube(hole)), keep_photo_light=True, folder=folder)
    rendered, plain = (renderer.render(p, VIEW) for p in (plan, replace(plan, pieces=())))
    truth = painted(renderer.camera(0))
    gain = np.median(plain.linear / truth, axis=(0, 1))
    return rendered.linear / gain, rendered.unseen


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Painted()[0].camera


def test_what_a_piece_uncovers_is_taken_from_other_frames(camera: Camera) -> None:
    picture, unseen = relit(GONE)
    before, truth = painted(camera), painted(camera, cube=False)
    covered = np.abs(before - truth).max(axis=-1) > 0.05
    assert covered.sum() > 150
    grey = np.abs(picture - GREY).max(axis=-1) < 0.01
    assert grey[covered].mean() < 0.2 and unseen == grey[covered].any(), "some floor beneath it is never seen"
    assert np.quantile(np.abs(picture - truth)[covered & ~grey], 0.95) < 0.03
    assert np.abs(picture - before)[covered].mean() > 0.1, "the cube was there"
    np.testing.assert_allclose(np.median((picture / before)[~covered]), 1.0, atol=0.02)


def test_a_piece_is_drawn_where_it_stands_now(camera: Camera) -> None:
    by = np.array([-0.3, 0.8, 0.0])
    picture, _ = relit(TourPlan(hour=0.0, pieces=(replace(CUBE_PIECE, pose=moved(tuple(by))),)))
    truth = painted(camera, by=by)
    red = truth[..., 0] > 5 * truth[..., 1]
    assert red.sum() > 150
    assert np.quantile(np.abs(picture - truth)[red], 0.85) < 0.08


@pytest.mark.parametrize("by", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0)])
def test_a_piece_that_slides_in_its_own_plane_takes_its_texture_along(by: Any) -> None:
    """The cube's top from above: where it was and is, pixels keep their depth."""
    camera = Camera(K, look_at(TOP + LIFT + [0.0, -0.3, 1.0], TOP + LIFT, UP))
    scene = EditableScene(RayCaster(box_with_cube()), UP, Path())
    there = TourPlan(hour=0.0, pieces=(replace(CUBE_PIECE, pose=moved(by)),))
    place = Arrangement(scene, there, Caches(), None, Configuration())
    now, was = place.gbuffer(camera), place.scanned(camera)
    top = (np.abs(np.asarray(now.position) - (TOP + LIFT))[..., 2] < 1e-3) & np.asarray(now.hit)
    still = top & (np.abs(np.asarray(now.depth) - np.asarray(was.depth)) < 1e-3)
    assert still.sum() > 300
    assert uncovered_pixels(now, was, scene.caster)[still].all()


def test_what_no_frame_saw_is_grey_and_said() -> None:
    picture, unseen = relit(GONE, count=1)
    assert unseen
    grey = np.abs(picture - GREY).max(axis=-1) < 0.02
    assert grey.sum() > 150


def test_a_mesh_that_was_brought_in_is_grey_and_not_missed(tmp_path: Path) -> None:
    """In front of walls that frames see."""
    trimesh.creation.box((0.5, 0.5, 0.5)).export(tmp_path / "box.ply")
    brought = Piece((0.0, 0.0, 0.0), pose=moved(tuple(TOP + LIFT)), file="box.ply")
    for count in (1, 5):
        picture, unseen = relit(TourPlan(hour=0.0, pieces=(brought,)), count=count, folder=tmp_path)
        grey = np.abs(picture - GREY).max(axis=-1) < 0.02
        assert grey.sum() > 60 and not unseen


@pytest.mark.parametrize("cameras_known", [False, True])
def test_damaged_frames_are_left_out(cameras_known: bool) -> None:
    """As if there were no such frame."""
    expected, _ = relit(GONE, count=4)
    capture = Painted(5, damaged=4)
    if cameras_known:
        capture.camera = lambda index: Painted()[index].camera  # type: ignore[method-assign]
    renderer = Renderer(Scene(capture, box_with_cube()), keep_photo_light=True)
    picture, plain = (renderer.render(p, VIEW).linear for p in (GONE, replace(GONE, pieces=())))
    gain = np.median(plain / painted(renderer.camera(0)), axis=(0, 1))
    np.testing.assert_allclose(picture / gain, expected, rtol=1e-3, atol=1e-3)


def test_planes_go_on_where_the_scan_has_a_hole(camera: Camera) -> None:
    picture, _ = relit(GONE, hole=True)
    before, truth = painted(camera), painted(camera, cube=False)
    covered = np.abs(before - truth).max(axis=-1) > 0.05
    grey = np.abs(picture - GREY).max(axis=-1) < 0.01
    assert np.quantile(np.abs(picture - truth)[covered & ~grey], 0.95) < 0.03
    red = np.abs(picture - before).max(axis=-1) < 0.05
    assert not (covered & red).any(), "nothing is left of the cube"


def test_planes_go_on_for_a_camera_that_flies() -> None:
    """Above the cube."""
    renderer = Renderer(Scene(Painted(), box_with_cube(hole=True)), keep_photo_light=True)
    camera = Camera(K, look_at(TOP + LIFT + [0.0, -0.3, 1.0], TOP + LIFT, UP))
    shown = [
        renderer.render(plan, dataclasses.replace(VIEW, camera=camera)).linear.min(axis=-1) > 0
        for plan in (replace(GONE, pieces=()), GONE)
    ]
    assert shown[1][shown[0]].all(), "no new hole is left"
