"""NYU's labelled file as a stranger may make it: sizes that it does not hold, and arrays of other files."""

from pathlib import Path

import numpy as np
import pytest
from extras import need
from reference.pairs_export import export_nyu

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
