"""Pictures with depth written as the published data sets have them: names, folders, bits, units, order of axes."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from extras import need
from jaxtyping import Float

from hyjax.util.images import write_png
from reference.arkit_export import file_in, write_depth

Image = Float[np.ndarray, "h w 3"]
Depth = Float[np.ndarray, "h w"]


def export_folder(folder: Path, name: str, image: Image, depth: Depth, *, step: float = 0.001) -> None:
    """`NAME_rgb.png` and `NAME_depth.png` with 16 bits, a step being so many metres."""
    write_png(file_in(folder, f"{name}_rgb.png"), image)
    write_depth(file_in(folder, f"{name}_depth.png"), depth / step)


def export_subfolders(folder: Path, name: str, image: Image, depth: Depth) -> None:
    """`rgb/NAME.png` and `depth/NAME.png` in millimetres."""
    write_png(file_in(folder / "rgb", f"{name}.png"), image)
    write_depth(file_in(folder / "depth", f"{name}.png"), 1000 * depth)


def export_diml_indoor(scene: Path, name: str, image: Image, depth: Depth, *, whole: bool = False) -> None:
    """A picture of a DIML indoor scene, as in the sample data or as in the whole data set."""
    colour, filled, ending = ("col", "up_png", "ud") if whole else ("color", "depth_filled", "depth_filled")
    write_png(file_in(scene / colour, f"{name}_c.png"), image)
    write_depth(file_in(scene / filled, f"{name}_{ending}.png"), 1000 * depth)


def export_diml_outdoor(
    scene: Path, name: str, image: Image, depth: Depth, confidence: Depth, *, whole: bool = False
) -> None:
    """A picture of a DIML outdoor scene; confidence in [0, 1]."""
    if whole:
        kinds = {"left": "left/{}_left.png", "depth": "depth/{}_depth.png", "conf": "conf/{}_conf.png"}
    else:
        kinds = {"left": "outleft/{}.png", "depth": "depthmap/{}.png", "conf": "confidencemap/{}.png"}
    left, depth_file, conf = (scene / kind.format(name) for kind in kinds.values())
    write_png(file_in(left.parent, left.name), image)
    write_depth(file_in(depth_file.parent, depth_file.name), 1000 * depth)
    write_png(file_in(conf.parent, conf.name), confidence[..., None])


def export_middlebury(
    scene: Path, view: str, disparity_name: str, image: Image, disparity: Depth, *, dmin: float | None = None
) -> None:
    """A view of 2003, 2005 or 2006: disparity in 8 bits, 0 where unknown, less what was cut off both pictures."""
    write_png(file_in(scene, f"{view}.png"), image)
    stored = np.where(disparity > 0, disparity - (dmin or 0), 0)
    write_png(file_in(scene, f"{disparity_name}.png"), stored[..., None] / 255)
    if dmin is not None:
        (scene / "dmin.txt").write_text(f"{dmin:g}\n")


def export_middlebury_2014(scene: Path, view: int, image: Image, disparity: Depth, doffs: float) -> None:
    """A view of 2014: disparity as little-endian PFM from the bottom up, infinity where unknown, and calib.txt."""
    write_png(file_in(scene, f"im{view}.png"), image)
    stored = np.where(disparity > 0, disparity - doffs, np.inf).astype("<f4")
    height, width = stored.shape
    header = f"Pf\n{width} {height}\n-0.003922\n".encode()
    (scene / f"disp{view}.pfm").write_bytes(header + stored[::-1].tobytes())
    (scene / "calib.txt").write_text(
        f"cam0=[1000 0 {width / 2}; 0 1000 {height / 2}; 0 0 1]\ncam1=[1000 0 {width / 2 + doffs}; 0 1000 "
        f"{height / 2}; 0 0 1]\ndoffs={doffs}\nbaseline=193.001\nwidth={width}\nheight={height}\nndisp=290\n"
    )


def export_nyu(file: Path, images: list[Image], depths: list[Depth], raw: list[Depth]) -> None:
    """A labelled file as MATLAB 7.3 writes it: HDF5 with the axes in reverse order."""
    need("nyu")
    import h5py

    with h5py.File(file, "w", userblock_size=512) as stored:
        pixels = np.round(255 * np.stack(images)).astype(np.uint8)
        stored["images"] = np.ascontiguousarray(pixels.transpose(0, 3, 2, 1))
        stored["depths"] = np.ascontiguousarray(np.stack(depths).transpose(0, 2, 1), np.float32)
        stored["rawDepths"] = np.ascontiguousarray(np.stack(raw).transpose(0, 2, 1), np.float32)


def truncate(file: Path, keep: float = 0.6) -> None:
    """Cut a file off as an interrupted download leaves it."""
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])


def write_grey16(path: Path, levels: Float[np.ndarray, "h w c"]) -> None:
    """A 16-bit picture of several channels."""
    target = oiio.ImageOutput.create(str(path))
    target.open(str(path), oiio.ImageSpec(levels.shape[1], levels.shape[0], levels.shape[2], "uint16"))
    target.write_image(np.ascontiguousarray(levels.astype(np.uint16)))
    target.close()
