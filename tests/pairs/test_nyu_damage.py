"""NYU's labelled file as a stranger may make it: sizes that it does not hold, and arrays of other files."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from extras import need
from reference.pairs_export import export_nyu

from hyjax.pairs.nyu import NyuPairs
from hyjax.pairs.registry import open_pairs
from hyjax.util.errors import InputError


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("giant", "pictures of 30000x30000 pixels; at most"),
        ("one piece", "'rawDepths' is packed in pieces of over 256 MiB"),
        ("tiny pieces", "'images' has over 16384 pieces a picture"),
        ("link", "'rawDepths' lies in another place"),
        ("external", "'rawDepths' lies in another place"),
        ("text", "'rawDepths' must be numbers"),
    ],
)
def test_what_a_small_file_may_ask_for(tmp_path: Path, damage: str, message: str) -> None:
    need("nyu")
    import h5py

    file, depth = tmp_path / "nyu.mat", np.ones((6, 8))
    export_nyu(file, [np.zeros((6, 8, 3))], [depth], [depth])
    with h5py.File(file, "a") as stored:
        if damage == "giant":
            for name, shape in {"images": (1, 3), "depths": (1,), "rawDepths": (1,)}.items():
                del stored[name]
                stored.create_dataset(name, (*shape, 30_000, 30_000), np.uint8, chunks=True)
        elif damage == "tiny pieces":
            for name, shape in {"images": (1, 3), "depths": (1,), "rawDepths": (1,)}.items():
                del stored[name]
                size = (*shape, 1024, 1024)
                stored.create_dataset(name, size, np.uint8, chunks=(1,) * len(size))
        else:
            del stored["rawDepths"]
        if damage == "one piece":
            shape = (2**13, 2**8, 2**8)
            stored.create_dataset("rawDepths", shape, "f4", chunks=shape, compression="gzip")
        elif damage == "link":
            stored["rawDepths"] = h5py.ExternalLink(str(tmp_path / "other.mat"), "depths")
            export_nyu(tmp_path / "other.mat", [np.zeros((6, 8, 3))], [depth], [depth])
        elif damage == "external":
            (tmp_path / "secret").write_bytes(bytes(8 * 48))
            stored.create_dataset("rawDepths", (1, 8, 6), "f8", external=[(str(tmp_path / "secret"), 0, 8 * 48)])
        elif damage == "text":
            stored["rawDepths"] = np.full((1, 8, 6), b"abc")
    with pytest.raises(InputError, match=message):
        open_pairs(f"nyu:{file}")[0]


@pytest.mark.parametrize(
    ("times", "piece", "message"),
    [
        (1, (1, 8, 6), "a piece of '/images' is damaged at picture 0"),
        (2, (1, 8, 6), "'images' is packed in another way than by deflate"),
        (1, (1 << 22, 8, 6), "pieces of 'images' unpack to over 256 MiB a picture"),
    ],
)
def test_pieces_that_unpack_to_far_more(tmp_path: Path, times: int, piece: tuple[int, ...], message: str) -> None:
    """A piece of nothing, packed twice, took 3 GiB out of 124 KiB: HDF5 unpacks to the end, whatever it needs."""
    need("nyu")
    import h5py

    packed = bytes(1 << 24)
    for _ in range(times):
        packed = zlib.compress(packed)
    with h5py.File(tmp_path / "a.mat", "w") as file:
        for name, more, kind in ("images", (3,), "u1"), ("depths", (), "f4"), ("rawDepths", (), "f4"):
            count = piece[0] if name == "images" else 1
            made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            made.set_chunk((count, *([1] * len(more)), *piece[1:]))
            for _ in range(times):
                made.set_deflate(9)
            shape = (piece[0], *more, 16, 12)
            kept = h5py.h5d.create(
                file.id, name.encode(), h5py.h5t.py_create(np.dtype(kind)), h5py.h5s.create_simple(shape), made
            )
            kept.write_direct_chunk((0,) * len(shape), packed, 0)
    with pytest.raises(InputError, match=message):
        NyuPairs(tmp_path / "a.mat")[0]
