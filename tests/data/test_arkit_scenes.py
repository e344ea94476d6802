"""The ARKitScenes reader, on the built-in room exported as a raw scan and on small scans with one thing wrong."""

import functools
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from reference.arkit_export import export_arkit_scan, write_depth
from reference.phone_layouts import zipped
from refusals import refuses_capture
from scipy.spatial.transform import Rotation

from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.mesh import save_mesh
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.tsdf import fuse
from hyjax.scene import fusion
from hyjax.scene.surfaces import surface_of
from hyjax.util.errors import InputError
from hyjax.util.images import read_image, write_png

VIDEO = "41000000"
FIRST, SECOND = f"{VIDEO}_6845.210", f"{VIDEO}_6845.710"
BOX = trimesh.creation.box((4, 5, 3))


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=2, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def caster(room: RoomCapture) -> RayCaster:
    return RayCaster(room.reference())


@pytest.fixture
def scan(room: RoomCapture, tmp_path: Path) -> Path:
    """Two frames, half a second apart, with a box for a mesh."""
    return export_arkit_scan(tmp_path / "raw" / "Training", room, BOX, video_id=VIDEO)


refuses = functools.partial(refuses_capture, strict=True)


@pytest.mark.parametrize("quarter_turns", range(4))
def test_the_exported_room_is_the_room(
    room: RoomCapture, caster: RayCaster, tmp_path: Path, quarter_turns: int
) -> None:
    """However the device was held: upright, the same pictures, depth and G-buffer."""
    folder = export_arkit_scan(tmp_path, room, BOX, quarter_turns=quarter_turns)
    capture = open_capture(folder)
    assert capture.format == "ARKitScenes"
    assert capture.quarter_turns == quarter_turns and capture.name == VIDEO and len(capture) == len(room)
    np.testing.assert_array_equal(capture.up, room.up)
    for frame, original in zip(capture, room):
        np.testing.assert_allclose(frame.image, original.image, atol=1e-6)
        assert frame.time == pytest.approx(original.time)
        assert frame.depth is not None and frame.depth.shape == (60, 80)
        seen, truth = caster.gbuffer(frame.camera), caster.gbuffer(original.camera)
        np.testing.assert_array_equal(seen.hit, truth.hit)
        np.testing.assert_allclose(seen.position, truth.position, atol=1e-4)
        np.testing.assert_allclose(seen.normal, truth.normal, atol=1e-2)
        # The depth map has a lens of its own, which sees the same surface.
        seen = caster.gbuffer(frame.depth_camera)
        np.testing.assert_allclose(frame.depth, seen.depth, atol=0.001)


def test_any_capture_can_be_exported(room: RoomCapture, caster: RayCaster, tmp_path: Path) -> None:
    """One whose y points down, such as the kitchen's: mesh and poses are turned together to be z-up."""
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_rotvec([1.6, 0.2, 0.1]).as_matrix()
    cameras = [Camera(frame.camera.intrinsics, tilt @ frame.camera.pose) for frame in room]
    images, mesh = np.stack([frame.image for frame in room]), room.reference().copy().apply_transform(tilt)
    tilted = RoomCapture(np.uint8(np.round(images * 255)), cameras, mesh, {})
    tilted.up = tilt[:3, :3] @ room.up
    capture = open_capture(export_arkit_scan(tmp_path, tilted, mesh))
    mine = RayCaster(surface_of(capture, progress=False)[1])
    for frame, original in zip(capture, room):
        seen, truth = mine.gbuffer(frame.camera), caster.gbuffer(original.camera)
        assert np.mean(seen.hit != truth.hit) < 1e-3
        assert np.quantile(np.abs(seen.depth - truth.depth), 0.999) < 1e-3


def test_pictures_on_disk_are_turned(room: RoomCapture, tmp_path: Path) -> None:
    """Otherwise the test above would prove nothing."""
    for quarter_turns, shape in enumerate(((120, 160, 3), (160, 120, 3))):
        scan = export_arkit_scan(tmp_path / str(quarter_turns), room, BOX, quarter_turns=quarter_turns)
        assert read_image(scan / "vga_wide" / f"{FIRST}.png").shape == shape


def test_names_are_apples(scan: Path) -> None:
    names = {str(file.relative_to(scan)) for file in scan.rglob("*") if file.is_file()}
    both = {f"{name}.{{}}" for name in (FIRST, SECOND)}
    expected = {f"{VIDEO}_3dod_mesh.ply", "lowres_wide.traj"}
    for folder in ("vga_wide", "lowres_wide", "lowres_depth", "confidence"):
        expected |= {f"{folder}/{name.format('png')}" for name in both}
    expected |= {f"lowres_wide_intrinsics/{name.format('pincam')}" for name in both}
    expected |= {f"vga_wide_intrinsics/{name}.pincam" for name in (FIRST, f"{VIDEO}_6845.711")}
    assert names == expected


# ---- which files are taken ----


def test_depth_is_the_nearest_in_time(scan: Path) -> None:
    """Sixty maps a second beside thirty pictures: off by up to a sixtieth, each with its own intrinsics."""
    for folder, suffix in (("lowres_depth", "png"), ("lowres_wide_intrinsics", "pincam"), ("confidence", "png")):
        (scan / folder / f"{FIRST}.{suffix}").rename(scan / folder / f"{VIDEO}_6845.202.{suffix}")
    whole = open_capture(scan)[0].depth
    assert whole is not None and whole.any()
    write_depth(scan / "lowres_depth" / f"{VIDEO}_6845.213.png", np.full((60, 80), 1234))
    np.testing.assert_array_equal(open_capture(scan)[0].depth, whole)  # the nearer one has no intrinsics
    pincams = scan / "lowres_wide_intrinsics"
    shutil.copy(pincams / f"{SECOND}.pincam", pincams / f"{VIDEO}_6845.214.pincam")
    np.testing.assert_allclose(open_capture(scan)[0].depth, 1.234)


def test_confidence_of_depth_is_kept(scan: Path) -> None:
    levels = np.full((60, 80), 2)
    levels[:, :30], levels[:, 30:50] = 0, 1
    write_png(scan / "confidence" / f"{FIRST}.png", levels / 255)
    capture = open_capture(scan)
    np.testing.assert_array_equal(capture[0].confidence, levels / 2)
    assert capture.sensor.name == "phone LiDAR" and capture.depth_reading(0).confidence is not None
    shutil.rmtree(scan / "confidence")
    assert open_capture(scan)[0].confidence is None


def as_older_sample(scan: Path) -> Path:
    """The scan with the names of the older sample: <timestamp>.png in wide/, color.traj and so on."""
    older = scan.parent / "41999999"
    renamed = {
        "vga_wide": "wide",
        "vga_wide_intrinsics": "color_intrinsics",
        "lowres_depth": "depth_densified",
        "confidence": "confidence",
    }
    for folder, name in renamed.items():
        for file in (scan / folder).iterdir():
            (older / name).mkdir(parents=True, exist_ok=True)
            shutil.copy(file, older / name / file.name.partition("_")[2])
    shutil.copy(scan / "lowres_wide.traj", older / "color.traj")
    shutil.copy(scan / f"{VIDEO}_3dod_mesh.ply", older / "41999999_3dod_mesh.ply")
    return older


def test_the_older_samples_layout(scan: Path) -> None:
    older = as_older_sample(scan)
    capture = open_capture(older)
    assert capture.format == "ARKitScenes" and capture.name == "41999999" and capture.mesh_file is not None
    for frame, original in zip(capture, open_capture(scan)):
        np.testing.assert_array_equal(frame.image, original.image)
        np.testing.assert_array_equal(frame.camera.pose, original.camera.pose)
        np.testing.assert_array_equal(frame.depth, original.depth)
        assert frame.depth_intrinsics == frame.camera.intrinsics.resize(60, 80)
    assert capture[0].name == FIRST.partition("_")[2]


def test_missing_parts_of_the_older_sample_are_named(scan: Path) -> None:
    older = as_older_sample(scan)
    shutil.rmtree(older / "color_intrinsics")
    refuses(older, "color_intrinsics")
    shutil.rmtree(older / "wide")
    refuses(older, "no wide")


def test_readings_of_low_confidence_are_dropped(scan: Path) -> None:
    whole = open_capture(scan)[0].depth
    confidence = np.full((60, 80), 2)
    confidence[:, :30], confidence[:, 30:50] = 0, 1
    write_png(scan / "confidence" / f"{FIRST}.png", confidence / 255)
    depth = open_capture(scan)[0].depth
    assert not depth[:, :30].any() and whole[:, :30].any()
    np.testing.assert_array_equal(depth[:, 30:], whole[:, 30:])
    shutil.rmtree(scan / "confidence")
    np.testing.assert_array_equal(open_capture(scan)[0].depth, whole)


def test_a_scan_without_depth(scan: Path) -> None:
    shutil.rmtree(scan / "lowres_depth")
    shutil.rmtree(scan / "lowres_wide_intrinsics")
    assert all(frame.depth is None for frame in open_capture(scan))


def test_the_best_pictures_are_taken(scan: Path) -> None:
    """vga_wide, else wide, else lowres_wide; one whose intrinsics are missing is passed over with a word."""
    assert open_capture(scan)[0].image.shape == (120, 160, 3)
    for name in ("vga_wide", "vga_wide_intrinsics"):
        (scan / name).rename(scan / name.removeprefix("vga_"))
    assert open_capture(scan)[0].image.shape == (120, 160, 3) and not open_capture(scan).remarks
    shutil.rmtree(scan / "wide_intrinsics")
    capture = open_capture(scan)
    assert capture[0].image.shape == (60, 80, 3)
    assert "no wide_intrinsics, lowres_wide is taken" in capture.remarks[0]


def test_the_3dod_layout(scan: Path, room: RoomCapture, caster: RayCaster) -> None:
    frames = scan / f"{VIDEO}_frames"
    frames.mkdir()
    for name in ("lowres_wide", "lowres_wide_intrinsics", "lowres_depth", "lowres_wide.traj"):
        (scan / name).rename(frames / name)
    for name in ("vga_wide", "vga_wide_intrinsics", "confidence"):
        shutil.rmtree(scan / name)
    for folder in (scan, frames):
        capture = open_capture(folder)
        assert capture.mesh_file == scan / f"{VIDEO}_3dod_mesh.ply" and capture.name == VIDEO and len(capture) == 2
    np.testing.assert_allclose(
        capture[1].depth, caster.gbuffer(capture[1].camera).depth, atol=0.001
    )  # lowres_wide and its depth share a lens
    np.testing.assert_allclose(capture[1].camera.origin, room[1].camera.origin, atol=1e-6)


def test_laser_scans_of_the_venue(scan: Path, tmp_path: Path) -> None:
    assert open_capture(scan).laser_folder is None
    venue = tmp_path / "laser_scanner_point_clouds" / "467138"
    venue.mkdir(parents=True)
    assert open_capture(scan).laser_folder is None
    table = tmp_path / "raw" / "metadata.csv"  # with a gap in the column, pandas writes whole numbers as floats
    table.write_text(f"video_id,visit_id,fold\n47333462,1.0,Training\n{VIDEO},467138.0,Training\n")
    assert open_capture(scan).laser_folder == venue
    table.write_text(f"video_id,visit_id,fold\n{VIDEO},,Training\n")
    assert open_capture(scan).laser_folder is None
    (tmp_path / "raw_train_val_splits.csv").write_text(f"video_id,visit_id,fold\n{VIDEO},467138,Training\n")
    assert open_capture(scan).laser_folder == venue
    own = scan / "laser_scanner_point_clouds"
    own.mkdir()
    (own / "468000.ply").touch()
    assert open_capture(scan).laser_folder == own


def test_links_that_lead_nowhere_are_passed_over(scan: Path) -> None:
    for name in ("vga_wide/41000000_1.000.png", "gone.ply", "lowres_depth/x.png"):
        (scan / name).symlink_to(scan / "nowhere")
    capture = open_capture(scan)
    assert capture.fingerprint and capture[0].image.ndim == 3


def test_the_fingerprint_follows_the_files(scan: Path) -> None:
    seen = [open_capture(scan).fingerprint]
    assert open_capture(scan).fingerprint == seen[0]
    pincam = scan / "vga_wide_intrinsics" / f"{FIRST}.pincam"
    for change in (
        lambda: pincam.write_text(pincam.read_text() + "\n"),
        lambda: write_png(scan / "confidence" / f"{FIRST}.png", np.ones((60, 80))),
        lambda: (scan / "lowres_wide.traj").write_text((scan / "lowres_wide.traj").read_text() + "\n"),
        lambda: (scan / f"{VIDEO}_3dod_mesh.ply").unlink(),
    ):
        change()
        seen.append(open_capture(scan).fingerprint)
    assert len(set(seen)) == len(seen)


# ---- the mesh that came with it ----


def test_a_captured_mesh_that_fits_is_the_default(
    scan: Path, room: RoomCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    own = f"captured mesh {VIDEO}_3dod_mesh.ply"
    assert surface_of(open_capture(scan), progress=False)[0].startswith("fusion of")  # the box is another's
    assert f"the {own} agrees with" in caplog.text and "that is taken" in caplog.text
    save_mesh(scan / f"{VIDEO}_3dod_mesh.ply", room.reference())
    assert surface_of(open_capture(scan), progress=False)[0] == own


def test_a_captured_mesh_is_repaired(scan: Path) -> None:
    """It may have a triangle without area, which a given file would be refused for."""
    capture, file = open_capture(scan), scan / f"{VIDEO}_3dod_mesh.ply"
    flat = trimesh.Trimesh(BOX.vertices, [*BOX.faces, [0, 0, 1]], process=False)
    file.write_bytes(trimesh.exchange.ply.export_ply(flat))
    description, mesh = surface_of(capture, "captured", progress=False)
    assert description == f"captured mesh {file.name}" and len(mesh.faces) == len(BOX.faces)
    with pytest.raises(InputError, match="degenerate"):
        surface_of(capture, str(file), progress=False)


def test_without_a_mesh_the_asset_is_named(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(fusion, "fuse_capture", lambda *_, **__: BOX)
    (scan / f"{VIDEO}_3dod_mesh.ply").unlink()
    capture = open_capture(scan)
    assert capture.mesh_file is None
    with pytest.raises(InputError, match=rf"{VIDEO}: no mesh .* asset 'mesh'.*'fused'"):
        surface_of(capture, "captured", progress=False)
    assert surface_of(capture, progress=False)[0].startswith("fusion of")


def test_depth_maps_fuse_to_the_room(room: RoomCapture, caster: RayCaster, tmp_path: Path) -> None:
    """Of a device held sideways, through the depth's own lens."""
    capture = open_capture(export_arkit_scan(tmp_path, room, BOX, quarter_turns=3))
    fused = fuse(list(capture), 0.06, max_depth=8.0, min_weight=0.005, progress=False)
    truth, made = (np.asarray(c.gbuffer(room[0].camera).depth) for c in (caster, RayCaster(fused)))
    seen = made > 0
    assert seen.mean() > 0.6 and np.median(np.abs(made - truth)[seen]) < 0.01


@pytest.mark.slow
def test_the_command_takes_a_scan(room: RoomCapture, tmp_path: Path) -> None:
    scan = export_arkit_scan(tmp_path, room, room.reference(), quarter_turns=1)
    command = [str(Path(sys.executable).with_name("hyjax")), "relight", "--quiet", "--capture", str(scan)]
    options = ["--size", "64x48", "--lights", "center-point", "--no-shadows", "--keep-photo-light"]
    done = subprocess.run(
        [*command, *options, "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    made = {file.name for file in (tmp_path / "out").iterdir()}
    assert {f"{FIRST}.relit.png", f"{SECOND}.relit.png", "contact_sheet.png"} <= made
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert record["settings"]["mesh"] == f"captured mesh {VIDEO}_3dod_mesh.ply"


# ---- what is wrong with a scan ----


@pytest.mark.parametrize(
    ("missing", "parts"),
    [
        (["lowres_wide.traj"], ["no lowres_wide.traj", "download asset 'lowres_wide.traj'", "two dozen videos"]),
        (["vga_wide", "lowres_wide"], ["no vga_wide", "download asset 'vga_wide'", "wide, lowres_wide"]),
        (["vga_wide_intrinsics", "lowres_wide"], ["download asset 'vga_wide_intrinsics'"]),
        (["lowres_wide_intrinsics"], ["download asset 'lowres_wide_intrinsics'"]),
    ],
)
def test_missing_assets_are_named(scan: Path, missing: list[str], parts: list[str]) -> None:
    for name in missing:
        shutil.rmtree(scan / name) if (scan / name).is_dir() else (scan / name).unlink()
    refuses(scan, str(scan), *parts)


def shift(trajectory: Path, seconds: float) -> None:
    rows = [line.split() for line in trajectory.read_text().splitlines()]
    trajectory.write_text("".join(f"{float(row[0]) + seconds:.8f} {' '.join(row[1:])}\n" for row in rows))


def test_frames_that_the_trajectory_does_not_cover(scan: Path) -> None:
    shift(scan / "lowres_wide.traj", 0.3)
    capture = open_capture(scan)
    assert "1 pictures are left out, at times that lowres_wide.traj does not cover" in capture.remarks[0]
    assert [frame.name for frame in capture] == [SECOND]
    shift(scan / "lowres_wide.traj", 1000.0)
    refuses(scan, "none of 2 pictures", "2 pictures are left out, at times that lowres_wide.traj does not cover")


def test_frames_without_intrinsics_or_depth(scan: Path) -> None:
    (scan / "vga_wide_intrinsics" / f"{FIRST}.pincam").unlink()
    assert [frame.name for frame in open_capture(scan)] == [SECOND]
    (scan / "lowres_depth" / f"{SECOND}.png").rename(scan / "lowres_depth" / f"{VIDEO}_6845.730.png")
    refuses(scan, "none of 2 pictures", "1 pictures are left out, without .pincam", "without depth or its .pincam")


@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("lowres_wide.traj", "", "empty"),
        ("lowres_wide.traj", "6845.1 0 0 0 1 2\n", "row 1 is not seven"),
        ("lowres_wide.traj", "2 0 0 0 1 2 3\n1 0 0 0 1 2 3\n", "row 2: time 1 is before"),
        ("lowres_wide.traj", "2 0 0 0 1 2 3\n2 0 0 0 1 2 3\n", "row 2: time 2 is the same"),
        (f"vga_wide_intrinsics/{FIRST}.pincam", "160 120 131 131 80", "5 numbers"),
        (f"lowres_wide_intrinsics/{FIRST}.pincam", "80 60 0 65 40 30", "focal lengths"),
    ],
)
def test_malformed_files_are_named(scan: Path, file: str, content: str, problem: str) -> None:
    (scan / file).write_text(content)
    refuses(scan, file, problem)


def test_damaged_and_unequal_pictures_are_named(scan: Path) -> None:
    write_png(scan / "confidence" / f"{FIRST}.png", np.ones((30, 40)))
    refuses(scan, f"confidence/{FIRST}.png", "40x30", "80x60")
    (scan / "confidence" / f"{FIRST}.png").unlink()
    (scan / "lowres_wide_intrinsics" / f"{FIRST}.pincam").write_text("160 120 131 131 80 60")
    refuses(scan, f"frame {FIRST} is 80x60", "160x120")
    (scan / "vga_wide_intrinsics" / f"{FIRST}.pincam").write_text("80 60 65 65 40 30")
    refuses(scan, f"frame {FIRST} is 160x120", "80x60")
    picture = scan / "vga_wide" / f"{SECOND}.png"
    picture.write_bytes(picture.read_bytes()[:200])
    assert len(open_capture(scan)) == 1 and open_capture(scan).depth_count == 2
    refuses(scan, f"vga_wide/{SECOND}.png", "damaged and left out")


def test_a_folder_without_pictures_is_named(scan: Path) -> None:
    for name in ("vga_wide", "lowres_wide"):
        for file in (scan / name).iterdir():
            file.unlink()
    refuses(scan, "no vga_wide")


def test_a_folder_of_scans_is_told_to_give_one(scan: Path, tmp_path: Path) -> None:
    (tmp_path / "raw" / "metadata.csv").touch()
    for folder in (tmp_path / "raw", scan.parent):
        shutil.copytree(scan, scan.parent / "42000000", dirs_exist_ok=True)
        with pytest.raises(InputError, match=rf"{folder}: not a capture, but has .*{VIDEO}/ \(ARKitScenes\)"):
            open_capture(folder)


def test_an_archive_is_read_as_its_folder_is(scan: Path) -> None:
    for frame, same in zip(open_capture(scan), open_capture(zipped(scan)), strict=True):
        np.testing.assert_array_equal(frame.image, same.image)
        np.testing.assert_array_equal(frame.depth, same.depth)
