"""Windows and lamps that lit the photographs: given, hinted at, and found."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.geometry.raycast import RayCaster
from hyjax.photo_light import source_search
from hyjax.photo_light.hints import hinted_sources, is_lit, shows_light
from hyjax.photo_light.source_search import find_photo_sources, search_sources
from hyjax.photo_light.sources import LAMP_RADIUS, PhotoSources, PhotoWindow, read_sources, source_entries
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError

WINDOW = "{center: [0.0, 2.95, 1.52], normal: [1, 0, 0], width: 2.4, height: 1.4}"


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=24, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def scene(room: RoomCapture) -> Scene:
    return Scene(room, room.reference())


def find(scene: Scene, **options: Any) -> PhotoSources:
    return find_photo_sources(scene.capture, scene.caster, [scene.frame(i) for i in range(0, 24, 4)], **options)


def given(scene: Scene, tmp_path: Path, text: str) -> PhotoSources:
    file = tmp_path / "sources.yaml"
    file.write_text(text)
    return find(scene, file=file)


def test_the_window_is_found_without_hints(room: RoomCapture, scene: Scene) -> None:
    windows, _ = search_sources(scene.caster, list(room), room.up)
    truth = room.anchors["window_0"]
    assert len(windows) == 1
    assert np.linalg.norm(windows[0].center - truth["center"]) < 0.15
    assert 2 * np.linalg.norm(windows[0].right) == pytest.approx(truth["width"], abs=0.25)
    assert 2 * np.linalg.norm(windows[0].up) == pytest.approx(truth["height"], abs=0.25)
    np.testing.assert_allclose(windows[0].normal, truth["normal"], atol=0.05)
    np.testing.assert_allclose(np.cross(windows[0].right, windows[0].up) @ windows[0].normal > 0, True)


def rectangles(
    hole: np.ndarray,
    burnt: np.ndarray,
    wall: np.ndarray,
    frames: int | np.ndarray = 3,
    *,
    agreement: float = 1.0,
    value: float = 0.5,
) -> list:
    seen = np.broadcast_to(np.asarray(frames), hole.shape)
    agreements, brightness = np.where(burnt, agreement, 0.0), np.full(hole.shape, value)
    return source_search._rectangles(source_search._Cells(hole, hole, burnt, wall, seen, agreements, brightness))


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({}, 1),
        ({"frames": 10, "agreement": 0.5}, 1),
        ({"frames": 10, "agreement": 0.3}, 0),  # a lamp before the hole burns another cell in each frame
        ({"value": 0.84}, 1),
        ({"value": 0.9}, 0),  # the glow of a lamp
        ({"frames": 1}, 0),
    ],
)
def test_a_window_is_burnt_out_in_many_frames_and_ends_sharply(changed: dict[str, Any], found: int) -> None:
    hole = np.zeros((60, 60), bool)
    hole[20:45, 10:40] = True
    assert len(rectangles(hole, hole, ~hole, **changed)) == found


@pytest.mark.parametrize(("side", "found"), [(7, 0), (8, 1)])
def test_what_is_burnt_out_of_a_window_has_some_area(side: int, found: int) -> None:
    """0.15 square metres, in cells of 5 cm; less is a lamp."""
    hole = np.zeros((60, 60), bool)
    hole[20:30, 10:20] = True
    burnt = np.zeros_like(hole)
    burnt[20 : 20 + side, 10 : 10 + side] = True
    assert len(rectangles(hole, burnt, ~hole)) == found


@pytest.mark.parametrize("scanned", [True, False])
def test_a_window_has_some_wall_around(scanned: bool) -> None:
    """Or it is sunlit ground behind an open place."""
    hole = np.zeros((60, 60), bool)
    hole[20:45, 10:40] = True
    wall = ~hole & scanned & (np.arange(60)[:, None] < 30)
    assert rectangles(hole, hole, wall) == [(20, 44, 10, 39)] * scanned


def test_a_window_is_what_is_burnt_out_of_a_larger_hole() -> None:
    """Its hole runs into what was not scanned above it."""
    hole = np.zeros((80, 60), bool)
    hole[20:45, 10:40] = True
    wall, burnt = ~hole, hole.copy()
    hole[:, 36:] = True
    grown = source_search.MOST_GROWN
    assert rectangles(hole, burnt, wall & ~hole) == [(20, 44, 10, 39 + grown)], "a little more than is burnt out"
    burnt[:, 10:25] = False  # a dark garden below the sky
    wall[:, 36:] = True
    assert rectangles(hole & ~wall, burnt, wall) == [(20, 44, 10, 35)]


def test_of_a_hole_and_what_is_burnt_out_of_it_one_is_left() -> None:
    """Though the hole was seen in too few frames."""
    hole = np.zeros((80, 60), bool)
    hole[20:45, 10:50] = True
    burnt = np.zeros_like(hole)
    burnt[20:45, 10:30] = True
    frames = np.where(burnt, 2, 0)
    assert rectangles(hole, burnt, ~hole, frames) == [(20, 44, 10, 29 + source_search.MOST_GROWN)]


@pytest.mark.parametrize("gap", [4, 9])
def test_neighbouring_windows_stay_two(gap: int) -> None:
    """With a dark frame between them that was not scanned."""
    hole = np.zeros((90, 120), bool)
    burnt = np.zeros_like(hole)
    burnt[10:40, 15:40] = burnt[40 + gap : 70 + gap, 15:40] = True
    hole[10 : 70 + gap, 15:40] = hole[20 : 60 + gap, 40:] = True  # it runs on upwards
    found = sorted(rectangles(hole, burnt, ~hole))
    assert len(found) == 2 and found[0][0] == 10 and found[1][1] == 69 + gap
    assert found[0][1] < 40 + gap <= found[1][0] + source_search.MOST_GROWN


def test_hints_come_before_the_search_and_dark_lamps_are_left_out(scene: Scene) -> None:
    sources = find(scene)
    assert sources.origin == "capture" and [w.name for w in sources.windows] == ["window-1"]
    assert not sources.lamps  # the room was photographed by day


@pytest.mark.parametrize(("radius", "lit"), [(0.1, True), (LAMP_RADIUS, True), (0.0, False)])
def test_a_hinted_lamp_counts_where_it_is_burnt_out(
    radius: float, lit: bool, room: RoomCapture, scene: Scene
) -> None:
    """A bulb is enough; a single bright pixel is not."""
    position = np.asarray(room.anchors["lamp_1"]["position"], float)
    frames = [room[i] for i in range(len(room))]
    assert not is_lit(position, scene.caster, frames)
    for frame in frames:
        (x, y), depth = frame.camera.project(position)
        if depth > 0.2:
            reach = radius * frame.camera.intrinsics.fx / depth
            (left, right), (top, bottom) = ((max(int(v - reach), 0), max(int(v + reach) + 1, 0)) for v in (x, y))
            frame.image[top:bottom, left:right] = 1.0
    assert is_lit(position, scene.caster, frames) == lit


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_black_or_burnt_out_frames_say_nothing(value: float, room: RoomCapture, scene: Scene) -> None:
    frames = [room[i] for i in range(0, 24, 6)]
    for frame in frames:
        frame.image[:] = value
    assert search_sources(scene.caster, frames, room.up) == ((), ())


def test_a_file_is_taken_as_it_is(scene: Scene, tmp_path: Path) -> None:
    sources = given(scene, tmp_path, f"windows: [{WINDOW}]\nlamps: [{{position: [1.4, 1.6, 1.5], name: pendant}}]")
    assert sources.origin == "file" and sources.windows[0].name == "window-1" and sources.lamps[0].name == "pendant"
    np.testing.assert_allclose(sources.windows[0].corners.mean(axis=0), [0.0, 2.95, 1.52], atol=1e-6)
    assert np.ptp(sources.windows[0].corners[:, 1]) == pytest.approx(2.4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("windows: [", "neither YAML nor JSON"),
        ("- 1", "must be a mapping"),
        ("{}", "names no window"),
        ("window: []", "did you mean 'windows'"),
        ("lights: []", "has new lights, which --lights takes"),
        ("windows: 3", "'windows' must be a list"),
        (f"windows: [{WINDOW.replace('width', 'widht')}]", "did you mean 'width'"),
        (f"windows: [{WINDOW.replace(', height: 1.4', '')}]", "'height' is missing"),
        (f"windows: [{WINDOW.replace('2.4', '-2.4')}]", "'width' must be a number of metres > 0"),
        (f"windows: [{WINDOW.replace('2.4', '.nan')}]", "'width'"),
        (f"windows: [{WINDOW.replace('2.95', '.inf')}]", "'center' must be three finite numbers"),
        (
            f"windows: [{WINDOW.replace('[1, 0, 0]', '[0, 0, 0]')}]",
            "window 0: 'normal' must not be the zero vector",
        ),
        (f"windows: [{WINDOW.replace('[1, 0, 0]', '[-1, 0, 0]')}]", "looks away from the cameras"),
        (f"windows: [{WINDOW.replace('[0.0, 2.95', '[-9.0, 2.95')}]", "off the scan's walls"),
        (f"windows: [{WINDOW}, {{name: window-1, {WINDOW[1:]}]", "given twice"),
        (f"windows: [{{name: ceiling, {WINDOW[1:]}]", "'ceiling' is that of what was not scanned"),
        ("lamps: [{position: [99, 0, 0]}]", "outside the scan and its cameras, from"),
        ("lamps: [{position: [1, 1, 1], radius: 1.5}]", "'radius' must be a number of metres > 0, at most 1"),
        ("lamps: [{position: [1, 1]}]", "'position' must be three finite numbers"),
    ],
)
def test_bad_files_are_refused_in_one_line(text: str, said: str, scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sources\.yaml") as caught:
        given(scene, tmp_path, text)
    assert said in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no such file"):
        find(scene, file=tmp_path / "none.yaml")


def test_a_normal_is_checked_before_a_scan_is_loaded(tmp_path: Path) -> None:
    file = tmp_path / "sources.yaml"
    file.write_text(f"windows: [{WINDOW.replace('[1, 0, 0]', '[0, 0, 0]')}]")
    with pytest.raises(InputError, match="zero vector"):
        source_entries(file)


def test_a_lamp_may_hang_where_the_cameras_stood(tmp_path: Path) -> None:
    """Above an open place nothing is scanned."""
    ground = RayCaster(trimesh.creation.box(bounds=[[-2, -2, -0.1], [2, 2, 0.0]]))
    file = tmp_path / "sources.yaml"
    file.write_text("lamps: [{position: [0, 0, 1.5]}]")
    up, eyes = np.array([0.0, 0.0, 1.0]), np.array([[0.0, -1.0, 1.6], [1.0, 0.0, 1.4]])
    assert len(read_sources(file, up, ground, eyes).lamps) == 1
    with pytest.raises(InputError, match="outside the scan and its cameras"):
        read_sources(file, up, ground, eyes - [0.0, 0.0, 1.0])


def test_a_window_of_a_file_on_a_plain_wall_is_doubted(
    scene: Scene, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given(scene, tmp_path, f"windows: [{WINDOW}]")
    assert not caplog.records
    beside = "{center: [0.0, 0.75, 1.52], normal: [1, 0, 0], width: 0.8, height: 0.8}"
    given(scene, tmp_path, f"windows: [{beside}]")
    assert "sources.yaml: window-1 is neither open nor burnt out in any picture" in caplog.text


def test_a_capture_without_hints_has_none(room: RoomCapture) -> None:
    assert hinted_sources({}, room.up, RayCaster(room.reference()), []).origin == "none"


def test_a_hinted_window_on_a_plain_wall_is_doubted(room: RoomCapture, scene: Scene) -> None:
    frames = [room[i] for i in range(0, 24, 3)]
    true = room.anchors["window_0"]
    size = float(true["width"]), float(true["height"])
    window = PhotoWindow.facing("true", np.asarray(true["center"]), np.asarray(true["normal"]), room.up, *size)
    assert shows_light(window, scene.caster, frames)
    beside = np.asarray(true["center"], float) - [0.0, 2.2, 0.0]
    wrong = PhotoWindow.facing("wrong", beside, np.asarray(true["normal"]), room.up, 0.8, 0.8)
    assert shows_light(wrong, scene.caster, frames) is False
    assert shows_light(wrong, scene.caster, []) is None
