"""Page: a folder that any web server shows, in which a browser's GPU relights the frames of a scene."""

import dataclasses
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from hyjax.configuration import PRESETS, Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.data.frames import select_frames, spread
from hyjax.device.page_content import (
    RAYS,
    RESOLUTIONS,
    SCENE_FILE,
    followed_programs,
    frame_entry,
    frame_picture,
    page_content,
    page_scripts,
    scene_content,
)
from hyjax.device.scene_arrays import scene_arrays
from hyjax.export.page_sun import sun_table
from hyjax.export.single_page import check_single_file, is_single, new_single_page
from hyjax.light.setup import LightSetup
from hyjax.relighting.pictures import sheet_row
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.files import new_folder
from hyjax.util.images import resize
from hyjax.util.reading import read_json

FRAMES = 24
"""Most frames of a page that names none."""
SHEET_ROWS = 3
THUMBNAIL, THUMBNAIL_WIDTH = "thumbnail.jpg", 640
_OF_PRESETS = "programs", "resolutions", "exponent"
_PAGE_FILE = "page.json"
_log = logging.getLogger(__name__)


def export_web(settings: Any) -> dict[str, Any]:
    """`write_page` with the settings of an export."""
    check_page_folder(settings.out)
    if settings.guide not in (None, "rgb"):
        raise InputError("web: the page's guide is the frame itself; leave --guide out")
    configuration = dataclasses.replace(settings.open_configuration(), schedule=settings.open_schedule())
    configuration = configuration.followed_by("page")
    scene = Scene.open(settings.scene, progress=not settings.quiet)
    frames = None if settings.frames is None else select_frames(settings.frames, len(scene))
    setup = scene.lights(settings.lights, at_photo_sources=True)
    presets = [Configuration.preset(name) for name in PRESETS if settings.presets and name != configuration.name]
    return write_page(
        scene, setup, configuration, frames, settings.out, presets=presets, progress=not settings.quiet
    )


def write_page(
    scene: Scene,
    setup: LightSetup,
    configuration: Configuration | Schedule,
    frames: Sequence[int] | None,
    out: Path,
    *,
    presets: Sequence[Configuration] = (),
    rays: int = RAYS,
    resolutions: tuple[int, int] = RESOLUTIONS,
    lossless: bool = False,
    sun: bool = True,
    progress: bool = False,
) -> dict[str, Any]:
    """Write a page.

    It appears whole or not at all; an earlier page in its place is replaced.

    Args:
        out: folder; or a single file, which ends in .html.
        configuration: how frames are relit, as far as pages follow it, or a schedule for the default one.
        frames: by position in the capture; `FRAMES`, spread over it, by default.
        presets: configurations that may be chosen on the page in the place of its own.
        resolutions: texels a side of shadow maps with one view, and of each of several, at a scale of 1.
        lossless: whether frames are PNG and not JPEG files.
        sun: whether to add the sun by the hour.

    Returns:
        The content of page.json.
    """
    frames = spread(range(len(scene)), FRAMES) if frames is None else frames
    if not frames:
        raise InputError("web: no frames; choose at least one")
    configuration = Configuration.of(configuration).followed_by("page", say=False)
    steps = tqdm(total=len(frames) + 4, desc="page", unit="step", disable=not progress)
    check_page_folder(out)
    with new_single_page(out) if is_single(out) else new_folder(out, replace=True) as folder, steps:
        arrays = scene_arrays(scene, rays=rays)
        described, packed = scene_content(scene, setup, arrays)
        (folder / SCENE_FILE).write_bytes(packed)
        steps.update()
        entries = []
        for index in frames:
            entries.append(_write_frame(scene.frame(index), folder, lossless))
            steps.update()
        sizes = {(entry["height"], entry["width"]) for entry in entries}
        if len(sizes) > 1:
            raise InputError("web: the frames are of several sizes; give one with --size")
        (size,) = sizes
        programs, *others = (
            followed_programs(arrays.counts, size, chosen, resolutions) for chosen in (configuration, *presets)
        )
        by_hour = sun_table(scene) if sun else None
        steps.update()
        presets_of = {other["configuration"]: {key: other[key] for key in _OF_PRESETS} for other in others}
        content = page_content(scene.capture.name, size, setup, entries) | programs | described
        content |= {"presets": presets_of, "sun": by_hour}
        (folder / _PAGE_FILE).write_text(json.dumps(content), encoding="utf-8")
        _write_sheet(Relighter(scene, setup, configuration, whole=True), frames, folder)
        steps.update()
        _write_scripts(folder)
        (folder / "README.md").write_text(_readme(content), encoding="utf-8")
        steps.update()
    return content


def check_page_folder(out: Path) -> None:
    """Raise `InputError` unless a page can be written there: nothing is, or an earlier page."""
    if is_single(out):
        check_single_file(out)
    elif out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; choose another --out")
    elif out.is_dir() and any(out.iterdir()) and not _is_page(out):
        raise InputError(f"{out}: is not empty and holds no page of hyjax; choose another --out")


def _is_page(folder: Path) -> bool:
    try:
        content = read_json(folder / _PAGE_FILE)
    except InputError:
        return False
    return isinstance(content, dict) and content.get("made_by") == "hyjax"


def _write_frame(frame: Frame, folder: Path, lossless: bool) -> dict[str, Any]:
    """Write a frame's picture; its entry in page.json."""
    name = f"frames/{frame.name}.{'png' if lossless else 'jpg'}"
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(frame_picture(frame.image, lossless=lossless))
    return frame_entry(frame.name, frame.camera, name)


def _write_sheet(relighter: Relighter, frames: Sequence[int], folder: Path) -> None:
    """Write the pictures for browsers that cannot run the page."""
    rows, shown = [], ("frame", "relit", "visibility")
    for index in spread(list(frames), SHEET_ROWS):
        frame = relighter.place.frame(index)
        pictures = sheet_row(frame, relighter.relit(frame), "linear")
        rows.append((frame.name, [pictures[column] for column in shown]))
        if len(rows) == 1:
            _write_thumbnail(pictures["relit"], folder)
    write_contact_sheet(folder / "contact_sheet.png", rows, shown)


def _write_thumbnail(picture: Float[np.ndarray, "h w 3"], folder: Path) -> None:
    height, width = picture.shape[:2]
    small = min(width, THUMBNAIL_WIDTH)
    pixels = resize(picture, max(1, round(height * small / width)), small)
    (folder / THUMBNAIL).write_bytes(frame_picture(pixels))


def _write_scripts(folder: Path) -> None:
    for name, content in page_scripts():
        (folder / name).write_bytes(content)


def _readme(content: dict[str, Any]) -> str:
    height, width = content["size"]
    sun = content["sun"]
    by_hour = (
        f"The sun by the hour is that of {sun['day']} at {sun['latitude']:g} degrees north."
        if sun
        else "This page has no sun by the hour: the extra `tour` was not installed."
    )
    return f"""# {content["name"]}, relit in the browser

{len(content["frames"])} frames of {width}x{height} pixels, relit by the browser's own GPU (WebGPU).
Nothing is sent anywhere.

Any web server shows this folder; on this machine for instance

    python -m http.server --bind 127.0.0.1 8000

and then http://localhost:8000. Elsewhere it must be https: browsers have WebGPU on secure pages only. Opened as a
file it shows `contact_sheet.png` alone; `hyjax export --to web --out room.html` makes a page that opens as one.

{by_hour}

`page.json` holds the shaders with their buffers and launches, the lights, and the frames with their cameras;
`scene.bin` the arrays, packed with gzip. Scripts on the page find `window.hyjax` with `ready`, `fps`, `stats()`,
`setLights(json)`, `goto(frame)` and `pixels()`.
"""
