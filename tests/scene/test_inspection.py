"""What is told of a capture: by `hyjax info PATH`."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax import cli
from hyjax.data.capture import Capture, Frame
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.scene.inspection import Inspection, inspect, relight_command
from hyjax.scene.inspection_picture import write_inspection
from hyjax.util.errors import InputError
from hyjax.util.images import picture_shape

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)


class Walk(Capture):
    """A walk past a wall two metres away, ten frames a second, ten centimetres each."""

    name, up, fingerprint, sensor, format = "walk", UP, "", PHONE_LIDAR, "made up"

    def __init__(
        self,
        wall: trimesh.Trimesh | None = None,
        depth: bool = True,
        step: float = 0.1,
        *,
        unit: float = 1.0,
        lens: Intrinsics = LENS,
        up: np.ndarray = UP,
    ) -> None:
        self._wall, self._depth, self._step, self._unit, self._lens, self.up = wall, depth, step, unit, lens, up
        self.mesh_file = None if wall is None else Path("wall.ply")

    def mesh(self) -> trimesh.Trimesh | None:
        return self._wall

    def __len__(self) -> int:
        return 6

    def camera(self, index: int) -> Camera:
        eye = np.array([0.0, self._step * index, 0.0])
        return Camera(self._lens, look_at(eye, eye + np.eye(3)[0], UP))

    def __getitem__(self, index: int) -> Frame:
        if not 0 <= index < 6:
            raise IndexError
        depth = np.full(LENS.shape, 2.0 * self._unit, np.float32) if self._depth else None
        if depth is not None:
            depth[:12] = 0
        picture = np.full((*LENS.shape, 3), 0.5, np.float32)
        return Frame(f"{index}", picture, self.camera(index), index / 10, depth, exposure=0.01 + 0.001 * index)


def wall(distance: float = 2.0, scale: float = 1.0) -> trimesh.Trimesh:
    corners = np.array([[distance, -9, -9], [distance, 9, -9], [distance, 9, 9], [distance, -9, 9]]) * scale
    return trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)


def told(inspection: Inspection) -> str:
    return "\n".join(f"{name}: {value}" for name, value in inspection.lines())


def test_what_a_capture_holds() -> None:
    found = inspect(Walk(wall(2.01)), progress=False)
    assert found.path_length == pytest.approx(0.5) and not found.doubts
    text = told(found)
    for part in (
        "format: made up",
        "frames: 6, 10 a second over 0.5 s",
        "pictures: 64x48",
        "exposure: 10 to 15 ms",
        "camera path: 0.5 m within x 0.00 to 0.00, y 0.00 to 0.50, z 0.00 to 0.00 m",
        "surface: x 2.00 to 2.00, y -",
        "6 maps of 64x48 (phone LiDAR), 75 % of the pixels, 2 to 2 m, median 2 m",
        "mesh: 2 triangles",
        "mesh to depth: 0.01 m (median); the mesh has 100 % of the depth readings",
    ):
        assert part in text


def test_times_that_were_not_recorded_are_not_told() -> None:
    walk = Walk(wall(2.01))
    walk.times_known = False
    found = inspect(walk, progress=False)
    assert "frames: 6\n" in told(found) and found.shown[0].title == "0"


@pytest.mark.parametrize(
    ("capture", "doubt"),
    [
        (Walk(wall(2.4)), r"mesh and depth lie 0\.4 m apart"),
        (Walk(wall(-5.0)), "the mesh is met by 0 % of the depth readings; same axes and units"),
        (Walk(wall(2.0, scale=1000.0)), r"spans 1\.8e\+04 m; is it in metres"),
        (Walk(wall(), step=2.0), "the camera jumps by 2 m"),
        (Walk(step=0.001), "the camera hardly moves"),
        (Walk(depth=False), "neither depth nor a mesh; give one with --mesh FILE"),
        (Walk(unit=1000.0), "the median depth is 2e\\+03 m; is the unit of the depth maps right"),
        (Walk(unit=0.001), r"the median depth is 0\.002 m; is the unit of the depth maps right"),
        (
            Walk(lens=Intrinsics(64, 48, 50.0, 50.0, 64.0, 48.0)),
            r"principal point lies at \(64, 48\) in pictures of 64x48",
        ),
        (Walk(up=-UP), "the pictures are upside down, or up points down"),
    ],
)
def test_what_is_doubtful(capture: Walk, doubt: str) -> None:
    found = inspect(capture, progress=False)
    assert any(re.search(doubt, line) for line in found.doubts), found.doubts
    assert "doubtful: " in told(found)


def test_the_command_to_relight_it() -> None:
    assert relight_command(Path("my scan"), Walk()) == "hyjax relight --capture 'my scan'"
    quick = relight_command(Path("MY SCAN"), Walk(), quick=True)
    assert quick == "hyjax relight --capture 'MY SCAN' --frames 0,2,3,5"
    bare = Walk(depth=False)
    bare.metric = False
    command = relight_command(Path("x"), bare)
    assert "--scale METRES_IN_ONE_UNIT" in command and "--mesh FILE" in command
    assert "--scale 0.5" in relight_command(Path("x"), bare, scale=0.5)


@pytest.mark.parametrize("capture", [Walk(), Walk(wall(), depth=False), Walk(depth=False)])
def test_the_picture(capture: Walk, tmp_path: Path) -> None:
    write_inspection(tmp_path / "info.png", inspect(capture, progress=False))
    height, width = picture_shape(tmp_path / "info.png")
    assert height > 300 and width > 900


def test_the_command_tells_of_a_real_scan(
    scanner3d_chair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["hyjax", "info", str(scanner3d_chair), "--quiet"])
    cli.main()
    out, err = capsys.readouterr()
    assert "3D Scanner App" in out and "70 maps of 256x192 (phone LiDAR)" in out and "46 poses" in out
    assert f"hyjax relight --capture {scanner3d_chair} --frames 0,8,15,23 --size 640x480\n" in out and not err
    assert (tmp_path / "out" / "scanner3d_chair-info.png").is_file()
    for wrong in ([str(tmp_path / "none")], [str(scanner3d_chair), "--out", "info"]):
        monkeypatch.setattr("sys.argv", ["hyjax", "info", *wrong])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 2 and capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "info").exists()


def test_places_and_dates_reach_no_output(
    scanner3d_chair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The real scan's had been taken out; they are put in again, where the app has them."""
    folder = tmp_path / "scan"
    folder.mkdir()
    for number in (0, 3):
        for name in (f"frame_{number:05d}.jpg", f"depth_{number:05d}.png", f"conf_{number:05d}.png"):
            (folder / name).symlink_to(scanner3d_chair / name)
        content = json.loads((scanner3d_chair / f"frame_{number:05d}.json").read_text())
        content |= {"latitude": 48.858370, "longitude": 2.294481, "date": "2024-05-06T07:08:09"}
        (folder / f"frame_{number:05d}.json").write_text(json.dumps(content))
    (folder / "info.json").write_text(json.dumps({"latitude": 48.858370, "title": "2024-05-06"}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "sys.argv", ["hyjax", "convert", str(folder), "--to", "nerfstudio", "--out", "out", "--quiet"]
    )
    cli.main()
    monkeypatch.setattr("sys.argv", ["hyjax", "info", str(folder), "--quiet"])
    cli.main()
    written = b"".join(file.read_bytes() for file in (tmp_path / "out").rglob("*") if file.is_file())
    written += (tmp_path / "out" / "scan-info.png").read_bytes() + "".join(capsys.readouterr()).encode()
    frames = "".join(f"{frame.name} {frame.time}" for frame in open_capture(folder))
    for secret in (b"48.858", b"2.2944", b"2024-05", b"402896"):
        assert secret not in written and secret not in frames.encode()


def test_nothing_to_read_is_refused() -> None:
    class Broken(Walk):
        def __getitem__(self, index: int) -> Frame:
            raise InputError("0.jpg: damaged")

    with pytest.raises(InputError, match=r"none of the frames can be read; the first: 0\.jpg: damaged"):
        inspect(Broken(), progress=False)
