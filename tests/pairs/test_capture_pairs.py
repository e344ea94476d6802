"""Pairs from captures: measured depth, a fused surface, both; and the Kinect's depth registered to its pictures."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from reference.listed_frames import ListedFrames
from scipy import ndimage

from hyjax.data.capture import Capture, ChosenFrames, Frame
from hyjax.data.kinect import COLOUR, KINECT, colour_pose, registered, warped
from hyjax.data.registry import open_capture
from hyjax.data.seven_scenes import open_seven_scenes
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.pairs.captures import CapturePairs
from hyjax.pairs.registry import open_pairs
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(96, 72, 90.0, 90.0, 48.0, 36.0)


def world() -> trimesh.Trimesh:
    """A wall at x = 2 and a box of half a metre before it."""
    wall = trimesh.creation.box((0.2, 4, 4), trimesh.transformations.translation_matrix((2.1, 0, 0)))
    box = trimesh.creation.box((0.5, 0.5, 0.5), trimesh.transformations.translation_matrix((1.4, 0, 0)))
    return trimesh.util.concatenate([wall, box])


class Views(ListedFrames):
    """A capture of the world above from a little walk, with true depth and a hole in each depth map."""

    name, fingerprint = "views", "a"

    def __init__(self, count: int = 12) -> None:
        caster = RayCaster(world())
        frames = []
        for index, y in enumerate(np.linspace(-0.4, 0.4, count)):
            camera = Camera(LENS, look_at(np.array([0.0, y, 0.3 * np.sin(9 * y)]), np.array([2.0, 0, 0]), UP))
            depth = np.array(caster.gbuffer(camera).depth)
            depth[:10, :10] = 0
            image = np.full((LENS.height, LENS.width, 3), index / count, np.float32)
            frames.append(Frame(f"{index}", image, camera, float(index), depth))
        super().__init__(frames, UP)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def views() -> Views:
    return Views()


def pairs_of(views: Capture, depth: str, indices: range | None = None) -> CapturePairs:
    chosen = range(len(views)) if indices is None else indices
    return CapturePairs(views, chosen, depth, progress=False)  # type: ignore[arg-type]


def test_chosen_frames_are_a_capture_of_their_own(views: Views) -> None:
    some = ChosenFrames(views, [3, 5])
    assert isinstance(some, Capture) and len(some) == 2 and some[1] is views[5]
    assert len({some.fingerprint, ChosenFrames(views, [3]).fingerprint, views.fingerprint}) == 3


def test_sensor(views: Views) -> None:
    pairs = pairs_of(views, "sensor", range(2, 4))
    assert (len(pairs), pairs.unit, pairs[1].name, pairs[1].normal) == (2, "metres", "3", None)
    assert not pairs[1].valid[:10, :10].any() and pairs[1].valid[20:, 20:].all()
    np.testing.assert_array_equal(pairs[1].depth, views[3].depth)


def test_surface_counts_where_the_reading_agrees(views: Views) -> None:
    pair = pairs_of(views, "surface")[6]
    truth = RayCaster(world()).gbuffer(views[6].camera)
    right = np.abs(pair.depth - np.asarray(truth.depth)) < 0.03 + 0.02 * pair.depth
    measured = np.asarray(views[6].depth) > 0
    assert right[pair.valid & measured].all()
    assert pair.valid[:10, :10].mean() > 0.5, "other frames have seen what this one has not read"
    assert pair.normal is not None
    length = np.linalg.norm(pair.normal, axis=-1)
    np.testing.assert_allclose(length[pair.valid], 1, atol=1e-5)
    assert not length[~pair.valid].any()
    rays = Camera(LENS, np.eye(4)).rays()
    assert (np.sum(rays * pair.normal, axis=-1)[pair.valid] < 0).all(), "normals point towards the camera"
    in_camera = np.array([-1.0, 0, 0]) @ views[6].camera.pose[:3, :3]  # of the wall, and of the box's front
    turned = np.sum(in_camera * pair.normal, axis=-1)[ndimage.binary_erosion(pair.valid, iterations=5)]
    assert np.mean(turned > np.cos(np.deg2rad(10))) > 0.95


def test_both_have_borders_too(views: Views) -> None:
    frame = views[6]
    surface, both = pairs_of(views, "surface")[6], pairs_of(views, "both")[6]
    measured = np.asarray(frame.depth) > 0
    assert not surface.valid[measured].all(), "a fusion rounds borders off"
    np.testing.assert_array_equal(both.valid, surface.valid | measured)
    np.testing.assert_array_equal(both.depth[surface.valid], surface.depth[surface.valid])
    rest = both.valid & ~surface.valid
    np.testing.assert_array_equal(both.depth[rest], np.asarray(frame.depth)[rest])
    assert both.normal is not None and not both.normal[rest].any()


def test_a_surface_has_seen_the_chosen_frames_alone(views: Views) -> None:
    """Frames that see the box taken away leave no box behind."""
    caster = RayCaster(trimesh.creation.box((0.2, 4, 4), trimesh.transformations.translation_matrix((2.1, 0, 0))))
    changed = Views()
    for index in range(6):
        depth = np.array(caster.gbuffer(changed.frames[index].camera).depth)
        changed.frames[index] = dataclasses.replace(changed.frames[index], depth=depth)
    changed.fingerprint = "b"
    pair = pairs_of(changed, "surface", range(6))[3]
    box = np.asarray(RayCaster(world()).gbuffer(changed[3].camera).depth) < 1.8
    assert box.any() and (pair.depth[box & pair.valid] > 1.8).all()
    assert pair.valid[box].mean() > 0.9


def test_fingerprint_knows_content_but_not_place(views: Views) -> None:
    moved = Views()
    moved.fingerprint = "of the same frames elsewhere"
    before = pairs_of(views, "sensor").fingerprint
    assert pairs_of(moved, "sensor").fingerprint == before
    others = [
        pairs_of(views, "sensor", range(5)),
        pairs_of(views, "surface"),
        pairs_of(Views(13), "sensor", range(12)),
    ]
    assert len({before, *(other.fingerprint for other in others)}) == 4


def test_captures_that_cannot_be_used(views: Views) -> None:
    blind = Views(2)
    blind.frames = [dataclasses.replace(frame, depth=None) for frame in blind.frames]
    with pytest.raises(InputError, match="no depth"):
        pairs_of(blind, "sensor")
    other = Views(2)
    other.frames = [dataclasses.replace(frame, depth_intrinsics=LENS) for frame in other.frames]
    with pytest.raises(InputError, match="not registered"):
        pairs_of(other, "both")


# ---- the Kinect's two cameras ----


class Kinect(ListedFrames):
    """The world above as a Kinect has it: the depth camera's depth, pose and intrinsics; the box is white."""

    def __init__(self) -> None:
        caster = RayCaster(world())
        camera = Camera(KINECT, look_at(np.array([0.0, 0.1, 0.2]), np.array([2.0, 0, 0]), UP))
        colour = Camera(COLOUR, camera.pose @ colour_pose())
        box = np.asarray(caster.gbuffer(colour).position)[..., 0] < 1.8
        image = np.where(box[..., None], np.float32(1), np.zeros(3, np.float32))
        super().__init__([Frame("0", image, camera, 0.0, np.asarray(caster.gbuffer(camera).depth))], UP)


def test_registered_depth_is_what_the_colour_camera_sees() -> None:
    capture = Kinect()
    frame = registered(capture)[0]
    assert frame.camera.intrinsics == COLOUR and frame.depth is not None
    np.testing.assert_allclose(frame.camera.pose, capture[0].camera.pose @ colour_pose())
    truth = np.asarray(RayCaster(world()).gbuffer(frame.camera).depth)
    inner = (slice(40, -40), slice(40, -40))
    off = np.abs(frame.depth - truth)[inner]
    known = frame.depth[inner] > 0
    assert known.mean() > 0.97, "a strip beside the box is hidden from one of the two cameras"
    assert np.mean(off[known] < 0.01) > 0.99
    apart = np.abs(np.asarray(capture[0].depth) - truth)[inner]
    assert np.mean(apart > 0.1) > 0.05, "unregistered, the box is elsewhere"


def test_the_nearest_reading_wins() -> None:
    camera = Camera(Intrinsics(4, 2, 4.0, 4.0, 2.0, 1.0), np.eye(4))
    half = Camera(Intrinsics(2, 1, 2.0, 2.0, 1.0, 0.5), np.eye(4))
    depth = np.array([[3.0, 2.0, 0.0, 0.0], [4.0, 5.0, 0.0, 0.0]])
    np.testing.assert_allclose(warped(depth, camera, half), [[2.0, 0.0]])


def test_what_is_registered_already_stays(views: Views) -> None:
    assert registered(views) is views
    again = registered(Kinect())
    assert registered(again) is again


def contrast_at_borders(frame: Frame, camera: Camera) -> float:
    """Contrast of the picture where the depth's borders fall if `camera` took it, in multiples of that around."""
    assert frame.depth is not None
    known = frame.depth > 0
    jumps = known & (frame.depth < 3.5) & (ndimage.maximum_filter(frame.depth, 3) > 1.06 * frame.depth)
    jumps &= ndimage.binary_erosion(ndimage.binary_closing(known, iterations=2), iterations=4)
    contrast = ndimage.gaussian_gradient_magnitude(frame.image.mean(axis=-1), 1.0)
    contrast = np.minimum(contrast / (ndimage.uniform_filter(contrast, 41) + 0.01), 4.0)
    pixel, _ = camera.project(frame.camera.unproject(frame.depth)[jumps])
    return float(ndimage.map_coordinates(contrast, pixel.T[::-1] - 0.5, order=1, mode="constant").mean())


def test_borders_of_the_kitchen_coincide(kitchen: Path) -> None:
    """On frames that the registration was not fitted to."""
    frames = [open_seven_scenes(open_tree(kitchen))[index] for index in (230, 250, 270, 290)]
    before = np.mean([contrast_at_borders(frame, frame.camera) for frame in frames])
    after = [contrast_at_borders(f, Camera(COLOUR, f.camera.pose @ colour_pose())) for f in frames]
    assert np.mean(after) > 1.6 * before
    assert open_capture(kitchen)[230].camera.intrinsics == COLOUR


def test_kitchen_pairs(kitchen: Path) -> None:
    pairs = open_pairs(f"capture:{kitchen}?frames=225:300:15")
    assert (len(pairs), pairs[0].name) == (5, "frame-000450")
    assert 0.5 < pairs[0].valid.mean() < 0.9
    with pytest.raises(InputError, match="depth=laser"):
        open_pairs(f"capture:{kitchen}?depth=laser")
