"""The mesh that a capture is relit with: given, measured, or what a headset would have made."""

import hashlib
import logging
from collections.abc import Iterator
from pathlib import Path

import trimesh

from hyjax.cache import cache_folder
from hyjax.data.capture import Capture, Frame
from hyjax.data.room import RoomCapture
from hyjax.errors import InputError, did_you_mean
from hyjax.scene.mesh import load_mesh, save_mesh
from hyjax.scene.room import path
from hyjax.scene.scan import RenderedDepths, ScanConfig, simulate_scan
from hyjax.scene.tsdf import fuse

VERSION = 2
"""Of how surfaces are made. Add one whenever a fusion or a scan comes out differently."""
MAX_FUSED_FRAMES = 150
_log = logging.getLogger(__name__)
ROOM_SCAN = ScanConfig(
    frames=64, width=160, max_depth=6.0, noise=0.004, min_weight=0.05, missing=0.03, grazing_cosine=0.15
)
WORDS = ("captured", "scan", "fused", "true")


def surface_of(
    capture: Capture,
    mesh: str | None = None,
    *,
    voxel: float = 0.03,
    seed: int = 0,
    repair: bool = False,
    most_frames: int = MAX_FUSED_FRAMES,
    progress: bool = True,
) -> tuple[str, trimesh.Trimesh]:
    """The mesh to relight a capture with. Meshes made here are kept in the cache folder.

    Args:
        capture: whose rooms to get.
        mesh: a file, or `"captured"` (that came with the capture), `"fused"` (from the depth maps), `"scan"` (what
            a headset would have made of it, rough and with holes, drawn from `seed`), `"true"` (the built-in room's
            own). By default the built-in room gets its scan and any other capture its own mesh, or else its fusion.
        voxel: edge of a fusion's voxels in metres.
        seed: of a simulated scan.
        repair: drop unusable triangles of a mesh file instead of refusing it.
        most_frames: a fusion takes no more depth maps than this, spread over the capture.
        progress: show bars on stderr.

    Returns:
        What was taken, in a few words, and the mesh.

    Raises:
        InputError: the file cannot be used, the capture has no depth to make a mesh of, or there is no captured or
            true mesh.
    """
    if not 0 < voxel <= 1:
        raise InputError(f"voxel: must lie in (0, 1] metres, got {voxel:g}")
    if seed < 0:
        raise InputError(f"seed: must be >= 0, got {seed}")
    builtin = isinstance(capture, RoomCapture)
    captured: Path | None = getattr(capture, "mesh_file", None)
    mesh = mesh or ("scan" if builtin else "captured" if captured else "fused")
    if mesh == "captured":
        if captured is None:
            raise InputError(
                f"{capture.name}: no mesh came with this capture (of an ARKitScenes scan, download asset 'mesh'); "
                "use 'fused', 'scan' or a file"
            )
        # Reconstructions made on a device have a triangle without area here and there.
        return f"captured mesh {captured.name}", _load_in_metres(captured, repair=True)
    if mesh not in WORDS:
        check_mesh_name(mesh)
        return mesh, _load_in_metres(Path(mesh), repair)
    if mesh == "true":
        if not isinstance(capture, RoomCapture):
            raise InputError("mesh: only the built-in room has a true mesh; use 'fused', 'scan' or a file")
        return "true mesh", capture.mesh
    if capture[0].depth is None:
        raise InputError(f"{capture.name}: the capture has no depth to make a mesh of; give one with --mesh FILE")
    description = f"simulated scan, seed {seed}" if mesh == "scan" else f"fused at {voxel:g} m"
    spread = _Spread(capture, most_frames)
    if mesh == "fused" and most_frames != MAX_FUSED_FRAMES:
        description += f" from {len(spread)} frames"
    key = hashlib.sha256(f"{VERSION} {description} {capture.fingerprint}".encode()).hexdigest()[:16]
    file = cache_folder() / f"surface-{key}.ply"
    if file.is_file():
        try:
            return description, load_mesh(file)
        except InputError:
            file.unlink(missing_ok=True)  # damaged: made again below
    if mesh == "scan" and isinstance(capture, RoomCapture):
        # A person with a headset sees more of a room than the pictures show, and sees it more than once.
        walk = path.camera_path(ROOM_SCAN.frames, 256, 192)
        made = simulate_scan(RenderedDepths(capture.mesh, walk), ROOM_SCAN, seed, progress)
    elif mesh == "scan":
        made = simulate_scan(capture, ScanConfig(), seed, progress)
    else:
        made = fuse(spread, voxel, progress=progress)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        save_mesh(file, made)
        return description, load_mesh(file)  # as any later run will find it
    except (OSError, InputError) as error:
        _log.warning("the mesh is not kept for the next time: %s", error)
        return description, made


def _load_in_metres(file: Path, repair: bool) -> trimesh.Trimesh:
    loaded = load_mesh(file, repair)
    if not 0.1 < max(loaded.extents) < 1000:
        raise InputError(f"{file}: spans {max(loaded.extents):.3g} m; a room's mesh must be in metres")
    return loaded


def rough_mesh(capture: Capture) -> str:
    """What stands for the surface that a headset has of a capture: its own mesh, or else a simulated scan."""
    return "scan" if getattr(capture, "mesh_file", None) is None else "captured"


def check_mesh_name(mesh: str | None) -> None:
    """Raise `InputError` unless `mesh` is one of `WORDS` or an existing file."""
    if mesh is not None and mesh not in WORDS and not Path(mesh).is_file():
        hint = did_you_mean(mesh, WORDS)
        raise InputError(f"{mesh}: no such file{hint}; give a PLY, OBJ or GLB file, or one of {', '.join(WORDS)}")


class _Spread:
    """Evenly chosen frames of a long capture, read when asked for."""

    def __init__(self, capture: Capture, most: int) -> None:
        self._capture = capture
        self._indices = range(0, len(capture), -(-len(capture) // most))

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[Frame]:
        return (self._capture[index] for index in self._indices)
