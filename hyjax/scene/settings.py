"""Settings of a scene, and their checks. Readers and ray casting are loaded by a check or an opening."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hyjax.scene.fusion_settings import FusionSettings
from hyjax.util.settings import Settings
from hyjax.util.sizes import parse_size

if TYPE_CHECKING:
    from hyjax.data.capture import Capture

Occluders = Literal["completed", "surface"]
"""Meshes that cast shadows: all known of the place, see `hyjax.scene.occluders`, or the bare surface."""


@dataclasses.dataclass(frozen=True)
class SceneSettings(Settings):
    """Settings of a scene: a capture, its surface, and the working size."""

    capture: Path | None = None
    """Folder or archive of a capture, in one of the formats that `hyjax info` lists. Default: the built-in room."""
    mesh: str | None = None
    """PLY, OBJ or GLB file in the capture's world coordinates; or 'captured' (came with the capture), 'scan'
    (simulated headset scan), 'fused' (from depth maps), 'true' (built-in room only). Default: scan for the built-in
    room; captured for a capture that has one, unless the fusion of its depth has clearly more; else fused."""
    size: str | None = None
    """Working size: 512 (square) or 640x480 (width x height), of the largest centred part of that shape; the
    built-in room is rendered at it. Default: as captured."""
    fusion: FusionSettings = dataclasses.field(default_factory=FusionSettings)
    seed: int = 0
    """Seed of a simulated scan."""
    photo_sources: Path | None = None
    """YAML or JSON file of the windows and lamps that lit the frames. Default: the capture's own, else found
    ones."""
    repair_mesh: bool = False
    """Drop unusable triangles of a mesh file instead of refusing it."""
    scale: float | None = None
    """Metres in one unit of the capture's poses, for a capture that does not know it (COLMAP)."""
    strict: bool = False
    """Stop at the first damaged picture, pose or mesh of a capture instead of leaving it out with a line."""

    def options(self) -> dict[str, Any]:
        """Options by name, with those of the fusion."""
        options = dataclasses.asdict(self)
        fusion = options.pop("fusion")
        return options | fusion

    def open_capture(self, *, progress: bool = False) -> "Capture":
        """Open the capture of these settings; see `hyjax.data.registry.open_capture`.

        Raises:
            InputError: it cannot be used.
        """
        from hyjax.data.registry import open_capture

        size = parse_size(self.size)
        return open_capture(self.capture, progress, size=size, scale=self.scale, strict=self.strict)

    def check(self) -> "SceneSettings":
        """Return these settings if they are valid, as far as that is known before a scene is opened.

        Raises:
            InputError: a size, a setting of the fusion or the seed is out of range, there is no such mesh, or the
                file of the photo's sources cannot be read.
        """
        from hyjax.scene.surfaces import check_mesh_name, check_surface

        parse_size(self.size)
        check_mesh_name(self.mesh)
        check_surface(self.fusion, self.seed)
        if self.photo_sources is not None:
            from hyjax.photo_light.sources import source_entries

            source_entries(self.photo_sources)
        return self


def check_lights_name(lights: str) -> None:
    """Raise `InputError` unless this is a named set-up or a readable lights file."""
    import numpy as np

    from hyjax.data.light_file import is_light_file, read_lights
    from hyjax.scene.light_setups import check_setup_name

    if is_light_file(lights):
        read_lights(Path(lights), np.array([0.0, 0.0, 1.0]), warn=False)  # whichever way is up
    else:
        check_setup_name(lights)
