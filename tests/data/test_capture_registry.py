"""Formats of captures. One from outside the package is found by its files and relit like those of the package."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import hyjax
from hyjax.core.schedule import Schedule
from hyjax.data import registry
from hyjax.data.builtin_room import RoomCapture
from hyjax.data.capture import Capture, CaptureFormat, ChosenFrames, Frame
from hyjax.data.registry import known_formats, open_capture, register_format
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.mesh import save_mesh
from hyjax.scene.light_places import survey_capture
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.scene.surfaces import rough_mesh
from hyjax.util.errors import InputError
from hyjax.util.images import read_image, write_png

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(48, 36, 30.0, 30.0, 24.0, 18.0)


class Album(Capture):
    """PNG pictures of which `album.json` has the cameras' places; each camera looks at the origin."""

    up = UP

    def __init__(self, folder: Path) -> None:
        self.name, self._folder = folder.name, folder
        self._eyes = json.loads((folder / "album.json").read_text())
        mesh = folder / "room.ply"
        self.mesh_file = mesh if mesh.is_file() else None
        self.anchors = {"lamp_0": {"position": [0.0, 0.0, 1.0]}}

    @property
    def fingerprint(self) -> str:
        return (self._folder / "album.json").read_text()

    def __len__(self) -> int:
        return len(self._eyes)

    def __getitem__(self, index: int) -> Frame:
        pose = look_at(np.array(self._eyes[index]), np.zeros(3), UP)
        return Frame(f"{index}", read_image(self._folder / f"{index}.png"), Camera(LENS, pose), float(index))


ALBUM = CaptureFormat(
    "Album", lambda tree: "album.json" in tree, lambda tree: Album(tree.folder), "album.json, 0.png"
)


@pytest.fixture
def album(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two pictures in a room of 4 m; the format is registered for this test alone."""
    monkeypatch.setattr(registry, "CAPTURE_FORMATS", [*registry.CAPTURE_FORMATS])
    register_format(ALBUM)
    folder = tmp_path / "album"
    folder.mkdir()
    (folder / "album.json").write_text("[[1.5, 0.3, 0.2], [1.4, -0.4, 0.3]]")
    rng = np.random.default_rng(0)
    for index in range(2):
        write_png(folder / f"{index}.png", rng.uniform(0.3, 0.7, (*LENS.shape, 3)))
    room = trimesh.creation.box((4, 4, 3)).subdivide()
    room.invert()
    save_mesh(folder / "room.ply", room)
    return folder


def test_a_format_from_outside_is_relit(album: Path) -> None:
    capture = open_capture(album)
    assert isinstance(capture, Album) and len(list(capture)) == 2
    assert rough_mesh(capture) == "captured"
    scene = Scene.open(SceneSettings(capture=album))
    assert scene.source == "captured mesh room.ply" and len(scene) == 2
    view, setup = scene.view(0), scene.lights("evening-lamps")
    np.testing.assert_allclose(survey_capture(scene.caster, capture).lamps, [[0.0, 0.0, 1.0]])
    relit = hyjax.relight(view, scene.shade(view, setup, shadows=False), view.display, Schedule.preset("naive-50"))
    after = np.asarray(hyjax.to_display(relit.image))
    assert after.shape == view.display.shape and np.isfinite(after).all()
    assert np.abs(after - np.asarray(view.display)).mean() > 0.05


def test_defaults_of_a_capture(album: Path) -> None:
    (album / "room.ply").unlink()
    capture = open_capture(album)
    assert capture.mesh() is None and capture.reference() is None and capture.laser_folder is None
    assert capture.scan_input() == (capture, None) and rough_mesh(capture) == "scan"
    assert not ChosenFrames(capture, [0]).anchors


def test_the_new_format_stands_in_the_messages(album: Path, tmp_path: Path) -> None:
    assert "Album (album.json, 0.png)" in known_formats() and "7-Scenes" in known_formats()
    (album / "album.json").unlink()
    with pytest.raises(
        InputError, match=r"not a known capture layout; pictures alone .*7-Scenes.*ARKitScenes.*Album"
    ):
        open_capture(album)
    with pytest.raises(InputError, match="'Album' is registered already"):
        register_format(ALBUM)


def test_without_a_folder_the_built_in_room_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    from hyjax.data import builtin_room

    small = builtin_room.load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)
    monkeypatch.setattr(builtin_room, "load_room", lambda **_: small)
    room = open_capture(progress=False)
    assert isinstance(room, RoomCapture) and room.reference() is not None and room.mesh() is None
    depths, scanner = room.scan_input()
    assert scanner is not None and len(depths) == scanner.frames


def test_a_phones_depth_is_known_by_its_size(album: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Layouts such as nerfstudio's name no sensor."""
    for shape, sensor in (((192, 256), "phone LiDAR"), ((256, 192), "phone LiDAR"), ((480, 640), "depth camera")):
        reading = DepthReading(np.ones(shape, np.float32), Camera(LENS, np.eye(4)))
        monkeypatch.setattr(Album, "depth_count", 1)
        monkeypatch.setattr(Album, "depth_reading", lambda self, index, reading=reading: reading)
        assert open_capture(album).sensor.name == sensor
