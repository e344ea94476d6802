"""Videos of strangers: small files that ask for much, and files that name others."""

import struct
from pathlib import Path

import numpy as np
import pytest
from extras import need

from hyjax.data import video_frames
from hyjax.data.trees import open_tree
from hyjax.data.video_frames import VideoFrames
from hyjax.util.errors import InputError

need("captures")
import av

YCGCO = 8
"""Matrix of colours, by FFmpeg's numbers, that its scaler lacks."""


def write(
    path: Path, width: int = 64, height: int = 48, form: str = "mp4", color: int | None = None, **options: str
) -> bytes:
    with av.open(str(path), "w", format=form, options=options) as container:
        stream = container.add_stream("libx264", rate=30, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        if color is not None:
            stream.codec_context.colorspace = color
        for _ in range(2):
            pixels = np.zeros((height, width, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    return path.read_bytes()


def changed(content: bytes, kind: bytes, behind: int, *numbers: int) -> bytes:
    at = content.index(kind) + behind
    return content[:at] + struct.pack(f">{len(numbers)}I", *numbers) + content[at + 4 * len(numbers) :]


def opened(path: Path) -> VideoFrames:
    return VideoFrames(open_tree(path), path.name)


@pytest.mark.parametrize("kind", ["stsz", "stts", "ctts"])
def test_tables_that_count_more_than_there_is(tmp_path: Path, kind: str) -> None:
    """2.5 KiB took 4 GiB."""
    path = tmp_path / "rgb.mp4"
    content = write(path)
    count = 60_000_000
    content = changed(content, b"stsc", 16, count)
    if kind == "stsz":
        content = changed(changed(content, b"stsz", 8, 1, count), b"stts", 12, count)
    elif kind == "stts":
        content = changed(content, b"stts", 12, count)
    else:  # a table that the writer did not make, in the place of another
        content = changed(content.replace(b"stss", b"ctts"), b"ctts", 8, 1, count)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"rgb.mp4: not a readable video \(it counts more pictures than it has"):
        opened(path)


def test_fragments_that_count_more_than_there_is(tmp_path: Path) -> None:
    path = tmp_path / "rgb.mp4"
    content = write(path, movflags="frag_keyframe+empty_moov")
    assert len(opened(path)) == 2
    path.write_bytes(changed(content, b"trun", 8, 60_000_000))
    with pytest.raises(InputError, match="it counts more pictures than it has bytes"):
        opened(path)


def test_packed_tables(tmp_path: Path) -> None:
    path = tmp_path / "rgb.mp4"
    path.write_bytes(write(path).replace(b"mdia", b"cmov"))
    with pytest.raises(InputError, match="its tables are packed"):
        opened(path)


def test_tables_a_thousand_times(tmp_path: Path) -> None:
    path = tmp_path / "rgb.mp4"
    tables = struct.pack(">I4s", 8 + 400_000, b"free") + (b"stts" + struct.pack(">I", 1 << 20)) * 50_000
    path.write_bytes(write(path) + tables)
    with pytest.raises(InputError, match="over 64 tracks"):
        opened(path)


def test_pictures_that_are_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rgb.mp4"
    write(path, 8208, 4400)
    with pytest.raises(InputError, match=r"rgb.mp4: pictures of 8208x4400 pixels; at most 35651584 are read"):
        opened(path)
    write(path)
    monkeypatch.setattr(video_frames, "LIMITS", {"max_pixels": "100"})  # the decoder holds to it, too
    with pytest.raises(InputError, match=r"rgb.mp4: (picture 0 cannot be decoded|not a readable video)"):
        opened(path).read(0)


def test_colours_that_are_not_converted(tmp_path: Path) -> None:
    path = tmp_path / "rgb.mp4"
    write(path, color=YCGCO)
    assert opened(path).shape == (48, 64)
    with pytest.raises(InputError, match=r"rgb.mp4: picture 0 cannot be decoded \(.*not supported"):
        opened(path).read(0)


@pytest.mark.parametrize("kind", ["playlist", "list", "transport stream"])
def test_what_is_no_mp4_is_not_read_whatever_its_name(tmp_path: Path, kind: str) -> None:
    """FFmpeg would open the files that a list names."""
    path, other = tmp_path / "rgb.mp4", tmp_path / "other.ts"
    content = write(other, form="mpegts")
    if kind == "playlist":
        content = b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nother.ts\n#EXT-X-ENDLIST\n"
    elif kind == "list":
        content = b"ffconcat version 1.0\nfile other.ts\n"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"rgb.mp4: not a readable video"):
        opened(path)
