"""Programs: shaders, buffers and launches as plain data, run alike by a page's script and by Python.

A picture is stored as groups of four channels, plane after plane. How many groups there are depends on the number
of lights, so sizes and launches are linear in G, the number of groups of four lights: G = ceil(lights / 4).
"""

import dataclasses
import functools
import hashlib
import string
from collections.abc import Mapping, Sequence
from importlib import resources
from types import MappingProxyType
from typing import Any, Literal

FORMAT_VERSION = 1
"""Version of the JSON form. Add one when an older script could not run it."""
CHANNEL_BYTES = {"f32": 16, "f16": 8}
"""Size of a group of four channels of a pixel in bytes, by `Precision`."""
Precision = Literal["f32", "f16"]
GROUP_SIDE = 8
"""Number of pixels along each side of a workgroup of most shaders."""
NO_CONSTANTS: Mapping[str, object] = MappingProxyType({})
GROUP_LENGTH = 64
"""Number of elements of a workgroup of shaders over lists."""


@dataclasses.dataclass(frozen=True)
class Groups:
    """Number of channel groups: `base + lights * G`.

    >>> Groups(2, 1).count(9)
    5
    """

    base: int
    lights: int = 0

    def count(self, lights: int) -> int:
        """Number of groups for a number of lights."""
        return self.base + self.lights * -(-lights // 4)


@dataclasses.dataclass(frozen=True)
class Buffer:
    """Buffer of device memory.

    Attributes:
        bytes: of each channel group; of the whole where there are no groups.
        uniform: whether it is a uniform buffer, too.
    """

    bytes: int
    groups: Groups = Groups(1)
    uniform: bool = False
    initial: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True)
class Launch:
    """Launch of a shader.

    Attributes:
        stage: group of launches, see `Program`.
        label: in timings.
        shader: its name in the program.
        bind: buffers and textures, by binding number.
        width, height: workgroups.
        depth: layers of workgroups.
        jobs: whether it covers shadow maps of a size instead, with a layer for each of their views.
    """

    stage: str
    label: str
    shader: str
    bind: tuple[str, ...]
    width: int
    height: int = 1
    depth: Groups = Groups(1)
    jobs: bool = False


@dataclasses.dataclass
class Program:
    """Shaders with their buffers and launches.

    Stages: `load` once, `shadows` and `bounces` where lights change, `photo` where the picture changes, `frame`;
    `refined` and `stages` after it, for display.

    Attributes:
        size: (height, width) of pictures.
        names: buffers of pictures for display: `raw`, `refined`, `visibility`, `image`; of sums: `visible totals`.
    """

    size: tuple[int, int]
    precision: Precision = "f32"
    shaders: dict[str, str] = dataclasses.field(default_factory=dict)
    buffers: dict[str, Buffer] = dataclasses.field(default_factory=dict)
    launches: list[Launch] = dataclasses.field(default_factory=list)
    names: dict[str, str] = dataclasses.field(default_factory=dict)

    def buffer(self, name: str, size: int, groups: Groups = Groups(1), **options: Any) -> str:
        """Name of a buffer, which is added if it is new."""
        self.buffers.setdefault(name, Buffer(size, groups, **options))
        return name

    def picture(self, name: str, shape: tuple[int, int], groups: Groups) -> str:
        """Name of a picture's buffer, which is added if it is new."""
        return self.buffer(name, CHANNEL_BYTES[self.precision] * shape[0] * shape[1], groups)

    def launch(
        self,
        stage: str,
        label: str,
        files: Sequence[str],
        bind: Sequence[str],
        grid: tuple[int, int],
        depth: Groups = Groups(1),
        *,
        jobs: bool = False,
        constants: Mapping[str, object] = NO_CONSTANTS,
    ) -> None:
        """Add a launch."""
        shader = self.add_shader(files, constants)
        self.launches.append(Launch(stage, label, shader, tuple(bind), *grid, depth, jobs))

    def add_shader(self, files: Sequence[str], constants: Mapping[str, object] = NO_CONSTANTS) -> str:
        """Name of a shader, which is added if it is new."""
        text = shader_text(files, self.precision, constants)
        name = f"{files[-1]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        self.shaders.setdefault(name, text)
        return name

    def to_json(self) -> dict[str, Any]:
        """Program as plain data, for `hyjax/device/page/engine.js`."""
        content = dataclasses.asdict(self)
        return {"format": FORMAT_VERSION} | content


def shader_text(
    files: Sequence[str], precision: Precision = "f32", constants: Mapping[str, object] = NO_CONSTANTS
) -> str:
    """WGSL text of a shader: files of `hyjax/device/wgsl` after the storage format, with constants inserted."""
    stored = {"f32": "vec4<f32>", "f16": "vec4<f16>"}[precision]
    largest = {"f32": "3.0e38", "f16": "65504.0"}[precision]
    enable = "enable f16;\n" if precision == "f16" else ""
    parts = [_file(name) for name in ("storage", *files)]
    return enable + "\n".join(
        string.Template(part).substitute(constants, stored=stored, largest=largest) for part in parts
    )


@functools.cache
def _file(name: str) -> str:
    return resources.files("hyjax.device").joinpath("wgsl", f"{name}.wgsl").read_text(encoding="utf-8")


def grid_of(shape: tuple[int, int], tile: int = GROUP_SIDE) -> tuple[int, int]:
    """Numbers of workgroups across and down for a picture of (rows, columns)."""
    return -(-shape[1] // tile), -(-shape[0] // tile)


def line_of(count: int) -> tuple[int, int]:
    """Numbers of workgroups across and down for a list."""
    groups = -(-count // GROUP_LENGTH)
    width = min(groups, 1 << 15)
    return width, -(-groups // width)


def columns_rows(shape: tuple[int, int]) -> str:
    """Size in the order of shaders, columns first.

    >>> columns_rows((480, 640))
    '640, 480'
    """
    return f"{shape[1]}, {shape[0]}"
