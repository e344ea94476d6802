"""Meshes that the package makes itself: kept, keyed by what they are made of, made again when damaged."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from reference.listed_frames import ListedFrames

from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.data.capture import Frame
from hyjax.data.registry import open_capture
from hyjax.geometry import scan
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.mesh import save_mesh
from hyjax.scene import fusion
from hyjax.scene.fusion import FusionPlan
from hyjax.scene.fusion_settings import MAX_FUSED_FRAMES, FusionSettings
from hyjax.scene.surfaces import LARGEST_ERROR, SURFACE_ERROR, surface_arrays, surface_of
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

UP = np.array([0.0, 0.0, 1.0])
Made = list[str]


class Wall(ListedFrames):
    """A capture of a flat wall at 2 m, with or without depth."""

    name = "wall"

    def __init__(self, count: int = 3, depth: bool = True, fingerprint: str = "a") -> None:
        pose = look_at(np.zeros(3), np.array([2.0, 0, 0]), UP)
        intrinsics = Intrinsics(40, 30, 40.0, 40.0, 20.0, 15.0)
        image = np.full((30, 40, 3), 0.5, np.float32)
        plane = np.full((30, 40), 2.0, np.float32) if depth else None
        frames = [Frame(f"{i}", image, Camera(intrinsics, pose), float(i), plane) for i in range(count)]
        super().__init__(frames, UP)
        self.fingerprint = fingerprint


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """What was really made, in order; making is a stub so that it is quick."""
    calls: Made = []

    def stub(kind: str, *arguments: object) -> trimesh.Trimesh:
        calls.append(kind)
        if kind == "fuse":
            plan = arguments[1]
            assert isinstance(plan, FusionPlan)
            calls[-1] = f"fuse {len(plan.indices)} at {plan.voxel}"
        return trimesh.creation.icosphere(1, radius=1.0 + 0.1 * len(calls))

    monkeypatch.setattr(fusion, "fuse_capture", lambda *a, **_: stub("fuse", *a))
    monkeypatch.setattr(scan, "simulate_scan", lambda *a, **_: stub(f"scan {a[2]}", *a))
    return calls


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)


def same(a: trimesh.Trimesh, b: trimesh.Trimesh) -> bool:
    return a.vertices.shape == b.vertices.shape and bool(np.array_equal(a.vertices, b.vertices))


def get(capture: object, mesh: str | None = None, **options: object) -> trimesh.Trimesh:
    return surface_of(capture, mesh, progress=False, **options)[1]  # type: ignore[arg-type]


def test_made_once_and_read_after_that(cache: Path, made: Made) -> None:
    first, second = get(Wall()), get(Wall())
    assert made == ["fuse 3 at 0.03"] and same(first, second)
    (file,) = [entry for entry in cache.iterdir() if entry.is_file()]
    assert file.suffix == ".npz" and not file.name.startswith(".")


def test_the_key_holds_all_that_the_surface_depends_on(cache: Path, made: Made) -> None:
    for number, call in enumerate(
        [
            lambda: get(Wall()),
            lambda: get(Wall(), fusion=FusionSettings(voxel=0.05)),
            lambda: get(Wall(), "scan"),
            lambda: get(Wall(), "scan", seed=1),
            lambda: get(Wall(fingerprint="b")),
        ],
        start=1,
    ):
        call(), call()
        assert len(made) == number
    assert len(list(cache.iterdir())) == len(made)


def test_the_fingerprint_follows_the_files_of_a_capture(tmp_path: Path) -> None:
    stem = tmp_path / "frame-000000"
    write_png(tmp_path / "frame-000000.color.png", np.full((480, 640, 3), 0.5))
    np.savetxt(tmp_path / "frame-000000.pose.txt", np.eye(4))

    def fingerprint() -> str:
        prints = {open_capture(tmp_path).fingerprint for _ in range(2)}
        assert len(prints) == 1
        return prints.pop()

    seen = [fingerprint()]
    pose = stem.with_suffix(".pose.txt")
    times = (pose.stat().st_atime_ns, pose.stat().st_mtime_ns)
    np.savetxt(pose, np.eye(4) + np.eye(4, k=3), fmt="%.20f")
    os.utime(pose, ns=times)
    seen.append(fingerprint())  # another size, the same time
    os.utime(pose, ns=(times[0], times[1] + 1))
    seen.append(fingerprint())  # the same size, another time
    (tmp_path / "gravity-direction.txt").write_text("0 0 -1")
    seen.append(fingerprint())
    assert len(set(seen)) == 4


def test_the_rooms_fused_surface_follows_its_frames(cache: Path, made: Made, room: RoomCapture) -> None:
    """Fewer frames fuse to another surface, though the true mesh behind them is the same."""
    frames = list(room)
    half = RoomCapture(
        np.stack([np.uint8(frames[0].image * 255)]),
        [frames[0].camera],
        room.reference(),
        room.anchors,
    )
    get(room, "fused"), get(half, "fused")
    assert len(made) == 2


@pytest.mark.parametrize("damage", ["empty", "truncated", "garbage"])
def test_a_damaged_cache_is_made_again_with_a_line(
    cache: Path, made: Made, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    get(Wall())
    (file,) = cache.glob("*.npz")
    content = file.read_bytes()
    file.write_bytes({"empty": b"", "truncated": content[: len(content) // 2], "garbage": b"npz?" * 99}[damage])
    again = get(Wall())
    assert len(made) == 2 and len(again.faces) == 80
    (line,) = (record.getMessage() for record in caplog.records if "made again" in record.getMessage())
    assert file.name in line and "\n" not in line
    assert same(again, get(Wall())) and len(made) == 2


def test_an_unwritable_cache_does_not_stop_the_run(
    tmp_path: Path, made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with the room: what cannot be kept is made again next time."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "file" / "cache"))
    assert len(get(Wall()).faces) == 80


def test_an_interrupted_write_leaves_nothing(cache: Path, made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupt)
        with pytest.raises(KeyboardInterrupt):
            get(Wall())
    assert not list(cache.iterdir())
    get(Wall())
    assert len(made) == 2


def test_long_captures_are_fused_from_a_spread(cache: Path, made: Made) -> None:
    get(Wall(count=2 * MAX_FUSED_FRAMES + 1))
    (call,) = made
    assert 0.5 * MAX_FUSED_FRAMES <= int(call.split()[1]) <= MAX_FUSED_FRAMES


def test_the_default_fits_the_capture(cache: Path, made: Made, room: RoomCapture) -> None:
    assert surface_of(room, progress=False)[0] == "simulated scan, seed 0"
    assert surface_of(Wall(), progress=False)[0] == "fusion of 3 depth maps, voxels of 0.03 m, up to 2.5 m"
    assert made == ["scan 0", "fuse 3 at 0.03"]


def test_the_true_mesh_is_the_rooms_alone(cache: Path, room: RoomCapture) -> None:
    what, mesh = surface_of(room, "true", progress=False)
    assert what == "true mesh" and mesh is room.reference()
    with pytest.raises(InputError, match="this capture has no true mesh"):
        get(Wall(), "true")
    assert not cache.exists()


@pytest.mark.parametrize("mesh", [None, "fused", "scan"])
def test_a_capture_without_depth_is_refused(cache: Path, mesh: str | None) -> None:
    with pytest.raises(InputError, match=r"wall: the capture has no depth .*--mesh FILE"):
        get(Wall(depth=False), mesh)
    assert not cache.exists()


def test_a_file_is_taken_as_it_is(cache: Path, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    save_mesh(tmp_path / "ball.ply", ball)
    what, mesh = surface_of(Wall(depth=False), str(tmp_path / "ball.ply"), progress=False)
    assert what == str(tmp_path / "ball.ply") and len(mesh.faces) == len(ball.faces)
    with pytest.raises(InputError, match=r"none\.ply: no such file"):
        get(Wall(), str(tmp_path / "none.ply"))
    assert not cache.exists()


@pytest.mark.parametrize("wrong", [False, True])
def test_a_mesh_is_turned_to_the_cameras(
    cache: Path, tmp_path: Path, wrong: bool, caplog: pytest.LogCaptureFixture
) -> None:
    room = trimesh.creation.box((8.0, 8.0, 8.0)).subdivide()
    if not wrong:
        room.invert()
    save_mesh(tmp_path / "room.ply", room)
    mesh = get(Wall(depth=False), str(tmp_path / "room.ply"))
    inward = -np.einsum("nk,nk->n", mesh.face_normals, mesh.triangles_center)
    assert (inward > 0).all()
    told = [r.getMessage() for r in caplog.records]
    said = (
        f"{tmp_path / 'room.ply'}: parts of it show the cameras their back, 100 % of the triangles; they are turned"
    )
    assert told == wrong * [said]


def test_a_word_that_is_no_file_is_told_the_words() -> None:
    with pytest.raises(InputError, match=r"(?=.*scan)(?=.*fused)(?=.*true)"):
        get(Wall(), "fuse")


def test_fusing_a_wall_gives_the_wall(cache: Path) -> None:
    """Not stubbed: the mesh lies where the depth says, and what is read back is what was made."""
    mesh = get(Wall(), fusion=FusionSettings(voxel=0.05))
    assert np.abs(mesh.vertices[:, 0] - 2.0).max() < 0.03
    assert np.ptp(mesh.vertices[:, 1]) > 1.5
    assert same(mesh, get(Wall(), fusion=FusionSettings(voxel=0.05)))


def slack_by(capture: Wall, folder: Path) -> float | None:
    """Slack of a file's mesh that is the wall."""
    place = trimesh.transformations.translation_matrix((2.1, 0.0, 0.0))
    save_mesh(folder / "wall.ply", trimesh.creation.box((0.2, 8.0, 8.0), place))
    return surface_arrays(capture, str(folder / "wall.ply"), progress=False)[2]


@pytest.mark.parametrize(
    "error, least, most",
    [(0.0, SURFACE_ERROR, SURFACE_ERROR), (0.03, 0.05, 0.07), (0.3, LARGEST_ERROR, LARGEST_ERROR)],
)
def test_the_slack_of_shadows_is_by_how_far_mesh_and_readings_lie_apart(
    cache: Path, tmp_path: Path, error: float, least: float, most: float
) -> None:
    wall, pick = Wall(), np.random.default_rng(0)
    depth = wall.frames[0].depth  # of all of them
    assert depth is not None
    depth += pick.normal(0.0, error, depth.shape).astype(np.float32)
    slack = slack_by(wall, tmp_path)
    assert slack is not None and least <= slack <= most


def test_what_was_not_scanned_adds_no_slack(cache: Path, tmp_path: Path) -> None:
    wall = Wall()
    wall.frames[0].depth[:, :21] = 1.4  # type: ignore[index]  # a cupboard, of all frames
    assert slack_by(wall, tmp_path) == SURFACE_ERROR


def test_a_true_mesh_has_no_slack_and_what_nobody_can_judge_the_least(room: RoomCapture, tmp_path: Path) -> None:
    assert surface_arrays(room, "true", progress=False)[2] is None
    assert slack_by(Wall(depth=False), tmp_path) == SURFACE_ERROR
    away = Wall()
    away.frames[0].depth[...] = 0.0  # type: ignore[index]
    assert slack_by(away, tmp_path) == SURFACE_ERROR


def test_a_device_mesh_in_other_units_is_replaced_by_the_fusion_but_not_when_strict(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Scaled(Wall):
        has_mesh = True

        def mesh(self) -> trimesh.Trimesh:
            return trimesh.creation.box((5000, 4000, 3000))

    wall = Scaled()
    assert surface_of(wall, progress=False)[0].startswith("fusion") and "must be in metres" in caplog.text
    wall.strict = True
    with pytest.raises(InputError, match=r"must be in metres.*--strict"):
        surface_of(wall, progress=False)
