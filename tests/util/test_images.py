"""Pictures in and out: what is kept, what is refused, what is left behind."""

import contextlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import refusals

from hyjax.util.errors import InputError
from hyjax.util.images import read_depth, read_image, resize, write_exr, write_png


def refuses(path: Path, *parts: str, read=read_image) -> None:
    refusals.refuses(lambda: read(path), str(path), *parts)


def write_raw(path: Path, pixels: np.ndarray, kind: str) -> Path:
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind))
    assert target.write_image(np.ascontiguousarray(pixels))
    target.close()
    return path


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(0).random((37, 53, 3)).astype(np.float32)


def test_png_round_trip_is_exact_at_eight_bits(tmp_path: Path, picture: np.ndarray) -> None:
    stored = np.round(picture * 255) / 255
    write_png(tmp_path / "a.png", picture)
    back = read_image(tmp_path / "a.png")
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, stored, atol=1e-6)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def test_png_clips_and_rounds_to_the_nearest_step(tmp_path: Path) -> None:
    values = np.array([[-1.0, 0.0, 0.4 / 255, 0.6 / 255, 254.6 / 255, 1.0, 7.0]], np.float32)
    write_png(tmp_path / "a.png", values)
    np.testing.assert_array_equal(
        np.round(read_image(tmp_path / "a.png")[..., 0] * 255), [[0, 0, 0, 1, 255, 255, 255]]
    )


def test_exr_round_trip_keeps_what_a_half_holds(tmp_path: Path, picture: np.ndarray) -> None:
    linear = 40.0 * picture - 3.0
    write_exr(tmp_path / "a.exr", linear)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), linear.astype(np.float16).astype(np.float32))
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    assert str(source.spec().format) == "half"
    assert source.spec().getattribute("compression") == "zip"
    source.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.exr"]


def test_exr_clips_to_the_range_of_a_half_instead_of_infinity(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", np.array([[[1e6, -1e6, 1.0]]], np.float32))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), [[[65504, -65504, 1]]])


@pytest.mark.parametrize("write, suffix", [(write_png, "png"), (write_exr, "exr")])
def test_a_second_write_replaces_the_first(tmp_path: Path, picture: np.ndarray, write, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write(path, picture)
    write(path, np.zeros((4, 5, 3), np.float32))
    back = read_image(path)
    assert back.shape == (4, 5, 3) and not back.any()


def test_one_channel_pictures_may_lack_the_channel_axis(tmp_path: Path, picture: np.ndarray) -> None:
    write_exr(tmp_path / "a.exr", picture[..., 0])
    assert read_image(tmp_path / "a.exr").shape == (37, 53, 1)


def test_sixteen_bit_pictures_are_scaled_to_one(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "a.png", np.array([[[0], [32768], [65535]]], np.uint16), "uint16")
    np.testing.assert_allclose(read_image(path)[0, :, 0], [0, 32768 / 65535, 1], atol=1e-6)


@pytest.mark.parametrize("unit, scale", [(0.001, 1.0), (0.0002, 0.2)])
def test_depth_is_in_metres_and_zero_where_unread(tmp_path: Path, unit: float, scale: float) -> None:
    path = write_raw(tmp_path / "d.png", np.array([[[0], [65535], [1500], [65534]]], np.uint16), "uint16")
    depth = read_depth(path, unit)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, np.array([[0, 0, 1.5, 65.534]]) * scale, rtol=1e-6)


def test_depth_of_colour_is_refused(tmp_path: Path) -> None:
    path = write_raw(tmp_path / "d.png", np.zeros((4, 4, 3), np.uint16), "uint16")
    refuses(path, "one channel", read=read_depth)


def test_depth_of_eight_bits_is_refused(tmp_path: Path) -> None:
    """Stretched to 16 bits, a grey value of 100 would read as 25.7 m."""
    path = write_raw(tmp_path / "d.png", np.full((4, 4, 1), 100, np.uint8), "uint8")
    refuses(path, "16", read=read_depth)


@pytest.mark.parametrize("suffix", ["png", "jpg", "exr"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.95])
def test_truncated_pictures_are_refused(
    tmp_path: Path, picture: np.ndarray, suffix: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "exr":
        write_exr(path, np.tile(picture, (4, 4, 1)))
    else:
        write_raw(path, (np.tile(picture, (4, 4, 1)) * 255).astype(np.uint8), "uint8")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refuses(path, "damaged" if share > 0.1 else "picture")
    noise = capfd.readouterr()
    assert noise.out == "" and noise.err == "", "a library prints beside our one line"


def test_garbage_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for suffix in ("png", "jpg", "exr", "txt", ""):
        path = tmp_path / f"garbage.{suffix}"
        path.write_bytes(b"not a picture at all " * 100)
        refuses(path)
    assert capfd.readouterr().err == ""


def test_bytes_that_are_no_text_in_a_message_are_one_line(tmp_path: Path, picture: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, picture)
    for at in range(8, 330):
        content = bytearray(path.read_bytes())
        content[at] = 0xF9
        (tmp_path / "b.exr").write_bytes(content)
        with contextlib.suppress(InputError):
            read_image(tmp_path / "b.exr")


def test_a_giant_picture_is_refused_by_its_header(
    tmp_path: Path, picture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_png(tmp_path / "a.png", picture)
    monkeypatch.setenv("HYJAX_MOST_MEGAPIXELS", "8e-6")
    with pytest.raises(InputError, match=r"a\.png: \d+x\d+ pixels of .* set HYJAX_MOST_MEGAPIXELS"):
        read_image(tmp_path / "a.png")
    monkeypatch.setenv("HYJAX_MOST_MEGAPIXELS", "many")
    with pytest.raises(InputError, match="HYJAX_MOST_MEGAPIXELS: must be millions of pixels"):
        read_image(tmp_path / "a.png")


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    refuses(tmp_path / "none.png", "no such file")
    refuses(tmp_path, "is a folder")
    refuses(tmp_path / "none.png", "no such file", read=read_depth)


@pytest.mark.parametrize("write, suffix", [(write_png, "png"), (write_exr, "exr")])
def test_targets_that_cannot_be_written_are_one_line(
    tmp_path: Path, picture: np.ndarray, write, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / f"folder.{suffix}").mkdir()
    before = sorted(tmp_path.rglob("*"))
    targets = (tmp_path / "none" / f"a.{suffix}", tmp_path / "file" / f"a.{suffix}", tmp_path / f"folder.{suffix}")
    for target in targets:
        with pytest.raises(InputError) as caught:
            write(target, picture)
        assert str(target) in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before, "temporary files are left"
    assert capfd.readouterr().err == ""


def test_an_interrupted_write_leaves_the_old_file(
    tmp_path: Path, picture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    write_png(path, picture)
    before = path.read_bytes()

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_png(path, 1 - picture)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def centroid(picture: np.ndarray) -> tuple[float, float]:
    """Of the brightness, in continuous pixel coordinates (x, y): pixel j covers [j, j+1]."""
    weight = picture.sum(axis=2)
    y, x = (np.arange(n) + 0.5 for n in weight.shape)
    return float(weight.sum(0) @ x / weight.sum()), float(weight.sum(1) @ y / weight.sum())


@pytest.mark.parametrize("height, width", [(20, 30), (80, 120), (33, 47), (40, 25), (123, 61)])
def test_resize_aligns_edges_with_edges(height: int, width: int) -> None:
    """A spot keeps its place relative to the picture's edges, as `Intrinsics.resize` assumes."""
    y, x = np.mgrid[0:40, 0:60] + 0.5
    spot = np.exp(-((x - 19.3) ** 2 + (y - 24.8) ** 2) / 18.0)[..., None].astype(np.float32)
    small = resize(spot, height, width)
    assert small.shape == (height, width, 1)
    cx, cy = centroid(small)
    assert abs(cx - 19.3 * width / 60) < 0.05 * max(1, width / 60)
    assert abs(cy - 24.8 * height / 40) < 0.05 * max(1, height / 40)


def test_resize_keeps_constants_and_its_own_size(picture: np.ndarray) -> None:
    assert resize(picture, 37, 53) is picture
    for shape in ((5, 7), (100, 90)):
        np.testing.assert_allclose(resize(np.full((37, 53, 3), 0.7, np.float32), *shape), 0.7, atol=1e-5)


def test_a_png_is_not_written_under_another_formats_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.jpg: must end in \.png"):
        write_png(tmp_path / "a.jpg", np.zeros((4, 4, 3)))
    with pytest.raises(InputError, match=r"a\.png: must end in \.exr"):
        write_exr(tmp_path / "a.png", np.zeros((4, 4, 3)))
    assert not list(tmp_path.iterdir())
