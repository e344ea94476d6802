"""Lights as a person writes them: YAML or JSON, checked key by key.

    reference_lux: 300          # illuminance the frames were taken under; default 300
    lights:
      - kind: point             # or spot, directional, rect, sky, ambient
        position: [1.2, 0.4, 2.0]
        power: 800
        temperature: 2700

| kind        | needs                                   | may have                                        |
|-------------|-----------------------------------------|-------------------------------------------------|
| point       | position, power                         | radius, clearance                               |
| spot        | position, target or direction, power    | inner_degrees, outer_degrees, radius, clearance |
| directional | direction, illuminance                  | angular_degrees, aperture                       |
| rect        | center, normal, width, height, power    | up                                              |
| sky         | illuminance                             | up                                              |
| ambient     | illuminance                             |                                                 |

Every kind may have `color` (linear RGB, default white) or `temperature` (kelvin), and a `name`. Positions and
lengths are in metres in the capture's world axes, power in lumens, illuminance in lux; angles of a spot are half
angles, the `angular_degrees` of a sun its radius. `up` defaults to the capture's. `aperture` is the window that a
sun shines through: a mapping with center, normal, width, height and maybe up; it shows in the shadows.
Nothing nearer to a lamp than its `clearance` casts a shadow: what a scan makes of a lampshade is rarely hollow.
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import yaml
from jaxtyping import Float

from hyjax.color import blackbody
from hyjax.errors import InputError, did_you_mean
from hyjax.files import write_text
from hyjax.lights import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
)
from hyjax.pipeline import REFERENCE_LUX

LARGEST = float(np.finfo(np.float32).max)
RECTANGLE = {"center", "normal", "up", "width", "height"}
COMMON = {"kind", "name", "color", "temperature"}
KEYS: dict[str, set[str]] = {
    "point": {"position", "power", "radius", "clearance"},
    "spot": {"position", "target", "direction", "power", "inner_degrees", "outer_degrees", "radius", "clearance"},
    "directional": {"direction", "illuminance", "angular_degrees", "aperture"},
    "rect": {*RECTANGLE, "power"},
    "sky": {"illuminance", "up"},
    "ambient": {"illuminance"},
}
SUN_DEGREES = 0.27  # angular radius of the sun's disc, and of the moon's


@dataclasses.dataclass(frozen=True)
class LightSetup:
    """Lights and the illuminance that the frames are taken to have been photographed under."""

    lights: tuple[Light, ...]
    reference_lux: float = REFERENCE_LUX


def is_light_file(text: str) -> bool:
    """Whether this means a lights file, by its ending, and not a named set-up."""
    return Path(text).suffix.lower() in (".yaml", ".yml", ".json")


def read_lights(path: Path, up: Float[np.ndarray, "3"]) -> LightSetup:
    """Read a lights file; see the module's docstring for its form.

    Raises:
        InputError: no such file, not YAML or JSON, or anything `parse_lights` refuses; the message names the file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such lights file")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))  # JSON is a part of YAML
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" (line {mark.line + 1}: {getattr(error, 'problem', '')})" if mark else ""
        raise InputError(f"{path}: neither YAML nor JSON{line}") from None
    return parse_lights(content, up, str(path))


def parse_lights(content: Any, up: Float[np.ndarray, "3"], where: str = "lights") -> LightSetup:
    """Build lights from the plain data of a lights file.

    Raises:
        InputError: unknown kind or key (the nearest right one is named), a missing key, a value of the wrong form,
            negative power.
    """
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a mapping with the key 'lights'")
    _check_keys(where, content, {"lights", "reference_lux", "name"})
    entries = content.get("lights")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{where}: 'lights' must be a list of at least one light")
    reference = _number(where, content, "reference_lux", default=REFERENCE_LUX, positive=True)
    return LightSetup(tuple(_light(f"{where}: light {i}", e, up) for i, e in enumerate(entries)), reference)


def write_lights(path: Path, setup: LightSetup) -> None:
    """Write a set-up as a JSON lights file that `read_lights` takes back."""
    content = {"reference_lux": setup.reference_lux, "lights": [describe(light) for light in setup.lights]}
    write_text(path, json.dumps(content, indent=2) + "\n")


def describe(light: Light) -> dict[str, Any]:
    """One light as an entry of a lights file."""
    entry: dict[str, Any]
    if isinstance(light, PointLight):
        entry = {"kind": "point", "position": _list(light.position), "radius": _scalar(light.radius)}
        entry["clearance"] = _scalar(light.clearance)
    elif isinstance(light, SpotLight):
        entry = {"kind": "spot", "position": _list(light.position), "direction": _list(light.direction)}
        entry |= {f"{k}_degrees": _scalar(np.rad2deg(getattr(light, f"{k}_angle"))) for k in ("inner", "outer")}
        entry |= {"radius": _scalar(light.radius), "clearance": _scalar(light.clearance)}
    elif isinstance(light, DirectionalLight):
        entry = {"kind": "directional", "direction": _list(light.direction)}
        entry["angular_degrees"] = _scalar(np.rad2deg(light.angular_radius))
        if light.aperture is not None:
            entry["aperture"] = _describe_rectangle(light.aperture)
    elif isinstance(light, RectLight):
        entry = {"kind": "rect"} | _describe_rectangle(light)
    elif isinstance(light, SkyLight):
        entry = {"kind": "sky", "up": _list(light.up)}
    else:
        entry = {"kind": "ambient"}
    strength = "power" if hasattr(light, "power") else "illuminance"
    return entry | {strength: _scalar(getattr(light, strength)), "color": _list(light.color)}


def _describe_rectangle(rectangle: RectLight | Aperture) -> dict[str, Any]:
    right, up = np.asarray(rectangle.right, np.float64), np.asarray(rectangle.up, np.float64)
    normal = np.cross(right, up)
    return {
        "center": _list(rectangle.center),
        "normal": _list(normal / np.linalg.norm(normal)),
        "up": _list(up / np.linalg.norm(up)),
        "width": _scalar(2 * np.linalg.norm(right)),
        "height": _scalar(2 * np.linalg.norm(up)),
    }


def _light(where: str, entry: Any, world_up: Float[np.ndarray, "3"]) -> Light:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: must be a mapping, got {entry!r}")
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in KEYS:
        hint = did_you_mean(str(kind), KEYS)
        raise InputError(f"{where}: unknown kind {kind!r}{hint}; there are {', '.join(KEYS)}")
    where = f"{where} ({kind})"
    _check_keys(where, entry, COMMON | KEYS[kind])
    color = _color(where, entry)
    strength = _number(where, entry, "power" if "power" in KEYS[kind] else "illuminance")
    amount = jnp.float32(strength)
    if kind == "point":
        radius, clearance = (_length(where, entry, key) for key in ("radius", "clearance"))
        return PointLight(_vector(where, entry, "position"), amount, color, radius, clearance)
    if kind == "spot":
        return _spot(where, entry, amount, color)
    if kind == "directional":
        degrees = _number(where, entry, "angular_degrees", default=SUN_DEGREES)
        if degrees > 45:
            raise InputError(f"{where}: 'angular_degrees' must be at most 45, got {degrees:g}; use a sky for more")
        radius = jnp.float32(np.deg2rad(degrees))
        direction = _direction(where, entry, "direction")
        aperture = _aperture(where, entry["aperture"], world_up) if "aperture" in entry else None
        if aperture is not None and abs(_cosine(direction, aperture)) < 0.01:
            raise InputError(f"{where}: 'direction' runs along the aperture's plane; no light can come through")
        return DirectionalLight(direction, amount, color, radius, aperture)
    if kind == "rect":
        return RectLight(*_rectangle(where, entry, world_up), amount, color)
    if kind == "sky":
        return SkyLight(_direction(where, {"up": _list(world_up)} | entry, "up"), amount, color)
    return AmbientLight(amount, color)


def _spot(where: str, entry: dict[str, Any], power: Any, color: Any) -> SpotLight:
    if ("target" in entry) == ("direction" in entry):
        raise InputError(f"{where}: give either 'target' (a point) or 'direction'")
    position = _vector(where, entry, "position")
    if "target" in entry:
        entry = entry | {"direction": (_vector(where, entry, "target") - position).tolist()}
    outer = _number(where, entry, "outer_degrees", default=40.0, positive=True)
    inner = _number(where, entry, "inner_degrees", default=0.7 * outer)
    if not inner < outer <= 90:
        raise InputError(f"{where}: need inner_degrees < outer_degrees <= 90, got {inner:g} and {outer:g}")
    inner_angle, outer_angle = (jnp.float32(np.deg2rad(a)) for a in (inner, outer))
    direction = _direction(where, entry, "direction")
    radius, clearance = (_length(where, entry, key) for key in ("radius", "clearance"))
    return SpotLight(position, direction, power, color, inner_angle, outer_angle, radius, clearance)


def _aperture(where: str, entry: Any, world_up: Float[np.ndarray, "3"]) -> Aperture:
    where = f"{where}: aperture"
    if not isinstance(entry, dict):
        raise InputError(f"{where}: must be a mapping with {', '.join(sorted(RECTANGLE))}")
    _check_keys(where, entry, RECTANGLE)
    return Aperture(*_rectangle(where, entry, world_up))


def _cosine(direction: Any, rectangle: Aperture) -> float:
    normal = np.cross(rectangle.right, rectangle.up)
    return float(np.dot(direction, normal) / np.linalg.norm(normal))


def _rectangle(where: str, entry: dict[str, Any], world_up: Float[np.ndarray, "3"]) -> tuple[Any, Any, Any]:
    """Centre and half-axes, right × up along the normal, which is the side that a rectangle emits to."""
    normal = np.asarray(_direction(where, entry, "normal"), np.float64)
    up = np.asarray(_direction(where, {"up": _list(world_up)} | entry, "up"), np.float64)
    up = up - np.dot(up, normal) * normal
    if np.linalg.norm(up) < 1e-3:
        if "up" in entry:
            raise InputError(f"{where}: 'up' must not be parallel to 'normal'")
        up = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])  # a ceiling panel: any way round will do
    up /= np.linalg.norm(up)
    width, height = (_number(where, entry, key, positive=True) for key in ("width", "height"))
    half_right = jnp.asarray(np.cross(up, normal) * (0.5 * width), jnp.float32)
    return _vector(where, entry, "center"), half_right, jnp.asarray(up * (0.5 * height), jnp.float32)


def _check_keys(where: str, entry: dict[str, Any], known: set[str]) -> None:
    for key in entry:
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise InputError(f"{where}: unknown key {key!r}{hint}; there are {', '.join(sorted(known))}")


def _number(
    where: str, entry: dict[str, Any], key: str, default: float | None = None, positive: bool = False
) -> float:
    if key not in entry and default is not None:
        return default
    if key not in entry:
        raise InputError(f"{where}: key {key!r} is missing")
    value = entry[key]
    if not _is_number(value):
        raise InputError(f"{where}: {key!r} must be a finite number, got {value!r}")
    if value < 0 or (positive and value == 0):
        raise InputError(f"{where}: {key!r} must be {'> 0' if positive else '>= 0'}, got {value:g}")
    return float(value)


def _is_number(value: Any) -> bool:
    """Whether `value` is a number that float32 can hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _length(where: str, entry: dict[str, Any], key: str) -> Any:
    return jnp.float32(_number(where, entry, key, default=0.0))


def _vector(where: str, entry: dict[str, Any], key: str) -> Any:
    if key not in entry:
        raise InputError(f"{where}: key {key!r} is missing")
    value = entry[key]
    if not isinstance(value, Sequence) or len(value) != 3 or not all(_is_number(v) for v in value):
        raise InputError(f"{where}: {key!r} must be three finite numbers, got {value!r}")
    return jnp.asarray(value, jnp.float32)


def _direction(where: str, entry: dict[str, Any], key: str) -> Any:
    vector = _vector(where, entry, key)
    length = float(jnp.linalg.norm(vector))
    if length == 0:
        raise InputError(f"{where}: {key!r} must not be the zero vector")
    return vector / length


def _color(where: str, entry: dict[str, Any]) -> Any:
    if "temperature" in entry and "color" in entry:
        raise InputError(f"{where}: give either 'color' or 'temperature'")
    if "temperature" in entry:
        kelvin = _number(where, entry, "temperature")
        if not 1667 <= kelvin <= 25000:
            raise InputError(f"{where}: 'temperature' must lie in 1667..25000 kelvin, got {kelvin:g}")
        return blackbody(kelvin)
    color = _vector(where, {"color": [1.0, 1.0, 1.0]} | entry, "color")
    if bool((color < 0).any()):
        raise InputError(f"{where}: 'color' must not be negative, got {entry['color']!r}")
    return color


def _scalar(value: Any) -> float:
    return float(f"{float(value):.7g}")


def _list(vector: Any) -> list[float]:
    return [_scalar(v) for v in np.asarray(vector)]
