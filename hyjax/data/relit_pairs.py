"""Real places under two lights from one camera, with their geometry: Middlebury's stereo pictures.

    NAME/im1.png  NAMEL/im1.png  NAMEL/calib.txt                    evaluation version 3: right views
    NAME/view5.png in the place of NAME/im1.png                     its scenes of 2005, at another size
    NAME/im0.png, NAME/disp0GT.pfm or NAMEL/disp0GT.pfm             left view; its disparity, infinite where unknown
    SCENE/ambient/LIGHT/im0e0.png, …  SCENE/calib.txt, disp0.pfm    archives of 2014 and 2021: left views

`calib.txt` has K of both cameras, the baseline in millimetres and `doffs`; depth is
f · baseline / (1000 · (disparity + doffs)) metres. The layout of 2014 and 2021 is tested on written files only.

Source: vision.middlebury.edu/stereo; Scharstein et al., "High-resolution stereo datasets with subpixel-accurate
ground truth", GCPR 2014; Scharstein and Pal, CVPR 2007.
"""

import dataclasses
import itertools
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Frame
from hyjax.data.frames import fit
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.util.errors import InputError, shown
from hyjax.util.images import read_image
from hyjax.util.pfm import read_pfm
from hyjax.util.reading import finite, read_bytes

LARGEST_CALIBRATION = 1 << 16
"""Largest size of a calibration file, in bytes."""
LARGEST_VALUE = 1e7
"""Largest number of a calibration file."""
WIDTH = 360
"""Width, in pixels, that pictures are brought near to by a whole factor: half of the evaluation's quarter size."""
PLACES = ((0, 0), (1, 1), (0, 2), (1, 2))
"""Focal lengths and principal point in K."""
EXPOSURE = re.compile(r"im0e(\d{1,2})$")


@dataclasses.dataclass(frozen=True)
class RelitPair:
    """A place under two lights.

    Attributes:
        name: of the scene; with the lights' names where there are several.
        pictures: display values, from one camera.
        camera: of the pictures.
        depth: metres along the axis of `depth_camera`, 0 where unknown; None where only `partner` tells it.
        depth_camera: of the depth, or of the `partner`.
        partner: picture of the other camera of the rig, display values; None without one.
    """

    name: str
    pictures: tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]]
    camera: Camera
    depth: Float[np.ndarray, "dh dw"] | None
    depth_camera: Camera
    partner: Float[np.ndarray, "dh dw 3"] | None = None

    @property
    def baseline(self) -> float:
        """Metres from the depth's camera to the pictures' camera, to the right."""
        return float(self.camera.origin[0] - self.depth_camera.origin[0])


@dataclasses.dataclass(frozen=True)
class _Rig:
    """Calibrated pair of cameras, left and right, in quarter or full size."""

    left: Camera
    right: Camera
    focal: float
    baseline: float
    offset: float

    def depth(self, disparity: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Depth of the left view, in metres; 0 where unknown."""
        known = np.isfinite(disparity) & (disparity + self.offset > 0)
        shift = np.where(known, disparity, 1.0) + np.where(known, self.offset, 0.0)
        return np.where(known, self.focal * self.baseline / shift, 0.0).astype(np.float32)


def open_relit_pairs(folder: Path, width: int = WIDTH) -> list[RelitPair]:
    """Open all places under two lights in a folder."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    pairs: list[RelitPair] = []
    for scene in [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]:
        if (scene / "ambient").is_dir():
            pairs += _ambient_pairs(scene, width)
        other = scene.with_name(scene.name + "L")
        if scene != folder and (other / "im1.png").is_file():
            pairs.append(_evaluation_pair(scene, other, width))
    if not pairs:
        raise InputError(
            f"{folder}: no folder NAME/ next to NAMEL/im1.png, and no SCENE/ambient/; see SOURCE.txt or the site"
        )
    return pairs


def _evaluation_pair(scene: Path, other: Path, width: int) -> RelitPair:
    rig = _rig(other / "calib.txt")
    first = next((file for name in ("im1.png", "view5.png") if (file := scene / name).is_file()), None)
    if first is None:
        raise InputError(f"{scene}: has neither im1.png nor view5.png")
    factor = max(1, round(rig.right.intrinsics.width / width))
    pictures = _picture(first, rig.right, factor), _picture(other / "im1.png", rig.right, factor)
    left = next((path for path in (scene / "im0.png", other / "im0.png") if path.is_file()), None)
    disparity = next((path for path in (scene / "disp0GT.pfm", other / "disp0GT.pfm") if path.is_file()), None)
    depth = None if disparity is None else _depth(disparity, rig)
    partner = None if left is None else _picture(left, rig.left, 1).image
    if depth is None and partner is None:
        raise InputError(f"{scene}: has neither disp0GT.pfm nor im0.png, which tell its geometry")
    return RelitPair(
        scene.name, (pictures[0].image, pictures[1].image), pictures[0].camera, depth, rig.left, partner
    )


def _ambient_pairs(scene: Path, width: int) -> list[RelitPair]:
    """Pairs of lights of a scene, each by its middle exposure."""
    rig = _rig(scene / "calib.txt")
    factor = max(1, round(rig.left.intrinsics.width / width))
    lights = {}
    for folder in sorted(path for path in (scene / "ambient").iterdir() if path.is_dir()):
        exposures = [file for file in folder.glob("im0e*.png") if EXPOSURE.match(file.stem)]
        exposures.sort(key=lambda file: int(file.stem[len("im0e") :]))
        if exposures:
            lights[folder.name] = _picture(exposures[len(exposures) // 2], rig.left, factor)
    if len(lights) < 2:
        raise InputError(f"{scene}/ambient: need im0e0.png and such under two lights at least, got {len(lights)}")
    depth = _depth(scene / "disp0.pfm", rig)
    return [
        RelitPair(f"{scene.name} {a} {b}", (lights[a].image, lights[b].image), lights[a].camera, depth, rig.left)
        for a, b in itertools.combinations(lights, 2)
    ]


def _depth(file: Path, rig: _Rig) -> Float[np.ndarray, "h w"]:
    disparity = read_pfm(file)
    if disparity.shape != rig.left.intrinsics.shape:
        raise InputError(
            f"{file}: is {disparity.shape[1]}x{disparity.shape[0]}, but calib.txt is for "
            f"{rig.left.intrinsics.width}x{rig.left.intrinsics.height}"
        )
    return rig.depth(disparity)


def _picture(file: Path, camera: Camera, factor: int) -> Frame:
    """Picture of a camera, smaller by a factor; one of another size is of the same field of view."""
    image = read_image(file)[..., :3]
    if image.shape[2] != 3:
        raise InputError(f"{file}: is grey; need red, green and blue")
    height, width = image.shape[:2]
    own = Camera(camera.intrinsics.resize(height, width), camera.pose)
    k = camera.intrinsics
    return fit(Frame(file.stem, image, own, 0.0), (k.height // factor, k.width // factor))


def _rig(file: Path) -> _Rig:
    """Cameras of a `calib.txt`."""
    text = read_bytes(file, most=LARGEST_CALIBRATION).decode("utf-8", errors="replace")
    values = {name: value.strip() for name, value in re.findall(r"^\s*(\w+)\s*=(.*)$", text, re.MULTILINE)}

    def numbers(name: str, count: int) -> list[float]:
        found = re.findall(r"[-+.\deE]+", values.get(name, ""))
        try:
            if len(found) != count:
                raise ValueError
            return [finite(float(x), str(file), least=-LARGEST_VALUE, most=LARGEST_VALUE) for x in found]
        except ValueError:
            need = f"need {count} number{'s' * (count > 1)}"
            raise InputError(f"{file}: {name}: {need}, got {shown(values.get(name, ''))}") from None

    (width,), (height,), (baseline,), (offset,) = (numbers(n, 1) for n in ("width", "height", "baseline", "doffs"))
    cameras = []
    for name, shift in (("cam0", 0.0), ("cam1", baseline / 1000)):
        k = np.reshape(numbers(name, 9), (3, 3))
        pose = np.eye(4)
        pose[0, 3] = shift
        cameras.append(Camera(Intrinsics(int(width), int(height), *(float(k[place]) for place in PLACES)), pose))
    left, right = cameras
    return _Rig(left, right, left.intrinsics.fx, baseline / 1000, offset)
