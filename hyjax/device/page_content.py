"""Content of page.json that exported pages and the tour share: frames with cameras, and programs of shaders."""

import json
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from hyjax.configuration import Configuration
from hyjax.device.frame_program import SceneCounts, frame_program
from hyjax.device.precision_check import precision_check
from hyjax.device.program import Precision, columns_rows, shader_text
from hyjax.geometry.camera import Camera
from hyjax.util.images import picture_file

PAGE_FORMAT = 3
"""Version of page.json. Add one whenever older scripts could not read it."""
QUALITY = 95
_OF_TIMING = "measure.html", "measure.js", "timing.js"


def frame_entry(name: str, camera: Camera, file: str) -> dict[str, Any]:
    """Frame's entry in page.json: name, camera, and file of its picture."""
    k = camera.intrinsics
    return {
        "name": name,
        "file": file,
        "height": k.height,
        "width": k.width,
        "pose": np.asarray(camera.pose, np.float64).round(9).tolist(),
        "intrinsics": [k.fx, k.fy, k.cx, k.cy],
    }


def frame_picture(image: Float[np.ndarray, "h w 3"], *, lossless: bool = False) -> bytes:
    """File of a frame's display values: JPEG, or PNG."""
    if lossless:
        return picture_file(image, "PNG", optimize=True)
    return picture_file(image, quality=QUALITY, subsampling=0, optimize=True)


def page_programs(
    counts: SceneCounts, size: tuple[int, int], configuration: Configuration, resolutions: tuple[int, int]
) -> dict[str, Any]:
    """Programs of a scene's frames, the shaders that show them, and checks, of each precision."""
    return {
        "programs": [
            frame_program(
                counts,
                size,
                configuration.schedule,
                configuration.shadow_schedule,
                precision=precision,
                stages=False,
            ).to_json()
            for precision in get_args(Precision)
        ],
        "displays": [
            shader_text(["color", "filled", "display"], precision, {"size": columns_rows(size)})
            for precision in get_args(Precision)
        ],
        "checks": [precision_check(precision).to_json() for precision in get_args(Precision)],
        "resolutions": list(resolutions),
        "schedule": json.loads(configuration.schedule.to_json()),
    }


def page_scripts() -> Iterator[tuple[str, bytes]]:
    """Names and content of the page's own files."""
    for file in resources.files("hyjax.device").joinpath("page").iterdir():
        if Path(file.name).suffix in (".html", ".css", ".js", ".svg") and file.name not in _OF_TIMING:
            yield file.name, file.read_bytes()
