"""What a person has set up on a tour: hour and weather, windows, lamps, furniture. Plain data, kept as JSON.

Everything that comes from a browser or a file passes `check` before it is used.
"""

import dataclasses
import datetime
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from jaxtyping import Float

from hyjax.data.light_file import LightSetup, parse_lights
from hyjax.errors import InputError
from hyjax.pipeline import REFERENCE_LUX
from hyjax.tour.sky import Sky, Weather, sky_at

LampKind = Literal["bulb", "spot", "candle", "strip"]
T = TypeVar("T")
Point = tuple[float, float, float]

MOST_WINDOWS, MOST_LAMPS, MOST_PIECES = 8, 16, 8
YEARS = 1900, 2100
GLASS = 0.7
"""Share of the light that a window lets in."""
GROUND = 0.2
"""Share of the daylight that the ground outside throws back."""
WALLS = 0.5
"""Share of the light that a room's surfaces throw back, on average."""
BALANCE = 0.43
"""How far a camera's white balance makes up for coloured light, from nothing to all, in reciprocal kelvin."""
NEUTRAL_KELVIN = 6500.0
ADAPTATION = 0.9
"""How far a camera makes up for the dark: 1 shows night as bright as day, 0 leaves it black."""


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
STRIP = (1.0, 0.03)  # metres


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


def lights_of(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> list[dict[str, Any]]:
    """The plan's lights as entries of a lights file: for each window its sky and its sun, the lamps, one ambient.

    What the room throws back is one ambient light, E = ρ Φ / (S (1 − ρ)) with all the light Φ that comes in, the
    room's surface S and its mean reflectance ρ: the sphere that photometry integrates in.

    Args:
        plan: what is set up.
        up: against gravity, world axes.
        surface: of the room's walls, floor and ceiling together, square metres.
        flicker: of some lamps by number: what their light is multiplied with just now.
    """
    sky, world = plan.sky(), compass(plan.north, up)
    toward = sky.toward @ world
    entries: list[dict[str, Any]] = []
    flux: list[tuple[float, float]] = []  # lumens and their kelvin
    for number, window in enumerate(plan.windows):
        inward = _unit(window.normal)
        opening = {
            "center": (np.asarray(window.center) + 0.01 * inward).tolist(),
            "normal": inward.tolist(),
            "up": upright(inward, up).tolist(),
            "width": float(window.width),
            "height": float(window.height),
        }
        # A tilted surface sees a part of the sky and a part of the ground.
        tilt = float(-inward @ up)
        outside = 0.5 * (1.0 + tilt) * sky.sky + 0.5 * (1.0 - tilt) * GROUND * sky.ground
        area = window.width * window.height
        power = GLASS * outside * area
        entries.append(
            {"kind": "rect", "name": f"window {number}", "power": power, "temperature": _balanced(sky.sky_kelvin)}
            | opening
        )
        flux.append((power, sky.sky_kelvin))
        cosine = float(-inward @ toward)
        if sky.direct > 0 and cosine > 0.02:
            entries.append(
                {
                    "kind": "directional",
                    "name": f"sun in window {number}",
                    "direction": (-toward).tolist(),
                    "illuminance": GLASS * sky.direct,
                    "temperature": _balanced(sky.direct_kelvin),
                    "aperture": opening,
                }
            )
            flux.append((GLASS * sky.direct * cosine * area, sky.direct_kelvin))
    for number, lamp in enumerate(plan.lamps):
        if lamp.on and lamp.lumen > 0:
            lumen = lamp.lumen * (flicker or {}).get(number, 1.0)
            entries.append({"name": f"{lamp.kind} {number}"} | _lamp_entry(lamp, lumen, up))
            flux.append((lumen, lamp.kelvin))
    total = sum(lumen for lumen, _ in flux)
    kelvin = sum(lumen * k for lumen, k in flux) / total if total > 0 else 4000.0
    bounced = WALLS * total / (surface * (1.0 - WALLS))
    # Never quite dark: a picture of nothing helps nobody.
    entries.append({"kind": "ambient", "illuminance": max(bounced, 1e-3), "temperature": _balanced(kelvin)})
    return entries


def reference_lux(entries: Sequence[Mapping[str, Any]], exposure: float) -> float:
    """The illuminance that the camera exposes for, as the lights file's `reference_lux`.

    Light that has bounced is what a room looks like on average, so exposure follows it: by day short, at night
    long, but not all the way, or night would look like day.
    """
    ambient = sum(float(entry["illuminance"]) for entry in entries if entry["kind"] == "ambient")
    return float((2.0 * ambient) ** ADAPTATION * REFERENCE_LUX ** (1.0 - ADAPTATION) * 2.0**-exposure)


def lights_file(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> dict[str, Any]:
    """The plan as the content of a lights file, which `hyjax relight --lights` takes; see `lights_of`.

    The camera does not follow a flicker: exposure is that of steady lamps.
    """
    steady = lights_of(plan, up, surface)
    entries = lights_of(plan, up, surface, flicker) if flicker else steady
    return {"reference_lux": reference_lux(steady, plan.exposure), "lights": entries}


def setup_of(
    plan: Plan, up: Float[np.ndarray, "3"], surface: float, flicker: Mapping[int, float] | None = None
) -> tuple[list[dict[str, Any]], LightSetup]:
    """Entries of `lights_file`, and the lights that they make."""
    content = lights_file(plan, up, surface, flicker)
    return content["lights"], parse_lights(content, up, "tour")


def place_lamp(kind: LampKind, point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Lamp:
    """A new lamp on a surface, a little off it, pointing away from it."""
    new = KINDS[kind]
    position = np.asarray(point, float) + new.lift * np.asarray(normal, float)
    return Lamp(kind, _triple(position), _triple(_unit(normal)), new.lumen, new.kelvin)


def place_window(
    point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Window:
    """A new window on a wall; on a surface that is nearly upright it is made upright."""
    inward = _unit(normal)
    level = inward - (inward @ up) * up
    if np.linalg.norm(level) > 0.8:
        inward = _unit(level)
    return Window(_triple(np.asarray(point, float) + 0.02 * inward), _triple(inward))


def compass(north: float, up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: east, north and up in world axes."""
    up = _unit(up)
    axis = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    x = _unit(axis - (axis @ up) * up)
    angle = math.radians(north)
    to_north = math.cos(angle) * x + math.sin(angle) * np.cross(up, x)
    return np.stack([np.cross(to_north, up), to_north, up])


def facing(window: Window, bearing: float, up: Float[np.ndarray, "3"]) -> float:
    """The `north` with which a window looks out towards a compass bearing in degrees (90 is east)."""
    east, north, _ = compass(0.0, up)
    out = -_unit(window.normal)
    return (math.degrees(math.atan2(out @ -east, out @ north)) + bearing) % 360.0


def flicker(seconds: float, number: int) -> float:
    """What a candle's light is multiplied with: a few waves of no common period; 1 on average."""
    t = seconds + 13.7 * number
    return 1.0 + 0.08 * math.sin(9.1 * t) + 0.06 * math.sin(14.3 * t + 1.0) + 0.05 * math.sin(3.7 * t + 2.0)


def _lamp_entry(lamp: Lamp, lumen: float, up: Float[np.ndarray, "3"]) -> dict[str, Any]:
    light = {"power": lumen, "temperature": _balanced(lamp.kelvin)}
    position, direction = list(lamp.position), _unit(lamp.direction)
    radius = KINDS[lamp.kind].radius
    if lamp.kind in ("bulb", "candle"):
        return {"kind": "point", "position": position, "radius": radius} | light
    if lamp.kind == "spot":
        angles = {"inner_degrees": 20.0, "outer_degrees": 40.0}
        return (
            {"kind": "spot", "position": position, "direction": direction.tolist(), "radius": radius}
            | angles
            | light
        )
    size = {"width": STRIP[0], "height": STRIP[1], "up": upright(direction, up).tolist()}
    return {"kind": "rect", "center": position, "normal": direction.tolist()} | size | light


def _balanced(kelvin: float) -> float:
    """The colour temperature that light has in the picture."""
    neutral = 1.0 / NEUTRAL_KELVIN
    return 1.0 / (neutral + (1.0 - BALANCE) * (1.0 / kelvin - neutral))


def upright(normal: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The unit direction across `normal` that is nearest to `up`; any, where normal and up are one."""
    across = up - (up @ normal) * normal
    if np.linalg.norm(across) < 1e-2:
        axis = np.eye(3)[np.argmin(np.abs(normal))]
        across = axis - (axis @ normal) * normal
    return _unit(across)


def _unit(vector: Any) -> Float[np.ndarray, "3"]:
    v = np.asarray(vector, float)
    return v / np.linalg.norm(v)


def _triple(vector: Any) -> Point:
    x, y, z = (float(v) for v in vector)
    return x, y, z


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
