"""Export of a page that times schedules on the device that opens it: static files, for any HTTPS host."""

import json
import sys
from importlib import resources
from pathlib import Path

import jax.numpy as jnp

from hyjax.export.settings import ExportSettings
from hyjax.guide.choose import RGB, open_guide
from hyjax.scene.scene import Scene
from hyjax.tuning.device_latency import DeviceWorkload
from hyjax.tuning.device_request import calibration_schedules, job, latency_request, request_text
from hyjax.util.files import make_writable, write_text

PAGE = {"index.html": "measure.html"} | {name: name for name in ("measure.js", "timing.js", "engine.js")}
"""Files of the page, by the name that they have in the folder."""
FOLDER = "bench"
PROBE = 64
"""Side in pixels of the picture by which a guide's channels are counted."""


def export_bench(settings: ExportSettings) -> Path:
    """Write the page, its schedules, and the same as a request for other engines; the folder of them.

    The page times the presets, or all that `hyjax tune --latency` wants to know, and saves latency.json.

    Args:
        settings: of which the size, the number of lights and the guide's channels count.
    """
    settings.check()
    scene = Scene.open(settings.scene, progress=not settings.quiet)
    features = 3
    if settings.guide != RGB.name:
        features = open_guide(settings.guide).features(jnp.zeros((PROBE, PROBE, 3))).shape[-1]
    height, width = settings.shape
    lights = len(scene.lights(settings.lights).lights)
    return write_bench(
        settings.out / FOLDER,
        DeviceWorkload(height=height, width=width, lights=lights, features=features),
        quiet=settings.quiet,
    )


def write_bench(folder: Path, workload: DeviceWorkload, *, quiet: bool = True) -> Path:
    """Write the page for a workload; the folder."""
    make_writable(folder)
    schedules = calibration_schedules(workload)
    request = latency_request(workload, schedules)
    source = resources.files("hyjax.device").joinpath("page")
    for name, own in PAGE.items():
        write_text(folder / name, source.joinpath(own).read_text(encoding="utf-8"))
    write_text(folder / "request.json", request_text(request))
    write_text(folder / "bench.json", json.dumps(job(0, request, schedules)))
    if not quiet:
        print(
            f"Put {folder} on any HTTPS host, or: hyjax serve {folder}. What the page saves is for hyjax tune "
            "--latency",
            file=sys.stderr,
        )
    return folder
