"""NYU Depth v2, the labelled part: `nyu_depth_v2_labeled.mat`, a MATLAB 7.3 file, which is HDF5.

Its arrays are MATLAB's with the axes in reverse order:

    images      n × 3 × width × height, 8 bits
    depths      n × width × height, metres, holes filled in
    rawDepths   n × width × height, metres, 0 where there was no reading

Filled-in depth was painted in under the picture's colours, so pixels without a reading do not count.

Source: Silberman et al., "Indoor segmentation and support inference from RGBD images", ECCV 2012;
cs.nyu.edu/~fergus/datasets/nyu_depth_v2.html.
"""

import contextlib
import importlib
import itertools
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hyjax.pairs.depth_pairs import DepthPair, PairsKind, Unit, masked_pair
from hyjax.util.errors import InputError
from hyjax.util.files import digest
from hyjax.util.reading import check_regular

ARRAYS = {"images": 4, "depths": 3, "rawDepths": 3}
"""Numbers of axes of the arrays, by name."""
MOST_PIXELS = 1 << 22
"""Most pixels of a picture; the published ones have 640 x 480. HDF5 may declare data that it lacks."""
MOST_CHUNK_BYTES = 1 << 28
"""Most bytes of an array that are unpacked for a picture: all chunks that hold a part of it."""
PACKINGS: tuple[list[int], ...] = ([], [1], [2, 1], [3], [1, 3], [2, 1, 3])
"""Filters of HDF5 in turn: deflate (1) once at most, shuffled (2) before and a checksum (3) after it."""
MOST_CHUNKS = 1 << 14
"""Most chunks of a picture: HDF5 looks for each, those that the file lacks, too."""


class NyuPairs:
    """Pairs (`DepthPairs`) of a labelled file."""

    unit: Unit = "metres"

    def __init__(self, path: Path) -> None:
        self.name, self._path = path.stem, path
        with self._opened("damaged") as file:
            for name, axes in ARRAYS.items():
                if name not in file or getattr(file[name], "ndim", 0) != axes:
                    raise InputError(
                        f"{path}: has no array {name!r} of {axes} axes; give nyu_depth_v2_labeled.mat as published"
                    )
                _check_stored(path, file, name)
            shapes = {name: file[name].shape for name in ARRAYS}
            images, depths, raw = shapes.values()
            if images[1] != 3 or depths != raw or depths != (images[0], *images[2:]) or 0 in images:
                raise InputError(f"{path}: arrays do not belong together: {shapes}")
            if images[2] * images[3] > MOST_PIXELS:
                raise InputError(
                    f"{path}: pictures of {images[2]}x{images[3]} pixels; at most {MOST_PIXELS} are read"
                )
            for name in ARRAYS:
                _check_packing(path, file[name], name)
        self._count = int(images[0])

    @property
    def fingerprint(self) -> str:
        return digest([self._path.name, str(self._path.stat().st_size)])

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> DepthPair:
        index = range(self._count)[index]
        with self._opened(f"damaged at picture {index}") as file:
            for name in ARRAYS:
                _check_pieces(self._path, file[name], index)
            image, depth, raw = (np.asarray(file[name][index]).T for name in ARRAYS)
        image = image.astype(np.float32) / 255
        where = f"{self._path} {index}"
        return masked_pair(f"{index:04d}", image, depth, self.unit, where=where, valid=raw > 0)

    @contextlib.contextmanager
    def _opened(self, damage: str) -> Iterator[Any]:
        """Open file; every error of h5py becomes an `InputError`."""
        try:
            h5py = importlib.import_module("h5py")
        except ModuleNotFoundError:
            raise InputError(f"{self._path}: needs h5py; install it with: pip install 'hyjax[nyu]'") from None
        check_regular(self._path)
        try:
            file = h5py.File(self._path, "r")
        except Exception:  # OSError, RuntimeError, KeyError: damage shows itself in many ways
            raise InputError(f"{self._path}: not a readable HDF5 file (MATLAB 7.3); download it again") from None
        with file:
            try:
                yield file
            except InputError:
                raise
            except Exception as error:  # as above
                raise InputError(f"{self._path}: {damage} ({error})") from None


def _check_stored(path: Path, file: Any, name: str) -> None:
    """Raise `InputError` for an array that other files hold, or that is unpacked as a whole, or of no numbers."""
    array, link = file[name], file.get(name, getlink=True)
    if type(link).__name__ != "HardLink" or array.external or array.is_virtual:
        raise InputError(f"{path}: {name!r} lies in another place; give the file as published")
    if array.dtype.kind not in "fu":
        raise InputError(f"{path}: {name!r} must be numbers, got {array.dtype}")
    if array.chunks and math.prod(array.chunks) * array.dtype.itemsize > MOST_CHUNK_BYTES:
        raise InputError(f"{path}: {name!r} is packed in pieces of over {MOST_CHUNK_BYTES >> 20} MiB")
    pieces = [-(-side // piece) for side, piece in zip(array.shape[1:], (array.chunks or array.shape)[1:]) if piece]
    if math.prod(pieces) > MOST_CHUNKS:
        raise InputError(f"{path}: {name!r} has over {MOST_CHUNKS} pieces a picture; give the file as published")


def _check_packing(path: Path, array: Any, name: str) -> None:
    """Raise `InputError` for an array of which a picture needs too much, or that is packed more than once."""
    pieces = [-(-side // piece) for side, piece in zip(array.shape[1:], (array.chunks or array.shape)[1:])]
    if array.chunks and math.prod(pieces) * math.prod(array.chunks) * array.dtype.itemsize > MOST_CHUNK_BYTES:
        raise InputError(f"{path}: pieces of {name!r} unpack to over {MOST_CHUNK_BYTES >> 20} MiB a picture")
    packing = array.id.get_create_plist()
    steps = [packing.get_filter(number)[0] for number in range(packing.get_nfilters())]
    if steps not in PACKINGS:
        raise InputError(f"{path}: {name!r} is packed in another way than by deflate; give the file as published")


def _check_pieces(path: Path, array: Any, index: int) -> None:
    """Raise `InputError` for a piece of a picture that unpacks to more than it holds: HDF5 has no bound."""
    if not (array.chunks and array.compression):
        return
    whole = math.prod(array.chunks) * array.dtype.itemsize
    starts = (range(0, side, piece) for side, piece in zip(array.shape[1:], array.chunks[1:]))
    for corner in itertools.product([index // array.chunks[0] * array.chunks[0]], *starts):
        try:
            left_out, packed = array.id.read_direct_chunk(corner)
        except (OSError, RuntimeError, ValueError):  # never written; other damage shows itself when it is read
            continue
        if left_out or len(zlib.decompressobj().decompress(packed, whole + 1)) > whole:
            raise InputError(f"{path}: a piece of {array.name!r} is damaged at picture {index}")


KIND = PairsKind("nyu", lambda path, options: NyuPairs(path))
