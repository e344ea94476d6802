"""The built-in room as a capture, kept in the cache folder once it has been rendered."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    import trimesh

    from hyjax.geometry.scan import RenderedDepths, ScanConfig

VERSION = 6
"""Version of the room of `hyjax.synthetic.room`. Add one whenever its geometry or its pictures change."""
SIZE = (480, 640)
"""Height and width of its pictures where no other size is asked for."""
SHORTEST_SIDE, MOST_PIXELS = 16, 1280 * 960
"""Pixels: shortest side that is rendered, and most of a picture; others are resampled from there."""
FRAME_RATE = 2.0
"""Pictures a second: the walk takes twelve seconds."""

UP = np.array([0.0, 0.0, 1.0])


class RoomCapture(Capture):
    """The built-in room: a capture whose true surface is known; z is up."""

    name = "room"

    def __init__(
        self,
        images: UInt8[np.ndarray, "n h w 3"],
        depth: Float[np.ndarray, "n h w"],
        cameras: list[Camera],
        mesh: "trimesh.Trimesh | MeshArrays",
        anchors: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.up = UP
        self._surface = MeshArrays.of(mesh)
        self.anchors = anchors
        self._images = images
        self._depth = depth
        self._cameras = cameras

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        poses = np.stack([camera.pose for camera in self._cameras])
        parts = (self._surface.vertices, self._images[:: max(1, len(self) // 4)], self._depth.shape, poses)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()

    def reference(self) -> "trimesh.Trimesh":
        """The true surface in metres."""
        return self._surface.mesh

    @property
    def has_reference(self) -> bool:
        """True."""
        return True

    def scan_input(self) -> "tuple[RenderedDepths, ScanConfig]":
        """Depth along a walk of its own: a headset covers more of a room than the pictures do, more than once."""
        from hyjax.geometry.scan import RenderedDepths
        from hyjax.synthetic.room.path import camera_path

        config = scan_config()
        return RenderedDepths(self._surface.mesh, camera_path(config.frames, 256, 192)), config

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


def scan_config() -> "ScanConfig":
    """Scanner of the room's simulated scan."""
    from hyjax.geometry.scan import ScanConfig  # slow to load

    return ScanConfig(
        frames=64, width=160, max_depth=6.0, noise=0.004, min_weight=0.05, missing=0.03, grazing_cosine=0.15
    )


def rendered_size(size: tuple[int, int] | None) -> tuple[int, int]:
    """Height and width to render the room at, for pictures of a size: the nearest ones of its shape."""
    if size is None:
        return SIZE
    height, width = size
    share = max(1.0, SHORTEST_SIDE / min(size)) * min(1.0, (MOST_PIXELS / (height * width)) ** 0.5)
    return max(SHORTEST_SIDE, round(height * share)), max(SHORTEST_SIDE, round(width * share))


def load_room(
    seed: int = 0,
    n_frames: int = 24,
    width: int = SIZE[1],
    height: int = SIZE[0],
    cache_dir: Path | None = None,
    progress: bool = True,
    quality: float = 1.0,
) -> RoomCapture:
    """The built-in room, rendered on first use and read from the cache after that.

    Args:
        seed: varies books, colours and small placements.
        n_frames: pictures along the walk.
        width, height: of the pictures in pixels.
        cache_dir: where to keep it; None for `hyjax.util.cache.cache_folder()`.
        progress: show a bar on stderr while rendering.
        quality: of the light, see `render_room`.

    Raises:
        InputError: a size or the quality is out of range.
    """
    if seed < 0:
        raise InputError(f"room: seed is {seed}, must be 0 or more")
    folder = cache_folder() if cache_dir is None else Path(cache_dir)
    file = folder / f"room-v{VERSION}-seed{seed}-{n_frames}x{width}x{height}-q{quality:g}.npz"
    return cached_arrays(file, _capture, lambda: _render(folder, seed, n_frames, width, height, quality, progress))


def _render(
    folder: Path, seed: int, n_frames: int, width: int, height: int, quality: float, progress: bool
) -> Arrays:
    from hyjax.synthetic.room import camera_path, make_room, render_room

    room = make_room(seed)
    cameras = camera_path(room, n_frames, width, height)
    light_file = folder / f"room-light-v{VERSION}-seed{seed}-q{quality:g}.npz"  # for pictures of every size

    def kept(bake: Callable[[], np.ndarray]) -> np.ndarray:
        return cached_arrays(light_file, lambda arrays: arrays["irradiance"], lambda: {"irradiance": bake()})

    frames = render_room(room, cameras, quality, progress, keep=kept)
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
        MeshArrays(arrays["vertices"], arrays["faces"]),
        json.loads(str(arrays["anchors"])),
    )
