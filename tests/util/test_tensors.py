"""Safetensors of strangers: a small file that asks for much, and none that is torch's."""

import json
import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from hyjax.guide.weights import read_weights
from hyjax.metrics.weights import load_lpips
from hyjax.util.errors import InputError
from hyjax.util.tensors import LARGEST_FILE, LARGEST_HEADER, read_tensors

MEMO = b"\x80\x02Nr" + struct.pack("<I", 0x7FFFFFF0) + b"."
"""A pickle of nothing, whose memo has two thousand million entries."""


def test_arrays_and_texts_come_back(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3)}
    safetensors.numpy.save_file(arrays, tmp_path / "a.safetensors", metadata={"encoder": "small"})
    found, texts = read_tensors(tmp_path / "a.safetensors")
    np.testing.assert_array_equal(found["a"], arrays["a"])
    assert texts == {"encoder": "small"}


def wide() -> bytes:
    """A header of as many empty arrays as fit."""
    entry = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    text = json.dumps({f"{k}": entry for k in range(LARGEST_HEADER // 50)}).encode()
    return struct.pack("<Q", len(text)) + text


@pytest.mark.parametrize("read", [read_tensors, read_weights, load_lpips])
@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.ckpt", MEMO, "not safetensors, or damaged"),
        ("a.pt", b"PK\x03\x04" + MEMO, "not safetensors, or damaged"),
        ("a.npz", b"PK\x03\x04" + bytes(100), "not safetensors, or damaged"),
        ("a.safetensors", wide(), r"damaged \(its header is too large\)"),
        ("a.safetensors", b"", "not safetensors, or damaged"),
    ],
)
def test_what_is_refused_takes_no_memory(
    tmp_path: Path, read: Callable[[Path], object], name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=reason):
            read(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 1 << 22
    finally:
        tracemalloc.stop()


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.safetensors").write_bytes(b"")
    os.truncate(tmp_path / "a.safetensors", LARGEST_FILE + 1)
    with pytest.raises(InputError, match="has over 1024 MiB; too large for its kind"):
        read_tensors(tmp_path / "a.safetensors")
