"""The built-in room as a capture, kept in the cache folder once it has been rendered."""

import hashlib
import json
import logging
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from hyjax.cache import cache_folder
from hyjax.data.capture import Frame
from hyjax.errors import InputError
from hyjax.files import whole
from hyjax.scene.camera import Camera, Intrinsics
from hyjax.scene.room import camera_path, make_room, render_room

VERSION = 6
"""Of what `hyjax.scene.room` makes. Add one whenever its geometry or its pictures change."""
FRAME_RATE = 2.0
"""Pictures a second: the walk takes twelve seconds."""

UP = np.array([0.0, 0.0, 1.0])

Arrays = dict[str, np.ndarray]

_log = logging.getLogger(__name__)


class RoomCapture:
    """The built-in room: a `Capture`, with the exact surface behind it.

    Attributes:
        name: "room".
        up: against gravity: +z.
        mesh: the true surface in metres.
        anchors: named places (see `hyjax.scene.room.Room`).
    """

    name = "room"

    def __init__(
        self,
        images: UInt8[np.ndarray, "n h w 3"],
        depth: Float[np.ndarray, "n h w"],
        cameras: list[Camera],
        mesh: trimesh.Trimesh,
        anchors: dict[str, dict[str, object]],
    ) -> None:
        self.up = UP
        self.mesh = mesh
        self.anchors = anchors
        self._images = images
        self._depth = depth
        self._cameras = cameras

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        poses = np.stack([camera.pose for camera in self._cameras])
        parts = (self.mesh.vertices, self._images[:: max(1, len(self) // 4)], self._depth.shape, poses)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, index: int) -> Frame:
        number = range(len(self))[index]
        return Frame(
            name=f"{number:03d}",
            image=self._images[number].astype(np.float32) / 255.0,
            camera=self._cameras[number],
            time=number / FRAME_RATE,
            depth=self._depth[number].copy(),
        )


def load_room(
    seed: int = 0,
    n_frames: int = 24,
    width: int = 640,
    height: int = 480,
    cache_dir: Path | None = None,
    progress: bool = True,
    quality: float = 1.0,
) -> RoomCapture:
    """The built-in room, rendered on first use and read from the cache after that.

    Args:
        seed: varies books, colours and small placements.
        n_frames: pictures along the walk.
        width, height: of the pictures in pixels.
        cache_dir: where to keep it; None for `hyjax.cache.cache_folder()`.
        progress: show a bar on stderr while rendering.
        quality: of the light, see `render_room`.

    Raises:
        InputError: a size or the quality is out of range.
    """
    if seed < 0:
        raise InputError(f"room: seed is {seed}, must be 0 or more")
    folder = cache_folder() if cache_dir is None else Path(cache_dir)
    file = folder / f"room-v{VERSION}-seed{seed}-{n_frames}x{width}x{height}-q{quality:g}.npz"
    if file.is_file():
        try:
            return _capture(_read(file))
        except Exception as error:  # Damage shows itself in a dozen ways; all mean the same.
            _log.warning("%s: damaged (%s), rendering the room again", file, error)
    arrays = _render(seed, n_frames, width, height, quality, progress)
    _write(file, arrays)
    return _capture(arrays)


def _render(seed: int, n_frames: int, width: int, height: int, quality: float, progress: bool) -> Arrays:
    room = make_room(seed)
    cameras = camera_path(room, n_frames, width, height)
    frames = render_room(room, cameras, quality, progress)
    k = cameras[0].intrinsics
    return {
        "images": np.stack([np.round(image * 255).astype(np.uint8) for image, _ in frames]),
        "depth": np.stack([depth for _, depth in frames]),
        "poses": np.stack([camera.pose for camera in cameras]),
        "intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]),
        "vertices": np.asarray(room.mesh.vertices),
        "faces": np.asarray(room.mesh.faces),
        "anchors": np.array(json.dumps(room.anchors)),
    }


def _capture(arrays: Arrays) -> RoomCapture:
    height, width = arrays["images"].shape[1:3]
    intrinsics = Intrinsics(width, height, *(float(x) for x in arrays["intrinsics"]))
    return RoomCapture(
        arrays["images"],
        arrays["depth"],
        [Camera(intrinsics, pose) for pose in arrays["poses"]],
        trimesh.Trimesh(arrays["vertices"], arrays["faces"], process=False),
        json.loads(str(arrays["anchors"])),
    )


def _read(file: Path) -> Arrays:
    # Opened here, since np.load leaves a damaged file open.
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _write(file: Path, arrays: Arrays) -> None:
    """Keep the room if the cache folder lets us; of two processes that render at once, each leaves a whole file."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as part:
            np.savez(part, **arrays)  # type: ignore[arg-type]
    except (OSError, InputError) as error:
        _log.warning("%s: cannot keep the rendered room (%s)", file, error)
