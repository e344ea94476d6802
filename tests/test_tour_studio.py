"""Painting: the same pictures as `hyjax relight`, nothing made twice, furniture that moves."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

pytest.importorskip("astral", reason="needs the extra 'tour'")

from hyjax.color import to_linear
from hyjax.data.capture import Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import read_lights
from hyjax.data.room import UP, RoomCapture, load_room
from hyjax.lights import PointLight
from hyjax.pipeline import relight
from hyjax.scene.camera import Camera, Intrinsics, look_at
from hyjax.scene.mesh import submesh
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.schedule import Schedule
from hyjax.tour import studio as studio_module
from hyjax.tour.furniture import Part, nearest, piece_at, shell
from hyjax.tour.kept import Kept
from hyjax.tour.lighting import lights_file
from hyjax.tour.painting import View
from hyjax.tour.place import place_lamp
from hyjax.tour.plan import Piece, Plan, Window
from hyjax.tour.studio import Studio, Unwanted

HYJAX = Schedule.preset("hyjax")
VIEW = View(0, "relit", HYJAX)
CUBE, TOP = np.array([[0.5, 0.4, 0.35], [0.5, 0.4, 0.7]])


def box_room() -> trimesh.Trimesh:
    """Four by five metres, 2.5 m high, with a table of a cube and a wardrobe on the floor; small triangles."""
    walls = trimesh.creation.box(bounds=[[-2, -2.5, 0], [2, 2.5, 2.5]])
    walls.invert()
    cube = trimesh.creation.box((0.7, 0.7, 0.7), trimesh.transformations.translation_matrix(CUBE))
    wardrobe = trimesh.creation.box(bounds=[[-1.9, 1.0, 0.0], [-1.4, 2.0, 1.9]])
    mesh = trimesh.util.concatenate([walls, cube, wardrobe])
    mesh = mesh.subdivide_to_size(0.25)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


class BoxCapture:
    """Two frames of grey pictures in that room."""

    name, up, fingerprint = "box", UP, "box"

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> Any:
        k = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
        pose = look_at(np.array([-1.2 + 0.3 * index, -2.2, 1.5]), CUBE, UP)
        image = np.random.default_rng(index).uniform(0.3, 0.7, (48, 64, 3)).astype(np.float32)
        return Frame(f"{index}", image, Camera(k, pose), float(index))


@pytest.fixture(scope="module")
def studio() -> Studio:
    return Studio(BoxCapture(), box_room())


@pytest.fixture
def plan() -> Plan:
    lamp = place_lamp("bulb", np.array([0.5, 0.4, 1.2]), UP)
    window = Window((1.98, 0.0, 1.3), (-1.0, 0.0, 0.0))
    return Plan(hour=9.0, windows=(window,), lamps=(lamp,)).check()


def seed_of(studio: Studio, plan: Plan) -> Piece:
    """The cube, as a click from above picks it."""
    touch = studio.house.touch(plan, (0.5, 0.4, 2.0), (0.0, 0.0, -1.0))
    assert touch is not None and touch.piece is None
    np.testing.assert_allclose(touch.point, (0.5, 0.4, 0.7), atol=1e-5)
    np.testing.assert_allclose(touch.normal, UP, atol=1e-6)
    return Piece(tuple(touch.origin.tolist()))


def moved(by: tuple[float, float, float], degrees: float = 0.0) -> tuple[float, ...]:
    pose = trimesh.transformations.rotation_matrix(np.deg2rad(degrees), UP)
    pose[:3, 3] += by
    return tuple(pose.reshape(-1).tolist())


def test_a_painting_is_what_relight_makes_of_its_lights(studio: Studio, plan: Plan, tmp_path: Path) -> None:
    painting = studio.paint(plan, VIEW)
    file = tmp_path / "lights.json"
    file.write_text(json.dumps(lights_file(plan, UP, studio.surface)))
    setup, frame = read_lights(file, UP), studio.frame(0)
    caster = RayCaster(studio.house.mesh)
    display = jnp.asarray(frame.image)
    whole = relight(
        to_linear(display),
        caster.gbuffer(frame.camera),
        setup.lights,
        display,
        HYJAX,
        shadow_maps=cast_shadow_maps(caster, setup.lights),
        reference_lux=setup.reference_lux,
    )
    assert not painting.draft
    np.testing.assert_allclose(painting.linear, whole.image, rtol=2e-4, atol=2e-5)


def test_the_hour_changes_the_picture_and_a_lamp_lights_it(studio: Studio, plan: Plan) -> None:
    night = dataclasses.replace(plan, hour=1.0, lamps=())
    lit = dataclasses.replace(night, lamps=plan.lamps)
    day, dark, lamp = (studio.paint(p, VIEW).linear for p in (plan, night, lit))
    assert np.abs(day - dark).max() > 0.05 and np.abs(lamp - dark).max() > 0.05


@pytest.fixture
def cast(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What shadow maps are cast of: a part of the room, and lights."""
    found: list[Any] = []

    def counted(caster: Any, lights: Any, scale: float = 1.0) -> Any:
        found.append((caster, lights))
        return cast_shadow_maps(caster, lights, scale)

    monkeypatch.setattr(studio_module, "cast_shadow_maps", counted)
    return found


def test_nothing_is_cast_twice(studio: Studio, plan: Plan, cast: list[Any]) -> None:
    studio.paint(plan, VIEW)
    cast.clear()
    dimmer = dataclasses.replace(plan.lamps[0], lumen=100.0, kelvin=5000.0)
    studio.paint(dataclasses.replace(plan, lamps=(dimmer,), weather="clear", exposure=1.0), VIEW)
    assert cast == [], "brightness, colour and exposure cast no shadow"
    elsewhere = dataclasses.replace(dimmer, position=(0.0, 0.0, 1.0))
    studio.paint(dataclasses.replace(plan, lamps=(elsewhere,)), VIEW)
    assert len(cast) == 1, "only of the lamp that moved"


def test_a_picture_nobody_waits_for_is_given_up_and_what_was_cast_is_kept(
    studio: Studio, plan: Plan, cast: list[Any]
) -> None:
    lamps = tuple(dataclasses.replace(plan.lamps[0], position=(0.1 * k, 0.2, 1.3)) for k in range(3))
    crowded = dataclasses.replace(plan, windows=(), lamps=lamps)
    with pytest.raises(Unwanted):
        studio.paint(crowded, VIEW, unwanted=lambda: len(cast) == 2)
    studio.paint(crowded, VIEW)
    assert len([light for _, lights in cast for light in lights if isinstance(light, PointLight)]) == 4, "one anew"


def test_what_was_warmed_up_is_not_compiled_again(plan: Plan) -> None:
    class Small(BoxCapture):
        def __getitem__(self, index: int) -> Any:
            return fit(super().__getitem__(index), (24, 32))

    compiled: list[str] = []

    def heard(event: str, _: float, **__: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    studio = Studio(Small(), box_room())
    jax.monitoring.register_event_duration_secs_listener(heard)
    try:
        dark = dataclasses.replace(plan, windows=(), lamps=())
        steps = list(studio.warm_up(dark, VIEW))
        assert len(steps) > 5 and compiled
        compiled.clear()
        for lamps in ((), plan.lamps, 2 * plan.lamps):
            for draft in (True, False):
                studio.paint(dataclasses.replace(dark, lamps=lamps), VIEW, draft=draft)
        assert not compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(heard)


def test_a_draft_is_coarse_where_something_moved_and_says_so(studio: Studio, plan: Plan) -> None:
    fine = studio.paint(plan, VIEW)
    assert not studio.paint(plan, VIEW, draft=True).draft, "what is there already is taken"
    lamp = dataclasses.replace(plan.lamps[0], position=(0.3, 0.3, 1.4))
    draft = studio.paint(dataclasses.replace(plan, lamps=(lamp,)), VIEW, draft=True)
    fine = studio.paint(dataclasses.replace(plan, lamps=(lamp,)), VIEW)
    assert draft.draft and not fine.draft
    assert np.abs(draft.linear - fine.linear).mean() < 0.02


@pytest.mark.parametrize("shown", ["photo", "raw filter", "refined filter", "visibility", "conductances", "holes"])
def test_every_stage_can_be_looked_at(studio: Studio, plan: Plan, shown: Any) -> None:
    picture = studio.paint(plan, View(1, shown, HYJAX)).picture
    assert picture.shape == (48, 64, 3) and picture.dtype == np.uint8
    assert len(np.unique(picture)) > (0 if shown in ("holes", "visibility") else 5)


# ---- furniture ----


def test_floor_ceiling_and_walls_are_no_furniture() -> None:
    mesh = box_room()
    found = shell(mesh, UP)
    centres, corners = mesh.triangles_center, mesh.bounds
    on_wall = (np.abs(centres - corners[0]).min(axis=1) < 1e-6) | (np.abs(centres - corners[1]).min(axis=1) < 1e-6)
    assert found[on_wall].all()
    assert not found[np.abs(centres[:, 2] - 0.7) < 1e-6].any(), "the top of the cube is not"
    assert piece_at(mesh, np.array([0.0, 0.0, 0.0]), UP) is None


@pytest.mark.parametrize("missing", [[0, 0, 1], [1, 0, 0], [0, -1, 0]])
def test_a_side_that_was_not_scanned_makes_no_shell_of_what_stands_there(missing: list[int]) -> None:
    """As with phones, which are seldom pointed at the ceiling."""
    mesh = box_room()
    side = np.asarray(missing)
    open_side = np.abs(mesh.triangles_center @ side - (mesh.bounds @ side).max()) < 1e-6
    mesh.update_faces(~open_side)
    found = piece_at(mesh, TOP, UP)
    assert found is not None and mesh.area_faces[found].sum() > 0.49 + 4 * 0.7 * 0.4
    assert np.abs(mesh.triangles_center[found] - CUBE).max() < 0.36
    assert shell(mesh, UP)[np.abs(mesh.triangles_center[:, 2]) < 1e-6].all(), "the floor is"


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_click_finds_the_whole_piece_and_nothing_else(turn: float) -> None:
    mesh = box_room()
    pose = trimesh.transformations.rotation_matrix(turn, UP)
    mesh.apply_transform(pose)
    faces = piece_at(mesh, trimesh.transform_points(TOP[None], pose)[0], UP)
    assert faces is not None
    found = trimesh.transform_points(mesh.triangles_center[faces], np.linalg.inv(pose)) - CUBE
    assert np.abs(found).max() < 0.36, "nothing else"
    high = found[:, 2] > -0.25
    assert mesh.area_faces[faces][high].sum() > 0.49 + 4 * 0.7 * 0.4, "all of it but its foot on the floor"


def test_a_moved_part_is_cast_where_it_is() -> None:
    """Against a caster of the moved mesh."""
    mesh = box_room()
    faces = piece_at(mesh, TOP, UP)
    assert faces is not None
    piece, rest = submesh(mesh, faces), submesh(mesh, ~faces)
    pose = np.asarray(moved((0.4, -0.8, 0.1), 30.0)).reshape(4, 4)
    whole = trimesh.util.concatenate([rest, piece.copy().apply_transform(pose)])
    camera = Camera(Intrinsics(80, 60, 50.0, 50.0, 40.0, 30.0), look_at(np.array([-1.5, -2.2, 1.6]), CUBE, UP))
    parts = [Part(RayCaster(rest), np.eye(4), mesh), Part(RayCaster(piece), pose, mesh)]
    found = nearest([part.gbuffer(camera) for part in parts])
    expected = RayCaster(trimesh.Trimesh(whole.vertices, whole.faces, process=False)).gbuffer(camera)
    same = np.isclose(found.depth, expected.depth, atol=1e-4)
    assert same.mean() > 0.995, "but for rays along silhouettes"
    np.testing.assert_allclose(np.asarray(found.position)[same], np.asarray(expected.position)[same], atol=1e-3)


def test_shadows_follow_a_piece_that_moves(studio: Studio, plan: Plan) -> None:
    """As if the moved mesh had been scanned so."""
    lamp = place_lamp("spot", np.array([1.0, 0.0, 2.4]), -UP)
    at_night = dataclasses.replace(plan, hour=1.0, windows=(), lamps=(lamp,))
    piece = seed_of(studio, at_night)
    there = dataclasses.replace(at_night, pieces=(dataclasses.replace(piece, pose=moved((0.0, -1.0, 0.0), 20.0)),))
    found = studio.paint(there, VIEW).linear
    expected = Studio(BoxCapture(), studio.house.arranged_mesh(there)).paint(at_night, VIEW).linear
    still = studio.paint(at_night, VIEW).linear
    assert np.abs(found - still).mean() > 5 * np.abs(found - expected).mean()


def test_only_what_moved_is_cast_again(studio: Studio, plan: Plan, cast: list[Any]) -> None:
    piece = seed_of(studio, plan)
    studio.paint(dataclasses.replace(plan, pieces=(piece,)), VIEW)
    cast.clear()
    pushed = dataclasses.replace(piece, pose=moved((0.1, 0.0, 0.0)))
    studio.paint(dataclasses.replace(plan, pieces=(pushed,)), VIEW)
    assert cast and {len(patient.part.caster.mesh.faces) for patient, _ in cast} == {
        len(studio.house.piece_mesh(piece).faces)
    }  # type: ignore[union-attr]


def test_a_removed_piece_is_gone_and_put_back_all_is_as_before(studio: Studio, plan: Plan) -> None:
    piece = seed_of(studio, plan)
    gone = dataclasses.replace(plan, pieces=(dataclasses.replace(piece, removed=True),))
    touch = studio.house.touch(gone, (0.5, 0.4, 2.0), (0.0, 0.0, -1.0))
    assert touch is None or touch.point[2] < 0.1
    put_back = dataclasses.replace(plan, pieces=(piece,))
    before, back = (studio.paint(p, VIEW).linear for p in (plan, put_back))
    assert np.abs(before - back).max() < 0.05 * before.max()


def test_a_click_on_a_moved_piece_tells_which_and_where_it_came_from(studio: Studio, plan: Plan) -> None:
    piece = dataclasses.replace(seed_of(studio, plan), pose=moved((0.0, -1.0, 0.0)))
    touch = studio.house.touch(dataclasses.replace(plan, pieces=(piece,)), (0.5, -0.6, 2.0), (0.0, 0.0, -1.0))
    assert touch is not None and touch.piece == 0
    np.testing.assert_allclose(touch.origin, (0.5, 0.4, 0.7), atol=1e-5)


def test_memory_stays_within_its_bounds() -> None:
    kept = Kept(1.0)
    for number in range(100):
        kept(number, lambda: np.zeros(2**17, np.uint8))
    assert 99 in kept and 92 in kept and 91 not in kept
    assert kept._size <= 1.0


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


def test_the_first_plan_has_the_rooms_windows(room: RoomCapture) -> None:
    studio = Studio(room, room.mesh)
    plan = studio.first_plan()
    assert len(plan.windows) == sum(name.startswith("window") for name in room.anchors)
    assert plan.sky().direct > 1000
    assert any(entry["kind"] == "directional" for entry in lights_file(plan, room.up, studio.surface)["lights"])
