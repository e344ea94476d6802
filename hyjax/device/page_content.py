"""Content of page.json that exported pages and the tour share: frames with cameras, and programs of shaders."""

import json
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from hyjax.configuration import Configuration
from hyjax.device.frame_program import SceneCounts, frame_program
from hyjax.device.page_scene import describe_scene, light_keys, pack_scene, setup_content
from hyjax.device.precision_check import precision_check
from hyjax.device.program import Precision, columns_rows, shader_text
from hyjax.device.scene_arrays import SceneArrays
from hyjax.geometry.camera import Camera
from hyjax.geometry.shadow_caster import RESOLUTION, VIEW_RESOLUTION
from hyjax.light.setup import REFERENCE_LUX, LightSetup
from hyjax.scene.scene import Scene
from hyjax.util.images import picture_file

PAGE_FORMAT = 3
"""Version of page.json. Add one whenever older scripts could not read it."""
QUALITY = 95
RESOLUTIONS = RESOLUTION, VIEW_RESOLUTION
"""Texels a side of shadow maps with one view, and of each of several, where lights lie still."""
RAYS = 128
"""Rays of each point of the light transport, half of those of `relight`."""
SCENE_FILE = "scene.bin"
"""File of the packed arrays."""
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


def page_content(
    name: str, size: Sequence[int], setup: LightSetup, entries: list[dict[str, Any]]
) -> dict[str, Any]:
    """Content of page.json that every page has; `entries` are its frames'."""
    return {
        "format": PAGE_FORMAT,
        "made_by": "hyjax",
        "name": name,
        "size": list(size),
        "frames": entries,
        "setup": setup_content(setup),
        "default_reference_lux": REFERENCE_LUX,
        "light_keys": light_keys(),
    }


def scene_content(scene: Scene, setup: LightSetup, arrays: SceneArrays) -> tuple[dict[str, Any], bytes]:
    """Content of page.json about a scene that a GPU draws, and of `SCENE_FILE`."""
    packed = pack_scene(arrays)
    file = {"name": SCENE_FILE, "bytes": packed.bytes, "compression": "gzip"}
    described = describe_scene(scene, setup, arrays)
    return {"scene": described, "file": file, "arrays": packed.entries}, packed.content


def followed_programs(
    counts: SceneCounts, size: tuple[int, int], configuration: Configuration, resolutions: tuple[int, int]
) -> dict[str, Any]:
    """Programs, displays and checks of a configuration, as far as pages follow it, in each precision.

    Args:
        resolutions: texels a side of shadow maps with one view, and of each of several, at a scale of 1.
    """
    followed = configuration.followed_by("page", say=False)
    single, several = (max(16, round(side * followed.shadows.map_scale)) for side in resolutions)
    return {
        "configuration": configuration.name,
        "exponent": followed.light.photo_exponent,
        "programs": [
            frame_program(
                counts,
                size,
                followed.schedule,
                followed.shadow_schedule,
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
        "resolutions": [single, several],
        "schedule": json.loads(followed.schedule.to_json()),
    }


def page_scripts() -> Iterator[tuple[str, bytes]]:
    """Names and content of the page's own files."""
    for file in resources.files("hyjax.device").joinpath("page").iterdir():
        if Path(file.name).suffix in (".html", ".css", ".js", ".svg") and file.name not in _OF_TIMING:
            yield file.name, file.read_bytes()
