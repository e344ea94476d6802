"""Relighting a capture from end to end: everything that `hyjax relight` does, as a function."""

import contextlib
import dataclasses
import json
import os
import platform
import tempfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from hyjax.color import to_display, to_linear
from hyjax.contact_sheet import write_contact_sheet
from hyjax.data.capture import Capture, Frame
from hyjax.data.light_file import LightSetup, write_lights
from hyjax.errors import InputError
from hyjax.files import remove, write_text
from hyjax.images import resize, write_exr, write_png
from hyjax.pipeline import Mode, Relit, relight_stages
from hyjax.scene.camera import Camera, Intrinsics
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.schedule import Schedule
from hyjax.tuning.latency import StageClock

HEADINGS = ("frame", "raw filter", "refined filter", "visibility", "raw filter x frame", "relit")
SHEET_ROWS = 12
OPTIONAL = ("matplotlib", "pytest", "hypothesis")
PACKAGES = (
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "jaxopt",
    "numpy",
    "trimesh",
    "embreex",
    "scikit-image",
    "OpenImageIO",
)


@dataclasses.dataclass(frozen=True)
class Outputs:
    """What is written beside the relit PNG and EXR of each frame: PNGs, and EXRs with the linear values."""

    filters: bool = False
    visibility: bool = False


def relight_capture(
    capture: Capture,
    caster: RayCaster,
    setup: LightSetup,
    schedule: Schedule,
    out: Path,
    *,
    frames: Sequence[int] | None = None,
    size: tuple[int, int] | None = None,
    mode: Mode = "hyjax",
    shadows: bool = True,
    outputs: Outputs | None = None,
    settings: dict[str, Any] | None = None,
    clock: StageClock | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Relight frames of a capture and write pictures, a contact sheet, the lights and `run.json` to `out`.

    Every file appears whole or not at all, so that an interrupted run leaves nothing half-written.

    Args:
        capture: frames with poses.
        caster: the mesh, in the capture's world coordinates.
        setup: lights.
        schedule: cascade for the shading.
        out: folder, made if need be.
        frames: indices; all by default.
        size: (height, width) to work at: the largest centred window of that shape, resampled. Default: as captured.
        mode: see `relight`.
        shadows: whether lights cast shadows.
        outputs: what else to write for each frame.
        settings: recorded in `run.json` as they are.
        clock: times of earlier stages, if they are to be in `run.json` too.
        progress: show a bar on stderr.

    Returns:
        The content of `run.json`.

    Raises:
        InputError: the folder cannot be written, or no frame sees the mesh.
    """
    outputs, clock = outputs or Outputs(), clock or StageClock()
    chosen = range(len(capture)) if frames is None else frames
    make_writable(out)
    for summary in ("run.json", "lights.json", "contact_sheet.png"):
        remove(out / summary)  # of an earlier run, whose pictures are about to be replaced
    with clock("shadow maps"):
        maps = jax.block_until_ready(cast_shadow_maps(caster, setup.lights)) if shadows else None
    rows: list[tuple[str, list[np.ndarray]]] = []
    sheet_every = max(1, -(-len(chosen) // SHEET_ROWS))
    skipped, written = [], []
    for index in tqdm(chosen, desc="relighting", unit="frame", disable=not progress):
        with clock("read"):
            frame = fit(capture[index], size)
        with clock("g-buffer"):
            gbuffer = jax.block_until_ready(caster.gbuffer(frame.camera))
        if not bool(gbuffer.hit.any()):
            skipped.append(frame.name)
            continue
        display = jnp.asarray(frame.image)
        stages = relight_stages(
            to_linear(display),
            gbuffer,
            setup.lights,
            display,
            schedule,
            shadow_maps=maps,
            reference_lux=setup.reference_lux,
            mode=mode,
        )
        relit = clock.follow(stages)
        with clock("write"):
            _write_frame(out, frame.name, relit, mode, outputs)
        written.append(frame.name)
        if (len(written) - 1) % sheet_every == 0:
            rows.append((frame.name, _sheet_row(frame, relit, mode)))
    if not written:
        raise InputError(
            f"{capture.name}: no ray of any chosen frame met the mesh; are the mesh and the poses in the same "
            "coordinates (metres, camera-to-world)?"
        )
    write_contact_sheet(out / "contact_sheet.png", rows, HEADINGS)
    write_lights(out / "lights.json", setup)
    run = {
        "frames": written,
        "frames_without_surface": skipped,
        "mesh_faces": len(caster.mesh.faces),
        "size": list(frame.image.shape[:2]),
        "mode": mode,
        "schedule": json.loads(schedule.to_json()),
        "reference_lux": setup.reference_lux,
        "settings": settings or {},
        "milliseconds": clock.summary(),
        "peak_memory_mib": round(peak_memory_mib(), 1),
    } | environment()
    write_text(out / "run.json", json.dumps(run, indent=2) + "\n")
    return run


def fit(frame: Frame, size: tuple[int, int] | None) -> Frame:
    """The frame's largest centred window with the proportions of `size` (height, width), resampled to that size.

    Resampling averages light, hence happens in linear values. Depth is dropped: nothing here needs it.
    """
    if size is None or size == frame.camera.intrinsics.shape:
        return dataclasses.replace(frame, depth=None, depth_intrinsics=None)
    height, width = size
    h, w = frame.camera.intrinsics.shape
    scale = min(h / height, w / width)
    window_h, window_w = min(h, round(height * scale)), min(w, round(width * scale))
    top, left = (h - window_h) // 2, (w - window_w) // 2
    linear = np.asarray(to_linear(jnp.asarray(frame.image[top : top + window_h, left : left + window_w])))
    image = np.asarray(to_display(jnp.asarray(resize(linear, height, width))))
    intrinsics: Intrinsics = frame.camera.intrinsics.crop(top, left, window_h, window_w).resize(height, width)
    camera = Camera(intrinsics, frame.camera.pose)
    return dataclasses.replace(frame, image=image, camera=camera, depth=None, depth_intrinsics=None)


def select_frames(text: str, count: int) -> list[int]:
    """Frame indices from `all`, `7`, `0:300:30` (as Python slices) or a comma-separated list of these.

    Raises:
        InputError: not of this form, past the end of the capture, or nothing selected.
    """
    chosen: list[int] = []
    for part in text.split(","):
        fields = ["", "", ""] if part.strip() == "all" else part.strip().split(":")
        try:
            numbers = [int(field) if field.strip() else None for field in fields]
        except ValueError:
            numbers = []
        if not 1 <= len(numbers) <= 3 or numbers == [None] or numbers[2:] == [0]:
            raise InputError(f"frames: {text!r} is not of the form all, 7, 0:{count}:10 or a list of these")
        first = numbers[0] or 0
        last = numbers[1] if len(numbers) > 1 else first + 1 if first != -1 else None
        if not -count <= first < count or not -count <= (last or 0) <= count:
            raise InputError(f"frames: {text!r} runs past the end; the capture has frames 0 to {count - 1}")
        chosen += range(count)[slice(numbers[0], last, numbers[2] if len(numbers) > 2 else None)]
    chosen = list(dict.fromkeys(chosen))
    if not chosen:
        raise InputError(f"frames: {text!r} selects no frame of 0 to {count - 1}")
    return chosen


def environment() -> dict[str, Any]:
    """Versions and devices, for the record."""
    versions = {"hyjax": package_version("hyjax"), "python": platform.python_version()}
    versions |= {name: package_version(name) for name in PACKAGES}
    device = jax.devices()[0]
    return {"versions": versions, "device": f"{device.platform}: {device.device_kind}", "cpu_count": os.cpu_count()}


def peak_memory_mib() -> float:
    """Largest resident set of this process so far, in MiB; NaN where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if platform.system() == "Darwin" else 2**10)


def make_writable(out: Path) -> None:
    """Make the output folder, or raise `InputError` if files cannot be written there."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise InputError(f"{out}: cannot write there ({error.strerror}); choose another --out") from None


def _write_frame(out: Path, name: str, relit: Relit, mode: Mode, outputs: Outputs) -> None:
    pictures = {"relit": relit.image}
    if outputs.filters:
        pictures |= {"filter": relit.shading, "refined": relit.refined}
    if outputs.visibility:
        pictures |= {"visibility": relit.visibility}
    for kind, picture in pictures.items():
        shown = _shown(picture, encoded=kind == "visibility" or (mode == "paper" and kind != "relit"))
        write_png(out / f"{name}.{kind}.png", shown)
        encoded_filter = mode == "paper" and kind in ("filter", "refined")
        write_exr(out / f"{name}.{kind}.exr", np.asarray(to_linear(picture) if encoded_filter else picture))


def _sheet_row(frame: Frame, relit: Relit, mode: Mode) -> list[Float[np.ndarray, "h w 3"]]:
    paper = mode == "paper"
    # Filters brighter than white are dimmed, both alike, until their structure shows.
    dim = 1.0 if paper else max(1.0, float(np.percentile(np.asarray(relit.refined), 98)))
    return [
        frame.image,
        _shown(relit.shading / dim, encoded=paper),
        _shown(relit.refined / dim, encoded=paper),
        _shown(relit.visibility, encoded=True),
        _shown(relit.unrefined),
        _shown(relit.image),
    ]


def _shown(picture: Any, encoded: bool = False) -> Float[np.ndarray, "h w 3"]:
    return np.asarray(picture if encoded else to_display(picture))


def package_version(package: str) -> str:
    """The installed version of a package, or "not installed"."""
    with contextlib.suppress(metadata.PackageNotFoundError):
        return metadata.version(package)
    return "not installed"
