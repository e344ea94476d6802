"""Pairs from an endless row of random furnished rooms, without files: true depth and true normals."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8, UInt8, UInt16

from hyjax.pairs.depth_pairs import SELECTION_OPTIONS, DepthPair, Options, PairsKind, Unit
from hyjax.synthetic.random_room import RenderedView, make_random_room, photograph
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError
from hyjax.util.files import digest
from hyjax.util.images import to_bytes
from hyjax.util.lru_cache import LruCache

VERSION = 5
"""Version of the rooms of `hyjax.synthetic.random_room`. Add one when their geometry or pictures change."""
DEPTH_STEP = 0.0002
"""Step of rounded depth in metres, so that 16 bits reach 13 m."""
KEPT_ROOMS = 4
"""Number of rooms in memory: neighbours in a stream, and the work of a few threads."""


class _Stored(NamedTuple):
    """Stored views of a room: colours in 8 bits, depth in `DEPTH_STEP`s, normals times 127."""

    image: UInt8[np.ndarray, "v s s 3"]
    depth: UInt16[np.ndarray, "v s s"]
    normal: Int8[np.ndarray, "v s s 3"]


class GeneratedRooms:
    """Random rooms as a source of pairs. Pair i is always view i % views of room i // views.

    Neighbours share a room and come quickly in this order; every jump builds a room first.

    Attributes:
        unit: "metres".
    """

    name = "rooms"
    unit: Unit = "metres"

    def __init__(
        self,
        seed: int = 0,
        *,
        size: int = 352,
        views: int = 4,
        cached: bool = False,
        cache_dir: Path | None = None,
    ) -> None:
        """Choose a row of rooms.

        Args:
            size: of the square pictures in pixels.
            cached: keep finished rooms on disk, all views of a room at a time, for later epochs.
            cache_dir: where; None for `hyjax.util.cache.cache_folder()`.
        """
        if seed < 0 or views < 1 or not 32 <= size <= 4096:
            raise InputError(
                f"rooms: seed {seed}, views {views}, size {size}; need seed 0 or more, views 1 or more, "
                "size 32 to 4096"
            )
        self._seed, self._size, self._views = seed, size, views
        folder = cache_folder() if cache_dir is None else Path(cache_dir)
        self._folder = folder / f"rooms-v{VERSION}-seed{seed}-{size}x{views}" if cached else None
        self._rooms, self._stored = LruCache(KEPT_ROOMS), LruCache(KEPT_ROOMS)

    @property
    def fingerprint(self) -> str:
        return digest([f"rooms v{VERSION} seed {self._seed} {self._size}x{self._views}"])

    def __len__(self) -> int:
        return 2**31 - 1

    def __getitem__(self, index: int) -> DepthPair:
        index = range(len(self))[index]
        number, view = divmod(index, self._views)
        if self._folder is None:
            room = self._rooms(number, lambda: make_random_room(self._seed, number))
            stored, at = _rounded([photograph(room, view, self._size)]), 0
        else:
            stored, at = self._stored(number, lambda: self._read_or_render(number)), view
        normal = stored.normal[at].astype(np.float32)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1.0)
        return DepthPair(
            name=f"{number:07d}-{view}",
            image=stored.image[at].astype(np.float32) / 255,
            depth=stored.depth[at].astype(np.float32) * np.float32(DEPTH_STEP),
            valid=stored.depth[at] > 0,
            unit=self.unit,
            normal=normal,
        )

    def _read_or_render(self, number: int) -> _Stored:
        """Read all views of a room, or render them."""
        assert self._folder is not None
        file, shape = self._folder / f"{number:07d}.npz", (self._views, self._size, self._size)

        def parse(arrays: Arrays) -> _Stored:
            stored = _Stored(**arrays)
            if (stored.image.shape, stored.depth.shape, stored.normal.shape) != ((*shape, 3), shape, (*shape, 3)):
                raise ValueError("other pictures than asked for")
            return stored

        def make() -> Arrays:
            room = make_random_room(self._seed, number)
            return _rounded([photograph(room, view, self._size) for view in range(self._views)])._asdict()

        return cached_arrays(file, parse, make, compressed=True)


def _rounded(shots: list[RenderedView]) -> _Stored:
    return _Stored(
        np.stack([to_bytes(s.image) for s in shots]),
        np.stack([np.round(np.minimum(s.depth / DEPTH_STEP, 65535)).astype(np.uint16) for s in shots]),
        np.stack([np.round(s.normal * 127).astype(np.int8) for s in shots]),
    )


def _open(path: Path, options: Options) -> GeneratedRooms:
    def number(name: str, default: int) -> int:
        value = options.get(name, str(default))
        if not value.isdecimal():
            raise InputError(f"pairs: rooms?{name}={value} must be a whole number, 0 or more")
        return int(value)

    if options.keys() & set(SELECTION_OPTIONS):
        parts = [part.split(":") for part in options.get("frames", "all").split(",")]
        if not all(part[min(1, len(part) - 1)].strip().isdecimal() for part in parts):
            raise InputError("pairs: rooms are endless; name the first and the last as in rooms?frames=0:2000")
    cached = options.get("cached", "no")
    if cached not in ("yes", "no"):
        raise InputError(f"pairs: rooms?cached={cached} must be yes or no")
    return GeneratedRooms(
        number("seed", 0), size=number("size", 352), views=number("views", 4), cached=cached == "yes"
    )


KIND = PairsKind("rooms", _open, ("seed", "size", "views", "cached"), has_path=False)
