"""Relighting run: the frames of a capture, relit and written with a contact sheet, the lights and `run.json`."""

import contextlib
import dataclasses
import functools
import json
import logging
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from hyjax.configuration import PRESETS, Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture
from hyjax.data.frames import select_frames
from hyjax.data.light_file import is_light_file, write_lights
from hyjax.guide.choose import FrameGuide, configured_guide
from hyjax.light.kinds import Light, kind_name
from hyjax.light.setup import LightSetup
from hyjax.metrics.dark_share import DarkShare, dark_share
from hyjax.relighting.ahead import DarkLights, begin_programs, compile_ahead, is_short
from hyjax.relighting.frames import RelitFrame, cycles, relit_frames, relit_on_device
from hyjax.relighting.pictures import COLUMNS, sheet_row, write_frame, written_pictures
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.exposure import warn_of_far
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.light_setups import DARK_SETUPS, EXPOSURES, tell_made_up
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.util.arguments import checked_arguments
from hyjax.util.clock import StageClock, Stopwatch
from hyjax.util.contact_sheet import fitted_row, write_contact_sheet
from hyjax.util.cores import cores
from hyjax.util.environment import environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import output_folder, remove, write_text
from hyjax.util.prefetch import DEPTH, background_writer
from hyjax.util.progress import CommandBar, command_bar
from hyjax.util.quick_programs import optimise_programs, quick_programs

_log = logging.getLogger(__name__)
SHEET_ROWS = 12
SURFACE_OPTIONS = ("seed", "repair_mesh", "size", "scale", "strict", *FusionSettings.__dataclass_fields__)
"""Options of the opening of a scene, unknown of one that was opened before."""
WARM_UP = DEPTH + 2
"""Frames that do not count for frames per second: the first compiles, and others are read meanwhile."""


@checked_arguments
def relight_capture(
    settings: RelightSettings,
    *,
    scene: Scene | None = None,
    lights: LightSetup | Sequence[Light] | str | Path | None = None,
    schedule: Schedule | None = None,
    guide: FrameGuide | None = None,
) -> dict[str, Any]:
    """Relight frames of a capture and write pictures, a contact sheet, the lights and `run.json`.

    While the device relights a frame, the next ones are read and drawn into G-buffers, and the last ones encoded
    and written: the stages' milliseconds in `run.json` overlap, and `frames_per_second` (after the first `WARM_UP`)
    is what comes out. These threads do not see JAX's context managers that stand around the call. On a processor
    several frames are relit at a time, and where there are several devices, frames go to them in turns, unless each
    needs the one before it (`video`).

    Every file appears whole or not at all, so that an interrupted run leaves nothing half-written.

    Args:
        settings: what to relight and how. What is given below takes the place of what they name.
        scene: opened before.
        lights: a set-up, or its name or file.
        schedule: cascade for the shading.
        guide: what makes the guide of a frame.

    Returns:
        The content of `run.json`.

    Raises:
        InputError: any of these cannot be used, the folder cannot be written, no frame sees the mesh, or there is
            no Blender to render with; or `each_light`, which is for `relight_each`.
    """
    if settings.each_light:
        raise InputError("each_light: relight_capture makes one picture of all lights; call relight_each")
    return relight_run(settings, scene, lights, schedule, guide)


def relight_run(
    settings: RelightSettings,
    scene: Scene | None = None,
    lights: LightSetup | Sequence[Light] | str | Path | None = None,
    schedule: Schedule | None = None,
    guide: FrameGuide | None = None,
) -> dict[str, Any]:
    """The run of `relight_capture`, or with `each_light` that of one of the lights that the settings name."""
    # All that can be checked is checked before the first slow step.
    settings.check()
    record = settings.record() | ({} if schedule is None else {"schedule": schedule.name, "kappa": None})
    configuration = settings.open_configuration()
    if schedule is not None:
        configuration = dataclasses.replace(configuration, schedule=schedule)
    schedule, guide = configuration.schedule, guide or configured_guide(configuration.guide)
    tell_of_another_device(configuration)
    for renderer in settings.renderers:
        configuration = configuration.followed_by(renderer)
    taken = configuration.light.sampling
    if settings.sampling not in (None, taken):
        _log.warning(
            "sampling: %d asked; schedule, mode or renderer allow %d, which is taken", settings.sampling, taken
        )
    if settings.renderer == "blender":
        from hyjax.scene.blender import blender_python

        blender_python()
    device = None
    if settings.renderer == "webgpu":
        from hyjax.device.webgpu import open_device

        device = open_device()
    clock, progress, out = StageClock(), not settings.quiet, settings.out

    def open_capture() -> Capture:
        with clock("capture"):
            return settings.scene.open_capture(progress=progress)

    with command_bar("relighting", "frame", disable=settings.quiet) as bar, ExitStack() as stack:
        stack.enter_context(quick_programs(wanted=is_short(configuration)))
        capture = None
        if scene is None and settings.scene.capture is not None:
            capture = open_capture()  # one that cannot be used makes no folder
        stack.enter_context(output_folder(out))
        if scene is None:
            if capture is None:
                capture = open_capture()
            chosen = select_frames(settings.frames, len(capture))
            scene = Scene.open(settings.scene, capture=capture, clock=clock, progress=progress)
        else:
            chosen = select_frames(settings.frames, len(scene))
            if not settings.each_light:
                record |= dict.fromkeys(SURFACE_OPTIONS) | {"capture": scene.capture.name}
        divides = settings.divides_photo_light
        asked = settings.lights if lights is None else lights
        # The estimate of the photo's light runs on another thread. It may yet say how strong the lights are.
        begun = divides and settings.renderer == "shadow_map" and scene.photo_light.begin()
        if begun:
            placed = scene.lights(asked, at_photo_sources=True, exposed=False)
            compile_ahead(scene, chosen, placed, settings, configuration, guide, clock)
        setup = scene.lights(asked, at_photo_sources=divides)
        setup.check_existing(divided=divides)
        if setup.existing:
            try:
                scene.photo_light.kept(setup.existing)
            except InputError as error:
                raise InputError(f"{asked}: {error}" if isinstance(asked, str | Path) else str(error)) from None
        for light in setup.lights:
            kind_name(light)  # it can be written in the end
        record |= {"mesh": scene.source, "guide": guide.name}
        if lights is not None and not settings.each_light:
            record["lights"] = str(lights) if isinstance(lights, str | Path) else "lights.json"
        for stale in ("run.json", "lights.json", "contact_sheet.png"):
            remove(out / stale)  # of an earlier run, whose pictures are about to be replaced
        if settings.renderer == "webgpu":
            frames = relit_on_device(scene, chosen, setup, settings, configuration, guide, clock, device)
        else:
            dark = DarkLights()
            if settings.renderer == "shadow_map" and not begun:
                dark = begin_programs(scene, chosen, setup, configuration, guide, video=settings.video)
            relighter = Relighter(
                scene,
                setup,
                configuration,
                guide=guide,
                shadows=settings.shadows,
                occluders=settings.occluders,
                video=settings.video,
                shader=cycles(scene, setup, settings, clock, stack) if settings.renderer == "blender" else None,
                clock=clock,
            )
            relighter.dark_lights = dark.count
            # Blender, and what frames leave to the next, there is once.
            once = settings.video or settings.renderer == "blender"
            frames = relit_frames(
                scene, chosen, relighter, clock, once=once, after_first=lambda: dark.drop_later(relighter)
            )
        summary = _write_frames(frames, len(chosen), settings, clock, bar)
        if not summary.written:
            if not summary.skipped:
                raise InputError(f"{scene.capture.name}: none of the chosen frames can be read")
            raise InputError(
                f"{scene.capture.name}: no ray of any chosen frame met the mesh; are the mesh and the poses in the "
                "same coordinates (metres, camera-to-world)?"
            )
        tell_of_earlier_pictures(out, summary.written)
        if divides and scene.photo_light.sources.origin != "capture" and scene.photo_light.estimate.exponent:
            _log.warning("%s: %s", scene.capture.name, scene.photo_light.summary(scene.photo_light.estimate))
        if isinstance(asked, str | Path) and is_light_file(str(asked)):
            warn_of_far(setup.lights, scene.caster.bounds, str(asked))
        if str(asked) in EXPOSURES:  # the paper's two have lights of their own
            tell_made_up(str(asked), scene.anchors(at_photo_sources=divides), setup.lights)
        if not settings.each_light:
            given = isinstance(asked, str | Path) and is_light_file(str(asked))
            file = str(asked) if given else "lights.json"
            tell_of_exposure(summary, setup, file, dark=str(asked) not in DARK_SETUPS)
        write_contact_sheet(out / "contact_sheet.png", summary.rows, [*COLUMNS.values()])
        write_lights(out / "lights.json", setup)
        run = {
            "frames": summary.written,
            "frames_without_surface": summary.skipped,
            "mesh_faces": len(scene.caster.arrays.faces),
            "size": summary.size,
            "mode": settings.mode,
            "video": settings.video,
            "guide": guide.name,
            "renderer": settings.renderer,
            "sampling": configuration.light.sampling,
            "configuration": json.loads(configuration.to_json()),
            "schedule": json.loads(schedule.to_json()),
            "reference_lux": setup.reference_lux,
            "frames_too_dark": summary.dark,
            "frames_too_bright": summary.bright,
            "photo_light": scene.photo_light.record() if settings.divides_photo_light else None,
            "settings": record,
            "milliseconds": clock.summary(),
            "frames_per_second": summary.frames_per_second,
            "peak_memory_mib": round(peak_memory_mib(), 1),
        } | environment()
        write_text(out / "run.json", json.dumps(run, indent=2) + "\n")
        return run


def tell_of_another_device(configuration: Configuration) -> None:
    """Log that a configuration was measured on another device."""
    measured = configuration.measured
    if measured is None or configuration.name in PRESETS:
        return
    if measured.device != (here := environment()["device"]):
        _log.warning(
            "configuration %s was tuned on %s; on this device, %s, its times may be others",
            configuration.name,
            measured.device,
            here,
        )


def tell_of_earlier_pictures(out: Path, written: Sequence[str]) -> None:
    """Log pictures that other runs have left in the folder, beside those that were written."""
    ending = ".relit.png"
    left = sorted({file.name.removesuffix(ending) for file in out.glob(f"*{ending}")} - set(written))
    if left:
        _log.warning(
            "%s: has %s of an earlier run, too (%s%s%s), which the contact sheet does not show",
            out,
            f"{len(left)} pictures" if len(left) > 1 else "a picture",
            left[0],
            ending,
            ", …" if len(left) > 1 else "",
        )


def tell_of_exposure(summary: "_Summary", setup: LightSetup, file: str, *, dark: bool) -> None:
    """Log frames that burnt out, or ended nearly black where `dark` says so, and a remedy in the lights' file."""
    too_dark = (
        "%d of %d pictures end nearly black (%s): little light of the set-up reaches what they show; write nearer "
        "lights, more ambient light or less than its reference_lux of %.3g into %s, and give that"
    )
    too_bright = (
        "%d of %d pictures burn out where the photo did not (%s): their lights are too strong for the "
        "reference_lux of %.3g in %s; give a file with a larger one, or with weaker lights"
    )
    told = ((too_dark, summary.dark if dark else []), (too_bright, summary.bright))
    for message, names in told:
        if names:
            first = ", ".join(f"{name}.relit.png" for name in names[:3]) + (", …" if len(names) > 3 else "")
            _log.warning(message, len(names), len(summary.written), first, float(setup.reference_lux), file)


@dataclasses.dataclass
class _Summary:
    """Frames of a run.

    Attributes:
        written: names of those that were relit.
        skipped: names of those that see no surface.
        size: (height, width) of the last one.
        dark, bright: names of those that ended too dark, and too bright, see `DarkShare`.
        frames_per_second: after the warm-up; None for a shorter run.
    """

    written: list[str] = dataclasses.field(default_factory=list)
    skipped: list[str] = dataclasses.field(default_factory=list)
    rows: list[tuple[str, list[np.ndarray]]] = dataclasses.field(default_factory=list)
    size: list[int] = dataclasses.field(default_factory=list)
    dark: list[str] = dataclasses.field(default_factory=list)
    bright: list[str] = dataclasses.field(default_factory=list)
    frames_per_second: float | None = None


def _write_frames(
    frames: Generator[RelitFrame],
    count: int,
    settings: RelightSettings,
    clock: StageClock,
    bar: CommandBar | None,
) -> _Summary:
    """Write the pictures of all frames while the next ones are relit; the first before any other is."""
    summary, begun, shares = _Summary(), Stopwatch(), dict[str, DarkShare]()
    sheet_every = max(1, -(-count // SHEET_ROWS))
    every_stage = settings.save_filters or settings.save_visibility

    def write(name: str, photo: Float[np.ndarray, "h w 3"], pictures: dict[str, Float[Array, "h w 3"]]) -> None:
        shown = write_frame(clock, settings.out, name, pictures, settings.mode, exr=settings.exr)
        shares[name] = dark_share(photo, shown["relit"])

    def now(call: Callable[[], object]) -> None:
        call()

    with background_writer(threads=cores()) as later, contextlib.closing(frames):
        for done in frames if bar is None else bar.count(frames, count):
            frame = done.frame
            summary.size = list(frame.image.shape[:2])
            if done.image is None:
                summary.skipped.append(frame.name)
                optimise_programs()
                continue
            relit = done.compared() if every_stage else None
            pictures = written_pictures(done.image, relit, settings)
            (later if summary.written else now)(functools.partial(write, frame.name, frame.image, pictures))
            if len(summary.written) % sheet_every == 0:
                row = sheet_row(frame, relit or done.compared(), settings.mode)
                summary.rows.append((frame.name, fitted_row([row[name] for name in COLUMNS])))
                del row
            done.forget()
            del relit, pictures
            summary.written.append(frame.name)
            optimise_programs()
            if len(summary.written) == WARM_UP:
                begun = Stopwatch()
    summary.dark = [name for name in summary.written if shares[name].too_dark]
    summary.bright = [name for name in summary.written if shares[name].too_bright]
    timed = len(summary.written) - WARM_UP
    summary.frames_per_second = round(timed / begun.seconds, 2) if timed > 0 else None
    return summary
