"""Pairs from an endless row of random furnished rooms, which need no file: true depth and true normals."""

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8, UInt8, UInt16

from hyjax.cache import cache_folder
from hyjax.data.depth_pairs import DepthPair, Unit, digest
from hyjax.errors import InputError
from hyjax.files import whole
from hyjax.recent import Recent
from hyjax.scene.random_room import LitRoom, Shot, make_random_room, photograph

VERSION = 4
"""Of what `hyjax.scene.random_room` makes. Add one whenever its geometry or its pictures change."""
DEPTH_STEP = 0.0002
"""Metres that depth is rounded to, so that 16 bits reach 13 m."""
ROOMS_KEPT = 4
"""Rooms kept in memory: neighbours in a stream, and what a few threads work on."""

_log = logging.getLogger(__name__)


class _Stored(NamedTuple):
    """The views of a room as they are stored: colours in 8 bits, depth in `DEPTH_STEP`s, normals times 127."""

    image: UInt8[np.ndarray, "v s s 3"]
    depth: UInt16[np.ndarray, "v s s"]
    normal: Int8[np.ndarray, "v s s 3"]


class GeneratedRooms:
    """Random rooms as a source of pairs. Pair i is view i % views of room i // views, whoever asks and when.

    Neighbours share a room and come quickly in this order; every jump builds a room first.

    Attributes:
        name: "rooms".
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
            seed: another seed, other rooms.
            size: of the square pictures in pixels.
            views: pictures of each room.
            cached: keep finished rooms on disk, all views of a room at a time, for later epochs.
            cache_dir: where; None for `hyjax.cache.cache_folder()`.

        Raises:
            InputError: a number out of range.
        """
        if seed < 0 or views < 1 or not 32 <= size <= 4096:
            raise InputError(
                f"rooms: seed {seed}, views {views}, size {size}; need seed 0 or more, views 1 or more, "
                "size 32 to 4096"
            )
        self._seed, self._size, self._views = seed, size, views
        folder = cache_folder() if cache_dir is None else Path(cache_dir)
        self._folder = folder / f"rooms-v{VERSION}-seed{seed}-{size}x{views}" if cached else None
        self._rooms: Recent[LitRoom] = Recent(lambda number: make_random_room(seed, number), ROOMS_KEPT)
        self._stored: Recent[_Stored] = Recent(self._read_or_render, ROOMS_KEPT)

    @property
    def fingerprint(self) -> str:
        """See `DepthPairs`."""
        return digest([f"rooms v{VERSION} seed {self._seed} {self._size}x{self._views}"])

    def __len__(self) -> int:
        return 2**31 - 1

    def __getitem__(self, index: int) -> DepthPair:
        index = range(len(self))[index]
        number, view = divmod(index, self._views)
        if self._folder is None:
            stored, at = _rounded([photograph(self._rooms(number), view, self._size)]), 0
        else:
            stored, at = self._stored(number), view
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
        """All views of a room, from disk or new."""
        assert self._folder is not None
        file, shape = self._folder / f"{number:07d}.npz", (self._views, self._size, self._size)
        if file.is_file():
            try:
                return _read(file, shape)
            except Exception as error:  # Damage shows itself in a dozen ways; all mean the same.
                _log.warning("%s: damaged (%s), rendering the room again", file, error)
        room = make_random_room(self._seed, number)
        stored = _rounded([photograph(room, view, self._size) for view in range(self._views)])
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with whole(file) as part:
                np.savez_compressed(part, **stored._asdict())
        except (OSError, InputError) as error:
            _log.warning("%s: cannot keep the room (%s)", file, error)
        return stored


def _rounded(shots: list[Shot]) -> _Stored:
    return _Stored(
        np.stack([np.round(s.image * 255).astype(np.uint8) for s in shots]),
        np.stack([np.round(np.minimum(s.depth / DEPTH_STEP, 65535)).astype(np.uint16) for s in shots]),
        np.stack([np.round(s.normal * 127).astype(np.int8) for s in shots]),
    )


def _read(file: Path, shape: tuple[int, int, int]) -> _Stored:
    # Opened here, since np.load leaves a damaged file open.
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
        stored = _Stored(*(arrays[name] for name in _Stored._fields))
    if (stored.image.shape, stored.depth.shape, stored.normal.shape) != ((*shape, 3), shape, (*shape, 3)):
        raise ValueError("other pictures than asked for")
    return stored
