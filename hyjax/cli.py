"""The commands. Thin: everything here is one call into the package."""

import contextlib
import dataclasses
import logging
import os
import sys
import warnings
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from hyjax.errors import InputError
from hyjax.interrupts import keep_interrupts, leave
from hyjax.training.settings import PAPER, TrainSettings

if TYPE_CHECKING:
    from hyjax.data.capture import Capture
    from hyjax.schedule import Schedule


LARGEST = 16384  # pixels a side
WIDEST = 640  # pixels of a tour's picture, unless another size is given


@dataclasses.dataclass(frozen=True)
class Relight:
    """Relight the frames of a capture; without arguments, the built-in room."""

    capture: Path | None = None
    """Folder of a capture: 7-Scenes layout, or a scan of ARKitScenes. Default: the built-in room."""
    mesh: str | None = None
    """PLY, OBJ or GLB file in the capture's world coordinates; or 'captured' (came with the capture), 'scan'
    (simulated headset scan), 'fused' (from depth maps), 'true' (built-in room only). Default: scan for the built-in
    room; captured for a capture that has one, else fused."""
    frames: str = "all"
    """Which frames, by position in the capture: all, 7, 0:300:30, or a list such as 0,5,9:12."""
    lights: str = "noon-window"
    """noon-window, golden-hour, evening-lamps, night-moon, center-point, two-colors, or a YAML or JSON file."""
    schedule: str | None = None
    """hyjax, paper-50, paper-80, naive-50, naive-1000, or a JSON file. Default: hyjax; in paper mode paper-80."""
    kappa: float | None = None
    """Edge sensitivity of a named schedule. Default: 0.05 for hyjax and in paper mode, 0.02 for the others."""
    size: str | None = None
    """Work at this size: 512 (square) or 640x480 (width x height), of the largest centred part of that shape.
    Default: as captured."""
    guide: str = "rgb"
    """What guides the diffusion: rgb is the frame itself, small the network that comes with hyjax; or a safetensors
    file that train or tune wrote."""
    paper_mode: bool = False
    """Exactly the paper: multiply display values, leave holes in the mesh black."""
    video: bool = False
    """The frames follow each other: carry refined light from each to the next, so that it does not flicker."""
    shadows: bool = True
    """Whether lights cast shadows."""
    renderer: Literal["hyjax", "blender"] = "hyjax"
    """Who shades the mesh: hyjax, or Blender's Cycles, which traces every shadow and takes its time."""
    save_filters: bool = False
    """Also write each frame's raw and refined filter."""
    save_visibility: bool = False
    """Also write each frame's refined visibility."""
    voxel: float = 0.03
    """Voxel of a fused mesh in metres."""
    seed: int = 0
    """Of the simulated scan."""
    repair_mesh: bool = False
    """Drop unusable triangles of the mesh file instead of refusing it."""
    out: Path = Path("out")
    """Folder for the results."""
    quiet: bool = False
    """No progress bars."""


@dataclasses.dataclass(frozen=True)
class Tune:
    """Find the schedule that makes the best picture within a time budget on this device."""

    fps: tuple[float, ...] = ()
    """Frame rates to reach, such as 60, or several: 30 60 120."""
    budget_ms: tuple[float, ...] = ()
    """Budgets in milliseconds, besides or instead of frame rates."""
    stage: Literal["cascade", "frame"] = "cascade"
    """Whether the budget is for the diffusion alone or for the whole frame."""
    capture: Path | None = None
    """Folder of a capture: 7-Scenes layout, or a scan of ARKitScenes. Default: the built-in room."""
    mesh: str | None = None
    """The rough mesh: a file, 'captured' (came with the capture), 'scan' (simulated headset scan), or 'fused' (from
    depth maps). Default: captured where there is one, else scan."""
    target: str | None = None
    """The accurate mesh that the picture should look like: a file, 'true', 'fused' (at 2 cm), or 'converged' (1000
    steps of diffusion on the rough mesh). Default: true for the built-in room, else fused where there is depth."""
    lights: str = "two-colors"
    """A named set-up, or a YAML or JSON file; see relight."""
    frames: str | None = None
    """Which frames to tune on, see relight. Default: four of the first three quarters."""
    holdout: str | None = None
    """Which frames are only reported on. Default: four of the last quarter."""
    size: str = "512"
    """Work at this size: 512 (square) or 640x480 (width x height)."""
    guide: str = "rgb"
    """What guides the diffusion: rgb, small or a safetensors file; see relight."""
    joint: bool = False
    """Also tune a learned guide's last layer, together with the best schedule's kappa, lambda and attachment."""
    voxel: float = 0.03
    """Voxel of a fused rough mesh in metres."""
    repair_mesh: bool = False
    """Drop unusable triangles of a mesh file instead of refusing it."""
    seed: int = 0
    """Of the search and of the simulated scan."""
    time_limit: float | None = None
    """Seconds after which the search only finishes what it has."""
    extra: bool = True
    """Also tune for a few more budgets, to draw the curve of quality against time."""
    recalibrate: bool = False
    """Measure the device anew instead of using the latency table from the cache."""
    out: Path = Path("tuned")
    """Folder for schedule.json, pareto.csv, pareto.png, contact_sheet.png and report.html."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""
    quiet: bool = False
    """No progress bars."""


@dataclasses.dataclass(frozen=True)
class Train:
    """Train a guide network by depth super-resolution."""

    settings: tyro.conf.OmitArgPrefixes[TrainSettings]
    paper: bool = False
    """The paper's recipe as the default of all settings; it wants a GPU. With --help, it shows them."""
    hosts: int = 1
    """How many computers train together; each runs the same command with its own --host."""
    host: int = 0
    """Which of them this is."""
    coordinator: str | None = None
    """ADDRESS:PORT of host 0, where there are several."""
    out: Path = Path("trained")
    """Folder for guide.safetensors, log, curve, pictures and checkpoints; one that all hosts see."""
    resume: bool = False
    """Go on from the last checkpoint in the out folder."""
    quiet: bool = False
    """No progress bars."""


@dataclasses.dataclass(frozen=True)
class Tour:
    """Relight a capture live in the browser: hour and weather, windows, lamps, furniture."""

    capture: Path | None = None
    """Folder of a capture: 7-Scenes layout, or a scan of ARKitScenes. Default: the built-in room."""
    mesh: str | None = None
    """PLY, OBJ or GLB file in the capture's world coordinates, or a word; see relight."""
    guide: str = "rgb"
    """What guides the diffusion: rgb, small or a safetensors file; see relight."""
    schedule: Path | None = None
    """A JSON file, such as tune writes, to choose from beside the named ones."""
    size: str | None = None
    """Work at this size: 512 (square) or 640x480 (width x height). Default: as captured, at most 640 wide."""
    port: int = 8080
    """Where the page is served."""
    host: str = "127.0.0.1"
    """Address to listen at. Anybody who reaches another address than the default can see and change the tour."""
    voxel: float = 0.03
    """Voxel of a fused mesh in metres."""
    seed: int = 0
    """Of the simulated scan."""
    repair_mesh: bool = False
    """Drop unusable triangles of the mesh file instead of refusing it."""
    out: Path = Path("tour")
    """Folder for what one saves, and for the set-up, with which the tour goes on next time."""
    quiet: bool = False
    """No progress bars."""


@dataclasses.dataclass(frozen=True)
class Info:
    """Print versions, devices and what optional parts are installed."""


def parse() -> Relight | Tune | Train | Tour | Info:
    """The command line. Exits with status 2 if it is none."""
    # The defaults of `train`, and what its help says they are.
    recipe = PAPER if "--paper" in sys.argv else TrainSettings()
    commands = (
        Annotated[Relight, tyro.conf.subcommand("relight")]
        | Annotated[Tune, tyro.conf.subcommand("tune")]
        | Annotated[Train, tyro.conf.subcommand("train", default=Train(recipe))]
        | Annotated[Tour, tyro.conf.subcommand("tour")]
        | Annotated[Info, tyro.conf.subcommand("info")]
    )
    return tyro.cli(commands, prog="hyjax", description="Relight camera frames of real rooms.")


def main() -> None:
    """Entry point of the `hyjax` command. Bad input: one line on stderr and exit status 2."""
    logging.basicConfig(level=logging.WARNING, format="hyjax: %(message)s")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    if sys.argv[1:] == ["--version"]:
        print(f"hyjax {metadata.version('hyjax')}")
        return
    keep_interrupts()
    try:
        command = parse()
        if isinstance(command, Relight):
            run_relight(command)
        elif isinstance(command, Tune):
            run_tune(command)
        elif isinstance(command, Train):
            run_train(command)
        elif isinstance(command, Tour):
            run_tour(command)
        else:
            run_info()
        sys.stdout.flush()
    except InputError as error:
        print(f"hyjax: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # whoever read our output (`| head`) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        print("hyjax: interrupted; the files written so far are whole", file=sys.stderr)
        leave(130)


def run_relight(command: Relight) -> None:
    """`hyjax relight`."""
    # Heavy imports wait until the command line is known to be right.
    from hyjax.data.frames import select_frames
    from hyjax.data.light_file import is_light_file, read_lights
    from hyjax.data.light_setups import check_setup_name, named_setup, survey_capture
    from hyjax.data.open import open_capture
    from hyjax.data.room import UP as ROOM_UP
    from hyjax.data.room import load_room
    from hyjax.data.surfaces import check_mesh_name, surface_of
    from hyjax.files import make_writable
    from hyjax.guide.choose import open_guide
    from hyjax.relighting import Outputs, check_video, relight_capture
    from hyjax.scene.blender import blender_python
    from hyjax.scene.raycast import RayCaster
    from hyjax.tuning.latency import StageClock

    _keep_compiled()
    # All that can be checked is checked before the first slow step.
    clock, bars = StageClock(), not command.quiet
    schedule = _schedule(command)
    check_video(command.video, "paper" if command.paper_mode else "hyjax")
    size = _size(command.size)
    from_file = is_light_file(command.lights)
    if not from_file:
        check_setup_name(command.lights)
    check_mesh_name(command.mesh)
    guide = open_guide(command.guide)
    if command.renderer == "blender":
        blender_python()
    capture: Capture | None = None
    if command.capture is not None:
        with clock("capture"):
            capture = open_capture(command.capture)
    setup = read_lights(Path(command.lights), ROOM_UP if capture is None else capture.up) if from_file else None
    make_writable(command.out)
    if capture is None:
        with clock("capture"):
            capture = load_room(progress=bars)
    chosen = select_frames(command.frames, len(capture))
    with clock("mesh"):
        source, mesh = surface_of(
            capture,
            command.mesh,
            voxel=command.voxel,
            seed=command.seed,
            repair=command.repair_mesh,
            progress=bars,
        )
        caster = RayCaster(mesh)
    if setup is None:
        setup = named_setup(command.lights, survey_capture(caster, capture))
    run = relight_capture(
        capture,
        caster,
        setup,
        schedule,
        command.out,
        frames=chosen,
        size=size,
        guide=guide,
        mode="paper" if command.paper_mode else "hyjax",
        video=command.video,
        shadows=command.shadows,
        renderer=command.renderer,
        outputs=Outputs(command.save_filters, command.save_visibility),
        settings=dataclasses.asdict(command)
        | {"capture": str(command.capture or "built-in room"), "mesh": source, "out": str(command.out)},
        clock=clock,
        progress=bars,
    )
    if run["frames_without_surface"]:
        names = ", ".join(run["frames_without_surface"])
        print(f"hyjax: skipped, no ray met the mesh: {names}", file=sys.stderr)
    count = len(run["frames"])
    print(f"{count} frame{'s' * (count != 1)} relit; look at {command.out / 'contact_sheet.png'}")


def run_tune(command: Tune) -> None:
    """`hyjax tune`."""
    from hyjax.tuning.report import summary
    from hyjax.tuning.tune import tune

    _keep_compiled()
    tuned = tune(
        fps=command.fps,
        budget_ms=command.budget_ms,
        capture=command.capture,
        mesh=command.mesh,
        target=command.target,
        lights=command.lights,
        stage=command.stage,
        frames=command.frames,
        holdout=command.holdout,
        size=_size(command.size),
        guide=command.guide,
        joint=command.joint,
        seed=command.seed,
        time_limit=command.time_limit,
        extra=command.extra,
        recalibrate=command.recalibrate,
        voxel=command.voxel,
        repair_mesh=command.repair_mesh,
        out=command.out,
        resume=command.resume,
        settings=dataclasses.asdict(command)
        | {"capture": str(command.capture or "built-in room"), "out": str(command.out)},
        progress=not command.quiet,
    )
    if tuned.record["frames without surface"]:
        names = ", ".join(tuned.record["frames without surface"])
        print(f"hyjax: left out, no ray met the mesh: {names}", file=sys.stderr)
    print(f"latency table: {tuned.record['latency']['table']}")
    print(tuned.schedule)
    for sentence in summary(tuned):
        print(sentence)
    print(f"Look at {command.out / 'report.html'}; relight with --schedule {command.out / 'schedule.json'}")


def run_train(command: Train) -> None:
    """`hyjax train`."""
    import shlex

    import jax

    settings = command.settings.check()
    if command.hosts < 1 or not 0 <= command.host < command.hosts:
        raise InputError(f"host: {command.host} of {command.hosts} hosts; they are numbered from 0")
    if command.hosts > 1:
        if command.coordinator is None:
            raise InputError("coordinator: give --coordinator ADDRESS:PORT of host 0, the same on every host")
        jax.distributed.initialize(command.coordinator, command.hosts, command.host)
    from hyjax.training.run import train

    _keep_compiled()
    called = shlex.join(["hyjax", *sys.argv[1:]])
    if not command.quiet:
        print(
            f"{settings.encoder} with {settings.features} features learns from {', '.join(settings.pairs)}: "
            f"{settings.iterations} updates of {settings.batch} crops of {settings.size}x{settings.size} into "
            f"{command.out}, the first after a minute or more of compilation",
            file=sys.stderr,
        )
    try:
        last = train(settings, command.out, resume=command.resume, command=called, progress=not command.quiet)
    except KeyboardInterrupt:
        if (command.out / "checkpoints").is_dir():
            print("hyjax: --resume goes on from the last checkpoint", file=sys.stderr)
        raise
    print(f"{'validation':16}{'guide':>10}{'RGB guide':>12}")
    for name, value in last["rgb"].items():
        print(f"{name:16}{last[name]:10.4f}{value:12.4f}")
    print(f"Look at {command.out / 'curve.png'}; relight with --guide {command.out / 'guide.safetensors'}")


def run_tour(command: Tour) -> None:
    """`hyjax tour`."""
    import threading

    try:
        import astral  # noqa: F401
        import av  # noqa: F401
        import viser  # noqa: F401
    except ImportError as error:
        raise InputError(f"tour: needs the package {error.name}; install it with: pip install '.[tour]'") from None
    from hyjax.data.open import open_capture
    from hyjax.data.room import load_room
    from hyjax.data.surfaces import check_mesh_name, surface_of
    from hyjax.files import make_writable
    from hyjax.guide.choose import open_guide
    from hyjax.schedule import PRESETS, Schedule
    from hyjax.tour.door import LOCAL, check_port
    from hyjax.tour.page import Tour as ServedTour
    from hyjax.tour.studio import Studio

    _keep_compiled()
    bars = not command.quiet
    check_port(command.host, command.port)
    size = _size(command.size)
    check_mesh_name(command.mesh)
    guide = open_guide(command.guide)
    schedules = {name: Schedule.preset(name) for name in PRESETS if not name.endswith("shadow")}
    if command.schedule is not None:
        tuned = _read_schedule(str(command.schedule))
        schedules = {f"{tuned.name} ({command.schedule.name})": tuned} | schedules
    capture = None if command.capture is None else open_capture(command.capture)
    make_writable(command.out)
    capture = load_room(progress=bars) if capture is None else capture
    _, mesh = surface_of(
        capture, command.mesh, voxel=command.voxel, seed=command.seed, repair=command.repair_mesh, progress=bars
    )
    height, width = capture[0].camera.intrinsics.shape
    if size is None and width > WIDEST:
        size = round(height * WIDEST / width), WIDEST
    studio = Studio(capture, mesh, guide=guide, size=size, folder=command.out)
    if command.host not in (LOCAL, "localhost"):
        print(
            f"hyjax: listening at {command.host}: whoever reaches it can see and change this tour", file=sys.stderr
        )
    tour = ServedTour(studio, schedules, command.out, host=command.host, port=command.port)
    tour.warm_up()
    print(f"The tour is open at {tour.url} (Ctrl-C ends it)", flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        tour.stop()
        print(f"The tour has ended; with --out {command.out} it goes on from here")
        leave(0)


def _keep_compiled() -> None:
    """Keep what XLA compiles in the cache folder."""
    import jax

    from hyjax.cache import cache_folder
    from hyjax.files import make_writable

    with contextlib.suppress(InputError):  # an unwritable cache folder costs time only
        compiled = cache_folder() / "compiled"
        make_writable(compiled)
        jax.config.update("jax_compilation_cache_dir", str(compiled))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        # Half-written by a process that was killed, or that writes it just now: compiled anew.
        warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")


def run_info() -> None:
    """`hyjax info`."""
    import jax

    from hyjax.cache import cache_folder
    from hyjax.environment import OPTIONAL, environment, package_version

    record = environment()
    for name, version in record["versions"].items():
        print(f"{name:<32}{version}")
    for name in OPTIONAL:
        print(f"{name:<32}{package_version(name)} (optional)")
    print(f"{'devices':<32}{', '.join(f'{d.platform} ({d.device_kind})' for d in jax.devices())}")
    print(f"{'cpu cores':<32}{record['cpu_count']}")
    print(f"{'cache':<32}{cache_folder()}")


def _schedule(command: Relight) -> "Schedule":
    from hyjax.schedule import PAPER_KAPPA, Schedule

    text = command.schedule or ("paper-80" if command.paper_mode else "hyjax")
    if Path(text).suffix.lower() != ".json":
        kappa = PAPER_KAPPA if command.kappa is None and command.paper_mode else command.kappa
        return Schedule.preset(text, kappa=kappa)
    if command.kappa is not None:
        raise InputError(f"kappa: {text} brings its own; give --kappa with a named schedule only")
    return _read_schedule(text)


def _read_schedule(text: str) -> "Schedule":
    from hyjax.schedule import Schedule

    try:
        return Schedule.from_json(Path(text).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{text}: cannot read the schedule ({getattr(error, 'strerror', error)})") from None
    except InputError as error:
        raise InputError(f"{text}: {error}") from None


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    fields = text.lower().split("x")
    numbers = all(f.isascii() and f.isdecimal() and len(f) < 6 and 8 <= int(f) <= LARGEST for f in fields)
    if not 1 <= len(fields) <= 2 or not numbers:
        raise InputError(f"size: {text!r} must be a number (512) or width x height (640x480), each 8 to {LARGEST}")
    return int(fields[-1]), int(fields[0])


if __name__ == "__main__":
    warnings.filterwarnings("default")
    main()
