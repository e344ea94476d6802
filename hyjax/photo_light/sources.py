"""Photo sources: the windows and lamps that lit the photographs.

They come from a file that a person writes, from the capture's own hints, or are found in the pictures:

    windows:
      - name: balcony           # or none
        center: [0.0, 2.9, 1.5]
        normal: [1, 0, 0]       # into the room
        width: 2.4
        height: 1.4
    lamps:
      - position: [1.4, 1.6, 1.5]
        radius: 0.1             # of what glows; default: as it is seen, else 0.05

Positions and lengths are in metres, in the capture's world axes.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float

from hyjax.data.hand_written import converted
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.reading import read_yaml
from hyjax.util.vectors import unit

Vector = Float[np.ndarray, "3"]
SATURATED_VALUE = 0.97
"""Display value of all three channels from which a pixel counts as burnt out."""
WALL_DISTANCE = 0.4
"""Largest distance, in metres, of a given window from the scan or its bounding box."""
CEILING_DISTANCE = 0.25
"""Distance, in metres, below a ceiling within which a lamp belongs to it."""
UNSCANNED = ("walls", "floor", "ceiling")
"""Names of the light from the parts of the box around a scan."""
LAMP_RADIUS = 0.05
"""Default radius of a lamp, in metres."""


@dataclasses.dataclass(frozen=True)
class PhotoWindow:
    """Window that lit the photographs.

    Attributes:
        name: unique among the sources.
        center: of the rectangle.
        right, up: half axes of the rectangle, with right × up along `normal`.
        normal: unit vector into the room.
    """

    name: str
    center: Vector
    right: Vector
    up: Vector
    normal: Vector

    @classmethod
    @checked_arguments
    def facing(
        cls, name: str, center: Vector, normal: Vector, up: Vector, width: float, height: float
    ) -> "PhotoWindow":
        """Window as upright as can be.

        Raises:
            InputError: the normal is zero.
        """
        rectangle = Aperture.facing(center, normal, up, width, height)
        place, right, high = (np.asarray(side, float) for side in (rectangle.center, rectangle.right, rectangle.up))
        return cls(name, place, right, high, unit(normal))

    @property
    def aperture(self) -> Aperture:
        """Opening of the window."""
        return Aperture(*(np.asarray(v, np.float32) for v in (self.center, self.right, self.up)))

    @property
    def corners(self) -> Float[np.ndarray, "4 3"]:
        """Corners, in the order of a walk round the rectangle."""
        turns = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        return np.stack([self.center + s * self.right + t * self.up for s, t in turns])


@dataclasses.dataclass(frozen=True)
class PhotoLamp:
    """Lamp that was lit in the photographs.

    Attributes:
        name: unique among the sources.
        position: of its middle.
        radius: of what glows, in metres; 0 where its form is unknown, and it is not drawn.
    """

    name: str
    position: Vector
    radius: float


@dataclasses.dataclass(frozen=True)
class PhotoSources:
    """Windows and lamps that lit the photographs, and the origin of this knowledge."""

    windows: tuple[PhotoWindow, ...]
    lamps: tuple[PhotoLamp, ...]
    origin: Literal["file", "capture", "found", "none"]

    @property
    def anchors(self) -> dict[str, dict[str, Any]]:
        """Places for new lights, in the form of `Capture.anchors`."""
        known: dict[str, dict[str, Any]] = {}
        for number, window in enumerate(self.windows):
            width, height = (2 * float(np.linalg.norm(axis)) for axis in (window.right, window.up))
            place = {"center": window.center, "normal": window.normal, "width": width, "height": height}
            known[f"window_{number}"] = place
        return known | {f"lamp_{number}": {"position": lamp.position} for number, lamp in enumerate(self.lamps)}


_Number = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
_Size = Annotated[float, msgspec.Meta(gt=0.0, le=1e3)]


class _Window(msgspec.Struct, forbid_unknown_fields=True):
    center: tuple[_Number, _Number, _Number]
    normal: tuple[_Number, _Number, _Number]
    width: _Size
    height: _Size
    name: str | None = None


class _Lamp(msgspec.Struct, forbid_unknown_fields=True):
    position: tuple[_Number, _Number, _Number]
    radius: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None
    name: str | None = None


class _SourcesFile(msgspec.Struct, forbid_unknown_fields=True):
    windows: list[Any] = []
    lamps: list[Any] = []


FORMS = {
    **dict.fromkeys(("center", "normal", "position"), "three finite numbers"),
    **dict.fromkeys(("width", "height"), "a number of metres > 0"),
    "radius": "a number of metres > 0, at most 1",
    **dict.fromkeys(("windows", "lamps"), "a list"),
    "name": "a text",
}


def source_entries(path: Path) -> tuple[list[_Window], list[_Lamp]]:
    """Windows and lamps of a file, whatever the scan.

    Raises:
        InputError: no such file, or malformed.
    """
    content = read_yaml(path)
    if isinstance(content, dict) and "lights" in content:
        raise InputError(f"{path}: has new lights, which --lights takes from a file of their own")
    lists = converted(str(path), content, _SourcesFile, FORMS)
    windows = [converted(f"{path}: window {i}", entry, _Window, FORMS) for i, entry in enumerate(lists.windows)]
    lamps = [converted(f"{path}: lamp {i}", entry, _Lamp, FORMS) for i, entry in enumerate(lists.lamps)]
    if not windows and not lamps:
        raise InputError(f"{path}: names no window and no lamp")
    for i, entry in enumerate(windows):
        if not any(entry.normal):
            raise InputError(f"{path}: window {i}: 'normal' must not be the zero vector")
    names = [entry.name or f"window-{i + 1}" for i, entry in enumerate(windows)]
    names += [entry.name or f"lamp-{i + 1}" for i, entry in enumerate(lamps)]
    for name in names:
        if name in UNSCANNED:
            raise InputError(f"{path}: the name {name!r} is that of what was not scanned; choose another")
        if names.count(name) > 1:
            raise InputError(f"{path}: the name {name!r} is given twice")
    return windows, lamps


@checked_arguments
def read_sources(path: Path, up: Vector, caster: RayCaster, eyes: Float[np.ndarray, "n 3"]) -> PhotoSources:
    """Sources from a file; see the module for its form.

    Args:
        path: YAML or JSON.
        up: unit vector against gravity.
        caster: the scan, which windows must stand at.
        eyes: where cameras stood, which windows must face.

    Raises:
        InputError: no such file, malformed, a window off the walls or inside out, a lamp outside the scan.
    """
    path = Path(path)
    named_windows, lamps = source_entries(path)
    windows = []
    for i, entry in enumerate(named_windows):
        center, normal = np.asarray(entry.center, float), np.asarray(entry.normal, float)
        name = entry.name or f"window-{i + 1}"
        try:
            windows.append(PhotoWindow.facing(name, center, normal, up, entry.width, entry.height))
            _check_place(windows[-1], caster, eyes)
        except InputError as error:
            raise InputError(f"{path}: window {i}: {error}") from None
    bounds = np.concatenate([caster.mesh.bounds, eyes])  # above an open place nothing is scanned
    low, high = bounds.min(axis=0) - WALL_DISTANCE, bounds.max(axis=0) + WALL_DISTANCE
    made = []
    for i, lamp in enumerate(lamps):
        place = np.asarray(lamp.position, float)
        if (place < low).any() or (place > high).any():
            raise InputError(
                f"{path}: lamp {i}: position {list(lamp.position)} lies outside the scan and its cameras, from "
                f"{low.round(1).tolist()} to {high.round(1).tolist()} (metres, its axes)"
            )
        made.append(PhotoLamp(lamp.name or f"lamp-{i + 1}", place, lamp.radius or LAMP_RADIUS))
    return PhotoSources(tuple(windows), tuple(made), "file")


def _check_place(window: PhotoWindow, caster: RayCaster, eyes: Float[np.ndarray, "n 3"]) -> None:
    """Raise `InputError` if a window stands off the walls, or looks out of the room."""
    mesh = caster.mesh
    rim = np.concatenate([window.corners, 0.5 * (window.corners + np.roll(window.corners, 1, axis=0))])
    from scipy.spatial import cKDTree  # SciPy is slow to load

    away = cKDTree(_surface_points(mesh)).query(rim)[0]
    low, high = mesh.bounds
    inside = bool(((window.center > low - WALL_DISTANCE) & (window.center < high + WALL_DISTANCE)).all())
    to_box = np.abs(np.stack([window.center - low, window.center - high]))[:, np.abs(window.normal) > 0.9]
    if np.median(away) > WALL_DISTANCE and not (inside and to_box.size and to_box.min() < WALL_DISTANCE):
        raise InputError(
            f"stands {np.median(away):.2g} m off the scan's walls; give its centre in metres, in the capture's axes"
        )
    if np.median((eyes - window.center) @ window.normal) < 0:
        raise InputError("looks away from the cameras; its normal must point into the room")


def _surface_points(mesh: Any) -> Float[np.ndarray, "n 3"]:
    """Points all over a mesh: its vertices, and more of them on large triangles."""
    corners, areas = mesh.vertices[mesh.faces], mesh.area_faces
    chosen = np.random.default_rng(0).choice(len(areas), 20000, p=areas / areas.sum())
    weights = np.random.default_rng(1).dirichlet(np.ones(3), len(chosen))
    return np.concatenate([mesh.vertices, np.einsum("nk,nkd->nd", weights, corners[chosen])])


def scan_top(caster: RayCaster, up: Vector) -> float:
    """Height of the top of a scan, less the highest thousandth of its vertices."""
    return float(np.quantile(np.asarray(caster.arrays.vertices) @ up, 0.999))


def spoken(name: str) -> str:
    """Name of a source for people: `window_0` → window-1."""
    kind, _, number = name.partition("_")
    return f"{kind}-{int(number) + 1}" if number.isdecimal() else name
