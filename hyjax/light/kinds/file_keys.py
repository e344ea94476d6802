"""Keys of a kind of light in a lights file."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Union

import numpy as np
from jaxtyping import ArrayLike, Float

from hyjax.util.errors import InputError

LARGEST_NUMBER = float(np.finfo(np.float32).max)
"""Largest number of a key."""
REQUIRED = object()
"""Default of a required key."""


@dataclasses.dataclass(frozen=True)
class FileKey:
    """Key of a light in a lights file.

    Attributes:
        name: the key.
        form: of its value: a number, three numbers, three numbers that give a direction, linear RGB, or a mapping
            with keys of its own.
        default: value where the key is left out.
        least, most: bounds of a number.
        positive: whether a number must be above zero.
        field: the light's field, if its name is not the key's.
        degrees: whether the number is an angle in degrees, which the field has in radians.
        written: whether the light is written with this key; false for an alternative to another key.
        old_name: key that is still read in its place.
    """

    name: str
    form: Union[Literal["number", "vector", "direction", "color", "list", "any"], tuple["FileKey", ...]] = "number"  # noqa: UP007
    default: Any = REQUIRED
    least: float = 0.0
    most: float = LARGEST_NUMBER
    positive: bool = False
    field: str = ""
    degrees: bool = False
    written: bool = True
    old_name: str = ""

    def to_field(self, value: Any) -> Any:
        """Array of the field from the file's value."""
        if self.form == "direction":
            return direction(value, self.name)
        return np.asarray(np.deg2rad(value) if self.degrees else value, np.float32)

    def to_value(self, field: Any) -> Any:
        """Plain numbers of a file from the field's array."""
        return plain(np.rad2deg(field) if self.degrees else field)


LUMINOUS_FLUX = FileKey("luminous_flux", old_name="power")
ILLUMINANCE = FileKey("illuminance")
RADIUS = FileKey("radius", default=0.0)
CLEARANCE = FileKey("clearance", default=0.0)


Triple = Float[ArrayLike, "3"] | Sequence[float]
"""Three numbers, an array or a sequence."""


def direction(vector: Triple, name: str = "direction") -> Float[np.ndarray, "3"]:
    """Unit vector along a vector, in float32."""
    single = np.asarray(vector, np.float32)
    length = np.linalg.norm(single)
    if length == 0:
        raise InputError(f"{name!r} must not be the zero vector")
    return single / length


def plain(value: Float[ArrayLike, "*s"]) -> Any:
    """Python numbers of a number or a vector, with the seven digits of float32."""
    array = np.asarray(value, np.float64)
    return [plain(component) for component in array] if array.ndim else float(f"{float(array):.7g}")


def fields_of(keys: tuple[FileKey, ...], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a file by the names of their fields."""
    return {key.field or key.name: key.to_field(values[key.name]) for key in keys if key.written}


def values_of(keys: tuple[FileKey, ...], light: Any) -> dict[str, Any]:
    """Fields of a light by the names of their keys; the inverse of `fields_of`."""
    return {key.name: key.to_value(getattr(light, key.field or key.name)) for key in keys if key.written}
