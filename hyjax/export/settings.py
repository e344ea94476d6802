"""Settings of an export. The command line takes its options, their defaults and their help from here."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from hyjax.relighting.settings import open_schedule
from hyjax.scene.settings import SceneSettings, check_lights_name, parse_size
from hyjax.util.errors import InputError
from hyjax.util.settings import Settings

if TYPE_CHECKING:
    from hyjax.configuration import Configuration
    from hyjax.core.schedule import Schedule

Target = Literal["web", "bench", "stablehlo", "iree", "onnx", "litert", "coreml"]
What = Literal["cascade", "plain-cascade", "guide"]
DEFAULT_SIZE = "512"
MOST_CHANNELS = 64
SMALLEST_NETWORK = 32
"""Pixels a side that a network is exported for: it halves the picture five times."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExportSettings(Settings):
    """Export a cascade or a guide network for another runtime, or a page that runs one."""

    captures: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Of --to web: several captures, for a page of each and an index of them. A single one: --capture."""
    to: Target
    """stablehlo, iree, onnx, litert or coreml: a file for that runtime, with a README.md; web: a page for browsers
    with WebGPU, a folder, or with --out room.html one file that opens by itself; bench: one that times a device."""
    what: What = "cascade"
    """Function of a file for a runtime: cascade repairs a filter with a confidence for each pixel; plain-cascade
    repairs a filter that is known everywhere; guide is the network of --guide."""
    scene: SceneSettings = dataclasses.field(default_factory=SceneSettings)
    frames: str | None = None
    """Of a page: which frames, by position in the capture: all, 7, 0:300:30, or a list such as 0,5,9:12. Default:
    24, spread over the capture."""
    lights: str = "evening-lamps"
    """Of a page: noon-window, golden-hour, evening-lamps, night-moon, center-point, two-colors, or a YAML or JSON
    file."""
    configuration: str | None = None
    """quality, balanced, fast, or a JSON file that tune wrote; see relight. The log names the choices that a
    page does not follow. A file for a runtime takes the schedule from it."""
    presets: bool = False
    """Of a page: its visitor may change to quality, balanced or fast."""
    schedule: str | None = None
    """hyjax (the default), paper-50, paper-80, naive-50, naive-1000, or a JSON file of one, such as tune writes."""
    kappa: float | None = None
    """Edge sensitivity of a named schedule. Default: 0.05 for hyjax, 0.02 for the others."""
    guide: str = "rgb"
    """Guide of the diffusion: rgb is the frame itself, small the network that comes with hyjax; or a safetensors
    file that train or tune wrote."""
    channels: int = 3
    """Of the filter that a cascade repairs."""
    triple: str | None = None
    """Of IREE: the machine to compile for, such as aarch64-linux-android31 or arm64-apple-ios17.0. Default: the one
    that this runs on, the only one that is checked."""
    out: Path = Path("exported")
    """Folder for the results; a file for a runtime gets a folder in it, such as cascade-onnx. Of --to web: also a
    file that ends in .html."""
    quiet: bool = False
    """No progress on the terminal."""

    def check(self) -> "ExportSettings":
        """These settings, if an export can start with them as far as that can be known in advance.

        Raises:
            InputError: a value out of range, a schedule or set-up that does not exist, or options that exclude each
                other.
        """
        self.open_schedule()
        self.scene.check()
        if self.captures and self.to != "web":
            raise InputError("captures: several go with --to web only; one is given as --capture")
        if self.captures and self.scene.capture is not None:
            raise InputError("captures: name all of them one after the other, without --capture")
        if self.to in ("web", "bench"):
            check_lights_name(self.lights)
            return self
        if not 1 <= self.channels <= MOST_CHANNELS:
            raise InputError(f"channels: a filter has 1 to {MOST_CHANNELS}, got {self.channels}")
        if self.triple is not None and self.to != "iree":
            raise InputError(f"triple: goes with --to iree only, not with {self.to}")
        if self.what == "guide":
            if self.guide == "rgb":
                raise InputError("guide: rgb is the frame itself; to export a network give --guide small or a file")
            if min(self.shape) < SMALLEST_NETWORK:
                raise InputError(f"size: a network needs at least {SMALLEST_NETWORK} pixels a side")
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width that a file for a runtime is made for."""
        height, width = parse_size(self.scene.size or DEFAULT_SIZE) or (0, 0)
        return height, width

    def open_schedule(self) -> "Schedule":
        """Schedule by name or from a file.

        Raises:
            InputError: no such schedule, a file that cannot be used, or a κ beside a file's own.
        """
        if self.schedule is None and self.kappa is None:
            return self.open_configuration().schedule
        return open_schedule(self.schedule or "hyjax", self.kappa)

    def open_configuration(self) -> "Configuration":
        """Configuration by name or from a file."""
        from hyjax.configuration import DEFAULT, Configuration

        chosen = Configuration.open(self.configuration or DEFAULT)
        chosen.followed_by("page" if self.to in ("web", "bench") else "file", say=False)
        return chosen

    def record(self) -> dict[str, Any]:
        """Options as a record of the export has them."""
        options = dataclasses.asdict(self)
        options.pop("scene")
        scene = {name: None if value is None else str(value) for name, value in self.scene.options().items()}
        texts = {"out": str(self.out), "captures": [str(capture) for capture in self.captures]}
        return scene | options | texts
