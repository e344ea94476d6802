"""The built-in room as a capture; its photographs come with the package, or are rendered once and kept."""

import dataclasses
import functools
import hashlib
import json
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8

from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.raycast import RayCaster
from hyjax.util.cache import Arrays, cache_folder, cached_arrays, keep_arrays, read_kept
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

if TYPE_CHECKING:
    import trimesh

    from hyjax.geometry.scan import RenderedDepths, ScanConfig
    from hyjax.synthetic.room import Room

VERSION = 7
"""Version of the room of `hyjax.synthetic.room`. Add one whenever its geometry or its pictures change."""
SIZE = (480, 640)
"""Height and width of its pictures where no other size is asked for."""
SHORTEST_SIDE, MOST_PIXELS = 16, 1280 * 960
"""Pixels: shortest side that is rendered, and most of a picture; others are resampled from there."""
FRAME_RATE = 2.0
"""Pictures a second: the walk takes twelve seconds."""
SHIPPED = "room-v7-seed0-24x640x480-q1"
"""Key of the room whose photographs come with the package."""
PHOTOGRAPHS = Path(__file__).parent / "room_photographs"
"""Folder of lossless pictures; `HYJAX_WRITE_ROOM=1 pytest -m "" tests/synthetic/test_room.py` renders them anew."""

UP = np.array([0.0, 0.0, 1.0])
_log = logging.getLogger(__name__)
_Image = UInt8[np.ndarray, "h w 3"]


class RoomCapture(Capture):
    """The built-in room: a capture whose true surface is known; z is up.

    Args:
        images: of the frames, an array or what gives them one by one.
        cameras: of the frames.
        mesh: the true surface.
        anchors: places for lights.
        key: of the pictures, where they are known without being looked at.
    """

    name = "room"

    def __init__(
        self,
        images: "UInt8[np.ndarray, 'n h w 3'] | _Awaited",
        cameras: list[Camera],
        mesh: "trimesh.Trimesh | MeshArrays",
        anchors: Mapping[str, Mapping[str, Any]],
        key: str | None = None,
    ) -> None:
        self.up = UP
        self._surface = MeshArrays.of(mesh)
        self.anchors = anchors
        self._images, self._cameras, self._key = images, cameras, key

    @functools.cached_property
    def fingerprint(self) -> str:
        poses = np.stack([camera.pose for camera in self._cameras])
        images: Any = self._images
        if self._key is None:
            pictures = [images[:: max(1, len(self) // 4)], np.array(images.shape[:3])]
        else:
            pictures = [np.frombuffer(self._key.encode(), np.uint8)]
        lenses = np.array([dataclasses.astuple(camera.intrinsics) for camera in self._cameras])
        parts = (self._surface.vertices, *pictures, poses, lenses)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()

    def camera(self, index: int) -> Camera:
        return self._cameras[index]

    @property
    def depth_count(self) -> int:
        return len(self)

    def reference(self) -> "trimesh.Trimesh":
        """The true surface in metres."""
        return self._surface.mesh

    @property
    def has_reference(self) -> bool:
        return True

    def scan_input(self) -> "tuple[RenderedDepths, ScanConfig]":
        """Depth along a walk of its own: a headset covers more of a room than the pictures do, more than once."""
        return self._scanned, scan_config()

    @functools.cached_property
    def _scanned(self) -> "RenderedDepths":
        """Depth that the surface, and its finer detail for shadows, are both scanned from."""
        from hyjax.geometry.scan import RenderedDepths
        from hyjax.synthetic.room.path import camera_path

        return RenderedDepths(self._surface.mesh, camera_path(scan_config().frames, 256, 192))

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, index: int) -> Frame:
        return dataclasses.replace(self.picture(index), depth=self.depth_reading(index).depth)

    def depth_reading(self, index: int) -> DepthReading:
        """See `Capture`; cast onto the true surface."""
        camera = self._cameras[index]
        hits = self._caster.cast(camera.origin, camera.rays().reshape(-1, 3))
        depth = np.where(hits.hit, hits.distance, 0.0).astype(np.float32)
        return DepthReading(depth.reshape(camera.intrinsics.shape), camera, None)

    def picture(self, index: int) -> Frame:
        """See `Capture`."""
        number = range(len(self))[index]
        image = self._images[number].astype(np.float32) / 255.0
        return Frame(f"{number:03d}", image, self._cameras[number], number / FRAME_RATE)

    @functools.cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self._surface)


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
    wait: bool = True,
) -> RoomCapture:
    """The built-in room, shipped or rendered on first use, and read from the cache after that.

    Args:
        seed: varies books, colours and small placements.
        n_frames: pictures along the walk.
        width, height: of the pictures in pixels.
        cache_dir: where to keep it; None for `hyjax.util.cache.cache_folder()`.
        progress: show a bar on stderr while rendering.
        quality: of the light, see `hyjax.synthetic.room.photographs`.
        wait: whether to wait until it is rendered; else whoever asks for a frame waits for that one.

    Raises:
        InputError: a size or the quality is out of range.
    """
    if seed < 0:
        raise InputError(f"room: seed is {seed}, must be 0 or more")
    folder = cache_folder() if cache_dir is None else Path(cache_dir)
    file = folder / f"room-v{VERSION}-seed{seed}-{n_frames}x{width}x{height}-q{quality:g}.npz"
    with _rendering:
        kept = read_kept(file, lambda arrays: RoomCapture(*room_parts(arrays), file.stem))
        if kept is not None:
            return kept
        if file not in _rooms or _rooms[file].is_broken_off:
            _rooms[file] = _Rendering(file, seed, n_frames, width, height, quality, progress)
        rendering = _rooms[file]
    if wait:
        rendering.wait()
    return rendering.capture


class _Rendering:
    """The room while it is rendered on a thread of its own, which ends with the process."""

    def __init__(
        self, file: Path, seed: int, n_frames: int, width: int, height: int, quality: float, progress: bool
    ) -> None:
        from hyjax.synthetic.room import camera_path, make_room

        self._room = make_room(seed)
        cameras = camera_path(n_frames, width, height)
        mesh = MeshArrays(np.asarray(self._room.mesh.vertices), np.asarray(self._room.mesh.faces))
        anchors = json.loads(json.dumps(self._room.anchors))
        self._images: list[Future[_Image]] = [Future() for _ in cameras]
        self._file, self._quality, self._progress = file, quality, progress
        self._light_file = file.parent / f"room-light-v{VERSION}-seed{seed}-q{quality:g}.npz"  # of all sizes
        self._ended = threading.Event()
        self.is_broken_off = False
        self.capture = RoomCapture(_Awaited(self._images), cameras, mesh, anchors, file.stem)
        threading.Thread(target=self._run, args=(cameras, mesh, anchors), name="room", daemon=True).start()

    def wait(self) -> None:
        """Wait until the room is kept; an interrupt breaks the rendering off."""
        try:
            self._ended.wait()
        except BaseException:
            self.is_broken_off = True
            raise
        self._images[-1].result()

    def _run(self, cameras: list[Camera], mesh: MeshArrays, anchors: Mapping[str, Any]) -> None:
        try:
            if self._file.stem == SHIPPED:
                shot = _shipped(len(cameras))
            else:
                shot = _rendered(self._room, cameras, self._quality, self._progress, self._light_file)
            for number, image in enumerate(shot):
                if self.is_broken_off:
                    raise CancelledError
                self._images[number].set_result(image)
            images = np.stack([future.result() for future in self._images])
            keep_arrays(self._file, room_arrays(images, cameras, mesh, anchors))
        except BaseException as error:
            self.is_broken_off = True
            waited_for = [future for future in self._images if not future.done()]
            for future in waited_for:
                future.set_exception(error)
            if not waited_for:
                _log.warning("%s: not kept: %s", self._file, error)
        finally:
            self._ended.set()
            with _rendering:
                if _rooms.get(self._file) is self:
                    del _rooms[self._file]


_rooms: dict[Path, _Rendering] = {}
_rendering = threading.Lock()


class _Awaited:
    """Pictures that are being rendered."""

    def __init__(self, images: "Sequence[Future[_Image]]") -> None:
        self._images = images

    def __getitem__(self, number: int) -> _Image:
        return self._images[number].result()


def _rendered(
    room: "Room", cameras: list[Camera], quality: float, progress: bool, light_file: Path
) -> Iterator[_Image]:
    from hyjax.synthetic.room import photographs

    def kept(bake: Callable[[], np.ndarray]) -> np.ndarray:
        return cached_arrays(light_file, lambda arrays: arrays["irradiance"], lambda: {"irradiance": bake()})

    return map(to_bytes, photographs(room, cameras, quality, progress, kept))


def _shipped(count: int) -> Iterator[_Image]:
    from PIL import Image

    for number in range(count):
        file = PHOTOGRAPHS / f"{number:03d}.webp"
        try:
            yield np.asarray(Image.open(file).convert("RGB"))
        except OSError as error:  # of Pillow, too
            raise InputError(
                f"{file}: a photograph of the built-in room is damaged ({error}); install hyjax anew"
            ) from None


def room_arrays(
    images: np.ndarray, cameras: Sequence[Camera], mesh: MeshArrays, anchors: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """Arrays of a room for its file, from what `RoomCapture` takes."""
    k = cameras[0].intrinsics
    return {
        "images": images,
        "poses": np.stack([camera.pose for camera in cameras]),
        "intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]),
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "anchors": np.array(json.dumps(anchors)),
    }


def room_parts(arrays: Arrays) -> tuple[np.ndarray, list[Camera], MeshArrays, Mapping[str, Any]]:
    """Parts of a room from the arrays of its file, see `room_arrays`."""
    height, width = arrays["images"].shape[1:3]
    intrinsics = Intrinsics(width, height, *(float(x) for x in arrays["intrinsics"]))
    cameras = [Camera(intrinsics, pose) for pose in arrays["poses"]]
    mesh, anchors = MeshArrays(arrays["vertices"], arrays["faces"]), json.loads(str(arrays["anchors"]))
    return arrays["images"], cameras, mesh, anchors
