"""Rooms whose true pictures under any light are known, as captures kept in the cache folder."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.data.builtin_room import RoomCapture, room_arrays, room_parts, scan_config
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.scan import RenderedDepths
from hyjax.light.setup import LightSetup
from hyjax.synthetic.truth import TruthLight, TruthRoom, lit_room
from hyjax.synthetic.truth.room import VERSION, source_key, truth_exposure
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.files import digest
from hyjax.util.images import to_bytes

Picture = Float[np.ndarray, "h w 3"]


class TruthCapture(RoomCapture):
    """Photos of a room under its own light, with its true geometry and light.

    Attributes:
        exposure: e of the photos, each channel.
        mean_light: K, over all frames: see `TruthRoom`.
    """

    def __init__(self, name: str, arrays: Arrays, folder: Path, quality: float) -> None:
        super().__init__(*room_parts(arrays))
        self.name = name
        self.exposure, self.mean_light = arrays["exposure"], arrays["mean_light"]
        self._scan_poses, self._folder, self._quality = arrays["scan_poses"], folder, quality

    @functools.cached_property
    def _scanned(self) -> RenderedDepths:
        focal = 525.0 * 256 / 640
        cameras = [Camera(Intrinsics(256, 192, focal, focal, 128.0, 96.0), pose) for pose in self._scan_poses]
        return RenderedDepths(self._surface.mesh, cameras)

    @functools.cached_property
    def room(self) -> TruthRoom:
        """The room itself, made when first asked for."""
        return lit_room(self.name, self._quality)

    def photo_light(self) -> TruthLight:
        """The light that the photos were taken under."""
        return self.room.bake(self.room.sources, self._folder)

    def light(self, setup: LightSetup) -> TruthLight:
        """The light of a set-up with all its bounces, baked once."""
        return self.room.bake(setup.lights, self._folder)

    def truth(self, setup: LightSetup, frames: Sequence[int]) -> list[Picture]:
        """True pictures under a set-up, of some of the frames.

        Exposed so that light of the set-up's `reference_lux` stands for the photos' mean light: see `TruthRoom`.
        """
        return [self._kept_truth(setup, n) for n in frames]

    def _kept_truth(self, setup: LightSetup, n: int) -> Picture:
        """Picture of a frame under a set-up, from the cache folder if it was made before."""
        what = [source_key(setup.lights), repr(float(setup.reference_lux)), str(self._cameras[n].intrinsics)]
        key = digest([self.fingerprint, *what, self._cameras[n].pose.tobytes().hex(), str(n)])
        file = self._folder / "truth-pictures" / f"v{VERSION}-{self.name}-q{self._quality:g}-{key}.npz"

        def make() -> Arrays:
            exposure = truth_exposure(self.exposure, self.mean_light, setup.reference_lux)
            picture = self.room.photograph(self.light(setup), self._cameras[n], n, exposure)
            return {"picture": np.round(255 * picture).astype(np.uint8)}

        return cached_arrays(file, lambda arrays: arrays["picture"].astype(np.float32) / 255, make)


def load_truth_room(
    name: str = "builtin-0",
    n_frames: int = 24,
    width: int = 640,
    height: int = 480,
    cache_dir: Path | None = None,
    quality: float = 1.0,
) -> TruthCapture:
    """A room by name, photographed on first use and read from the cache after that.

    Args:
        name: see `hyjax.synthetic.truth.lit_room`.
        n_frames: photos along the walk.
        width, height: of the photos in pixels.
        cache_dir: where to keep it; None for `hyjax.util.cache.cache_folder()`.
        quality: of light and textures.

    Raises:
        InputError: no such room, or a quality out of range.
    """
    folder = cache_folder() if cache_dir is None else Path(cache_dir)
    file = folder / f"truth-room-v{VERSION}-{name}-{n_frames}x{width}x{height}-q{quality:g}.npz"

    def make() -> dict[str, np.ndarray]:
        return _photograph(lit_room(name, quality), folder, n_frames, width, height)

    return cached_arrays(file, lambda arrays: TruthCapture(name, arrays, folder, quality), make)


def _photograph(room: TruthRoom, folder: Path, n_frames: int, width: int, height: int) -> dict[str, np.ndarray]:
    light = room.bake(room.sources, folder)
    room.photo_light = light
    cameras = room.walks.photos(n_frames, width, height)
    images = np.stack([to_bytes(room.photograph(light, camera, n)) for n, camera in enumerate(cameras)])
    return room_arrays(images, cameras, MeshArrays.of(room.mesh), room.anchors) | {
        "scan_poses": np.stack([camera.pose for camera in room.walks.scan(scan_config().frames, 256, 192)]),
        "exposure": room.white,
        "mean_light": room.mean_light(light, cameras),
    }
