"""Relighting a capture from end to end: everything that `hyjax relight` does, as a function."""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from hyjax.color import to_display, to_linear
from hyjax.contact_sheet import write_contact_sheet
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import LightSetup, write_lights
from hyjax.environment import environment, peak_memory_mib
from hyjax.errors import InputError
from hyjax.files import make_writable, remove, write_text
from hyjax.gbuffer import GBuffer
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.images import write_exr, write_png
from hyjax.overlap import DEPTH, ahead, behind
from hyjax.pipeline import Mode, Relit, relight_stages
from hyjax.scene.blender import BlenderRenderer
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.schedule import Schedule
from hyjax.tuning.latency import StageClock, Stopwatch
from hyjax.video import Video

Renderer = Literal["hyjax", "blender"]

HEADINGS = ("frame", "raw filter", "refined filter", "visibility", "raw filter x frame", "relit")
SHEET_ROWS = 12
WARM_UP = DEPTH + 2
"""Frames that do not count for frames per second: the first compiles, and others are read meanwhile."""


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
    guide: FrameGuide = RGB,
    mode: Mode = "hyjax",
    video: bool = False,
    shadows: bool = True,
    renderer: Renderer = "hyjax",
    outputs: Outputs | None = None,
    settings: dict[str, Any] | None = None,
    clock: StageClock | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Relight frames of a capture and write pictures, a contact sheet, the lights and `run.json` to `out`.

    While the device relights a frame, the next ones are read and their rays cast, and the last ones encoded and
    written: the stages' milliseconds in `run.json` overlap, and `frames_per_second` (after the first `WARM_UP`) is
    what comes out. These threads do not see JAX's context managers that stand around the call. Where there are
    several devices, frames go to them in turns, unless each needs the one before it (`video`).

    Every file appears whole or not at all, so that an interrupted run leaves nothing half-written.

    Args:
        capture: frames with poses.
        caster: the mesh, in the capture's world coordinates.
        setup: lights.
        schedule: cascade for the shading.
        out: folder, made if need be.
        frames: indices; all by default.
        size: (height, width) to work at: the largest centred window of that shape, resampled. Default: as captured.
        guide: what makes the guide of a frame, see `open_guide`.
        mode: see `relight`.
        video: whether the light is kept still from one frame to the next, see `hyjax.video`.
        shadows: whether lights cast shadows.
        renderer: who shades the mesh and casts the shadows: `"hyjax"` from G-buffer and shadow maps, or
            `"blender"`, which traces rays (see `hyjax.scene.blender`).
        outputs: what else to write for each frame.
        settings: recorded in `run.json` as they are.
        clock: times of earlier stages, if they are to be in `run.json` too.
        progress: show a bar on stderr.

    Returns:
        The content of `run.json`.

    Raises:
        InputError: a video in mode `"paper"`, the folder cannot be written, no frame sees the mesh, or there is no
            Blender to render with.
    """
    if renderer not in get_args(Renderer):
        raise InputError(f"renderer: {renderer!r} is unknown; use one of {', '.join(get_args(Renderer))}")
    check_video(video, mode)
    outputs, clock = outputs or Outputs(), clock or StageClock()
    memory = Video()
    chosen = range(len(capture)) if frames is None else frames
    make_writable(out)
    for summary in ("run.json", "lights.json", "contact_sheet.png"):
        remove(out / summary)  # of an earlier run, whose pictures are about to be replaced
    given: dict[str, Any] = {}  # to the relighting of every frame
    with contextlib.ExitStack() as stack:
        if renderer == "blender":
            with clock("blender start"):
                blender = stack.enter_context(BlenderRenderer(caster.mesh, setup.lights, shadows=shadows))
        elif shadows:
            with clock("shadow maps"):
                given["shadow_maps"] = jax.block_until_ready(cast_shadow_maps(caster, setup.lights))
        rows: list[tuple[str, list[np.ndarray]]] = []
        sheet_every = max(1, -(-len(chosen) // SHEET_ROWS))
        skipped, written = [], []

        # Each device has its own lights and shadow maps; Blender, and what frames leave to the next, there is once.
        devices = jax.local_devices()[: 1 if video or renderer == "blender" else None]
        held = [jax.device_put((setup.lights, given), device) for device in devices] if len(devices) > 1 else []

        def see(index: int) -> tuple[Frame, GBuffer]:
            with clock("read"):
                frame = fit(capture[index], size)
            with clock("g-buffer"):
                return frame, jax.block_until_ready(caster.gbuffer(frame.camera))

        def relight_frame(numbered: tuple[int, tuple[Frame, GBuffer]]) -> tuple[Frame, Relit | None]:
            number, (frame, gbuffer) = numbered
            if not bool(gbuffer.hit.any()):
                return frame, None
            lights, options = setup.lights, dict(given)
            display = jnp.asarray(frame.image)
            if held:
                lights, options = held[number % len(held)]
                display, gbuffer = jax.device_put((display, gbuffer), devices[number % len(held)])
            if renderer == "blender":
                with clock("blender"):
                    rendering = blender.render(frame.camera)
                gbuffer = rendering.seen_by_both(gbuffer)
                options |= {
                    "shading": jnp.asarray(rendering.shading),
                    "visibility": jnp.asarray(rendering.visibility),
                }
            with clock("guide"):
                features = jax.block_until_ready(guide.features(display))
            if video:
                camera = frame.camera
                options["settle"] = memory.settle(
                    gbuffer, lights, features, schedule, camera.pose, camera.intrinsics.matrix
                )
            stages = relight_stages(
                to_linear(display),
                gbuffer,
                lights,
                features,
                schedule,
                reference_lux=setup.reference_lux,
                mode=mode,
                **options,
            )
            return frame, clock.follow(stages)

        begun = Stopwatch()
        with contextlib.ExitStack() as running:
            later = running.enter_context(behind())
            seen = enumerate(running.enter_context(contextlib.closing(ahead(see, chosen))))
            done: Iterator[tuple[Frame, Relit | None]] = map(relight_frame, seen)
            if held:
                many = ahead(relight_frame, seen, len(held), threads=len(held))
                done = running.enter_context(contextlib.closing(many))
            for frame, relit in tqdm(done, "relighting", len(chosen), unit="frame", disable=not progress):
                if relit is None:
                    skipped.append(frame.name)
                    continue
                pictures = _pictures(relit, outputs)
                later(functools.partial(_write_frame, clock, out, frame.name, pictures, mode))
                written.append(frame.name)
                if len(written) == WARM_UP:
                    begun = Stopwatch()
                if (len(written) - 1) % sheet_every == 0:
                    rows.append((frame.name, _sheet_row(frame, relit, mode)))
        timed = len(written) - WARM_UP
        frames_per_second = round(timed / begun.seconds, 2) if timed > 0 else None
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
        "video": video,
        "guide": guide.name,
        "renderer": renderer,
        "schedule": json.loads(schedule.to_json()),
        "reference_lux": setup.reference_lux,
        "settings": settings or {},
        "milliseconds": clock.summary(),
        "frames_per_second": frames_per_second,
        "peak_memory_mib": round(peak_memory_mib(), 1),
    } | environment()
    write_text(out / "run.json", json.dumps(run, indent=2) + "\n")
    return run


def check_video(video: bool, mode: Mode) -> None:
    """Raise `InputError` if light is to be kept still in a mode that cannot."""
    if video and mode == "paper":
        raise InputError("video: the paper's mode has no memory of earlier frames; leave one of the two out")


def _pictures(relit: Relit, outputs: Outputs) -> dict[str, Float[Array, "h w 3"]]:
    """What is written of a frame, by kind; nothing else is kept until then."""
    pictures = {"relit": relit.image}
    if outputs.filters:
        pictures |= {"filter": relit.shading, "refined": relit.refined}
    if outputs.visibility:
        pictures |= {"visibility": relit.visibility}
    return pictures


def _write_frame(
    clock: StageClock, out: Path, name: str, pictures: dict[str, Float[Array, "h w 3"]], mode: Mode
) -> None:
    with clock("write"):
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
