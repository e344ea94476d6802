"""Keys with which a kind of light is written in a lights file."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Union

import numpy as np
from jaxtyping import ArrayLike, Float

from hyjax.util.errors import InputError

LARGEST = float(np.finfo(np.float32).max)
REQUIRED = object()
"""Default of a key that must be given."""


@dataclasses.dataclass(frozen=True)
class FileKey:
    """One key of a light in a lights file.

    Attributes:
        name: the key.
        form: of its value: a number, three numbers, three numbers that give a direction, linear RGB, or a mapping
            with keys of its own.
        default: value where the key is left out.
        least, most: bounds of a number.
        positive: whether a number must be above zero.
        field: the light's field, if it is not called like the key.
        degrees: whether the number is an angle in degrees, which the field has in radians.
        written: whether the light is written with this key; false for one that is another way to say the same.
        old_name: key that is still read in its place.
    """

    name: str
    form: Union[Literal["number", "vector", "direction", "color", "list", "any"], tuple["FileKey", ...]] = "number"  # noqa: UP007
    default: Any = REQUIRED
    least: float = 0.0
    most: float = LARGEST
    positive: bool = False
    field: str = ""
    degrees: bool = False
    written: bool = True
    old_name: str = ""

    def to_field(self, value: Any) -> Any:
        """The file's value as the field's array."""
        if self.form == "direction":
            return direction(value, self.name)
        return np.asarray(np.deg2rad(value) if self.degrees else value, np.float32)

    def to_value(self, field: Any) -> Any:
        """The field's array as plain numbers of a file."""
        return plain(np.rad2deg(field) if self.degrees else field)


LUMINOUS_FLUX = FileKey("luminous_flux", old_name="power")
ILLUMINANCE = FileKey("illuminance")
RADIUS = FileKey("radius", default=0.0)
CLEARANCE = FileKey("clearance", default=0.0)


Triple = Float[ArrayLike, "3"] | Sequence[float]
"""Three numbers, as an array or written out."""


def direction(vector: Triple, name: str = "direction") -> Float[np.ndarray, "3"]:
    """A vector made unit, in float32.

    Raises:
        InputError: the zero vector; the message calls it by its name.
    """
    single = np.asarray(vector, np.float32)
    length = np.linalg.norm(single)
    if length == 0:
        raise InputError(f"{name!r} must not be the zero vector")
    return single / length


def plain(value: Float[ArrayLike, "*s"]) -> Any:
    """A number or a vector as Python numbers, of the seven digits that float32 has."""
    array = np.asarray(value, np.float64)
    return [plain(component) for component in array] if array.ndim else float(f"{float(array):.7g}")


def fields_of(keys: tuple[FileKey, ...], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a file by the names of the fields that they become."""
    return {key.field or key.name: key.to_field(values[key.name]) for key in keys if key.written}


def values_of(keys: tuple[FileKey, ...], light: Any) -> dict[str, Any]:
    """Fields of a light by the names of the keys that they are written with; the inverse of `fields_of`."""
    return {key.name: key.to_value(getattr(light, key.field or key.name)) for key in keys if key.written}
