"""`hyjax info`: contents of a capture; or versions, devices and optional parts."""

import dataclasses
import logging
from pathlib import Path
from typing import get_args

import tyro

from hyjax.util.errors import InputError
from hyjax.util.settings import Settings


@dataclasses.dataclass(frozen=True)
class InfoSettings(Settings):
    """List the contents of a capture and doubts about it; without PATH: versions, devices and optional parts."""

    path: tyro.conf.Positional[Path | None] = None
    """Folder or archive of a capture."""
    scale: float | None = None
    """Metres in one unit of its poses, for a capture that does not know it."""
    out: Path | None = None
    """PNG file for a few frames, their depth and the path from above. Default: out/NAME-info.png."""
    choices: bool = False
    """List the choices of a configuration: name, default, values and meaning."""
    quiet: bool = False
    """No progress bar."""


def run_info(settings: InfoSettings) -> None:
    """`hyjax info`."""
    if settings.choices:
        print_choices()
    elif settings.path is not None:
        inspect_capture(settings)
    else:
        print_versions()


def inspect_capture(settings: InfoSettings) -> None:
    """`hyjax info PATH`."""
    from hyjax.data.registry import open_capture
    from hyjax.scene.inspection import inspect, relight_command
    from hyjax.scene.inspection_picture import write_inspection
    from hyjax.util.files import make_writable

    assert settings.path is not None
    if settings.out is not None and settings.out.suffix.lower() != ".png":
        raise InputError(f"out: {settings.out}: a picture is written; give a name that ends in .png")
    level = logging.getLogger("hyjax").level
    logging.getLogger("hyjax").setLevel(logging.ERROR)  # its lines stand in the list below
    try:
        capture = open_capture(settings.path, scale=settings.scale)
        inspection = inspect(capture, progress=not settings.quiet)
        out = settings.out or Path("out") / f"{capture.name}-info.png"
        make_writable(out.parent)
        write_inspection(out, inspection)
    finally:
        logging.getLogger("hyjax").setLevel(level)
    for name, value in inspection.lines():
        print(f"{name:<16}{value}")
    print(f"{'picture':<16}{out}")
    whole, quick = (relight_command(settings.path, capture, scale=settings.scale, quick=q) for q in (False, True))
    if quick != whole:
        print(f"{'a first look':<16}{quick}")
    print(f"{'relight it':<16}{whole}")


def print_choices() -> None:
    """`hyjax info --choices`."""
    from hyjax.choices.table import CHOICES

    for choice in CHOICES.values():
        low, high = choice.bounds or (0, 0)
        values = f"{low:g} to {high:g}" if high < 2**31 else f"{low:g} and more"
        values = " | ".join(map(str, get_args(choice.type))) or (values if choice.bounds else choice.type.__name__)
        default = "none" if choice.default is None else str(choice.default)
        print(f"{choice.name:<16}{default:<18}{values:<18}{choice.help}")


def print_versions() -> None:
    """`hyjax info` without a path."""
    import jax

    from hyjax.data.registry import CAPTURE_FORMATS
    from hyjax.device.webgpu import describe, open_device
    from hyjax.light.kinds import LIGHT_KINDS
    from hyjax.metrics import METRICS
    from hyjax.util.cache import cache_folder
    from hyjax.util.environment import OPTIONAL, environment, package_version

    record = environment()
    for name, version in record["versions"].items():
        print(f"{name:<32}{version}")
    for name in OPTIONAL:
        print(f"{name:<32}{package_version(name)} (optional)")
    print(f"{'devices':<32}{', '.join(f'{d.platform} ({d.device_kind})' for d in jax.devices())}")
    print(f"{'cpu cores':<32}{record['cpu_count']}")
    try:
        adapter = describe(open_device())
    except InputError as error:
        adapter = f"none ({error})"
    print(f"{'webgpu':<32}{adapter}")
    print(f"{'cache':<32}{cache_folder()}")
    print(f"{'kinds of light':<32}{', '.join(LIGHT_KINDS)}")
    print(f"{'metrics':<32}{', '.join(METRICS)}")
    for entry in CAPTURE_FORMATS:
        print(f"{'capture format':<32}{entry.name}: {entry.signs}")
