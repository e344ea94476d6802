"""Tools that point at the scene: put a lamp or a window there, pick furniture up; and meshes that are uploaded."""

import secrets
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from hyjax.tour.checks import check_rays
from hyjax.tour.placement import draw_window, place_lamp, place_window
from hyjax.tour.plan import Piece
from hyjax.tour.session import Session
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write

MOST_UPLOADED = 64 * 2**20  # bytes
UPLOADS = (".ply", ".obj", ".glb")


def use_tool(session: Session, tool: str, origin: Any, direction: Any) -> None:
    """Use a tool where a ray meets the scene: `window`, `furniture`, or a kind of lamp."""
    start, ray = check_rays(origin, direction)
    scene = session.renderer.scene
    hit = scene.pick(session.plan, start, ray)
    if hit is None:
        raise InputError("there is no surface here; click on a wall, the floor or a thing")
    if tool == "window":
        session.add("windows", place_window(hit.point, hit.normal, session.renderer.up))
    elif tool == "furniture":
        _select_furniture(session, hit.piece, hit.origin)
    else:
        session.add("lamps", place_lamp(tool, hit.point, hit.normal))  # type: ignore[arg-type]


def add_drawn_window(session: Session, origin: Any, rays: Float[np.ndarray, "n n 3"]) -> None:
    """Add a window that was drawn: rays through a rectangle, row by row."""
    start, rays = check_rays(origin, rays)
    renderer = session.renderer
    points, normals = renderer.scene.visible_surface(session.plan, start, rays.reshape(-1, 3))
    corners = rays[[0, 0, -1, -1], [0, -1, -1, 0]]
    session.add("windows", draw_window(start, corners, points, normals, renderer.up))


def add_mesh(session: Session, frame: int, name: str, content: bytes) -> None:
    """Put a mesh file into the room, on the floor in front of a frame's camera."""
    suffix = Path(name).suffix.lower()
    if suffix not in UPLOADS:
        raise InputError(f"{Path(name).name}: give a mesh as {', '.join(UPLOADS)}, in metres")
    if not 0 < len(content) <= MOST_UPLOADED:
        raise too_large(name, len(content))
    file = f"mesh-{secrets.token_hex(6)}{suffix}"
    with atomic_write(session.out / file) as temporary:
        temporary.write_bytes(content)
    try:
        session.add("pieces", _place_mesh(session, frame, file))
    except Exception as error:
        (session.out / file).unlink(missing_ok=True)
        if isinstance(error, InputError):
            raise InputError(str(error).replace(str(session.out / file), Path(name).name)) from None
        raise


def too_large(name: str, size: int) -> InputError:
    """Error of a file that is empty or too large."""
    return InputError(f"{Path(name).name}: {size} bytes; give a mesh of at most {MOST_UPLOADED >> 20} MiB")


def too_many(name: str) -> InputError:
    """Error of a file that arrives while others are still on their way."""
    return InputError(f"{Path(name).name}: too many files at once; bring it when the others have arrived")


def _select_furniture(session: Session, number: int | None, point: Float[np.ndarray, "3"]) -> None:
    if number is None:
        x, y, z = (round(float(v), 4) for v in point)
        piece = Piece((x, y, z))
        session.renderer.scene.check_piece(piece)
        number = session.renderer.scene.overlapping_piece(session.plan, piece)
        if number is None:
            session.add("pieces", piece)
            return
    session.select(("pieces", number))


def _place_mesh(session: Session, frame: int, file: str) -> Piece:
    renderer = session.renderer
    piece = Piece((0.0, 0.0, 0.0), file=file)
    mesh = renderer.scene.piece_mesh(piece)
    assert mesh is not None
    if not 0.02 < max(mesh.extents) < 10:
        raise InputError(f"{file}: spans {max(mesh.extents):.3g} m; furniture must be in metres")
    camera = renderer.camera(frame)
    height, width = camera.intrinsics.shape
    hit = renderer.scene.pick(session.plan, camera.origin, camera.rays()[height * 2 // 3, width // 2])
    target = camera.origin + camera.pose[:3, 2] if hit is None else hit.point
    lowest = float((mesh.vertices @ renderer.up).min())
    centre = mesh.bounds.mean(axis=0)
    foot = centre + (lowest - centre @ renderer.up) * renderer.up
    pose = np.eye(4)
    pose[:3, 3] = target - foot
    return replace(piece, pose=tuple(pose.reshape(-1).tolist()))
