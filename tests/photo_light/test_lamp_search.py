"""Lit lamps in pictures: in rows overhead, at the border, and where they burn out what is around them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from reference.listed_frames import ListedFrames

from hyjax.data.capture import Frame
from hyjax.data.recording import without_margin
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.light.emission import LAMP_REACH
from hyjax.photo_light.ceiling_lamps import Blob, ceiling_lamps
from hyjax.photo_light.glowing_places import glowing_places
from hyjax.photo_light.lamp_search import LARGEST_REACH, blobs_of, is_flat
from hyjax.photo_light.sightings import sight
from hyjax.photo_light.source_search import find_photo_sources, search_sources
from hyjax.photo_light.sources import LAMP_RADIUS, PhotoLamp, PhotoWindow
from hyjax.scene.scene import Scene
from hyjax.util.vectors import unit

UP = np.array([0.0, 0.0, 1.0])
INTRINSICS = Intrinsics(320, 240, 250.0, 250.0, 160.0, 120.0)
LAMP = np.array([1.2, 2.2, 1.9])
EYES = ((-1.2, -2.0, 1.4), (-0.4, -2.2, 1.5), (0.4, -2.0, 1.4), (1.2, -1.8, 1.5))


@pytest.fixture(scope="module")
def box() -> RayCaster:
    mesh = trimesh.creation.box(bounds=[[-2.0, -3.0, 0.0], [2.0, 3.0, 2.5]])
    mesh.invert()
    return RayCaster(mesh.subdivide_to_size(0.5))


def picture(eye: tuple[float, ...], target: np.ndarray, value: float = 0.3) -> Frame:
    """Even picture from an eye towards a target."""
    camera = Camera(INTRINSICS, look_at(np.array(eye), target, UP))
    return Frame("picture", np.full((240, 320, 3), value, np.float32), camera, 0.0)


def paint(frame: Frame, place: np.ndarray, radius: float) -> None:
    """Burn out a disc around a place."""
    (x, y), depth = frame.camera.project(place)
    columns, rows = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
    frame.image[np.hypot(columns - x, rows - y) < radius * 250.0 / depth] = 1.0


def paint_panel(frame: Frame, low: tuple[float, float], high: tuple[float, float], height: float) -> None:
    """Burn out a level rectangle."""
    rays, origin = frame.camera.rays(), frame.camera.origin
    along = (height - origin[2]) / np.where(rays[..., 2] > 0.01, rays[..., 2], np.nan)
    place = (origin + along[..., None] * rays)[..., :2]
    frame.image[((place > low) & (place < high)).all(axis=-1)] = 1.0


TURN = trimesh.transformations.euler_matrix(0.4, -1.1, 2.0)
"""Into axes in which no wall is level."""


def search_turned(
    caster: RayCaster, frames: list[Frame], turn: np.ndarray
) -> tuple[tuple[PhotoWindow, ...], tuple[PhotoLamp, ...]]:
    """Sources of the same pictures and scan in other axes; positions are turned back."""
    moved = [replace(f, camera=Camera(f.camera.intrinsics, turn @ f.camera.pose)) for f in frames]
    windows, lamps = search_sources(RayCaster(caster.mesh.copy().apply_transform(turn)), moved, turn[:3, :3] @ UP)
    back = turn[:3, :3].T
    return windows, tuple(replace(lamp, position=back @ lamp.position) for lamp in lamps)


@pytest.mark.parametrize("turn", [np.eye(4), TURN])
def test_a_lamp_of_the_ceiling_is_as_large_as_its_panel(turn: np.ndarray, box: RayCaster) -> None:
    """A globe below keeps its size."""
    frames = [picture(eye, np.array([0.2, 2.5, 1.9])) for eye in EYES]
    for frame in frames:
        paint_panel(frame, (-0.3, 1.2), (0.3, 1.5), 2.5)
        paint(frame, LAMP + np.array([0.0, 0.0, 0.2]), 0.08)
    panel, globe = sorted(search_turned(box, frames, turn)[1], key=lambda lamp: -lamp.radius)
    np.testing.assert_allclose(panel.position, [0.0, 1.35, 2.5], atol=0.12)
    assert LAMP_REACH * panel.radius == pytest.approx(np.hypot(0.3, 0.15), rel=0.25)
    assert globe.radius == pytest.approx(0.08, rel=0.15)


def test_a_globe_close_under_the_ceiling_keeps_its_size(box: RayCaster) -> None:
    frames = [picture(eye, np.array([0.2, 2.5, 1.9])) for eye in EYES]
    for frame in frames:
        paint(frame, LAMP + np.array([0.0, 0.0, 0.45]), 0.12)
    (globe,) = search_sources(box, frames, UP)[1]
    assert globe.radius == pytest.approx(0.12, rel=0.15)


@pytest.mark.parametrize("side", [0.5, 0.9])
def test_a_small_hole_of_the_ceiling_is_a_lamp_and_others_are_windows(side: float, box: RayCaster) -> None:
    mesh, frames = box.mesh.subdivide_to_size(0.2), [picture(eye, np.array([0.2, 2.5, 1.9])) for eye in EYES]
    center = mesh.triangles_center
    above = (np.abs(center[:, :2] - (0.0, 1.4)) < side).all(axis=1) & (center[:, 2] > 2.4)
    ahead = (np.abs(center[:, ::2] - (0.2, 1.2)) < 0.5).all(axis=1) & (center[:, 1] > 2.9)
    low, high = mesh.triangles[above].reshape(-1, 3).min(axis=0), mesh.triangles[above].reshape(-1, 3).max(axis=0)
    mesh.update_faces(~(above | ahead))
    holed = RayCaster(mesh)
    for frame in frames:
        sighting = holed.cast(frame.camera.origin, frame.camera.rays().reshape(-1, 3))
        frame.image[~sighting.hit.reshape(240, 320)] = 1.0
    (window, *skylights), lamps = search_sources(holed, frames, UP)
    assert window.normal @ (0.0, -1.0, 0.0) > 0.9
    assert len(lamps) == (side < LARGEST_REACH / np.sqrt(2)) and len(skylights) == 1 - len(lamps)
    for lamp in lamps:
        np.testing.assert_allclose(lamp.position, (low + high) / 2, atol=0.2)  # seen slant
        assert LAMP_REACH * lamp.radius == pytest.approx(np.linalg.norm(high - low) / 2, rel=0.25)


def test_a_glow_on_the_ceiling_stays_of_unknown_form(box: RayCaster) -> None:
    """Lamp, wall and ceiling burn out as one blob."""
    place = np.array([0.8, 2.6, 2.35])
    frames = [picture(eye, np.array([0.2, 2.5, 1.4])) for eye in EYES]
    for frame in frames:
        paint(frame, place, 0.5)
    lamps = search_sources(box, frames, UP)[1]
    assert lamps and all(lamp.radius == 0 for lamp in lamps)


def test_rows_of_ceiling_lamps_are_found_where_two_frames_agree() -> None:
    lamps = np.array([[0.0, y, 2.4] for y in (3.0, 5.0, 7.0)])
    origins = [np.array([0.1, y, 1.5]) for y in (0.0, 1.1, 2.3, 3.7)]
    blobs = [
        Blob(number, unit(lamp - origin), 0.06 / float(np.linalg.norm(lamp - origin)))
        for number, origin in enumerate(origins)
        for lamp in lamps
        if lamp[1] > origin[1] + 0.5
    ]
    blobs.append(Blob(0, unit(np.array([0.5, 2.0, 0.9])), 0.02))  # in one frame alone
    found = ceiling_lamps(origins, blobs, UP, np.arange(2.0, 2.8, 0.02))
    places = np.array(sorted((place for place, _ in found), key=lambda place: place[1]))
    np.testing.assert_allclose(places, lamps, atol=0.08)
    assert ceiling_lamps(origins, blobs[:3], UP, np.arange(2.0, 2.8, 0.02)) == []  # a single frame's


def test_far_lamps_of_a_row_are_found_as_well() -> None:
    """Each in two pictures, from six to eight metres away: cameras of a walk look along a corridor."""
    origins = [np.array([0.0, y, 1.5]) for y in (0.0, 1.0)]
    lamps = np.array([[0.0, y, 2.4] for y in (4.0, 7.5, 9.5)])
    blobs = [
        Blob(number, unit(lamp - origin), 0.06 / float(np.linalg.norm(lamp - origin)))
        for number, origin in enumerate(origins)
        for lamp in lamps
    ]
    found = sorted(place[1] for place, _ in ceiling_lamps(origins, blobs, UP, np.arange(2.0, 2.8, 0.02)))
    np.testing.assert_allclose(found, [4.0, 7.5], atol=0.15)  # the last is too far from the first camera


def test_a_lamp_at_the_border_is_a_blob_and_a_white_border_is_none(box: RayCaster) -> None:
    frame = picture(EYES[0], np.array([0.0, 2.0, 1.4]))
    frame.image[100:112, :10] = 1.0
    (blob,) = blobs_of(0, sight(box, frame))
    assert blob.direction @ unit(frame.camera.rays()[105, 4]) > 0.999
    frame.image[:4] = frame.image[-4:] = frame.image[:, :4] = frame.image[:, -4:] = 1.0
    for bordered in (frame, replace(frame, image=without_margin(frame.image))):
        found = sight(box, bordered)
        assert len(blobs_of(0, found)) == 1
        assert not found.known[:4].any() and found.known[5:-5, 5:-5].all()


def test_a_lamp_is_found_that_burns_out_the_wall_and_touches_the_border(box: RayCaster) -> None:
    frames = [picture(eye, np.array([0.2, 2.5, 1.0])) for eye in EYES]
    wall = LAMP + np.array([0.1, 0.8, 0.2])
    for frame in frames:
        paint(frame, LAMP, 0.15)
        paint(frame, wall, 0.3)
    windows, lamps = search_sources(box, frames, UP)
    assert windows == () and len(lamps) >= 1
    assert np.linalg.norm(lamps[0].position - LAMP) < 0.6 and lamps[0].radius == 0  # of unknown form
    bright = [picture(eye, np.array([0.2, 2.5, 1.0]), 0.6) for eye in EYES]
    for frame in bright:
        paint(frame, LAMP, 0.15)
    assert glowing_places(box, [sight(box, frame) for frame in bright], UP) == []  # daylight burns walls out, too


@pytest.mark.parametrize("value", [0.3, 0.88])
@pytest.mark.parametrize(
    ("count", "radius", "found"),
    [(3, 0.08, True), (2, 0.08, False), (3, 0.035, False)],  # two frames agree by chance; so small is a glint
)
def test_three_frames_that_agree_closely_find_a_globe_that_was_not_scanned(
    count: int, radius: float, found: bool, value: float, box: RayCaster
) -> None:
    """Before a bright wall, too."""
    frames = [picture(eye, np.array([0.2, 2.5, 1.0]), value) for eye in EYES[:count]]
    for frame in frames:
        paint(frame, LAMP, radius)
    lamps = [lamp for lamp in search_sources(box, frames, UP)[1] if lamp.radius > 0]
    assert len(lamps) == found
    for lamp in lamps:
        np.testing.assert_allclose(lamp.position, LAMP, atol=0.03)
        assert lamp.radius == pytest.approx(radius, rel=0.15)


@pytest.mark.parametrize(("told", "radius"), [("", 0.08), (", radius: 0.05", 0.05), (", radius: 0.2", 0.2)])
def test_a_lamp_that_is_told_glows_as_it_is_seen(told: str, radius: float, box: RayCaster, tmp_path: Path) -> None:
    """At the place that was told; a radius that was told stays."""
    frames = [picture(eye, np.array([0.2, 2.5, 1.0])) for eye in EYES]
    for frame in frames:
        paint(frame, LAMP, 0.08)
    place = LAMP + np.array([0.1, 0.0, 0.0])
    file = tmp_path / "sources.yaml"
    file.write_text(f"lamps: [{{position: {place.tolist()}{told}}}, {{position: [-1.0, 1.0, 1.0]}}]")
    near, other = find_photo_sources(ListedFrames(frames, UP), box, frames, file=file).lamps
    np.testing.assert_allclose(near.position, place)
    assert near.radius == pytest.approx(radius, rel=0.15) and other.radius == LAMP_RADIUS


def test_two_near_lamps_glow_each_as_it_is_seen(box: RayCaster, tmp_path: Path) -> None:
    frames = [picture(eye, np.array([0.2, 2.5, 1.0])) for eye in EYES]
    places, radii = (LAMP, LAMP - np.array([0.34, 0.0, 0.0])), (0.06, 0.1)
    for frame in frames:
        for place, radius in zip(places, radii, strict=True):
            paint(frame, place, radius)
    file = tmp_path / "sources.yaml"
    file.write_text("lamps: [" + ", ".join(f"{{position: {place.tolist()}}}" for place in places) + "]")
    lamps = find_photo_sources(ListedFrames(frames, UP), box, frames, file=file).lamps
    assert [lamp.radius for lamp in lamps] == pytest.approx(radii, rel=0.15)


def test_three_frames_find_no_globe_close_before_a_surface(box: RayCaster) -> None:
    """Paper on a table, placed a little off it."""
    place = np.array([0.4, 2.84, 1.2])
    frames = [picture(eye, np.array([0.2, 2.5, 1.0])) for eye in EYES[:3]]
    for frame in frames:
        paint(frame, place, 0.08)
    assert all(lamp.radius == 0 for lamp in search_sources(box, frames, UP)[1])


def test_three_frames_that_agree_loosely_find_no_lamp(box: RayCaster) -> None:
    frames = [picture(eye, np.array([0.2, 2.5, 1.0])) for eye in EYES[:3]]
    for frame, radius in zip(frames, (0.06, 0.08, 0.11), strict=True):
        paint(frame, LAMP, radius)
    assert all(lamp.radius == 0 for lamp in search_sources(box, frames, UP)[1])


def test_a_patch_of_a_bright_wall_is_no_globe(box: RayCaster) -> None:
    frame = picture(EYES[0], np.array([0.0, 2.0, 1.4]), 0.88)
    frame.image[100:112, 100:140] = frame.image[150:162, 100:112] = 1.0
    assert blobs_of(0, sight(box, frame)) == []
    paint(frame, np.array([0.0, 2.0, 1.9]), 0.08)
    assert len(blobs_of(0, sight(box, frame))) == 1


def test_cameras_that_hardly_move_find_no_lamp(box: RayCaster) -> None:
    """Their rays meet anywhere."""
    steps = ((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.02))
    frames = [picture(tuple(np.add(EYES[0], step)), np.array([0.2, 2.5, 1.0])) for step in steps]
    for frame in frames:
        paint(frame, LAMP, 0.15)
        paint(frame, LAMP + np.array([0.1, 0.8, 0.2]), 0.3)
    assert search_sources(box, frames, UP)[1] == ()
    origins, high = [np.add(EYES[0], step) for step in steps], LAMP + np.array([0.0, 0.0, 0.6])
    blobs = [Blob(number, unit(high - origin), 0.02) for number, origin in enumerate(origins)]
    heights = np.arange(2.1, 2.9, 0.02)
    assert ceiling_lamps(origins, blobs, UP, heights) == []
    apart = [*origins[:3], np.array(EYES[2])]
    blobs[3] = Blob(3, unit(high - apart[3]), 0.02)
    ((place, _),) = ceiling_lamps(apart, blobs, UP, heights)
    np.testing.assert_allclose(place, high, atol=0.08)


def test_a_small_lit_sign_on_a_wall_is_flat_and_a_bulb_before_it_is_not(box: RayCaster) -> None:
    """Its own few points tell nothing; the wall around it does."""
    sightings = [sight(box, picture(eye, np.array([0.0, 3.0, 0.6]))) for eye in EYES]
    sign = np.array([0.0, 3.0, 0.6])
    few = sign + np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.01], [-0.01, 0.0, 0.0]])
    assert is_flat(sightings, sign, few)
    assert not is_flat(sightings, sign - np.array([0.0, 0.3, 0.0]), few)  # nothing was scanned near it
    assert not is_flat(sightings, sign, few[:0])


def test_a_wall_that_is_merely_burnt_out_is_no_window(box: RayCaster) -> None:
    frames = [picture(eye, np.array([0.0, 3.0, 1.3]), 0.6) for eye in EYES]
    corners = np.array([[x, 3.0, z] for x in np.linspace(-0.6, 0.6, 150) for z in np.linspace(0.9, 1.9, 120)])
    for frame in frames:
        x, y = frame.camera.project(corners)[0].T
        frame.image[y.astype(int), x.astype(int)] = 1.0
    assert search_sources(box, frames, UP)[0] == ()


def test_specks_of_a_large_picture_are_not_burnt_out(box: RayCaster) -> None:
    """Large pictures are shrunk before they are searched."""
    small = picture(EYES[0], LAMP)
    camera = Camera(small.camera.intrinsics.resize(960, 1280), small.camera.pose)
    image = np.full((960, 1280, 3), 0.3, np.float32)
    image[2::4, 2::4] = 1.0
    image[400:480, 600:680] = 1.0
    scene = Scene(ListedFrames([Frame("large", image, camera, 0.0)], UP), box.mesh)
    (frame,) = scene.photo_light._frames
    seen = sight(box, frame)
    assert seen.low.shape == (240, 320) and 0.9 * 20**2 <= seen.burnt.sum() <= 1.1 * 21**2
