"""The commands. Thin: everything here is one call into the package."""

import contextlib
import dataclasses
import gc
import io
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import tyro

import hyjax
from hyjax.data.convert_settings import ConvertSettings
from hyjax.device.serve import ServeSettings, run_serve
from hyjax.export.settings import ExportSettings
from hyjax.info import InfoSettings, run_info
from hyjax.relighting.settings import RelightSettings
from hyjax.sweep.settings import SweepSettings
from hyjax.tour.settings import TourSettings
from hyjax.training.settings import TrainSettings, paper_settings
from hyjax.tuning.settings import TuneSettings
from hyjax.util.claims import claimed
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.interrupts import defer_interrupts, exit_now
from hyjax.util.terminal import check_given, end_output, open_closed_streams, quiet_libraries, usage_error

WITH_CAPTURE = ("relight", "tune", "tour")
"""Commands that take a capture as an option."""
RENAMED_VALUES = {("--renderer", "hyjax"): "shadow_map"}
OBJECTS_BEFORE_COLLECTION = 10_000
"""Number of new objects before Python looks for garbage: tracing makes many."""
SWITCH_SECONDS = 5e-4
"""Seconds after which a thread that runs Python makes way: those that mostly compute outside wait less for it."""


@dataclasses.dataclass(frozen=True)
class Train:
    """Train a guide network by depth super-resolution."""

    settings: TrainSettings
    paper: bool = False
    """The paper's recipe as the default of all settings; it wants a GPU. With --help, it shows them. It differs
    from the published code of Metzger et al. in weight decay (none; there 1e-5), loss (not times 10), lowering of
    the learning rate (every 1000 updates; every 100 epochs), kappa at the start (1; 0.03), norm of guide
    differences (L2; mean absolute value), start of the diffusion (bilinear; bicubic), rotation of crops (none; 15
    degrees), encoder at the start (random unless --start is given; ImageNet's), scale of depth (each crop's mean;
    the data set's) and steps when judged (a random number; all)."""
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


def parse() -> Any:
    """Settings of the command line. Exits with status 2 on a usage error."""
    # The defaults of `train`, and what its help says they are.
    recipe = paper_settings() if "--paper" in sys.argv else TrainSettings()
    commands = (
        Annotated[RelightSettings, tyro.conf.subcommand("relight")]
        | Annotated[TuneSettings, tyro.conf.subcommand("tune", default=TuneSettings(out=Path("tuned")))]
        | Annotated[SweepSettings, tyro.conf.subcommand("sweep")]
        | Annotated[Train, tyro.conf.subcommand("train", default=Train(recipe))]
        | Annotated[TourSettings, tyro.conf.subcommand("tour")]
        | Annotated[ExportSettings, tyro.conf.subcommand("export")]
        | Annotated[ServeSettings, tyro.conf.subcommand("serve")]
        | Annotated[ConvertSettings, tyro.conf.subcommand("convert")]
        | Annotated[InfoSettings, tyro.conf.subcommand("info")]
    )
    arguments = _renamed(sys.argv[1:])
    if not arguments:
        raise InputError("give a command, as in hyjax relight; see hyjax --help")
    if arguments[0].startswith("-") and not arguments[0].startswith(("-h", "--help", "--tyro")):
        raise InputError(f"{arguments[0]}: a command comes first, as in hyjax relight; see hyjax --help")
    if len(arguments) > 1 and arguments[0] in WITH_CAPTURE and not arguments[1].startswith("-"):
        raise InputError(f"{arguments[1]}: is no option; a capture is given as --capture {arguments[1]}")
    if arguments[:1] == ["info"] and any(argument.split("=")[0] == "--capture" for argument in arguments):
        raise InputError("--capture: is no option here; the capture is given by itself: hyjax info PATH")
    check_given(arguments)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            command = tyro.cli(
                commands,
                args=arguments,
                prog="hyjax",
                description="Relight camera frames of real rooms.",
                config=(tyro.conf.OmitArgPrefixes,),
            )
    except SystemExit as end:
        if end.code:
            raise InputError(usage_error(said.getvalue(), *arguments[:1])) from None
        raise
    sys.stderr.write(said.getvalue())
    return command


def _renamed(arguments: list[str]) -> list[str]:
    """Arguments with the values that version 0.1 called otherwise, with a line that says the new name."""
    renamed = []
    for place, argument in enumerate(arguments):
        option, _, value = argument.rpartition("=")
        before = option or (arguments[place - 1] if place else "")
        new = RENAMED_VALUES.get((before, value))
        if new is not None:
            print(f"hyjax: {before} {value} is now called {new}", file=sys.stderr)
            argument = f"{option}={new}" if option else new
        renamed.append(argument)
    return renamed


def main() -> None:
    """Entry point of the `hyjax` command. Bad input: one line on stderr and exit status 2."""
    open_closed_streams()
    quiet_libraries()
    # Products of matrices are small here, and their threads would spin on cores that are in use.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        if sys.argv[1:] == ["--version"]:
            print(f"hyjax {hyjax.__version__}", flush=True)
            return
        defer_interrupts()
        command = parse()
        gc.set_threshold(OBJECTS_BEFORE_COLLECTION)
        gc.enable()  # off until here
        if type(command) in DRAWING:
            from hyjax.util.compiled import compile_beside

            compile_beside(KERNELS)
        RUNNERS[type(command)](command)
        sys.stdout.flush()
    except InputError as error:
        print(f"hyjax: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        sys.exit(end_output(error))
    except KeyboardInterrupt:
        print("hyjax: interrupted; the files written so far are whole", file=sys.stderr)
        exit_now(130)


def run_relight(settings: RelightSettings) -> None:
    """`hyjax relight`."""
    # Heavy imports wait until the command line is known to be right.
    from hyjax.relighting.run import relight_capture

    _keep_for_later()
    if settings.each_light:
        from hyjax.relighting.each_light import relight_each

        runs = relight_each(settings)
        out, run = next(iter(runs.items()))
        done = f"{len(runs)} light{'s' * (len(runs) != 1)}, each by itself"
    else:
        out, run = settings.out, relight_capture(settings)
        done = f"{len(run['frames'])} frame{'s' * (len(run['frames']) != 1)} relit"
    if run["frames_without_surface"]:
        names = ", ".join(run["frames_without_surface"])
        print(f"hyjax: skipped, no ray met the mesh: {names}", file=sys.stderr)
    print(f"{done}; look at {out / 'contact_sheet.png'}")


def run_tune(settings: TuneSettings) -> None:
    """`hyjax tune`."""
    from hyjax.tuning.tune import tune, tune_schedule, write_request

    _keep_for_later()
    from hyjax.tuning.report import STEMS, best_file, summary

    if (path := settings.target_device.request) is not None:
        request = write_request(settings, path)
        print(f"{len(request.schedules)} schedules to time at {request.workload}: {path}")
        return
    tuned = (tune if settings.tunes_frame else tune_schedule)(settings=settings)
    if blind := tuned.record.get("frames without surface"):
        print(f"hyjax: left out, no ray met the mesh: {', '.join(blind)}", file=sys.stderr)
    if tuned.stage == "cascade":
        print(f"latency table: {tuned.record['latency']['table']}")
        print(tuned.schedule)
    for sentence in summary(tuned):
        print(sentence)
    if settings.out is not None:
        option, file = STEMS[tuned.stage], settings.out / best_file(tuned.stage)
        print(f"Look at {settings.out / 'report.html'}; relight with --{option} {file}")


def run_swept(settings: SweepSettings) -> None:
    """`hyjax sweep`."""
    from hyjax.sweep.run import run_sweep

    try:
        swept = run_sweep(settings)
    except KeyboardInterrupt:
        print("hyjax: --resume goes on with what is left", file=sys.stderr)
        raise
    if swept.errors:
        print(f"hyjax: {len(swept.errors)} tasks have no result; the first: {swept.errors[0]}", file=sys.stderr)
    if swept.damaged:
        lines = f"{swept.damaged} damaged line{'s' * (swept.damaged != 1)} of rows"
        print(f"hyjax: {lines} left out, cut off by a kill or a full disk; their tasks ran again", file=sys.stderr)
    print(f"{swept.tasks} tasks of {len(swept.lines)} configurations; look at {swept.out / 'sweep.png'}")


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
    optional_module("grain", "train", "train")
    from hyjax.training.run import train

    _keep_for_later()
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


def run_tour(settings: TourSettings) -> None:
    """`hyjax tour`."""
    import threading

    for module in ("astral", "av", "websockets"):
        optional_module(module, "tour", "tour")
    from hyjax.export.web import write_page
    from hyjax.tour.tour import Tour

    _keep_for_later()
    tour = Tour.open(settings, write_page)
    alone = contextlib.ExitStack()  # until the process ends
    alone.enter_context(claimed(settings.out))
    if not settings.is_local:
        print(
            f"hyjax: listening at {settings.host}: anybody who reaches it can use this tour",
            file=sys.stderr,
        )
    tour.warm_up()
    print(f"The tour is open at {tour.url} (Ctrl-C ends it)", flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        tour.stop()
        print(f"The tour has ended; with --out {settings.out} it goes on from here")
        exit_now(0)


def run_export(settings: ExportSettings) -> None:
    """`hyjax export`."""
    settings.check()
    _keep_for_later()
    if settings.captures:
        from hyjax.export.gallery import export_gallery

        count = len(export_gallery(settings))
        print(f"{settings.out} is a gallery of {count}; look at it with: hyjax serve {settings.out}")
    elif settings.to == "web":
        from hyjax.export.web import export_web

        export_web(settings)
        files = [settings.out] if settings.out.is_file() else settings.out.rglob("*")
        size = sum(file.stat().st_size for file in files if file.is_file()) / 1e6
        look = "open it in a browser" if settings.out.is_file() else f"look at it with: hyjax serve {settings.out}"
        print(f"{settings.out} is a page of {size:.0f} MB; {look}")
    elif settings.to == "bench":
        from hyjax.export.bench import export_bench

        export_bench(settings)
    else:
        from hyjax.export.run import export_file

        print(f"Look at {export_file(settings) / 'README.md'}")


def run_convert(settings: ConvertSettings) -> None:
    """`hyjax convert`."""
    from hyjax.data.convert import convert, relight_command

    count = convert(settings)
    print(f"{count} frame{'s' * (count != 1)} in {settings.out}; relight with: {relight_command(settings)}")


RUNNERS: dict[type[Any], Callable[[Any], None]] = {
    RelightSettings: run_relight,
    TuneSettings: run_tune,
    SweepSettings: run_swept,
    Train: run_train,
    TourSettings: run_tour,
    ExportSettings: run_export,
    ServeSettings: run_serve,
    ConvertSettings: run_convert,
    InfoSettings: run_info,
}
"""Function of each command, by its settings."""
DRAWING = (RelightSettings, TuneSettings, TourSettings, ExportSettings)
"""Settings of the commands that draw surfaces in their own process."""
KERNELS = tuple(f"hyjax.geometry.{name}" for name in ("fusion_kernel", "raster_kernels", "surface_kernel"))
"""Modules of compiled functions, in the order in which they are used."""


def _keep_for_later() -> None:
    """Keep memory for the next frame, compiled programs for the next start, and modules out of collections."""
    from hyjax.util.memory import keep_freed_memory

    keep_freed_memory()  # before the first thread
    from hyjax.util.compiled_cache import keep_compiled

    keep_compiled()
    gc.freeze()
    sys.setswitchinterval(SWITCH_SECONDS)
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained")


if __name__ == "__main__":
    warnings.filterwarnings("default")
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained")
    main()
