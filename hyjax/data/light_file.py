"""Lights as a person writes them: YAML or JSON, checked key by key.

    reference_lux: 300          # illuminance the frames were taken under; default 300
    lights:
      - kind: point             # or spot, directional, rect, sky, ambient
        position: [1.2, 0.4, 2.0]
        luminous_flux: 800
        temperature: 2700

| kind        | needs                                           | may have                                        |
|-------------|-------------------------------------------------|-------------------------------------------------|
| point       | position, luminous_flux                         | radius, clearance                               |
| spot        | position, target or direction, luminous_flux    | inner_degrees, outer_degrees, radius, clearance |
| directional | direction, illuminance                          | angular_degrees, aperture                       |
| rect        | center, normal, width, height, luminous_flux    | up                                              |
| sky         | illuminance                                     | up                                              |
| ambient     | illuminance                                     |                                                 |

Every kind may have `color` (linear RGB, default white) or `temperature` (kelvin), and a `name`. Positions and
lengths are in metres in the capture's world axes, luminous flux in lumens, illuminance in lux; angles of a spot are
half angles, the `angular_degrees` of a sun its radius. `up` defaults to the capture's. `aperture` is the window
that a sun shines through: a mapping with center, normal, width, height and maybe up; it shows in the shadows.
Nothing nearer to a lamp than its `clearance` casts a shadow: what a scan makes of a lampshade is rarely hollow.

The lights that the photos were taken under are off, unless `existing` keeps some of them: it says how much is left
of each, by the names that `hyjax relight` writes to `run.json`, as a number or as red, green and blue:

    existing: {window-1: 0.2, ceiling: [1.0, 0.6, 0.3]}

A file may leave `lights` out then. Each kind declares its keys (`Light.KEYS`); the checks here are made from them,
and so hold for kinds that are registered from outside the package.
"""

import functools
import json
import logging
import re
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from hyjax.data.hand_written import check_keys
from hyjax.light.color import BLACKBODY_KELVIN
from hyjax.light.kinds import LIGHT_KINDS, AmbientLight, Light, kind_name
from hyjax.light.kinds.file_keys import LARGEST_NUMBER, REQUIRED, FileKey, plain
from hyjax.light.setup import REFERENCE_LUX, LightSetup
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.files import write_text
from hyjax.util.reading import read_yaml

_log = logging.getLogger(__name__)

COMMON_KEYS = (
    FileKey("kind", "any"),
    FileKey("name", "any", default=None),
    FileKey("color", "color", default=None),
    FileKey("temperature", least=BLACKBODY_KELVIN[0], most=BLACKBODY_KELVIN[1], default=None),
)
FILE_KEYS = (
    FileKey("lights", "list", default=()),
    FileKey("existing", "any", default=None),
    FileKey("reference_lux", positive=True, default=REFERENCE_LUX),
    FileKey("name", "any", default=None),
)
_Finite = Annotated[float, msgspec.Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
_NonNegative = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_NUMBER)]
FORMS: dict[str, tuple[Any, str]] = {
    "vector": (tuple[_Finite, _Finite, _Finite], "three finite numbers"),
    "direction": (tuple[_Finite, _Finite, _Finite], "three finite numbers"),
    "color": (tuple[_NonNegative, _NonNegative, _NonNegative], "three finite numbers, none negative"),
    "list": (list, "a list of lights"),
    "any": (Any, "anything"),
}
"""Type of the values of each form, and its description in errors."""


def is_light_file(text: str) -> bool:
    """Whether this means a lights file, by its ending, and not a named set-up."""
    return Path(text).suffix.lower() in (".yaml", ".yml", ".json")


@checked_arguments
def read_lights(path: Path, up: Float[np.ndarray, "3"], *, warn: bool = True) -> LightSetup:
    """Read a lights file; see the module's docstring for its form.

    Raises:
        InputError: no such file, not YAML or JSON, or anything `parse_lights` refuses; the message names the file.
    """
    path = Path(path)
    return parse_lights(read_yaml(path), up, str(path), warn=warn)


@checked_arguments
def parse_lights(
    content: Any, up: Float[np.ndarray, "3"], where: str = "lights", *, warn: bool = True
) -> LightSetup:
    """Build lights from the plain data of a lights file.

    Raises:
        InputError: unknown kind or key (the nearest right one is named), a missing key, a value of the wrong form,
            a negative luminous flux.
    """
    if isinstance(content, dict) and not {"windows", "lamps"}.isdisjoint(content):
        raise InputError(
            f"{where}: has what lit the photos (windows, lamps), which --photo-sources takes from a file of its own"
        )
    values = _checked(where, content, FILE_KEYS)
    existing = _existing(where, values["existing"])
    if not values["lights"]:
        if not existing:
            raise InputError(f"{where}: 'lights' must be a list of at least one light, or 'existing' keep a source")
        return LightSetup((AmbientLight(jnp.float32(0.0), jnp.ones(3)),), values["reference_lux"], existing)
    entries = _renamed(where, values["lights"], warn)
    lights = tuple(_light(f"{where}: light {i}", entry, up) for i, entry in enumerate(entries))
    return LightSetup(jax.tree.map(jnp.asarray, lights), values["reference_lux"], existing)


@checked_arguments
def write_lights(path: Path, setup: LightSetup) -> None:
    """Write a set-up as a JSON lights file that `read_lights` takes back.

    Raises:
        InputError: a light of a kind that is not registered.
    """
    lights = [{"kind": kind_name(light)} | light.to_entry() for light in setup.lights]
    content: dict[str, Any] = {"reference_lux": plain(setup.reference_lux), "lights": lights}
    if setup.existing:
        content["existing"] = {name: list(factors) for name, factors in setup.existing.items()}
    write_text(path, json.dumps(content, indent=2) + "\n")


def _existing(where: str, content: Any) -> dict[str, tuple[float, float, float]]:
    """Remaining share of each source of the photo."""
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{where}: 'existing' must be a mapping of sources to numbers, got {content!r}")
    kept = {}
    for name, value in content.items():
        try:
            numbers = msgspec.convert([value] * 3 if isinstance(value, int | float) else value, FORMS["color"][0])
        except msgspec.ValidationError:
            raise InputError(
                f"{where}: existing: {name!r} must be a number >= 0, or three, got {value!r}"
            ) from None
        kept[str(name)] = numbers
    return kept


def _light(where: str, entry: Any, world_up: Float[np.ndarray, "3"]) -> Light:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: must be a mapping, got {entry!r}")
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in LIGHT_KINDS:
        hint = did_you_mean(str(kind), LIGHT_KINDS)
        raise InputError(f"{where}: unknown kind {kind!r}{hint}; there are {', '.join(LIGHT_KINDS)}")
    where = f"{where} ({kind})"
    values = _checked(where, entry, LIGHT_KINDS[kind].KEYS + COMMON_KEYS)
    try:
        return LIGHT_KINDS[kind].from_entry(values, world_up)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _renamed(where: str, entries: list[Any], warn: bool) -> list[Any]:
    """Entries with today's keys in the place of those of version 0.1; says so once a file."""
    found: dict[str, str] = {}
    renamed = []
    for number, entry in enumerate(entries):
        kind = LIGHT_KINDS.get(str(entry.get("kind"))) if isinstance(entry, dict) else None
        names = {key.old_name: key.name for key in kind.KEYS if key.old_name} if kind else {}
        old = {name: names[name] for name in names if name in entry and names[name] not in entry}
        both = [name for name in names if name in entry and names[name] in entry]
        if both:
            place = f"{where}: light {number} ({entry['kind']})"
            raise InputError(f"{place}: {both[0]!r} is the old name of {names[both[0]]!r}; give one of them")
        renamed.append({old.get(key, key): value for key, value in entry.items()} if old else entry)
        found |= old
    for old_name, name in found.items() if warn else ():
        _log.warning("%s: key %r is now called %r; the old name will go", where, old_name, name)
    return renamed


def _checked(where: str, content: Any, keys: tuple[FileKey, ...]) -> dict[str, Any]:
    """Values of all keys, defaults filled in; vectors are tuples."""
    known = {key.name: key for key in keys}
    check_keys(where, content, sorted(known), [key.name for key in keys if key.default is REQUIRED])
    try:
        values = msgspec.structs.asdict(msgspec.convert(content, _struct(keys)))
    except msgspec.ValidationError as error:
        at = re.search(r" - at `\$\.(\w+)", str(error))
        assert at is not None
        raise InputError(_explain(where, content[at[1]], known[at[1]])) from None
    return {k: msgspec.structs.asdict(v) if isinstance(v, msgspec.Struct) else v for k, v in values.items()}


@functools.cache
def _struct(keys: tuple[FileKey, ...]) -> type[msgspec.Struct]:
    """Type of a mapping with these keys and no other."""
    required = [(key.name, _type(key)) for key in keys if key.default is REQUIRED]
    optional = [(key.name, _type(key), key.default) for key in keys if key.default is not REQUIRED]
    return msgspec.defstruct("Entry", [*required, *optional], forbid_unknown_fields=True)


def _type(key: FileKey) -> Any:
    if isinstance(key.form, tuple):
        return _struct(key.form)
    if key.form == "number":
        least = msgspec.Meta(gt=0.0) if key.positive else msgspec.Meta(ge=key.least)
        return Annotated[float, least, msgspec.Meta(le=key.most)]
    return FORMS[key.form][0]


def _explain(where: str, value: Any, key: FileKey) -> str:
    """Description of the fault in a key's value."""
    if isinstance(key.form, tuple):
        try:
            _checked(f"{where}: {key.name}", value, key.form)
        except InputError as error:
            return str(error)
    return f"{where}: {key.name!r} must be {_form(key)}, got {value!r}"


def _form(key: FileKey) -> str:
    if key.form != "number":
        return FORMS[str(key.form)][1]
    if key.least > 0:
        return f"a number in {key.least:g}..{key.most:g}"
    most = f" and <= {key.most:g}" if key.most < LARGEST_NUMBER else ""
    return f"a finite number {'> 0' if key.positive else '>= 0'}{most}"
