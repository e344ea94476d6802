"""Named set-ups: in any room, lights hang in free space and give finite light."""

import dataclasses
import re

import jax
import numpy as np
import pytest
import trimesh

from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import WHITE, to_display
from hyjax.light.kinds import AmbientLight, DirectionalLight, PointLight, RectLight, SkyLight
from hyjax.light.setup import LightSetup
from hyjax.metrics.dark_share import dark_share
from hyjax.scene import exposure as exposure_module
from hyjax.scene.exposure import bounded, exposed, warn_of_far, warn_of_missing
from hyjax.scene.light_places import LightAnchors, WindowPlace, _points, survey
from hyjax.scene.light_response import Response, kinds_of, paleness
from hyjax.scene.light_setups import EXPOSURES, SETUPS, _sunlit, named_setup, placed_setup, tell_made_up
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError
from hyjax.util.vectors import unit

UP = np.array([0.0, 0.0, 1.0])
BOX = np.array([[-2.0, -3.0, 0.0], [2.0, 3.0, 2.5]])


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def room_caster(room: RoomCapture) -> RayCaster:
    return RayCaster(room.reference())


@pytest.fixture(scope="module")
def box() -> RayCaster:
    mesh = trimesh.creation.box(bounds=BOX)
    mesh.invert()
    return RayCaster(mesh)


def box_camera(eye: tuple[float, ...], target: tuple[float, ...]) -> Camera:
    return Camera(Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0), look_at(np.array(eye), np.array(target), UP))


BOX_CAMERAS = [box_camera((0.5, -2, 1.5), (-0.5, 2, 1)), box_camera((0.2, -2, 1.5), (0.8, 2, 1))]


def finite(setup: LightSetup) -> bool:
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(setup.lights))


def places(setup: LightSetup) -> list[tuple[np.ndarray, float]]:
    """Where light starts: lamps with their radius, and the centres of windows."""
    found = []
    for light in setup.lights:
        rectangle = getattr(light, "aperture", light)
        if isinstance(light, PointLight):
            found.append((np.asarray(light.position), float(light.radius)))
        elif hasattr(rectangle, "center"):
            found.append((np.asarray(rectangle.center), 0.0))
    return found


@pytest.fixture(scope="module")
def stages(
    room: RoomCapture, room_caster: RayCaster, box: RayCaster
) -> dict[str, tuple[LightAnchors, RayCaster, np.ndarray]]:
    cameras = [frame.camera for frame in room]
    bounds = np.array([room.anchors["bounds"][side] for side in ("low", "high")], float)
    return {
        "anchors": (survey(room_caster, cameras, room.up, room.anchors), room_caster, bounds),
        "no anchors": (survey(room_caster, cameras, room.up), room_caster, bounds),
        "box": (survey(box, BOX_CAMERAS, UP), box, BOX),
        "one camera": (survey(box, BOX_CAMERAS[:1], UP), box, BOX),
    }


@pytest.mark.parametrize("where", ["anchors", "no anchors", "box", "one camera"])
@pytest.mark.parametrize("name", SETUPS)
def test_lights_hang_in_free_space(name: str, where: str, stages: dict[str, tuple]) -> None:
    stage, caster, bounds = stages[where]
    setup = named_setup(name, stage)
    assert finite(setup)
    assert setup.reference_lux > 0
    for light in setup.lights:
        strength = getattr(light, light.STRENGTH)
        assert float(strength) > 0 and (np.asarray(light.color) >= 0).all() and np.asarray(light.color).max() > 0
    directions = np.asarray(trimesh.creation.icosphere(2).vertices)
    for place, radius in places(setup):
        # A window may stand in the depth of its wall.
        assert (place > bounds[0] - 0.1).all() and (place < bounds[1] + 0.1).all(), f"{place} is out of the room"
        # Light starts on the bulb's ball; a window has its wall beside it, a lamp its stem and shade.
        free = caster.cast(place + radius * directions, directions).distance
        assert np.quantile(free, 0.05) > 0.005 and np.median(free) > 0.1


@pytest.mark.parametrize("where", ["anchors", "no anchors", "one camera"])
@pytest.mark.parametrize("name", SETUPS)
def test_places_are_known_before_the_exposure(name: str, where: str, stages: dict[str, tuple]) -> None:
    """Programs and shadow maps that are made meanwhile are those of the exposed lights."""
    stage = stages[where][0]
    placed, setup = placed_setup(name, stage).lights, named_setup(name, stage).lights
    (leaves, tree), (others, other) = map(jax.tree.flatten, (placed, setup))
    assert tree == other
    assert [(x.shape, x.dtype) for x in leaves] == [(x.shape, x.dtype) for x in others]
    without = [[dataclasses.replace(x, **{x.STRENGTH: 0.0}) for x in lights] for lights in (placed, setup)]
    jax.tree.map(np.testing.assert_array_equal, *without)


@pytest.mark.parametrize("name", SETUPS)
def test_every_set_up_lights_what_is_looked_at(
    name: str, room: RoomCapture, room_caster: RayCaster, stages: dict[str, tuple]
) -> None:
    setup = named_setup(name, stages["anchors"][0])
    gbuffer = room_caster.gbuffer(room[2].camera)
    lux = np.zeros((*gbuffer.hit.shape, 3))
    for light in setup.lights:
        lux += np.asarray(light.illuminance_at(gbuffer.position, gbuffer.normal)[..., None] * light.color)
    seen = lux[np.asarray(gbuffer.hit)]
    assert np.isfinite(seen).all() and (seen >= 0).all()
    assert 0.05 < np.median(seen) / setup.reference_lux < 20  # neither black nor burnt out


def test_anchors_are_used_where_there_are_any(room: RoomCapture, room_caster: RayCaster) -> None:
    cameras = [frame.camera for frame in room]
    stage = survey(room_caster, cameras, room.up, room.anchors)
    (window,) = stage.windows
    np.testing.assert_allclose(window.center, room.anchors["window_0"]["center"])
    assert window.width == room.anchors["window_0"]["width"]
    np.testing.assert_allclose(stage.lamps, [room.anchors[f"lamp_{i}"]["position"] for i in (0, 1)])
    assert not any(stage.made_up.values())
    lamps = [
        np.asarray(x.position) for x in named_setup("evening-lamps", stage).lights if isinstance(x, PointLight)
    ]
    np.testing.assert_allclose(lamps, stage.lamps, atol=1e-5)
    only_lamps = survey(room_caster, cameras, room.up, {"lamp_0": {"position": [1, 2, 1]}})
    np.testing.assert_allclose(only_lamps.lamps, [[1, 2, 1]])
    assert np.isfinite(only_lamps.windows[0].center).all()


def test_places_that_are_made_up_are_said(
    room: RoomCapture, room_caster: RayCaster, caplog: pytest.LogCaptureFixture
) -> None:
    """Of the lights that a set-up uses."""

    def said(name: str, anchors: LightAnchors) -> list[str]:
        caplog.clear()
        tell_made_up(name, anchors, named_setup(name, anchors).lights)
        return caplog.messages

    cameras = [frame.camera for frame in room]
    assert not said("evening-lamps", survey(room_caster, cameras, room.up, room.anchors))
    without = {name: place for name, place in room.anchors.items() if not name.startswith("window")}
    found = survey(room_caster, cameras, room.up, without)
    places = ", ".join("({:.1f}, {:.1f}, {:.1f})".format(*window.center) for window in found.windows)
    assert said("noon-window", found) == [
        f"noon-window: made up: windows at {places}; if yours are elsewhere, give them with --photo-sources FILE"
    ]
    bare = survey(room_caster, cameras, room.up)
    (line,) = said("evening-lamps", bare)
    assert "lamps at (" in line and ") and windows at (" in line
    (line,) = said("golden-hour", bare)
    assert "windows at (" in line and "lamp" not in line


def test_made_up_window_faces_what_is_looked_at(box: RayCaster) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    (window,) = stage.windows
    assert abs(window.inward @ UP) < 1e-6 and np.linalg.norm(window.inward) == pytest.approx(1)
    assert (stage.focus - window.center) @ window.inward > 0.3
    assert len(stage.lamps) == len(stage.points) == 2


def test_what_stands_out_of_its_wall_does_not_cut_the_light_of_a_made_up_window(box: RayCaster) -> None:
    """As mullions of a glass wall do: its light would end up in single spots."""
    posts = [
        trimesh.creation.box(bounds=[[x - 0.025, y - 0.08, 0.0], [x + 0.025, y + 0.08, 2.5]])
        for x, y in [(x, y) for x in np.arange(-2.0, 2.1, 0.5) for y in (-3.0, 3.0)]
        + [(x, y) for y in np.arange(-3.0, 3.1, 0.5) for x in (-2.0, 2.0)]
    ]
    caster = RayCaster(trimesh.util.concatenate([box.mesh, *posts]))
    (window,) = survey(caster, BOX_CAMERAS, UP).windows
    opening = window.opening(UP)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.99, 0.99, 25)]), -1).reshape(-1, 2)
    points = np.asarray(opening.center) + grid @ np.stack([opening.right, opening.up])
    inward = np.broadcast_to(0.2 * window.inward, points.shape)
    assert not window.in_free_space and not caster.occluded(points, inward, 1.0).any()
    assert caster.occluded(points, -inward, 1.0).all(), "it stands before its wall"


def lamp_lux(stage: LightAnchors) -> np.ndarray:
    """Median illuminance of what each camera sees by the lamps, in lux."""
    lamps = [PointLight(lamp, 900.0, np.ones(3), radius=0.06, clearance=0.3) for lamp in stage.lamps]
    return stage.seen.of_cameras(stage.seen.lux(lamps).sum(axis=1))


def clearance(mesh: trimesh.Trimesh, place: np.ndarray) -> float:
    """Distance of a place from a surface, in metres."""
    return float(np.linalg.norm(mesh.subdivide_to_size(0.05).vertices - place, axis=1).min())


@pytest.mark.parametrize(("width", "count"), [(0.25, 1), (2.0, 2)])
def test_the_back_of_a_chair_does_not_part_a_room_as_a_partition_does(
    box: RayCaster, width: float, count: int
) -> None:
    panel = trimesh.creation.box(bounds=[[-width, -0.02, 0.0], [width, 0.02, 0.95]])
    cameras = [box_camera((0.0, side * 2.5, 1.5), (0.0, side * 0.7, 0.0)) for side in (-1, 1)]
    stage = survey(RayCaster(trimesh.util.concatenate([box.mesh, panel])), cameras, UP)
    assert len(stage.stops) == count
    assert (lamp_lux(stage) > 5).all()


def test_a_camera_at_a_door_gets_a_lamp_in_the_room_that_it_looks_into() -> None:
    rooms = trimesh.creation.box(bounds=[[-3.0, -1.5, 0.0], [3.0, 1.5, 2.5]])
    rooms.invert()
    sides = [[[-0.05, -1.5, 0.0], [0.05, -0.42, 2.5]], [[-0.05, 0.42, 0.0], [0.05, 1.5, 2.5]]]
    walls = [trimesh.creation.box(bounds=bounds) for bounds in sides]
    cameras = [box_camera((-0.5, 0.9, 1.5), (-2.0, -0.5, 0.5)), box_camera((-0.25, 0.0, 1.5), (2.0, 0.0, 0.5))]
    stage = survey(RayCaster(trimesh.util.concatenate([rooms, *walls])), cameras, UP)
    assert len(stage.stops) == 2 and (lamp_lux(stage) > 5).all()


def test_a_made_up_lamp_burns_no_spot_into_what_is_near(box: RayCaster) -> None:
    """What is looked at lies under a seat, with a wall beside it."""
    seat = trimesh.creation.box(bounds=[[-0.6, 0.0, 0.55], [0.2, 0.9, 0.6]])
    wall = trimesh.creation.box(bounds=[[-1.0, -1.0, 0.0], [-0.9, 3.0, 2.5]])
    caster = RayCaster(trimesh.util.concatenate([box.mesh, seat, wall]))
    stage = survey(caster, [box_camera((0.2, -2.0, 1.0), (-0.2, 0.6, 0.0))], UP)
    assert clearance(caster.mesh, _points(caster, stage.focus, stage.stops[0].eye, UP)[0]) < 0.4
    for lamp in (*stage.lamps, *stage.points):
        assert clearance(caster.mesh, lamp) > 0.8
        assert not caster.occluded(stage.stops[0].eye, (lamp - stage.stops[0].eye)[None], 1.0)[0]


@pytest.mark.parametrize("aside", np.linspace(-0.8, 0.8, 5))
@pytest.mark.parametrize("ahead", [-0.4, 0.4])
def test_the_lamp_in_the_middle_is_in_no_furniture(aside: float, ahead: float) -> None:
    """Nor between two that are clear of it."""
    room = trimesh.creation.box(bounds=[[-2.5, -2.5, 0.0], [2.5, 2.5, 2.6]])
    room.invert()
    low = np.array([aside - 0.15, ahead - 0.15, 0.0])
    column = trimesh.creation.box(bounds=[low, low + np.array([0.3, 0.3, 2.6])])
    caster = RayCaster(trimesh.util.concatenate([room, column]))
    stage = survey(caster, [box_camera((0.1, -2.2, 0.2), (0.0, 0.5, 0.5))], UP)
    (lamp,) = placed_setup("center-point", stage).lights
    assert clearance(caster.mesh, np.asarray(lamp.position)) > 0.6


@pytest.mark.parametrize("side", [2.0, 2.6, 4.0])
def test_two_lamps_stay_apart_in_small_rooms(side: float) -> None:
    room = trimesh.creation.box(bounds=[[-side / 2, -side / 2, 0.0], [side / 2, side / 2, 2.4]])
    room.invert()
    stage = survey(RayCaster(room), [box_camera((0.1, 0.1 - side / 2, 1.2), (0.0, side / 4, 0.3))], UP)
    pair = _points(stage.seen.caster, stage.focus, stage.stops[0].eye, UP)
    least = 0.7 * np.linalg.norm(pair[1] - pair[0])
    apart = np.linalg.norm(stage.points[1] - stage.points[0])
    assert apart > 0.99 * least or (apart > 0.5 and np.allclose(stage.points[1], pair[1]))


def test_a_made_up_lamp_stays_in_the_room() -> None:
    """Beyond an open window there is room without end, and nothing to light."""
    room = trimesh.creation.box(bounds=[[-2.0, -3.0, 0.0], [2.0, 3.0, 2.4]]).subdivide_to_size(0.3)
    room.invert()
    middle = room.triangles_center
    opening = (middle[:, 1] > 2.99) & (abs(middle[:, 0]) < 1.2) & (abs(middle[:, 2] - 1.5) < 0.65)
    room.update_faces(~opening)
    stage = survey(RayCaster(room), [box_camera((0.1, -1.0, 1.5), (0.0, 3.0, 1.0))], UP)
    assert all(lamp[1] < 3.0 for lamp in stage.lamps)


@pytest.mark.parametrize("target", [0.2, 1.0, 2.0])
def test_a_made_up_lamp_goes_no_farther_than_it_gains(target: float) -> None:
    """Under a rough ceiling that leaves no place a metre of room."""
    room = trimesh.creation.box(bounds=[[-3.0, -4.0, 0.0], [3.0, 4.0, 1.9]]).subdivide_to_size(0.2)
    room.invert()
    room.vertices += np.random.default_rng(0).normal(0.0, 0.005, room.vertices.shape)
    stage = survey(RayCaster(room), [box_camera((0.1, -3.0, 1.2), (0.0, 0.0, target))], UP)
    places = _points(RayCaster(room), stage.focus, stage.stops[0].eye, UP)
    for place, lamp in zip(places, stage.lamps, strict=True):
        gained = clearance(room, lamp) - clearance(room, place)
        assert np.linalg.norm(lamp - place) <= 3.0 * gained + 0.1
        assert clearance(room, lamp) > 0.6


def test_the_sun_falls_downwards_through_its_window(stages: dict[str, tuple]) -> None:
    stage = stages["anchors"][0]
    heights = {}
    for name in ("noon-window", "golden-hour", "night-moon"):
        (sun,) = [light for light in named_setup(name, stage).lights if isinstance(light, DirectionalLight)]
        direction = np.asarray(sun.direction, float)
        assert direction @ stage.windows[0].inward > 0.3 and direction @ stage.up < 0
        heights[name] = -np.rad2deg(np.arcsin(direction @ stage.up))
    assert heights == pytest.approx({"noon-window": 35, "golden-hour": 13, "night-moon": 38}, abs=0.1)


def test_a_downward_view_still_finds_places(box: RayCaster) -> None:
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1.0]])  # straight down
    pose[:3, 3] = [0.3, 0.2, 2.0]
    stage = survey(box, [Camera(BOX_CAMERAS[0].intrinsics, pose)], UP)
    for name in SETUPS:
        assert finite(named_setup(name, stage))


def test_an_open_surface_gives_finite_places() -> None:
    """A scan with no walls: nothing ever stops the rays that look for free space."""
    floor = trimesh.Trimesh(
        [[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0.0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    stage = survey(RayCaster(floor), [box_camera((0, -2, 1.5), (0, 1, 0))], UP)
    for name in SETUPS:
        setup = named_setup(name, stage)
        assert finite(setup)
        assert all(place[2] > 0 for place, _ in places(setup))


PATIO = trimesh.util.concatenate(
    [
        trimesh.creation.box(bounds=[[-2.0, -2.0, -0.1], [2.0, 2.0, 0.0]]),
        trimesh.creation.box(bounds=[[-0.2, 0.0, 0.0], [0.2, 0.1, 0.8]]),
    ]
)
"""A floor with something that stands on it."""
PATIO_CAMERAS = [box_camera((0.5, -2, 1.5), (0, 0.3, 0.2)), box_camera((-0.8, -2, 1.4), (0.2, 0.3, 0))]


def test_where_no_wall_was_scanned_the_sky_is_open(caplog: pytest.LogCaptureFixture) -> None:
    """Sun and sky all around, with shadows in what is exposed for, and a line."""
    anchors = survey(RayCaster(PATIO), PATIO_CAMERAS, UP)
    for name in EXPOSURES:
        setup = named_setup(name, anchors)
        assert not any(isinstance(light, RectLight) for light in setup.lights)
        assert sum(isinstance(light, SkyLight) for light in setup.lights) == 1
        assert all(light.aperture is None for light in setup.lights if isinstance(light, DirectionalLight))
    sun = next(light for light in named_setup("noon-window", anchors).lights if isinstance(light, DirectionalLight))
    assert float(sun.direction[2]) < -0.5
    assert 0 < (anchors.seen.lux([sun]) == 0).mean() < 0.5
    tell_made_up("noon-window", anchors, named_setup("noon-window", anchors).lights)
    (line,) = caplog.messages
    assert line.startswith("noon-window: no wall for a window was found, and little is above; light from outside")


def test_a_sky_counts_as_far_as_it_is_seen() -> None:
    """Half of it beside a high wall."""
    wall = trimesh.creation.box(bounds=[[-50.0, 0.3, 0.0], [50.0, 0.4, 100.0]])
    floor = trimesh.creation.box(bounds=[[-5.0, -5.0, -0.1], [5.0, 5.0, 0.0]])
    looking_down = [box_camera((0, 0, 1.5), (0.01, 0, 0))]
    sky = SkyLight(UP, 100.0, np.ones(3))
    lux = [
        np.median(survey(RayCaster(mesh), looking_down, UP).seen.lux([sky]))
        for mesh in (floor, trimesh.util.concatenate([floor, wall]))
    ]
    assert lux[0] == pytest.approx(100.0, rel=0.01) and lux[1] == pytest.approx(50.0, rel=0.15)


def test_the_open_sun_is_turned_to_where_it_lands() -> None:
    """A high wall stands before the usual sun."""
    anchors = survey(RayCaster(PATIO), PATIO_CAMERAS, UP)
    (usual,) = (light for light in SETUPS["golden-hour"](anchors).lights if isinstance(light, DirectionalLight))
    toward = -np.asarray(usual.direction, float)
    side, base = np.cross(UP, toward), toward * [4.0, 4.0, 0.0]
    corners = [base - 2 * side, base + 2 * side, base + 2 * side + 4 * UP, base - 2 * side + 4 * UP]
    wall = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    seen = survey(RayCaster(trimesh.util.concatenate([PATIO, wall])), PATIO_CAMERAS, UP)
    shaded = dataclasses.replace(seen, windows=anchors.windows, open_sky=True)
    (turned,) = (light for light in SETUPS["golden-hour"](shaded).lights if isinstance(light, DirectionalLight))
    assert (seen.seen.lux([usual]) > 0).mean() < (seen.seen.lux([turned]) > 0).mean()


@pytest.mark.parametrize("values", [np.arange(1.0), np.random.default_rng(0).random(670, np.float32)])
@pytest.mark.parametrize("quantile", [0.0, 0.5, 0.9, 1.0])
def test_quantiles_of_pictures_are_numpys(values: np.ndarray, quantile: float, box: RayCaster) -> None:
    seen, none = survey(box, BOX_CAMERAS, UP).seen, np.zeros(0, bool)
    pictured = dataclasses.replace(seen, camera=np.repeat([0, 2], [len(values), 1]))
    first, second = pictured.of_cameras(np.append(values, values[:1]), quantile)
    assert first == np.quantile(values, quantile) and second == values[0]
    nothing = seen.chosen(np.zeros(len(seen.points), bool))
    assert nothing.of_cameras(none.astype(float), quantile).shape == (0,)


@pytest.mark.parametrize("more", ["wall", "ceiling", "window", "rooms"])
def test_a_wall_a_ceiling_a_known_window_or_rooms_around_leave_no_open_sky(more: str) -> None:
    sides = [(side * np.cos(a), side * np.sin(a)) for side in (2.6, 3.8) for a in np.pi / 2 * np.arange(4)]
    walls = [
        trimesh.creation.box((0.1 + 2 * abs(y), 0.1 + 2 * abs(x), 2.4)).apply_translation((x, y, 1.2))
        for x, y in sides
    ]
    parts = {
        "rooms": trimesh.util.concatenate(walls),
        "wall": trimesh.creation.box(bounds=[[-2.0, 2.0, 0.0], [2.0, 2.1, 2.5]]),
        "ceiling": trimesh.creation.box(bounds=[[-2.0, -2.0, 2.4], [2.0, 2.0, 2.5]]),
    }
    mesh = trimesh.util.concatenate([PATIO, parts[more]]) if more in parts else PATIO
    window = {"center": [2.0, 0.0, 1.2], "normal": [-1.0, 0.0, 0.0], "width": 1.2, "height": 1.0}
    anchors = survey(RayCaster(mesh), PATIO_CAMERAS, UP, {"window_0": window} if more == "window" else None)
    assert not anchors.open_sky
    assert any(isinstance(light, RectLight) for light in named_setup("noon-window", anchors).lights)


def test_unknown_names_and_unseen_meshes_are_refused(box: RayCaster) -> None:
    with pytest.raises(InputError, match="noon-window"):
        named_setup("noon", survey(box, BOX_CAMERAS, UP))
    far = RayCaster(trimesh.creation.box(bounds=[[100, 100, 100], [101, 101, 101]]))
    with pytest.raises(InputError, match="no camera sees the mesh"):
        survey(far, BOX_CAMERAS, UP)


def test_the_sun_turns_to_what_is_seen_and_lamps_do_not_burn_out(box: RayCaster) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    (sun,) = [x for x in named_setup("golden-hour", stage).lights if isinstance(x, DirectionalLight)]
    assert stage.seen.lux([sun]).max() > 0
    warm = named_setup("golden-hour", stage).lights  # where its sun does not reach, too
    assert all(light.color[0] > light.color[2] for light in warm)
    evening = named_setup("evening-lamps", stage)
    direct = [light for light in evening.lights if not light.UNIFORM]  # the others only fill bounces up
    lux = stage.seen.lux(direct).sum(axis=1)
    assert np.quantile(lux, 0.95) < 1.6 * float(evening.reference_lux)


@pytest.mark.parametrize("name", EXPOSURES)
def test_the_median_picture_keeps_its_share_of_the_light_that_the_place_answers_with(
    name: str, box: RayCaster
) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    raw, seen, exposure = SETUPS[name](stage), stage.seen, EXPOSURES[name]
    lux, count = seen.lux(raw.lights), len(seen.points)
    near, parallel = kinds_of(raw.lights)
    strength = lux[:, near].sum(axis=1).mean()
    references = {}
    for bounced, photo_light in ((0.1, 1.0), (2.0, 1.0), (2.0, 4.0)):
        bounces = np.full(count, bounced * strength), np.zeros(count)
        answer = Response(np.full(count, photo_light), *bounces, 0.3)
        setup = exposed(raw, lux, seen, exposure, answer)
        references[bounced, photo_light] = setup.reference_lux
        own = seen.lux(setup.lights) * paleness(setup.lights)
        filled = 0.3 * own[:, ~(near | parallel)].sum(axis=1)
        light = own[:, near | parallel].sum(axis=1) + np.maximum(answer.near, filled)
        kept = np.median(seen.of_cameras(light / photo_light)) / setup.reference_lux
        assert 0.8 * exposure.share < kept < 1.05 * exposure.share
    assert references[0.1, 1.0] < references[2.0, 1.0]
    assert references[2.0, 4.0] == pytest.approx(references[2.0, 1.0] / 4, rel=0.35)


@pytest.mark.parametrize("name", ["noon-window", "golden-hour", "evening-lamps"])
def test_white_walls_take_less_light_than_dark_ones(name: str, box: RayCaster) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    raw, seen = SETUPS[name](stage), stage.seen
    lux, count = seen.lux(raw.lights), len(seen.points)
    near, parallel = kinds_of(raw.lights)

    def relit(photo_value: float) -> tuple[float, float]:
        value, dark = np.full(count, photo_value), np.zeros(count)
        answer = Response(np.ones(count), dark, dark, 0.3, measured=False, photo_value=value)
        setup = exposed(raw, lux, seen, EXPOSURES[name], answer)
        own = seen.lux(setup.lights)
        light = np.maximum(own[:, near].sum(axis=1), 0.3 * own[:, ~(near | parallel)].sum(axis=1))
        burnt = seen.of_cameras(value * light / setup.reference_lux, 0.9) > 1.02 * max(WHITE, photo_value)
        return float(setup.reference_lux), float(burnt.max())

    white, dark = relit(0.95 * WHITE), relit(0.1)
    assert white[0] >= dark[0] and white[1] == dark[1] == 0
    assert white[0] > dark[0] or name != "evening-lamps", "the sun bounds the others"
    assert relit(20.0)[0] == pytest.approx(relit(WHITE)[0]), "what the photo itself burns out may stay so"


@pytest.mark.parametrize("photo_value", [0.3, 0.95 * WHITE])
def test_ambient_light_burns_no_white_wall_out(photo_value: float, box: RayCaster) -> None:
    """A third of each picture is a white wall in the window's light; the rest gets nothing but ambient light."""
    stage = survey(box, BOX_CAMERAS[:1], UP)
    raw, seen, exposure = SETUPS["noon-window"](stage), stage.seen, EXPOSURES["noon-window"]
    near, _ = kinds_of(raw.lights)
    third, none = np.arange(len(seen.points)) % 3 == 0, np.zeros(len(seen.points))
    lux = np.where(near[None] & third[:, None], 100.0, 0.0)
    response = Response(none + 1.0, none, none, 0.5, photo_value=none + photo_value)
    setup = exposed(raw, lux, seen, exposure, response)
    fill = sum(0.5 * float(light.illuminance) for light in setup.lights if light.UNIFORM)
    light = ((lux * paleness(raw.lights))[:, near].sum(axis=1) + fill) / float(setup.reference_lux)
    brightest = seen.of_cameras(photo_value * light, 0.9)[0]
    assert brightest < 1.01 * WHITE
    if photo_value < 0.5:  # nothing burns: the exposure is kept
        assert np.median(seen.of_cameras(light)) > 0.8 * exposure.share


@pytest.mark.parametrize("brighter", [1.0, 30.0])
def test_no_picture_is_far_brighter_than_the_median_one(brighter: float, box: RayCaster) -> None:
    """A window lights one of three places of a walk much more than the others."""
    cameras = [box_camera((0.5, y, 1.5), (-0.5, y + 1.0, 1)) for y in (-2.0, -1.0, 0.0)]
    stage = survey(box, cameras, UP)
    raw, seen, exposure = SETUPS["night-moon"](stage), stage.seen, EXPOSURES["night-moon"]
    near, _ = kinds_of(raw.lights)
    none = np.zeros(len(seen.points))
    lux = np.where(near, np.where(seen.camera == 1, brighter, 1.0)[:, None], 0.0)
    setup = exposed(raw, lux, seen, exposure, Response(none + 1.0, none, none, 0.5))
    light = (lux * paleness(raw.lights))[:, near].sum(axis=1) / float(setup.reference_lux)
    assert seen.of_cameras(light).max() < 2.05 * exposure.share


def test_a_picture_in_the_sun_does_not_darken_the_others(monkeypatch: pytest.MonkeyPatch, box: RayCaster) -> None:
    """The sun has a bound of its own."""
    cameras = [box_camera((0.5, y, 1.5), (-0.5, y + 1.0, 1)) for y in (-2.0, -1.0, 0.0)]
    stage = survey(box, cameras, UP)
    raw, seen, exposure = SETUPS["golden-hour"](stage), stage.seen, EXPOSURES["golden-hour"]
    near, parallel = kinds_of(raw.lights)
    none = np.zeros(len(seen.points))
    sunlit = (seen.camera == 1) & (np.arange(len(none)) % 10 < 7)
    lux = np.where(parallel, np.where(sunlit, 300.0, 0.0)[:, None], np.where(near, 100.0, 0.0))
    response = Response(none + 1.0, none, none, 0.5)
    bound = exposed(raw, lux, seen, exposure, response)
    monkeypatch.setattr(exposure_module, "MOST_OVER_SHARE", 1e9)
    assert bound.reference_lux == exposed(raw, lux, seen, exposure, response).reference_lux


def test_a_window_whose_sun_grazes_the_floor_keeps_it(box: RayCaster) -> None:
    """Where another window's sun shows."""
    stage = survey(box, BOX_CAMERAS, UP)
    travel = np.array([0.0, 0.97, -0.24])
    level = stage.seen.chosen(stage.seen.normals @ UP > 0.9)
    window = WindowPlace(np.array([0.0, -2.99, 1.0]), np.array([0.0, 1.0, 0.0]), 3.0, 1.8)
    pictures, [(share, _)] = _sunlit(dataclasses.replace(stage, seen=level, windows=[window]), unit(travel))
    assert pictures == 0 and share > 0


def test_a_grazing_sun_is_turned_to_where_it_shows() -> None:
    """On level ground alone a usual low sun would hardly be seen."""
    anchors = survey(RayCaster(PATIO), PATIO_CAMERAS, UP)
    ground = dataclasses.replace(anchors, seen=anchors.seen.chosen(anchors.seen.normals @ UP > 0.9))
    (sun,) = (light for light in SETUPS["golden-hour"](ground).lights if isinstance(light, DirectionalLight))
    assert -np.asarray(sun.direction) @ UP > 0.3


@pytest.mark.parametrize("name", EXPOSURES)
def test_rounding_decides_nothing_of_an_exposure(name: str, box: RayCaster) -> None:
    """The median picture mostly has just its share: lights a millionth stronger are exposed alike."""
    stage = survey(box, BOX_CAMERAS, UP)
    raw, seen, found = SETUPS[name](stage), stage.seen, []
    lux, none = seen.lux(raw.lights), np.zeros(len(seen.points))
    bounced = (
        np.random.default_rng(0).uniform(0.5, 3.0, len(none)) * lux[:, kinds_of(raw.lights)[0]].sum(axis=1).mean()
    )
    for factor in 1.0 + 1e-6 * np.arange(-8, 9):
        strengths = [{light.STRENGTH: factor * getattr(light, light.STRENGTH)} for light in raw.lights]
        lights = tuple(dataclasses.replace(light, **one) for light, one in zip(raw.lights, strengths, strict=True))
        answer = Response(none + 1.0, factor * bounced, none, 0.3)
        setup = exposed(LightSetup(lights), factor * lux, seen, EXPOSURES[name], answer)
        (ambient,) = (float(light.illuminance) for light in setup.lights if light.UNIFORM)
        found.append(ambient / float(setup.reference_lux))
    assert max(found) < 1.001 * min(found)


def test_dark_photos_are_lifted_by_day_alone() -> None:
    shares = {name: exposure.lifted(0.04).share / exposure.share for name, exposure in EXPOSURES.items()}
    assert shares == pytest.approx(dict.fromkeys(EXPOSURES, 1.0) | {"noon-window": 3**0.5})
    assert EXPOSURES["noon-window"].lifted(0.3) == EXPOSURES["noon-window"]


def test_the_papers_set_ups_keep_their_exposure(box: RayCaster) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    assert all(named_setup(name, stage).reference_lux == 300.0 for name in ("center-point", "two-colors"))


@pytest.mark.parametrize("name", ["center-point", "two-colors"])
@pytest.mark.parametrize(("photo_light", "kept"), [(0.5, None), (0.02, 1.0), (20.0, 0.4)])
def test_a_fixed_exposure_is_left_for_pictures_that_would_end_dark_or_burnt(
    box: RayCaster, name: str, photo_light: float, kept: float | None
) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    seen, setup = stage.seen, named_setup(name, stage)
    lux = seen.lux(setup.lights)
    photo, none, dark = (np.full(len(lux), value) for value in (photo_light, 0.0, 1e-4))
    response = Response(photo, none, none, 0.5, photo_value=dark)
    left = bounded(setup, lux, seen, response).reference_lux
    if kept is None:
        assert left == setup.reference_lux
    else:
        pale = (lux * paleness(setup.lights)).sum(axis=1)
        assert np.median(seen.of_cameras(pale / left / photo_light)) == pytest.approx(kept)
    bright = dataclasses.replace(response, photo_value=np.full(len(lux), 0.8))
    strongest = 0.8 * lux.sum(axis=1) / photo_light / bounded(setup, lux, seen, bright).reference_lux
    assert (seen.of_cameras(strongest, 0.97) <= WHITE * (1.0 + 1e-6)).all()
    assert bounded(setup, 0 * lux, seen, response).reference_lux == setup.reference_lux, "no light, no exposure"


def test_a_hall_that_they_leave_dark_keeps_both_colours_and_is_exposed_longer() -> None:
    hall = trimesh.creation.box(bounds=[[0, 0, 0], [30, 30, 10]]).subdivide_to_size(2.0)
    hall.invert()
    stage = survey(RayCaster(hall), [box_camera((15.0, 1.0, 1.5), (15.0, 20.0, 3.0))], UP)
    setup = named_setup("two-colors", stage)
    assert len(setup.lights) == 2 and not np.allclose(setup.lights[0].color, setup.lights[1].color)
    assert 5.0 < setup.reference_lux < 100.0
    lux = stage.seen.lux(setup.lights).sum(axis=1)
    assert np.quantile(lux, 0.95) < 2.0 * setup.reference_lux, "and not burnt out"


def test_a_light_that_misses_the_view_is_told(box: RayCaster, caplog: pytest.LogCaptureFixture) -> None:
    stage = survey(box, BOX_CAMERAS, UP)
    behind = PointLight(np.array([0.0, 30.0, 1.0]), 900.0, np.ones(3))
    warn_of_missing(LightSetup((behind,), 100.0), stage.seen.lux([behind]), "mine")
    assert [record.getMessage() for record in caplog.records] == [
        "mine: light 0 (PointLight) reaches no surface that the cameras see"
    ]


def test_a_light_far_outside_is_told(box: RayCaster, caplog: pytest.LogCaptureFixture) -> None:
    near, far = (PointLight(np.array([0.0, y, 1.0]), 900.0, np.ones(3)) for y in (0.5, 180.0))
    ambient = AmbientLight(20.0, np.ones(3))
    warn_of_far([near, ambient, far], box.bounds, "mine.yaml")
    (record,) = caplog.records
    assert re.match(r"mine.yaml: light 2 \(PointLight\) stands 17\d m outside the scan", record.getMessage())


def test_windows_shine_by_their_area_and_all_of_them(box: RayCaster) -> None:
    place = {"normal": [1.0, 0.0, 0.0], "height": 1.0}
    anchors = {
        "window_0": place | {"center": [-2.0, 0.0, 1.3], "width": 2.0},
        "window_1": place | {"center": [-2.0, 2.0, 1.3], "width": 0.5},
    }
    for name in ("noon-window", "golden-hour", "evening-lamps", "night-moon"):
        setup = named_setup(name, survey(box, BOX_CAMERAS, UP, anchors))
        large, small = (light for light in setup.lights if isinstance(light, RectLight))
        assert float(large.luminous_flux) == pytest.approx(4 * float(small.luminous_flux), rel=1e-5)


CORRIDOR = np.array([[-1.0, 0.0, 0.0], [1.0, 24.0, 2.4]])


@pytest.fixture(scope="module")
def corridor() -> RoomCapture:
    """Grey photos along a corridor of 24 m."""
    mesh = trimesh.creation.box(bounds=CORRIDOR)
    mesh.invert()
    mesh = mesh.subdivide_to_size(0.8)
    eyes = [(0.2, y, 1.5) for y in np.linspace(1.0, 19.0, 7)]
    cameras = [box_camera(eye, (0.0, eye[1] + 2.0, 1.2)) for eye in eyes]
    photos = np.random.default_rng(0).integers(90, 140, (len(eyes), 48, 64, 3)).astype(np.uint8)
    return RoomCapture(photos, cameras, mesh, {})


def test_a_corridor_has_lights_all_along_and_no_black_pictures(corridor: RoomCapture) -> None:
    scene = Scene(corridor, corridor.reference())
    stage = survey(scene.caster, [corridor.camera(i) for i in range(len(corridor))], UP)
    along = np.sort([lamp[1] for lamp in stage.lamps])
    assert len(along) >= 4 and np.diff([0.0, *along, 24.0]).max() < 8.0
    assert len(stage.windows) >= 2
    for window in stage.windows:  # in the walls, which are outer ones
        assert abs(abs(window.center[0]) - 1.0) < 0.05 or abs(window.center[1] - 12.0) == pytest.approx(
            12, abs=0.05
        )
    for name in ("evening-lamps", "two-colors"):
        relighter = Relighter(scene, named_setup(name, stage), "fast")
        for index in (0, 3, 6):
            share = dark_share(scene.frame(index).image, np.asarray(to_display(relighter.picture(index))))
            assert share.black_before == 0 and share.black < 0.3, f"{name}, frame {index}: {share}"
