"""Pictures in and out through OpenImageIO. Every write goes to a temporary name first and is then renamed.

OpenImageIO is imported where it is used: kept in a module that outlives it at exit, it complains on stderr.
"""

import contextlib
import errno
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt8

from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write
from hyjax.util.picture_header import check_packing, check_picture, check_size

NO_DATE = "1970:01:01 00:00:00"
"""Date in an EXR, which otherwise has the time of writing: equal pictures are equal files."""
NO_DETAIL = "no further detail"
PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
PNG_OPTIONS: dict[str, str | int] = {"compression": "rle", "png:compressionLevel": 1, "png:filter": 64}
"""Compression of PNG, by runs of equal bytes alone, and its filter, the mean of the pixels before and above: much
faster than the usual 6 with the best filter of each row, for files that are somewhat larger."""


def read_image(path: Path, where: str | None = None) -> Float[np.ndarray, "h w c"]:
    """Read a picture as float32 with its channels as stored; integer formats are scaled to [0, 1].

    Colours of 8 bits that have a profile, such as Display P3, come back in sRGB.
    """
    pixels = _read(path, where, in_srgb=True)
    if pixels.dtype.kind != "u":
        return pixels.astype(np.float32, copy=False)
    return pixels * np.float32(1.0 / np.iinfo(pixels.dtype).max)


def read_labels(path: Path, where: str | None = None) -> UInt8[np.ndarray, "h w"]:
    """Read an 8-bit picture whose values are numbers, such as confidences of depth: its first channel as stored."""
    return _read(path, where, only="uint8")[..., 0]


def picture_shape(path: Path, where: str | None = None) -> tuple[int, int]:
    """(height, width) of a picture; its pixels are not decoded.

    A PNG and a JPEG are gone through to their end all the same: damaged ones are refused.
    """
    with _opened(Path(path), where or str(path)) as source:
        return source.spec().height, source.spec().width


def read_depth(path: Path, unit: float = 0.001, where: str | None = None) -> Float[np.ndarray, "h w"]:
    """Read a 16-bit depth map; returns metres, 0 where there is no reading (stored as 0 or 65535).

    Args:
        path: a one-channel 16-bit picture.
        unit: metres per stored step.
    """
    raw = _read(path, where, only="uint16")
    if raw.shape[2] != 1:
        raise InputError(f"{where or path}: a depth map has one channel, this picture has {raw.shape[2]}")
    depth = raw[..., 0].astype(np.float32) * unit
    return np.where(raw[..., 0] == 65535, 0.0, depth).astype(np.float32)


@contextlib.contextmanager
def _opened(path: Path, where: str) -> Iterator[Any]:
    """OpenImageIO's reader of a picture; its errors in the block become `InputError`."""
    import OpenImageIO as oiio

    check_picture(path, where)
    source = None
    try:
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise InputError(f"{where}: not a readable picture ({_error(oiio) or NO_DETAIL})")
        spec = source.spec()
        check_size(max(spec.width, spec.tile_width), max(spec.height, spec.tile_height), spec.nchannels, where)
        check_packing(spec.width, spec.height, path.stat().st_size, where)
        if spec.depth > 1:
            raise InputError(f"{where}: a volume of {spec.depth} layers, not a picture")
        yield source
    except UnicodeDecodeError:  # of a damaged header's texts
        raise InputError(f"{where}: damaged picture (its header is not UTF-8)") from None
    except MemoryError:
        raise InputError(f"{where}: needs more memory than there is") from None
    finally:
        if source is not None:
            source.close()


def _read(path: Path, where: str | None, only: str | None = None, *, in_srgb: bool = False) -> np.ndarray:
    """Values as they are stored: OpenImageIO takes five times as long to make numbers in [0, 1] of them."""
    where = where or str(path)
    with _opened(Path(path), where) as source:
        stored = str(source.spec().format)
        if only is not None and stored != only:
            raise InputError(f"{where}: stored as {stored}, must be {only}")
        pixels = source.read_image(stored if stored in ("uint8", "uint16", "half") else "float")
        error = _error(source)
        profile = source.spec().get("ICCProfile") if in_srgb and stored == "uint8" else None
    # A truncated JPEG is padded with grey and only reported as an error, so the error decides, not the pixels.
    if pixels is None or error:
        raise InputError(f"{where}: damaged or truncated picture ({error or NO_DETAIL})")
    if profile is None:
        return pixels
    from hyjax.util.color_profiles import to_srgb  # few pictures have one

    return to_srgb(pixels, np.asarray(profile, np.uint8).tobytes())


@checked_arguments
def write_png(
    path: Path,
    display: Float[np.ndarray, "h w"] | Float[np.ndarray, "h w c"] | UInt8[np.ndarray, "h w c"],
) -> None:
    """Write display-encoded values, in [0, 1] or as bytes, as an 8-bit PNG.

    Raises:
        InputError: another ending than `.png`, which would be another format; or the file cannot be written.
    """
    pixels = display if display.dtype == np.uint8 else to_bytes(display)
    _write(path, pixels, "uint8", {"oiio:ColorSpace": "srgb_rec709_scene", **PNG_OPTIONS})


def to_bytes(display: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Values in [0, 1] in 256 steps; those beyond are clipped."""
    return np.round(np.clip(np.asarray(display, np.float32), 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)


def picture_file(
    display: Float[np.ndarray, "h w c"] | UInt8[np.ndarray, "h w c"],
    form: Literal["JPEG", "PNG"] = "JPEG",
    **options: int,
) -> bytes:
    """Content of a picture's file, by Pillow; options as Pillow has them."""
    from PIL import Image

    pixels, file = display if display.dtype == np.uint8 else to_bytes(display), io.BytesIO()
    Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels).save(file, form, **options)
    return file.getvalue()


def write_depth(path: Path, depth: Float[np.ndarray, "h w"]) -> None:
    """Write a depth map in metres as a 16-bit PNG of millimetres; missing readings and those out of range are 0."""
    steps = np.round(np.nan_to_num(np.asarray(depth, np.float64), posinf=0.0, neginf=0.0) / 0.001)
    _write(path, np.where((steps > 0) & (steps < 65535), steps, 0).astype(np.uint16), "uint16", {})


def write_labels(path: Path, labels: UInt8[np.ndarray, "h w"]) -> None:
    """Write an 8-bit picture whose values are numbers, such as confidences of depth."""
    _write(path, labels, "uint8", {})


def write_exr(path: Path, linear: Float[np.ndarray, "h w c"]) -> None:
    """Write linear values as a half-float EXR (ZIP compressed). Values beyond half range are clipped to it."""
    pixels = np.clip(np.asarray(linear, dtype=np.float32), -65504.0, 65504.0).astype(np.float16)
    _write(path, pixels, "half", {"oiio:ColorSpace": "lin_rec709_scene", "compression": "zip", "DateTime": NO_DATE})


def _write(path: Path, pixels: np.ndarray, kind: str, attributes: dict[str, str | int]) -> None:
    path, ending = Path(path), ".exr" if kind == "half" else ".png"
    if path.suffix.lower() != ending:  # which would be another format
        raise InputError(f"{path}: must end in {ending}")
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    height, width, channels = pixels.shape
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(width, height, channels, kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    with atomic_write(path) as temporary:
        target = oiio.ImageOutput.create(str(temporary))
        if target is None or not target.open(str(temporary), spec):
            temporary.open("r+b").close()  # the system's reason, which OpenImageIO does not give of a PNG
            complaint = _error(oiio if target is None else target) or NO_DETAIL
            raise InputError(f"{path}: cannot write ({complaint.replace(str(temporary), str(path))})")
        written = target.write_image(np.ascontiguousarray(pixels))
        closed = target.close()
        complaint = _error(target)
        if complaint or not (written and closed and _has_its_end(temporary)):
            full = shutil.disk_usage(path.parent).free < pixels.nbytes
            number, text = errno.ENOSPC if full else errno.EIO, complaint or "not all of it was written"
            raise OSError(number, text.replace(str(temporary), str(path)))


def _has_its_end(path: Path) -> bool:
    """Whether a file is complete: OpenImageIO does not report a disk that was full on closing."""
    import OpenImageIO as oiio

    if path.suffix.lower() == ".png":
        return path.read_bytes().endswith(PNG_END)
    source = oiio.ImageInput.open(str(path))
    if source is None:
        oiio.geterror()  # or it complains on stderr
        return False
    last = source.spec().height - 1
    lines = source.read_scanlines(last, last + 1, 0, 0, source.spec().nchannels, "half")
    complaint = _error(source)
    source.close()
    return lines is not None and not complaint


def _error(where: Any) -> str:
    """First line of OpenImageIO's error message, or its file's, which may quote a damaged file's bytes; or none."""
    try:
        return next((line.strip() for line in str(where.geterror()).splitlines() if line.strip()), "")
    except UnicodeDecodeError:
        return "damaged"


def resize(pixels: Float[np.ndarray, "h w c"], height: int, width: int) -> Float[np.ndarray, "height width c"]:
    """Resample with edges aligned to edges, as `Intrinsics.resize` assumes, by Lanczos' filter.

    Pillow does so many times as fast as OpenImageIO.
    """
    if pixels.shape[:2] == (height, width):
        return pixels
    from PIL import Image

    planes = [Image.fromarray(np.ascontiguousarray(plane, np.float32)) for plane in np.moveaxis(pixels, -1, 0)]
    return np.stack(
        [np.asarray(plane.resize((width, height), Image.Resampling.LANCZOS)) for plane in planes], axis=-1
    )
