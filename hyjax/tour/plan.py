"""What a person has set up on a tour: hour and weather, windows, lamps, furniture. Plain data, kept as JSON.

Everything that comes from a browser or a file passes `check` before it is used.
"""

import dataclasses
import datetime
import json
import math
from collections.abc import Sequence
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from jaxtyping import Float

from hyjax.errors import InputError
from hyjax.tour.sky import Sky, Weather, sky_at

LampKind = Literal["bulb", "spot", "candle", "strip"]
T = TypeVar("T")
Point = tuple[float, float, float]

MOST_WINDOWS, MOST_LAMPS, MOST_PIECES = 8, 16, 8
YEARS = 1900, 2100


@dataclasses.dataclass(frozen=True)
class Kind:
    """A lamp that people know.

    Attributes:
        lumen, kelvin: when it is new.
        lift: metres from the surface that it was put on.
        radius: metres, of bulb or flame.
    """

    lumen: float
    kelvin: float
    lift: float
    radius: float


KINDS: dict[str, Kind] = {
    "bulb": Kind(800.0, 2700.0, 0.35, 0.05),
    "spot": Kind(600.0, 3000.0, 0.08, 0.02),
    "candle": Kind(13.0, 1900.0, 0.15, 0.008),
    "strip": Kind(1500.0, 4000.0, 0.03, 0.0),
}


@dataclasses.dataclass(frozen=True)
class Lamp:
    """A lamp: where it is, which way it points (a bulb and a candle: any), how bright and of which colour."""

    kind: LampKind
    position: Point
    direction: Point = (0.0, 0.0, -1.0)
    lumen: float = 800.0
    kelvin: float = 2700.0
    on: bool = True


@dataclasses.dataclass(frozen=True)
class Window:
    """A rectangle in a wall, in metres; `normal` points into the room."""

    center: Point
    normal: Point
    width: float = 1.2
    height: float = 1.4


@dataclasses.dataclass(frozen=True)
class Piece:
    """Furniture that was picked, moved or taken away; or a mesh that was brought in.

    Attributes:
        seed: a point on it, in the scan.
        pose: 4×4, of where it is now relative to where it was scanned; rows one after the other.
        removed: whether it is taken away.
        file: name of a mesh file in the tour's folder, for a piece that no scan has.
    """

    seed: Point
    pose: tuple[float, ...] = tuple(np.eye(4).reshape(-1).tolist())
    removed: bool = False
    file: str = ""

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        return np.asarray(self.pose, float).reshape(4, 4)


@dataclasses.dataclass(frozen=True)
class Plan:
    """All of it.

    Attributes:
        hour: local mean solar time, 0 to 24.
        day: date as 2026-06-21.
        latitude: degrees.
        north: degrees from the room's x axis to north, counter-clockwise seen from above.
        weather: see `hyjax.tour.sky`.
        exposure: stops that the picture is brighter than the camera would make it.
        windows, lamps, pieces: what there is.
    """

    hour: float = 12.0
    day: str = "2026-06-21"
    latitude: float = 48.0
    north: float = 0.0
    weather: Weather = "clear"
    exposure: float = 0.0
    windows: tuple[Window, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    pieces: tuple[Piece, ...] = ()

    def check(self) -> "Plan":
        """Return self if it makes sense.

        Raises:
            InputError: a value that is not finite or out of range, or too many of anything.
        """
        _within("hour", self.hour, 0, 24)
        _within("latitude", self.latitude, -90, 90)
        _within("north", self.north, -720, 720)
        _within("exposure", self.exposure, -4, 4)
        _one_of("weather", self.weather, Weather)
        self.date()
        for name, things, most in (
            ("windows", self.windows, MOST_WINDOWS),
            ("lamps", self.lamps, MOST_LAMPS),
            ("pieces of furniture", self.pieces, MOST_PIECES),
        ):
            if len(things) > most:
                raise InputError(f"{len(things)} {name}: at most {most} on a tour")
        for window in self.windows:
            _point("window: center", window.center)
            _axis("window: normal", window.normal)
            _within("window: width", window.width, 0.05, 20)
            _within("window: height", window.height, 0.05, 20)
        for lamp in self.lamps:
            _one_of("lamp: kind", lamp.kind, LampKind)
            _point("lamp: position", lamp.position)
            _axis("lamp: direction", lamp.direction)
            _within("lamp: lumen", lamp.lumen, 0, 100_000)
            _within("lamp: kelvin", lamp.kelvin, 1700, 20_000)
        for piece in self.pieces:
            _point("piece: seed", piece.seed)
            _pose("piece: pose", piece.pose)
            if piece.file != "" and (not isinstance(piece.file, str) or "/" in piece.file or "\\" in piece.file):
                raise InputError(f"piece: file {piece.file!r} must be the name of a file in the tour's folder")
        return self

    @property
    def files(self) -> set[str]:
        """Names of the mesh files that were brought in."""
        return {piece.file for piece in self.pieces if piece.file}

    def date(self) -> datetime.date:
        """`day` as a date.

        Raises:
            InputError: it is none.
        """
        try:
            day = datetime.date.fromisoformat(self.day)
        except (TypeError, ValueError):
            raise InputError(f"day: {self.day!r} must be a date such as 2026-06-21") from None
        if not YEARS[0] <= day.year <= YEARS[1]:
            raise InputError(f"day: {self.day} must lie in the years {YEARS[0]} to {YEARS[1]}")
        return day

    def sky(self) -> Sky:
        """What shines outside."""
        return sky_at(self.date(), self.hour, self.latitude, self.weather)

    def to_json(self) -> str:
        """As JSON text, which `from_json` takes back."""
        return json.dumps(dataclasses.asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> "Plan":
        """Read what `to_json` wrote.

        Raises:
            InputError: not JSON, an unknown key, or anything `check` refuses.
        """
        try:
            content = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"plan: not JSON (line {error.lineno}: {error.msg})") from None
        plan = _build(cls, content, "plan")
        for name in ("windows", "lamps", "pieces"):
            if not isinstance(getattr(plan, name), tuple):
                raise InputError(f"plan: {name!r} must be a list")
        parts: dict[str, Any] = {
            name: tuple(_build(kind, entry, name) for entry in getattr(plan, name))
            for name, kind in (("windows", Window), ("lamps", Lamp), ("pieces", Piece))
        }
        return dataclasses.replace(plan, **parts).check()


# ---- checks ----


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _within(name: str, value: Any, low: float, high: float) -> None:
    if not _number(value) or not low <= value <= high:
        raise InputError(f"{name}: must be a number in {low:g}..{high:g}, got {value!r}")


def _one_of(name: str, value: Any, known: Any) -> None:
    if value not in get_args(known):
        raise InputError(f"{name}: {value!r} is unknown; use one of {', '.join(get_args(known))}")


def _point(name: str, value: Any) -> None:
    if not isinstance(value, Sequence) or len(value) != 3 or not all(_number(v) and abs(v) < 1e4 for v in value):
        raise InputError(f"{name}: must be three numbers in metres, got {value!r}")


def _axis(name: str, value: Any) -> None:
    _point(name, value)
    if sum(v * v for v in value) < 1e-12:
        raise InputError(f"{name}: must not be the zero vector")


def _pose(name: str, value: Any) -> None:
    if not isinstance(value, Sequence) or len(value) != 16 or not all(_number(v) for v in value):
        raise InputError(f"{name}: must be the 16 numbers of a 4x4 matrix")
    matrix = np.asarray(value, float).reshape(4, 4)
    turn = matrix[:3, :3]
    if (
        np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3
        or np.linalg.det(turn) < 0
        or np.abs(matrix[:3, 3]).max() > 1e3
    ):
        raise InputError(f"{name}: must move and turn only")


def _build(kind: type[T], content: Any, where: str) -> T:
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a JSON object, got {type(content).__name__}")
    names = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in content:
        if key not in names:
            raise InputError(f"{where}: unknown key {key!r}; there are {', '.join(names)}")
    for key, field in names.items():
        if field.default is dataclasses.MISSING and key not in content:
            raise InputError(f"{where}: key {key!r} is missing")
    return kind(**{key: tuple(v) if isinstance(v, list) else v for key, v in content.items()})
