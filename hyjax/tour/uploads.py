"""Meshes that visitors bring in as furniture: they arrive in parts, and stand on the floor before the camera."""

import secrets
import threading
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from hyjax.tour.messages import Message
from hyjax.tour.placement import as_point
from hyjax.tour.plan import Piece
from hyjax.tour.renderer import Renderer
from hyjax.tour.tasks import camera_of
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write
from hyjax.util.memory import release_freed_memory

MOST_UPLOADED = 64 * 2**20
"""Bytes of a file; four times as many are on their way at most."""
MOST_FILES = 64
"""In a tour's folder."""
FORMATS = (".ply", ".obj", ".glb")


class Uploads:
    """Files on their way, by visitor, and those that have arrived, in the tour's folder."""

    def __init__(self, renderer: Renderer, out: Path) -> None:
        self._renderer, self._out, self._lock = renderer, out, threading.Lock()
        self._parts: dict[Hashable, bytearray] = {}

    def take(self, visitor: Hashable, message: Message) -> dict[str, Any]:
        """Take one more part; with the last, the piece of furniture that the file is."""
        with self._lock:
            parts = self._parts.pop(visitor, bytearray())
            size = len(parts) + len(message.part) + message.rest
            if not 0 < size <= MOST_UPLOADED or sum(map(len, self._parts.values())) + size > 4 * MOST_UPLOADED:
                most = MOST_UPLOADED >> 20
                raise InputError(f"{message.name}: {size} bytes; give a mesh of at most {most} MiB, one at a time")
            parts += message.part
            if message.rest:
                self._parts[visitor] = parts
                return {"got": len(parts)}
        return {"new": self._place(message, bytes(parts))}

    def drop(self, visitor: Hashable) -> None:
        """Drop what a visitor has not sent to the end."""
        with self._lock:
            self._parts.pop(visitor, None)

    def _place(self, message: Message, content: bytes) -> Piece:
        suffix = Path(message.name).suffix.lower()
        if suffix not in FORMATS:
            raise InputError(f"{message.name}: give a mesh as {', '.join(FORMATS)}, in metres")
        if sum(1 for _ in self._out.glob("mesh-*")) >= MOST_FILES:
            raise InputError(f"{self._out}: has {MOST_FILES} meshes; remove some first")
        path = self._out / f"mesh-{secrets.token_hex(6)}{suffix}"
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        try:
            return self._standing(message, path.name)
        except Exception as error:
            path.unlink(missing_ok=True)
            if isinstance(error, InputError):
                raise InputError(str(error).replace(str(path), message.name)) from None
            raise
        finally:
            release_freed_memory()  # of a mesh

    def _standing(self, message: Message, file: str) -> Piece:
        """Piece on the floor before the camera."""
        scene, up, piece = self._renderer.scene, self._renderer.up, Piece((0.0, 0.0, 0.0), file=file)
        mesh = scene.piece_mesh(piece)
        assert mesh is not None
        if not 0.02 < max(mesh.extents) < 10:
            raise InputError(f"{message.name}: spans {max(mesh.extents):.3g} m; furniture must be in metres")
        camera = camera_of(self._renderer, message)
        height, width = camera.intrinsics.shape
        hit = scene.pick(message.plan, camera.origin, camera.rays()[height * 2 // 3, width // 2])
        target = camera.origin + camera.pose[:3, 2] if hit is None else hit.point
        centre = mesh.bounds.mean(axis=0)
        foot = centre + (float((mesh.vertices @ up).min()) - centre @ up) * up
        pose = np.eye(4)
        pose[:3, 3] = target - foot
        piece = replace(piece, pose=tuple(pose.reshape(-1).tolist()), centre=as_point(centre))
        replace(message.plan, pieces=(*message.plan.pieces, piece)).check()
        return piece
