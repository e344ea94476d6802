"""Where the Kinect's colour camera stands: fitted so that borders of depth fall on borders of the pictures.

    python -m experiments.kinect_registration --capture PATH [--fit 0:225:5] [--judge 225:300:5]

7-Scenes has depth and pictures from two cameras and tells the intrinsics of the one for depth only
(`hyjax.data.kinect`). Here the points where depth jumps are projected into the pictures, and focal length, centre
and roll of the colour camera are sought for which they meet the most contrast, in multiples of the contrast around;
borders that have nothing to do with those of the picture meet less than 1. Takes about a minute on two cores.

Expect: on frames that were not fitted to, borders meet far more contrast with the constants of `hyjax.data.kinect`
than as recorded, as much as with those fitted here, and hardly less than with those fitted to these frames
themselves."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from experiments.blocks import Block, Picture, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import select_frames, spread
from hyjax.data.kinect import COLOUR, KINECT, ROLL, colour_pose
from hyjax.data.seven_scenes import open_seven_scenes
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError

JUMP = 1.06  # a border: the neighbour is this much farther away
FARTHEST = 3.5  # metres; beyond, the steps of a Kinect's depth are borders too
AROUND = 41  # pixels, whose contrast is compared with
MOST = 4.0  # in multiples of the contrast around: one hard edge in a plain wall does not decide
BLURS = (4.0, 2.0, 1.0, 0.0)  # pixels; from coarse to fine, so that borders some pixels off are found
STEPS = (5.0, 5.0, 5.0, 0.005)  # of the search, in pixels and radians
START = (525.0, 320.0, 240.0, 0.0)
Placement = tuple[float, float, float, float]
"""Focal length, centre (pixels) and roll (radians) of the colour camera."""
KNOWN: Placement = (COLOUR.fx, COLOUR.cx, COLOUR.cy, ROLL)


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path
    """A folder in the 7-Scenes layout."""
    fit: str = "0:225:5"
    """Frames to fit to."""
    judge: str = "225:300:5"
    """Frames to judge by."""


@dataclasses.dataclass(frozen=True)
class Borders:
    """Borders of one frame: where its depth jumps, in world coordinates, and its picture's contrast."""

    frame: Frame
    points: Float[np.ndarray, "n 3"]
    contrast: Float[np.ndarray, "h w"]

    def met(self, camera: Camera) -> Float[np.ndarray, "n"]:
        """Contrast that the points meet in the picture, if `camera` took it; 0 outside."""
        pixel, _ = camera.project(self.points)
        return ndimage.map_coordinates(
            self.contrast, [pixel[:, 1] - 0.5, pixel[:, 0] - 0.5], order=1, mode="constant"
        )


@experiment("Registering the Kinect's depth to its pictures")
def main(config: Config, start: Start) -> None:
    capture = open_seven_scenes(config.capture)
    fit, judge = (select_frames(text, len(capture)) for text in (config.fit, config.judge))
    fitting, judging = borders_of(capture, fit), borders_of(capture, judge)
    results = start()
    placements = {"as recorded": None, "hyjax.data.kinect": KNOWN}
    placements["fitted to the first"] = fitted(fitting)
    placements["fitted to the second"] = fitted(judging)
    for name, placement in placements.items():
        scores = [mean_contrast(borders, placement) for borders in (fitting, judging)]
        counts = [len(fit), len(judge)]
        results.add(kind="placement", name=name, placement=placement, contrast=scores, frames=counts)
    sheet = [(shown.frame.name, [marked(shown, None), marked(shown, KNOWN)]) for shown in spread(judging, 3)]
    write_contact_sheet(results.out / "borders.png", sheet, ["as recorded", "registered"])


def borders_of(capture: Capture, indices: Sequence[int]) -> list[Borders]:
    """The borders of some frames.

    Raises:
        InputError: a frame is not as the Kinect's depth camera has it.
    """
    found = []
    for index in indices:
        frame = capture[index]
        if frame.depth is None or frame.camera.intrinsics != KINECT:
            raise InputError(f"{capture.name} {frame.name}: need depth with 7-Scenes' intrinsics, 585 585 320 240")
        known = frame.depth > 0
        jumps = known & (frame.depth < FARTHEST) & (ndimage.maximum_filter(frame.depth, 3) > JUMP * frame.depth)
        # Not beside holes, where what is behind an object has no reading and its border lies somewhere in between.
        jumps &= ndimage.binary_erosion(ndimage.binary_closing(known, iterations=2), iterations=4)
        grey = frame.image.mean(axis=-1)
        contrast = np.hypot(*(ndimage.gaussian_filter(grey, 1.0, order=order) for order in ((0, 1), (1, 0))))
        contrast = np.minimum(contrast / (ndimage.uniform_filter(contrast, AROUND) + 0.01), MOST)
        found.append(Borders(frame, frame.camera.unproject(frame.depth)[jumps], contrast))
    return found


def camera_of(frame: Frame, placement: Placement | None) -> Camera:
    """The colour camera of a frame; None is as recorded, where it is the depth camera."""
    if placement is None:
        return frame.camera
    focal, x, y, roll = placement
    lens = Intrinsics(KINECT.width, KINECT.height, focal, focal, x, y)
    return Camera(lens, frame.camera.pose @ colour_pose(roll))


def mean_contrast(borders: Sequence[Borders], placement: Placement | None) -> float:
    """Mean over all points of all frames."""
    return float(np.mean(np.concatenate([b.met(camera_of(b.frame, placement)) for b in borders])))


def fitted(borders: Sequence[Borders]) -> Placement:
    """The placement for which borders meet the most contrast."""
    best = np.array(START)
    for blur in BLURS:
        contrasts = [ndimage.gaussian_filter(b.contrast, blur) if blur else b.contrast for b in borders]
        blurred = [dataclasses.replace(b, contrast=contrast) for b, contrast in zip(borders, contrasts)]

        def lost(steps: np.ndarray, start: np.ndarray = best, seen: Sequence[Borders] = blurred) -> float:
            return -mean_contrast(seen, tuple((start + steps * STEPS).tolist()))

        simplex = np.vstack([np.zeros(4), np.eye(4)])
        found = optimize.minimize(
            lost, simplex[0], method="Nelder-Mead", options={"maxfev": 120, "initial_simplex": simplex}
        )
        best = best + found.x * STEPS
    return tuple(best.tolist())


def marked(borders: Borders, placement: Placement | None) -> Float[np.ndarray, "h w 3"]:
    """The picture with the points in it."""
    picture = borders.frame.image.copy()
    pixel, _ = camera_of(borders.frame, placement).project(borders.points)
    column, row = np.floor(pixel).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < picture.shape[1]) & (row < picture.shape[0])
    picture[row[inside], column[inside]] = (1.0, 0.1, 0.1)
    return picture


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and picture from the rows."""
    found = of_kind(rows, "placement")
    lines = []
    for row in found:
        focal, x, y, roll = row["placement"] or (KINECT.fx, KINECT.cx, KINECT.cy, 0.0)
        cells = [f"{focal:.1f}", f"{x:.1f}", f"{y:.1f}", f"{roll:.4f}", *(f"{c:.2f}" for c in row["contrast"])]
        lines.append([row["name"], *cells])
    counts = " and ".join(str(count) for count in found[0]["frames"]) if found else "no"
    header = [
        "colour camera",
        "focal length",
        "centre x",
        "centre y",
        "roll",
        "on the first",
        "on the second",
    ]
    return [
        Table(f"Contrast that borders of depth meet in the pictures, {counts} frames.", header, lines),
        Picture(folder / "borders.png", "Borders of depth in the pictures: as recorded, and registered."),
    ]


if __name__ == "__main__":
    run(main)
