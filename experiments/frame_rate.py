"""Whole frames a second: every frame with its own camera, from the picture in memory to the relit picture's bytes.

    python -m experiments.frame_rate [--cores 1] [--capture PATH] [--guard] [--out results/frame_rate]

A frame is what `hyjax relight` makes of it: G-buffer, shading and shadows of the set-up's lights, the photo's light
divided out, bounces, both cascades, the picture. Frames are read and brought to size before; the capture's cameras
come round again and again, and nothing of a frame is kept for the next. Its programs are those that the command
keeps. As many frames are at work at a time as there are cores. *CPU* is time of all cores together, which other
work on the machine changes less than the rate.

- *Rate*: at 512 x 512, by sampling (the part of its size that a frame is relit at), on the scan and finer meshes.
- *Size*: 256² to 2048². Time a pixel at the largest size over that at the smallest should not be above 1.5.
- *Shaders* (`--shaders f32 f16`): the same frames by WebGPU, see `hyjax.device`: launches alone, many in a row, and
  with the picture's way to the device and back.
- *Long* (`--long 20000`): rate and memory after a tenth, a half and all frames.
- *Quality* (`--rooms NAME ...`): PSNR against the true pictures of rooms (`experiments.truth`), by sampling.
- *Large frames* (`--large-rooms NAME ...`): the same of frames relit smaller than others by half, and not.

Takes three minutes on two cores without the last four. `--guard` makes the process fail where a ratio within the
run is beyond its limit.

Expect: twenty to fifty frames a second on two idle cores, by the machine; less time a pixel in larger pictures; and
no less PSNR than with sampling 1, to some hundredths of a decibel.
"""

import dataclasses
import itertools
import resource
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
import trimesh
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, bind_to_cores, experiment, run
from experiments.frame_quality import add_large, add_samplings, differences, tables
from experiments.plotting import new_figure
from experiments.records import Results, Row, machine, of_kind
from hyjax.data.capture import Frame
from hyjax.data.frames import fit, spread
from hyjax.device.program import Precision
from hyjax.device.renderer import DeviceRenderer
from hyjax.device.webgpu import describe, open_device
from hyjax.light.color import to_display_bytes
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.relighter import Relighter, refine
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.clock import StageClock, Stopwatch
from hyjax.util.compiled_cache import keep_compiled
from hyjax.util.cores import cores
from hyjax.util.errors import InputError
from hyjax.util.memory import keep_freed_memory
from hyjax.util.prefetch import prefetch

RATE_SIZE = 512
"""Pixels a side of the pictures for frame rates by sampling and by mesh."""
WARM_UP = 4
SHADER_ROUNDS = 5
LONG_PARTS = (0.1, 0.5, 1.0)
MOST_DIVIDED_FACES = 1_000_000
"""Triangles up to which the photo's light is estimated: beyond, rays between all vertices would take minutes."""


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    capture: Path | None = None
    """By default the built-in room with its simulated scan."""
    lights: str = "noon-window"
    """A named set-up, or a file of lights."""
    configuration: str = "default"
    """A configuration by name, or a file, see `hyjax relight`."""
    frames: int = 120
    """Whole frames for each row."""
    samplings: tuple[int, ...] = (2, 1)
    triangles: tuple[int, ...] = (200_000, 2_000_000)
    """Of finer meshes: the scan, subdivided until it has as many."""
    sizes: tuple[int, ...] = (256, 512, 1024, 2048)
    """Side lengths of square pictures."""
    shaders: tuple[Precision, ...] = ()
    """Precisions in which WebGPU draws frames, too."""
    long: int = 0
    """Frames of one long run."""
    long_size: int = 512
    """Its pixels a side."""
    rooms: tuple[str, ...] = ()
    """Rooms of known truth to judge the samplings in, see `experiments.truth`."""
    large_rooms: tuple[str, ...] = ()
    """Likewise to judge large frames in."""
    cores: int | None = None
    """How many cores to run on; by default all that this process may use."""
    guard: bool = False
    """End with status 1 where a ratio is beyond its limit."""


class WholeFrames:
    """Relighting of frames of one size on one mesh.

    Attributes:
        clock: milliseconds by stage.

    Args:
        scene: whose frames they are.
        config: lights and options.
        size: pixels a side.
        sampling, keep_photo_light: see `RelightSettings`.
    """

    def __init__(
        self, scene: Scene, config: Config, size: int, sampling: int, *, keep_photo_light: bool = False
    ) -> None:
        settings = RelightSettings(
            lights=config.lights,
            configuration=config.configuration,
            sampling=sampling,
            keep_photo_light=keep_photo_light,
        )
        self.clock, chosen = StageClock(), settings.open_configuration()
        self._relighter = Relighter(scene, config.lights, chosen)
        if chosen.light.sampling != sampling:
            raise InputError(f"samplings: {chosen.name} allows {chosen.light.sampling} at most")
        self._frames = [fit(scene.capture.picture(index), (size, size)) for index in spread(range(len(scene)), 24)]

    def picture(self, frame: Frame) -> float:
        """Bytes of a relit frame; the seconds that they took."""
        watch = Stopwatch()
        with self.clock("G-buffer"):
            gbuffer = jax.block_until_ready(self._relighter.gbuffer(frame.camera))
        with self.clock("light"):
            lit = self._relighter.lit(frame, gbuffer=gbuffer)
        image = self.clock.follow(refine(lit, self._relighter.configuration), until="composite")
        with self.clock("bytes"):
            np.asarray(to_display_bytes(image))
        return watch.seconds

    def rate(self, count: int) -> dict[str, float]:
        """Rate, latency and CPU time of so many frames."""
        list(self._run(WARM_UP))
        self.clock = StageClock()
        watch, cpu = Stopwatch(), time.process_time()
        waits = 1e3 * np.array(list(self._run(count)))
        return {
            "fps": count / watch.seconds,
            "cpu_ms": 1e3 * (time.process_time() - cpu) / count,
            "median_ms": float(np.median(waits)),
            "p95_ms": float(np.percentile(waits, 95)),
        }

    def long(self, count: int) -> Iterator[dict[str, float]]:
        """Rate since the last mark and memory, at each of `LONG_PARTS`."""
        list(self._run(WARM_UP))
        watch, done = Stopwatch(), 0
        marks = [max(1, round(part * count)) for part in LONG_PARTS]
        for number, _ in enumerate(self._run(count), 1):
            if number in marks:
                yield {"frames": number, "fps": (number - done) / watch.seconds, "memory_mib": memory_mib()}
                watch, done = Stopwatch(), number

    def _run(self, count: int) -> Iterator[float]:
        frames = itertools.islice(itertools.cycle(self._frames), count)
        return prefetch(self.picture, frames, cores(), threads=cores())


def memory_mib() -> float:
    """Memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


@experiment("Whole frames a second", "rate")
def main(config: Config, start: Start) -> str | None:
    check(config)
    keep_freed_memory()
    keep_compiled()  # as the command does
    scene = Scene.open(SceneSettings(config.capture), progress=True)
    results = start()
    results.add(
        kind="conditions", cores=cores(), capture=scene.capture.name, mesh=scene.source, faces=len(scene.mesh.faces)
    )
    for sampling in config.samplings:
        add_rate(results, scene, config, sampling)
    for faces in config.triangles:
        add_rate(results, finer(scene, faces), config, config.samplings[0])
    for size in config.sizes:
        frames = WholeFrames(scene, config, size, config.samplings[0])
        count = max(8, min(config.frames, round(config.frames * (512 / size) ** 2)))
        results.add(kind="size", size=size, **frames.rate(count))
    for precision in config.shaders:
        add_shaders(results, scene, config, precision)
    if config.long:
        for mark in WholeFrames(scene, config, config.long_size, config.samplings[0]).long(config.long):
            results.add(kind="long", **mark)
    for room in config.rooms:
        add_samplings(results, room, config.samplings)
    for room in config.large_rooms:
        add_large(results, room)
    broken = [what for what, _, _, holds in guard(results.rows) if not holds] if config.guard else []
    return f"beyond its limit: {'; '.join(broken)}" if broken else None


def check(config: Config) -> None:
    if config.frames < 2 or config.long < 0 or not config.samplings:
        raise InputError("frames: need at least 2, with one sampling or more, and a long run of none or more")
    if bad := [number for number in (*config.samplings, *config.triangles) if number < 1]:
        raise InputError(f"samplings, triangles: must be at least 1, got {bad[0]}")
    if bad := [size for size in config.sizes if size < 32]:
        raise InputError(f"sizes: a picture must be at least 32 pixels wide, got {bad[0]}")
    if config.cores is not None:
        bind_to_cores(config.cores)


def finer(scene: Scene, faces: int) -> Scene:
    """The scene on its mesh, of which as many triangles are divided as are wanted; it throws its shadows itself."""
    mesh: trimesh.Trimesh = scene.mesh
    while len(mesh.faces) < faces:
        divided = min(len(mesh.faces), -(-(faces - len(mesh.faces)) // 3))
        mesh = mesh.subdivide(face_index=np.arange(divided))
    return Scene(scene.capture, mesh, slack=None)


def add_rate(results: Results, scene: Scene, config: Config, sampling: int) -> None:
    divided = len(scene.mesh.faces) <= MOST_DIVIDED_FACES
    frames = WholeFrames(scene, config, RATE_SIZE, sampling, keep_photo_light=not divided)
    found = frames.rate(config.frames)
    stages = {name: time["median_ms"] for name, time in frames.clock.summary().items() if "median_ms" in time}
    faces = len(scene.mesh.faces)
    results.add(kind="rate", faces=faces, sampling=sampling, divided=divided, stages=stages, **found)


def add_shaders(results: Results, scene: Scene, config: Config, precision: Precision) -> None:
    chosen = RelightSettings(configuration=config.configuration).open_configuration()
    device, size = open_device(precision), (RATE_SIZE, RATE_SIZE)
    renderer = DeviceRenderer(
        scene, scene.lights(config.lights, at_photo_sources=True), size, chosen.schedule, chosen.shadow_schedule,
        light=chosen.light, precision=precision, device=device,
    )  # fmt: skip
    frames = [fit(scene.capture.picture(index), size) for index in spread(range(len(scene)), 24)]
    waits, clock = [], StageClock()
    for frame in itertools.islice(itertools.cycle(frames), WARM_UP + config.frames):
        watch = Stopwatch()
        np.asarray(to_display_bytes(renderer.relight(frame.image, frame.camera)))
        waits.append(1e3 * watch.seconds)
    for _ in range(SHADER_ROUNDS + 1):
        with clock("launches"):
            for _ in range(config.frames):
                renderer.engine.run("frame")
            renderer.engine.download("cascade totals")  # waits for them
    launches = 1e3 * np.array(clock.seconds["launches"][1:]) / config.frames
    results.add(
        kind="shaders", precision=precision, adapter=describe(device), size=RATE_SIZE,
        launches_ms=float(np.median(launches)), slowest_launches_ms=float(launches.max()),
        median_ms=float(np.median(waits[WARM_UP:])), p95_ms=float(np.percentile(waits[WARM_UP:], 95)),
    )  # fmt: skip


def guard(rows: Sequence[Row]) -> list[tuple[str, float, float, bool]]:
    """Ratios within the run: name, ratio, limit, whether it holds. A ratio that was not measured does not hold."""
    nan = float("nan")
    rates = of_kind(rows, "rate")
    scan = {row["sampling"]: row["cpu_ms"] for row in rates if row["faces"] == min(r["faces"] for r in rates)}
    pixels = {row["size"]: row["cpu_ms"] / row["size"] ** 2 for row in of_kind(rows, "size")}
    growth = pixels[max(pixels)] / pixels[min(pixels)] if pixels else nan
    stages = rates[0]["stages"] if rates else {}
    slowest = max((time for name, time in stages.items() if name != "G-buffer"), default=nan)
    ratios = [
        ("CPU of a frame, sampling 2 / 1", scan.get(2, nan) / scan.get(1, nan), 0.75),
        ("G-buffer / the slowest other stage", stages.get("G-buffer", nan) / slowest, 2.0),
        ("CPU a pixel, largest / smallest picture", growth, 1.5),
    ]
    if quality := of_kind(rows, "quality"):
        ratios.append(("dB lost by sampling", -min(differences(quality).values(), default=0.0), 0.1))
    return [(what, ratio, limit, ratio <= limit) for what, ratio, limit in ratios]


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    conditions, rates = of_kind(rows, "conditions"), of_kind(rows, "rate")
    where = f"{machine(conditions[0])}, {conditions[0]['cores']} used"
    header = ["triangles", "sampling", "frames/s", "CPU ms a frame", "frame ms", "p95"]
    names = list(rates[0]["stages"])

    def timed(row: Row) -> list[str]:
        return [f"{row[key]:.1f}" for key in ("fps", "cpu_ms", "median_ms", "p95_ms")]

    faces = [f"{row['faces']}{'' if row['divided'] else '*'}" for row in rates]
    shown: list[Block] = [
        Table(
            f"Whole frames of {RATE_SIZE} x {RATE_SIZE}, {conditions[0]['capture']} ({conditions[0]['mesh']}); "
            f"{where}. *: the photo's light is not divided out.",
            header,
            [[count, str(row["sampling"]), *timed(row)] for count, row in zip(faces, rates)],
            names=2,
        ),
        Table(
            "Stages of a frame while others are at work, median ms.",
            ["triangles", "sampling", *names],
            [
                [count, str(row["sampling"]), *(f"{row['stages'].get(name, 0):.1f}" for name in names)]
                for count, row in zip(faces, rates)
            ],
            names=2,
        ),
        Plot(main.name, "Milliseconds of every stage, by sampling and mesh.", figure(rates)),
    ]
    if sizes := of_kind(rows, "size"):
        lines = [[f"{row['size']}²", *timed(row), f"{1e6 * row['cpu_ms'] / row['size'] ** 2:.1f}"] for row in sizes]
        shown.append(Table("By size.", ["size", *header[2:], "CPU ns a pixel"], lines))
    if drawn := of_kind(rows, "shaders"):
        keys = "launches_ms", "median_ms", "p95_ms"
        lines = [[row["adapter"], row["precision"], *(f"{row[key]:.2f}" for key in keys)] for row in drawn]
        header = ["adapter", "precision", "launches, ms a frame", "frame with its copies, ms", "p95"]
        shown.append(Table(f"By WebGPU, {drawn[0]['size']}², light at every pixel.", header, lines, names=2))
    if long := of_kind(rows, "long"):
        lines = [[str(row["frames"]), f"{row['fps']:.1f}", f"{row['memory_mib']:.0f}"] for row in long]
        shown.append(Table("One long run.", ["frames", "frames/s since the line above", "MiB"], lines))
    shown += tables(rows)
    lines = [[what, f"{ratio:.2f}", f"{limit:g}", "yes" if ok else "no"] for what, ratio, limit, ok in guard(rows)]
    return [*shown, Table("Guard.", ["ratio", "found", "limit", "holds"], lines)]


def figure(rates: Sequence[Row]) -> Figure:
    """Bars of each row's stages, next to each other."""
    fig = new_figure(7, 3.5)
    axes = fig.subplots()
    names = list(rates[0]["stages"])
    for k, row in enumerate(rates):
        places = np.arange(len(names)) + 0.8 * (k - 0.5 * (len(rates) - 1)) / len(rates)
        label = f"{row['faces']} triangles, sampling {row['sampling']}"
        axes.bar(places, [row["stages"].get(name, 0.0) for name in names], 0.8 / len(rates), label=label)
    axes.set_xticks(range(len(names)), names, rotation=20)
    axes.set_ylabel("milliseconds")
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
