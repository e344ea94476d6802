"""The mesh that a capture is relit with: a file, the device's own, a fusion, a simulated scan or the true one."""

import hashlib
import logging
from collections.abc import Callable
from pathlib import Path

import trimesh

from hyjax.data.capture import Capture, ChosenFrames
from hyjax.geometry.mesh import load_mesh, save_mesh
from hyjax.geometry.scan import simulate_scan
from hyjax.geometry.tsdf import fuse
from hyjax.util.cache import cache_folder
from hyjax.util.errors import InputError, did_you_mean

VERSION = 2
"""Of how surfaces are made. Add one whenever a fusion or a scan comes out differently."""
MAX_FUSED_FRAMES = 150
_log = logging.getLogger(__name__)
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
        capture: of the place.
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
    check_fusion(voxel, seed)
    if mesh is None and capture.reference() is not None:
        mesh = "scan"
    if mesh in (None, "captured"):
        captured = capture.mesh()
        if captured is not None:
            file = capture.mesh_file
            description = "captured mesh" if file is None else f"captured mesh {file.name}"
            return description, _check_metres(captured, str(file or capture.name))
        if mesh is not None:
            raise InputError(
                f"{capture.name}: no mesh came with this capture (of an ARKitScenes scan, download asset 'mesh'); "
                "use 'fused', 'scan' or a file"
            )
        mesh = "fused"
    if mesh not in WORDS:
        check_mesh_name(mesh)
        return mesh, _check_metres(load_mesh(Path(mesh), repair), mesh)
    if mesh == "true":
        true = capture.reference()
        if true is None:
            raise InputError("mesh: this capture has no true mesh; use 'fused', 'scan' or a file")
        return "true mesh", true
    if capture[0].depth is None:
        raise InputError(f"{capture.name}: the capture has no depth to make a mesh of; give one with --mesh FILE")
    description = f"simulated scan, seed {seed}" if mesh == "scan" else f"fused at {voxel:g} m"
    spread = ChosenFrames(capture, range(0, len(capture), -(-len(capture) // most_frames)))
    if mesh == "fused" and most_frames != MAX_FUSED_FRAMES:
        description += f" from {len(spread)} frames"

    def make() -> trimesh.Trimesh:
        if mesh == "scan":
            return simulate_scan(*capture.scan_input(), seed, progress)
        return fuse(spread, voxel, progress=progress)

    return description, kept(description, capture, make)


def kept(description: str, capture: Capture, make: Callable[[], trimesh.Trimesh]) -> trimesh.Trimesh:
    """A mesh from the cache folder, or made and kept there, under its description and the capture."""
    key = hashlib.sha256(f"{VERSION} {description} {capture.fingerprint}".encode()).hexdigest()[:16]
    file = cache_folder() / f"surface-{key}.ply"
    if file.is_file():
        try:
            return load_mesh(file)
        except InputError:
            file.unlink(missing_ok=True)  # damaged: made again below
    made = make()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        save_mesh(file, made)
        return load_mesh(file)  # as any later run will find it
    except (OSError, InputError) as error:
        _log.warning("the mesh is not kept for the next time: %s", error)
        return made


def _check_metres(mesh: trimesh.Trimesh, where: str) -> trimesh.Trimesh:
    if not 0.1 < max(mesh.extents) < 1000:
        raise InputError(f"{where}: spans {max(mesh.extents):.3g} m; a room's mesh must be in metres")
    return mesh


def check_fusion(voxel: float, seed: int) -> None:
    """Raise `InputError` unless a mesh can be made with this voxel in metres and this seed."""
    if not 0 < voxel <= 1:
        raise InputError(f"voxel: must lie in (0, 1] metres, got {voxel:g}")
    if seed < 0:
        raise InputError(f"seed: must be >= 0, got {seed}")


def rough_mesh(capture: Capture) -> str:
    """Name of the mesh that a headset would relight a capture with: its own, or else a simulated scan."""
    return "captured" if capture.has_mesh else "scan"


def check_mesh_name(mesh: str | None) -> None:
    """Raise `InputError` unless `mesh` is one of `WORDS` or an existing file."""
    if mesh is not None and mesh not in WORDS and not Path(mesh).is_file():
        hint = did_you_mean(mesh, WORDS)
        raise InputError(f"{mesh}: no such file{hint}; give a PLY, OBJ or GLB file, or one of {', '.join(WORDS)}")
