"""Seeds of the fuzzer: a small capture, or pairs of pictures with depth, in every layout that is read."""

import dataclasses
import importlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import small_capture as small
import trimesh
from reference.arkit_export import export_arkit_scan
from reference.listed_frames import ListedFrames
from reference.pairs_export import (
    export_diml_outdoor,
    export_folder,
    export_middlebury,
    export_middlebury_2014,
    export_nyu,
)
from reference.phone_layouts import box_room, write_polycam, write_record3d, write_scanner3d, zipped

from hyjax.data.capture import Frame
from hyjax.data.convert import write_capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.util.images import write_depth, write_png


def small_frames() -> list[Frame]:
    """Posed pictures with depth of the same size."""
    return [
        Frame(f"{k}", small.picture(k), Camera(small.LENS, small.pose(k)), k / 10, small.depth(k)) for k in range(2)
    ]


def published(module: str, **options: object) -> Callable[[Path], None]:
    """The layout as its own tests write it."""
    return lambda folder: importlib.import_module(module).write(folder, **options)


def seven_scenes(folder: Path) -> None:
    for number, frame in enumerate(small_frames()):
        write_png(folder / f"frame-{number:06d}.color.png", frame.image)
        assert frame.depth is not None
        write_depth(folder / f"frame-{number:06d}.depth.png", frame.depth)
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", frame.camera.pose)
    np.savetxt(folder / "camera-intrinsics.txt", small.LENS.matrix)
    np.savetxt(folder / "gravity-direction.txt", [0, 0, -1])


def arkit(folder: Path) -> None:
    export_arkit_scan(folder, ListedFrames(small_frames(), small.UP, PHONE_LIDAR), trimesh.creation.box())


def scanner3d(folder: Path) -> None:
    write_scanner3d(folder, box_room(2))


def record3d(folder: Path) -> None:
    write_record3d(folder, box_room(2))


def r3d(folder: Path) -> None:
    write_record3d(folder / "scan", box_room(2), r3d=True)
    archived(folder, "r3d")


def archived(folder: Path, suffix: str) -> None:
    """Leave the archive of `scan` alone in the folder."""
    made = zipped(folder / "scan", suffix)
    shutil.rmtree(folder / "scan")
    made.rename(folder / f"a.{suffix}")


def archive(folder: Path) -> None:
    write_scanner3d(folder / "scan", box_room(2))
    archived(folder, "zip")


def polycam(folder: Path) -> None:
    write_polycam(folder, box_room(2))


def stray(folder: Path) -> None:
    frames = [dataclasses.replace(frame, exposure=None) for frame in box_room(2)]
    write_capture(
        ListedFrames(frames, np.array([0.0, 1.0, 0.0]), PHONE_LIDAR), "stray", folder / "scan", progress=False
    )


def video(folder: Path) -> None:
    stray(folder)
    (folder / "scan/rgb.mp4").rename(folder / "a.mp4")
    shutil.rmtree(folder / "scan")


def scannet(folder: Path) -> None:
    tests = importlib.import_module("test_scannet")
    tests.write(folder, tests.sens([small.pose(0), small.pose(1)]))


def colmap_map(folder: Path) -> None:
    importlib.import_module("test_colmap").write_map(folder / "a.bin", small.depth(0)[:6, :8])


def trajectory(folder: Path) -> None:
    arkit(folder / "x")
    (folder / "x/41000000/lowres_wide.traj").rename(folder / "a.traj")
    next((folder / "x/41000000/lowres_wide_intrinsics").iterdir()).rename(folder / "b.pincam")
    shutil.rmtree(folder / "x")


# ---- pairs ----


def pairs_folder(folder: Path) -> None:
    export_folder(folder, "a", small.picture(0), small.depth(0))


def diml(folder: Path) -> None:
    export_diml_outdoor(folder, "a", small.picture(0), small.depth(0), np.ones(small.LENS.shape))


def middlebury(folder: Path) -> None:
    disparity = np.full(small.LENS.shape, 20.0)
    export_middlebury(folder, "view1", "disp1", small.picture(0), disparity, dmin=3)


def middlebury_pfm(folder: Path) -> None:
    export_middlebury_2014(folder, 0, small.picture(0), np.full(small.LENS.shape, 20.0), 3.5)


def nyu(folder: Path) -> None:
    image, depth = small.picture(0)[:6, :8], small.depth(0)[:6, :8] + 1
    export_nyu(folder / "a.mat", [image], [depth], [depth])
