"""Plan of a tour: hour and weather, windows, lamps, furniture. Plain data, kept as JSON.

Everything that comes from a browser or a file passes `check` before it is used.
"""

import dataclasses
import datetime
from typing import Annotated, Any, Literal, get_args

import msgspec
import numpy as np
from jaxtyping import Float

from hyjax.data.hand_written import converted
from hyjax.geometry.camera import check_pose
from hyjax.tour.sky import Sky, Weather, sky_at
from hyjax.util.errors import InputError
from hyjax.util.reading import parse_json

MOST_WINDOWS, MOST_LAMPS, MOST_PIECES = 8, 16, 8
YEARS = 1900, 2100

LampKind = Literal["bulb", "spot", "candle", "strip"]
Metres = Annotated[float, msgspec.Meta(gt=-1e4, lt=1e4)]
Point = tuple[Metres, Metres, Metres]
Intensity = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
LARGEST_FACTOR = 1.5
"""Largest factor of a source of the photo."""
Factor = Annotated[float, msgspec.Meta(ge=0, le=LARGEST_FACTOR)]
FILE_NAME = r"^(?!\.{1,2}$)[^/\\\x00-\x1f\x7f]*\Z"
"""A name in a folder: no path, no control characters, not the folder itself or its parent."""
SOURCE_NAME = r"^[^\x00-\x1f\x7f]*\Z"
"""A name of a source of the photo: no control characters."""
SIDE_RANGE = 0.05, 20.0
"""Least and largest side of a window, in metres."""
Side = Annotated[float, msgspec.Meta(ge=SIDE_RANGE[0], le=SIDE_RANGE[1])]


@dataclasses.dataclass(frozen=True)
class Kind:
    """An everyday lamp.

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


class Lamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A lamp: kind, position, direction (of a bulb or a candle: any), brightness and colour.

    `color` is linear RGB of any brightness, in the place of `kelvin` where there is one.
    """

    kind: LampKind
    position: Point
    direction: Point = (0.0, 0.0, -1.0)
    lumen: Annotated[float, msgspec.Meta(ge=0, le=100_000)] = 800.0
    kelvin: Annotated[float, msgspec.Meta(ge=1700, le=20_000)] = 2700.0
    on: bool = True
    color: tuple[Intensity, Intensity, Intensity] | None = None


class Window(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rectangle in a wall, in metres; `normal` points into the room."""

    center: Point
    normal: Point
    width: Side = 1.2
    height: Side = 1.4


class Piece(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Furniture that was picked, moved or taken away; or a mesh that was brought in.

    Attributes:
        seed: a point on it, in the scan.
        pose: 4×4, of where it is now relative to where it was scanned; rows one after the other.
        removed: whether it is taken away.
        centre: of it in the scan, where pages have its handle.
        file: name of a mesh file in the tour's folder, for a piece that no scan has.
    """

    seed: Point
    pose: Annotated[tuple[Metres, ...], msgspec.Meta(min_length=16, max_length=16)] = tuple(
        np.eye(4).reshape(-1).tolist()
    )
    removed: bool = False
    centre: Point | None = None
    file: Annotated[str, msgspec.Meta(max_length=255, pattern=FILE_NAME)] = ""

    @property
    def as_scanned(self) -> bool:
        """Whether it was picked alone, and still is where the scan has it."""
        return not (self.file or self.removed) and np.array_equal(self.matrix, np.eye(4))

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        return np.asarray(self.pose, float).reshape(4, 4)


LISTS = {"windows": (Window, MOST_WINDOWS), "lamps": (Lamp, MOST_LAMPS), "pieces": (Piece, MOST_PIECES)}
"""Fields of a plan that are lists, of what, and of how many at most."""
FORMS = dict.fromkeys(("position", "center", "seed", "centre"), "three numbers in metres") | {
    "direction": "three numbers",
    "normal": "three numbers",
    "color": "three numbers",
    "kind": f"one of {', '.join(get_args(LampKind))}",
    "weather": f"one of {', '.join(get_args(Weather))}",
    "day": "a date such as 2026-06-21",
    "pose": "the 16 numbers of a 4x4 matrix",
    "file": "the name of a file in the tour's folder",
    "existing": f"names of the photo's sources with a number in 0..{LARGEST_FACTOR} each",
}
"""Forms of values, where msgspec does not tell them."""


class TourPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that a viewer can set up.

    Attributes:
        hour: local mean solar time, 0 to 24.
        day: date as 2026-06-21.
        latitude: degrees.
        north: degrees from the room's x axis to north, counter-clockwise seen from above.
        exposure: stops that the picture is brighter than the camera would make it.
        windows, lamps, pieces: what there is.
        open_sky: whether light from outside comes from all around, and not through the windows.
        existing: what is left of the sources that lit the photos, by name; those that are not named are off.
    """

    hour: Annotated[float, msgspec.Meta(ge=0, le=24)] = 12.0
    day: str = "2026-06-21"
    latitude: Annotated[float, msgspec.Meta(ge=-90, le=90)] = 48.0
    north: Annotated[float, msgspec.Meta(ge=-720, le=720)] = 0.0
    weather: Weather = "clear"
    exposure: Annotated[float, msgspec.Meta(ge=-4, le=4)] = 0.0
    windows: tuple[Window, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    pieces: tuple[Piece, ...] = ()
    open_sky: bool = False
    existing: dict[Annotated[str, msgspec.Meta(max_length=80, pattern=SOURCE_NAME)], Factor] = {}

    def check(self) -> "TourPlan":
        """Return self if it is valid."""
        _checked(msgspec.to_builtins(self, enc_hook=_plain))
        return self

    @property
    def furnishes(self) -> bool:
        """Whether a piece is not as it was scanned."""
        return not all(piece.as_scanned for piece in self.pieces)

    def date(self) -> datetime.date:
        """`day` as a date."""
        try:
            day = datetime.date.fromisoformat(self.day)
        except ValueError:
            raise InputError(f"day: {self.day!r} must be a date such as 2026-06-21") from None
        if not YEARS[0] <= day.year <= YEARS[1]:
            raise InputError(f"day: {self.day} must lie in the years {YEARS[0]} to {YEARS[1]}")
        return day

    def sky(self) -> Sky:
        """Daylight or moonlight outside."""
        return sky_at(self.date(), self.hour, self.latitude, self.weather)

    def to_json(self) -> str:
        """JSON text, which `from_json` takes back."""
        return msgspec.json.format(msgspec.json.encode(self, enc_hook=_plain), indent=2).decode()

    @classmethod
    def from_json(cls, text: str) -> "TourPlan":
        """Plan of the text that `to_json` writes."""
        return _checked(parse_json(text, "plan"))


def _checked(content: Any) -> TourPlan:
    """A plan from JSON's types, with dates, directions and poses that types cannot express."""
    for name, (kind, most) in LISTS.items() if isinstance(content, dict) else ():
        things = content.get(name)
        if isinstance(things, list | tuple):
            if len(things) > most:
                raise InputError(f"{name}: {len(things)} {name}, at most {most} on a tour")
            for number, thing in enumerate(things):
                converted(f"{name}[{number}]", thing, kind, FORMS)
    plan: TourPlan = converted("plan", content, TourPlan, FORMS)
    plan.date()
    axes = {f"windows[{number}].normal": window.normal for number, window in enumerate(plan.windows)}
    axes |= {f"lamps[{number}].direction": lamp.direction for number, lamp in enumerate(plan.lamps)}
    for where, axis in axes.items():
        if sum(v * v for v in axis) < 1e-12:
            raise InputError(f"{where}: must not be the zero vector")
    for number, piece in enumerate(plan.pieces):
        check_pose(piece.matrix, f"pieces[{number}].pose")
    return plan


def _plain(value: Any) -> Any:
    """NumPy number as Python's; other objects as their text, which no field takes."""
    return value.item() if isinstance(value, np.generic) else repr(value)
