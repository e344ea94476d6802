"""Pictures of a video file, in any order, without holding more than a few of them.

Needs the package `av` (PyAV, which brings FFmpeg's libraries).
"""

import bisect
import contextlib
import threading
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from hyjax.data.file_tree import FileTree
from hyjax.data.mp4_boxes import check_counts
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.reading import open_regular

if TYPE_CHECKING:
    import av

UNTOLD, REC_709, LIMITED_RANGE = 2, 1, 1
"""Colour matrices and a range of values by FFmpeg's numbers."""
ENCODERS = ("libx264", "libx265", "hevc", "h264")
"""Video encoders, the first that FFmpeg has is taken."""
MOST_PIXELS = 8192 * 4352
"""Most pixels of a picture: those of H.265's highest level, a little over 8K."""
LIMITS = {"max_pixels": str(MOST_PIXELS)}
"""Options of decoders, for pictures that are larger than the file says at first."""
FORMAT = "mov"
"""FFmpeg's name of MP4 and QuickTime; others, such as lists of other files, are not read."""


class VideoFrames:
    """Pictures of a video by their position in order of time.

    Read in order, each is decoded once; otherwise decoding starts at the key frame before. Threads may read at the
    same time; they wait for each other. Pictures are as they are stored: a rotation that players would apply is not
    applied, as intrinsics are of the stored ones.

    Args:
        tree: of the file; from an archive it is copied to a temporary file, which lives as long as this object.
    """

    def __init__(self, tree: FileTree, name: str) -> None:
        av = import_av(tree.where(name))
        self._where = tree.where(name)
        self._lock = threading.Lock()
        with contextlib.ExitStack() as stack:
            path = stack.enter_context(tree.local(name))
            with open_regular(path, self._where) as file:
                check_counts(file, self._where)
            self._errors = (av.error.FFmpegError, OSError, ValueError, EOFError)
            try:
                self._times, self._keys = _index(av, path)
                self._container = stack.enter_context(_opened(av, path))
                self._stream = self._container.streams.video[0]
                self._stream.thread_type = "AUTO"
                context = self._stream.codec_context
                context.options = LIMITS
                self.shape = (int(context.height), int(context.width))
            except (*self._errors, IndexError, AttributeError) as error:  # of a stream without a decoder
                raise InputError(f"{self._where}: not a readable video ({_line(error)})") from None
            if not self._times or not self._keys or min(self.shape) < 1:
                raise InputError(f"{self._where}: holds no video pictures")
            if self.shape[0] * self.shape[1] > MOST_PIXELS:
                sides = f"{self.shape[1]}x{self.shape[0]}"
                raise InputError(f"{self._where}: pictures of {sides} pixels; at most {MOST_PIXELS} are read")
            weakref.finalize(self, stack.pop_all().close)
        self._decoded: Iterator[Any] | None = None
        self._next = 0

    def __len__(self) -> int:
        return len(self._times)

    def read(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """The picture at a position, display-encoded in [0, 1]."""
        if not 0 <= index < len(self):
            raise InputError(f"{self._where}: has {len(self)} pictures, none at position {index}")
        with self._lock:
            # Of streams with open groups of pictures, those right behind a key frame need the one before it.
            last_key = bisect.bisect_right(self._keys, self._times[index]) - 1
            for key in (last_key, last_key - 1, 0):
                try:
                    frame = self._find(index, max(key, 0))
                    pixels = None if frame is None else _colours(frame)
                except self._errors as error:
                    self._decoded = None
                    raise InputError(f"{self._where}: picture {index} cannot be decoded ({_line(error)})") from None
                if pixels is not None:
                    return pixels.astype(np.float32) / np.float32(255.0)
        raise InputError(f"{self._where}: picture {index} cannot be decoded; the video is damaged there")

    def _find(self, index: int, key: int) -> "av.VideoFrame | None":
        """The picture at a position, by decoding on, or anew from a key frame; None if it does not come."""
        wanted, start = self._times[index], self._keys[key]
        if self._decoded is None or index < self._next or self._times[self._next] < start:
            self._container.seek(start, stream=self._stream)
            self._decoded = self._container.decode(self._stream)
        for frame in self._decoded:
            if frame.pts is not None and frame.pts >= wanted:
                self._next = min(bisect.bisect_right(self._times, frame.pts), len(self) - 1)
                if frame.pts == wanted:
                    if index == len(self) - 1:
                        self._decoded = None
                    return frame
                break
        self._decoded = None
        return None


def _opened(av: Any, path: Path) -> Any:
    """The file as PyAV's container. FFmpeg decodes some pictures to learn of what kind they are."""
    return av.open(str(path), format=FORMAT, options=LIMITS)


def _index(av: Any, path: Path) -> tuple[list[int], list[int]]:
    """Times of all pictures, and of the key frames among them, in the stream's own unit; nothing is decoded."""
    times, keys = set(), set()
    with _opened(av, path) as container:
        if not container.streams.video:
            return [], []
        with contextlib.suppress(av.error.FFmpegError):  # a file that was cut off: what is there is used
            for packet in container.demux(container.streams.video[0]):
                if packet.pts is not None and packet.size and not packet.is_discard:
                    times.add(int(packet.pts))
                    if packet.is_keyframe:
                        keys.add(int(packet.pts))
    return sorted(times), sorted(keys)


def _colours(frame: "av.VideoFrame") -> UInt8[np.ndarray, "h w 3"]:
    """8-bit RGB. A video without a colour matrix is taken for Rec. 709, as phones record."""
    matrix = REC_709 if frame.colorspace == UNTOLD else None
    return frame.reformat(format="rgb24", src_colorspace=matrix).to_ndarray()


@contextlib.contextmanager
def new_video(
    path: Path, size: tuple[int, int], rate: int, pixels: str = "yuv420p", **options: str
) -> Iterator[Callable[[UInt8[np.ndarray, "h w 3"]], None]]:
    """Function that adds a picture to a new MP4 file. Python writes the file, as FFmpeg may not report a full disk.

    Args:
        size: height and width.
        rate: pictures a second.
        pixels: FFmpeg's name of their format; the usual one wants an even height and width.
        options: of the encoder.
    """
    av = import_av(f"writing {path.name}")
    with path.open("wb") as file, av.open(file, "w", format="mp4") as container:
        stream = container.add_stream(_encoder(av, path.name), rate=rate, options=options)
        (stream.height, stream.width), stream.pix_fmt = size, pixels
        stream.codec_context.colorspace, stream.codec_context.color_range = REC_709, LIMITED_RANGE

        def add(picture: UInt8[np.ndarray, "h w 3"]) -> None:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame = frame.reformat(format=pixels, dst_colorspace=REC_709, dst_color_range=LIMITED_RANGE)
            container.mux(stream.encode(frame))

        yield add
        container.mux(stream.encode())


def _encoder(av: Any, name: str) -> str:
    for encoder in ENCODERS:
        try:
            av.codec.Codec(encoder, "w")
        except ValueError:  # av.codec.codec.UnknownCodecError
            continue
        return encoder
    raise InputError(f"writing {name}: FFmpeg has none of the encoders {', '.join(ENCODERS)}")


def import_av(what: str) -> Any:
    """The package `av`."""
    return optional_module("av", "captures", what)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
