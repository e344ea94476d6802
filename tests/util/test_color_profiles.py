"""Colour profiles of pictures."""

import logging
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms

from hyjax.util.color_profiles import to_srgb
from hyjax.util.images import read_image

P3 = np.array([[0.5151, 0.2919, 0.1572], [0.2412, 0.6922, 0.0666], [-0.0011, 0.0419, 0.7841]])
"""Columns: red, green and blue of Display P3 in XYZ, adapted to D50."""
SRGB = np.array([[0.4361, 0.3851, 0.1431], [0.2225, 0.7169, 0.0606], [0.0139, 0.0971, 0.7141]])
GAMMA = 2.19921875


def profile(name: bytes = b"Display P3", primaries: np.ndarray = P3) -> bytes:
    """ICC profile of three primaries and a power."""

    def xyz(values: np.ndarray) -> bytes:
        return b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(65536 * v) for v in values))

    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(256 * GAMMA)) + b"\0\0"
    text = b"desc\0\0\0\0" + struct.pack(">I", len(name) + 1) + name + bytes(79 + 1 + (-len(name)) % 4)
    tags = {b"desc": text, b"wtpt": xyz(np.array([0.9642, 1.0, 0.8249])), b"cprt": b"text\0\0\0\0none\0\0\0\0"}
    tags |= {key: xyz(primaries[:, k]) for k, key in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    table, body, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for key, content in tags.items():
        content += bytes(-len(content) % 4)
        table += key + struct.pack(">II", start + len(body), len(content))
        body += content
    head = struct.pack(
        ">I4sI4s4s4s12s4s4s", 0, b"lcms", 0x02100000, b"mntr", b"RGB ", b"XYZ ", bytes(12), b"acsp", b""
    )
    head = head.ljust(68, b"\0") + struct.pack(">3i", 63190, 65536, 54061)
    whole = head.ljust(128, b"\0") + table + body
    return struct.pack(">I", len(whole)) + whole[4:]


def pixels() -> np.ndarray:
    return np.random.default_rng(0).integers(70, 180, (6, 8, 3)).astype(np.uint8)


def expected(values: np.ndarray) -> np.ndarray:
    """sRGB of pixels in P3, with a power for a curve."""
    linear = (values / 255.0) ** GAMMA @ (np.linalg.inv(SRGB) @ P3).T
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_a_photo_in_p3_is_read_as_srgb(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"photo.{ending}"
    values = np.kron(pixels(), np.ones((8, 8, 1), np.uint8))
    Image.fromarray(values).save(file, icc_profile=profile(), quality=100, subsampling=0)
    read = read_image(file)
    assert np.abs(read - expected(np.asarray(Image.open(file)))).max() < 2.5 / 255
    assert np.abs(read - values / 255.0).max() > 8 / 255, "it was not taken for sRGB"


def test_srgb_and_what_has_no_colours_stay_as_they_are(tmp_path: Path) -> None:
    values = pixels()
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(values).save(tmp_path / "photo.png", icc_profile=srgb)
    np.testing.assert_array_equal(read_image(tmp_path / "photo.png"), values * np.float32(1 / 255))
    np.testing.assert_array_equal(to_srgb(values[..., :1], profile()), values[..., :1])
    with_alpha = np.concatenate([values, values[..., :1]], axis=-1)
    converted = to_srgb(with_alpha, profile())
    np.testing.assert_array_equal(converted[..., 3], values[..., 0])
    assert np.abs(converted[..., :3] / 255.0 - expected(values)).max() < 2.5 / 255


@pytest.mark.parametrize("damaged", [b"no profile", profile()[:150], bytes(1 << 23)])
def test_a_profile_that_cannot_be_used_is_one_line(damaged: bytes, caplog: pytest.LogCaptureFixture) -> None:
    values = pixels()
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(to_srgb(values, damaged), values)
        to_srgb(values, damaged)
    assert len(caplog.records) == 1 and "taken for sRGB" in caplog.text
