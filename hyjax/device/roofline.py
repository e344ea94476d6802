"""Roofline: least time of a program on a device, from the bytes it moves and the operations it does. Estimates.

Symbols of this file: a launch takes max(bytes / bandwidth, operations / peak). Every picture is taken to come from
memory once a launch, as if caches held what neighbours share and nothing else; launching itself takes no time.
"""

import dataclasses
import re
from collections.abc import Sequence

from hyjax.device.cascade_program import CELLS_OF_TILE
from hyjax.device.program import CHANNEL_BYTES, Groups, Launch, Program

EDGE_BYTES = 8


@dataclasses.dataclass(frozen=True)
class Hardware:
    """A device by its data sheet.

    Attributes:
        name: of it.
        bandwidth: of its memory, GB/s.
        peak: single precision, GFLOP/s.
    """

    name: str
    bandwidth: float
    peak: float


HARDWARE = (
    # LPDDR5X-7500 on 64 bits, 7500e6 * 8 bytes: Apple's "17 % more" (September 2024) than the 51.2 GB/s of before.
    # Apple gives no peak: 6 cores of 128 units, two operations at about 1.45 GHz.
    Hardware("A18 Pro (iPhone 16 Pro)", 60.0, 2200.0),
    # LPDDR5X at 4800 MHz on 64 bits (Qualcomm, Snapdragon 8 Gen 3 product brief), 9600e6 * 8 bytes. Qualcomm gives
    # no peak: 1536 units, two operations at about 0.9 GHz.
    Hardware("Adreno 750 (Snapdragon 8 Gen 3)", 76.8, 2770.0),
    # Apple, MacBook Pro with M3, technical specifications: 100 GB/s. No peak is given: 10 cores of 128 units, two
    # operations at about 1.38 GHz.
    Hardware("M3 (10 GPU cores)", 100.0, 3530.0),
    # NVIDIA, H100 Tensor Core GPU data sheet: SXM5, 3.35 TB/s, 67 TFLOPS without tensor cores.
    Hardware("H100 SXM", 3350.0, 67000.0),
)


@dataclasses.dataclass(frozen=True)
class Work:
    """What a launch, or several, have to do.

    Attributes:
        passes: launches.
        read, written: bytes.
        operations: floating point, a fused one counted as two.
    """

    passes: int = 0
    read: float = 0.0
    written: float = 0.0
    operations: float = 0.0

    def __add__(self, other: "Work") -> "Work":
        return Work(
            self.passes + other.passes,
            self.read + other.read,
            self.written + other.written,
            self.operations + other.operations,
        )

    def milliseconds(self, hardware: Hardware) -> float:
        """Least time of one launch."""
        seconds = max((self.read + self.written) / hardware.bandwidth, self.operations / hardware.peak) * 1e-9
        return 1e3 * seconds


def launch_work(program: Program, launch: Launch, lights: int) -> Work:
    """Work of a launch of a cascade.

    >>> from hyjax.core.schedule import Schedule
    >>> from hyjax.device.cascade_program import CascadeWriter
    >>> program = Program((64, 64))
    >>> light, guide = (program.picture(name, (64, 64), Groups(1)) for name in ("light", "guide"))
    >>> refined = CascadeWriter(program, guide, 3).cascade("cascade", light, Schedule.uniform([(1, 4)]), Groups(1))
    >>> [(kind_of(launch), launch_work(program, launch, 2).passes) for launch in program.launches]
    [('edges', 1), ('diffuse', 1)]

    Args:
        program: it is of.
        launch: of kind `cells`, `edges`, `diffuse`, `upsample` or `total`.
        lights: number of lights.
    """
    sizes = [_bytes(program, name, lights) for name in launch.bind]
    vectors = [size / CHANNEL_BYTES[program.precision] for size in sizes]  # groups of four channels
    kind, layers = kind_of(launch), launch.depth.count(lights)
    if kind == "cells":
        return Work(1, sizes[0], sizes[1], 4 * 2 * vectors[0] + 4 * vectors[1])
    if kind == "total":
        return Work(1, sizes[0], sizes[1], 4 * 2 * vectors[0])
    if kind == "edges":  # a difference, its square, a sum; then the distance and its conductance
        neighbours = 2 * vectors[0]
        return Work(1, sizes[0], sizes[1], 12 * neighbours + 2 * 6 * sizes[1] / EDGE_BYTES)
    if kind == "upsample":  # four corners with their weights
        operations = 4 * vectors[1] * (8 + 6)
        guides = sum(sizes[2:])
        if guides:
            groups = _groups(program, launch.bind[2], lights)
            operations += 4 * vectors[1] * (12 * groups + 4)
        return Work(1, sizes[0] + guides * layers, sizes[1], operations)
    if kind == "diffuse":
        cells = sizes[1] / EDGE_BYTES
        # Cells of tiles over cells of the level: rims are read, and computed, more than once.
        share = launch.width * launch.height * CELLS_OF_TILE**2 / cells
        text = program.shaders[launch.shader]
        steps = int(re.findall(r"const STEPS = (\d+);", text)[0])
        each = 4 * (4 * 3 + 2) + (4 * 5 if len(launch.bind) > 3 else 0)  # flows, the step, the data term
        halo = min(share, 4.0)
        read = halo * (sizes[0] + sizes[1] * layers + sum(sizes[3:]))
        return Work(1, read, sizes[2], share * cells * layers * steps * each)
    raise ValueError(f"no cascade has a launch of kind {kind}")


def kind_of(launch: Launch) -> str:
    """File of a launch's shader."""
    return launch.shader.rsplit("-", 1)[0]


def work_by_kind(program: Program, lights: int) -> dict[str, Work]:
    """Work of a cascade's launches, by kind."""
    found: dict[str, Work] = {}
    for launch in program.launches:
        kind = kind_of(launch)
        found[kind] = found.get(kind, Work()) + launch_work(program, launch, lights)
    return found


def least_milliseconds(program: Program, lights: int, hardware: Hardware) -> float:
    """Estimated least time of a cascade: the sum over its launches."""
    launches: Sequence[Launch] = program.launches
    return sum(launch_work(program, launch, lights).milliseconds(hardware) for launch in launches)


def _bytes(program: Program, name: str, lights: int) -> float:
    buffer = program.buffers[name]
    return float(buffer.bytes * buffer.groups.count(lights))


def _groups(program: Program, name: str, lights: int) -> int:
    groups: Groups = program.buffers[name].groups
    return groups.count(lights)
