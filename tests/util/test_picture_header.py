"""Pictures that are refused by what their headers say, before any library reads them."""

import contextlib
import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hyjax.util import picture_header
from hyjax.util.errors import InputError
from hyjax.util.images import picture_shape, read_image, write_exr, write_png

PIXELS = np.linspace(0.0, 1.0, 12 * 16 * 3, dtype=np.float32).reshape(12, 16, 3)


def refuses(path: Path, says: str) -> None:
    for read in (read_image, picture_shape):
        with pytest.raises(InputError, match=says):
            read(path)


def jpeg(**options: object) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.uint8(255 * PIXELS)).save(stream, "JPEG", **options)
    return stream.getvalue()


def with_size(content: bytes, width: int, height: int) -> bytes:
    """A JPEG that says it is of another size."""
    at = max(content.find(b"\xff\xc0"), content.find(b"\xff\xc2"))
    return content[: at + 5] + struct.pack(">2H", height, width) + content[at + 9 :]


def chunks_of(content: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        found.append((kind, content[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def png(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """With the checksums of its chunks."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, value in chunks:
        parts += [struct.pack(">I", len(value)), kind, value, struct.pack(">I", zlib.crc32(kind + value))]
    return b"".join(parts)


@pytest.mark.parametrize("progressive", [False, True])
def test_a_jpeg_that_says_it_is_giant(tmp_path: Path, progressive: bool) -> None:
    (tmp_path / "a.jpg").write_bytes(with_size(jpeg(progressive=progressive), 65500, 65500))
    refuses(tmp_path / "a.jpg", "65500x65500 pixels")


def test_a_jpeg_of_a_thousand_scans(tmp_path: Path) -> None:
    content = with_size(jpeg(progressive=True), 4000, 4000)
    scan = content[content.index(b"\xff\xda") : -2]
    (tmp_path / "a.jpg").write_bytes(content[:-2] + 1000 * scan + content[-2:])
    refuses(tmp_path / "a.jpg", r"4000x4000 pixels in \d+ scans; too many")


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"restart_marker_blocks": 1}])
def test_what_follows_a_jpegs_end_is_no_scan(
    tmp_path: Path, options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As phones write it: a film or a second picture."""
    monkeypatch.setattr(picture_header, "MOST_PASSES", 4000)
    (tmp_path / "a.jpg").write_bytes(jpeg(**options) + 100 * b"\xff\xda\0\2")
    assert read_image(tmp_path / "a.jpg").shape == (12, 16, 3)


def test_a_png_that_says_it_is_giant(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", PIXELS)
    (kind, header), *rest = chunks_of((tmp_path / "a.png").read_bytes())
    sizes = {(1 << 20, 1 << 20): "1048576x1048576", (0, 5): "damaged", (5000, 5000): "a byte are"}
    for (width, height), says in sizes.items():
        (tmp_path / "a.png").write_bytes(png([(kind, struct.pack(">2I", width, height) + header[8:]), *rest]))
        refuses(tmp_path / "a.png", says)


def test_an_exr_that_says_it_is_giant(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", PIXELS)
    content = (tmp_path / "a.exr").read_bytes()
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    (tmp_path / "a.exr").write_bytes(content[:at] + struct.pack("<4i", 0, 0, 99999, 99999) + content[at + 16 :])
    refuses(tmp_path / "a.exr", "100000x100000 pixels")


def test_an_exr_of_many_channels_is_refused_by_all_its_values() -> None:
    picture_header.check_size(8000, 8000, 4, "a.exr")
    picture_header.check_size(100, 100, 400, "a.exr")
    with pytest.raises(InputError, match=r"a\.exr: 8000x8000 pixels of 5 channel"):
        picture_header.check_size(8000, 8000, 5, "a.exr")


def test_the_limit_can_be_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"at most 64 million are read, .* HYJAX_MOST_MEGAPIXELS"):
        picture_header.check_size(10_000, 10_000, 1, "a.png")
    monkeypatch.setenv("HYJAX_MOST_MEGAPIXELS", "100")
    picture_header.check_size(10_000, 10_000, 1, "a.png")


def test_an_exr_whose_header_is_no_utf8(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_exr(tmp_path / "a.exr", PIXELS)
    content = (tmp_path / "a.exr").read_bytes()
    for byte in (0xB0, 0xFF):
        (tmp_path / "a.exr").write_bytes(content.replace(b"chlist", bytes([byte]) + b"hlist", 1))
        refuses(tmp_path / "a.exr", r"a\.exr: ")
    assert capfd.readouterr().err == ""


def test_no_chunk_of_a_png_makes_libpng_talk(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Damaged anywhere, or with a chunk that is missing, doubled or out of place."""
    write_png(tmp_path / "a.png", PIXELS)
    content = (tmp_path / "a.png").read_bytes()
    chunks = chunks_of(content)
    contents = [content[:at] + bytes([content[at] ^ 0x55]) + content[at + 1 :] for at in range(0, len(content), 7)]
    contents += [png(chunks[:k] + chunks[k + 1 :]) for k, (kind, _) in enumerate(chunks) if kind != b"IDAT"]
    kinds = (b"ABCD", b"PLTE", b"cHrM")
    contents += [png([*chunks[:k], (kind, b"\0"), *chunks[k:]]) for k in range(1, 9) for kind in kinds]
    contents += [png([(b"IHDR", chunks[0][1][:8] + bytes(form)), *chunks[1:]]) for form in ((8, 3), (1, 2), (7, 7))]
    for number, damaged in enumerate(contents):
        (tmp_path / "b.png").write_bytes(damaged)
        with contextlib.suppress(InputError):
            read_image(tmp_path / "b.png")
        assert capfd.readouterr().err == "", number


def test_pngs_of_other_programs_may_have_more_behind_them_and_damaged_comments(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", PIXELS)
    content = (tmp_path / "a.png").read_bytes()
    comment = struct.pack(">I4s", 3, b"tEXt") + b"a\0b" + bytes(4)
    for number, other in enumerate((content + b"\n", content[:33] + comment + content[33:])):
        (tmp_path / f"{number}.png").write_bytes(other)
        np.testing.assert_array_equal(read_image(tmp_path / f"{number}.png"), read_image(tmp_path / "a.png"))


def test_formats_are_known_by_their_content(tmp_path: Path) -> None:
    for name, content in {"a.png": jpeg(), "a.tif": jpeg(), "a": jpeg()}.items():
        (tmp_path / name).write_bytes(content)
        assert read_image(tmp_path / name).shape == (12, 16, 3)
    Image.fromarray(np.uint8(255 * PIXELS)).save(tmp_path / "b.gif")
    refuses(tmp_path / "b.gif", "read are PNG, JPEG, OpenEXR, PNM, TIFF, WebP and BMP")


@pytest.mark.parametrize("form", ["TIFF", "WebP", "BMP"])
def test_formats_whose_headers_openimageio_reads(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = np.uint8(255 * PIXELS)
    Image.fromarray(picture).save(tmp_path / "a", form, lossless=True)
    np.testing.assert_allclose(255 * read_image(tmp_path / "a"), picture, atol=1e-4)
    assert picture_shape(tmp_path / "a") == (12, 16)
    monkeypatch.setenv("HYJAX_MOST_MEGAPIXELS", "1e-4")
    refuses(tmp_path / "a", "16x12 pixels of 3 channel")


def test_whole_steps_are_scaled_as_openimageio_does(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    for kind in ("uint8", "uint16"):
        steps = np.arange(np.iinfo(kind).max + 1, dtype=kind).reshape(-1, 256, 1)
        target = oiio.ImageOutput.create(str(tmp_path / "a.png"))
        target.open(str(tmp_path / "a.png"), oiio.ImageSpec(256, len(steps), 1, kind))
        target.write_image(steps)
        target.close()
        source = oiio.ImageInput.open(str(tmp_path / "a.png"))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), source.read_image("float"))
        source.close()


def test_a_pipe_is_no_picture(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    refuses(tmp_path / "a.png", "a pipe")
