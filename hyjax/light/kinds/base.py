"""Base class of all kinds of light, and their registry."""

import dataclasses
import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeAlias, TypeVar, dataclass_transform

import jax
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.color import blackbody
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import FileKey, fields_of, plain, values_of
from hyjax.light.kinds.shadow_views import ShadowViews
from hyjax.light.kinds.values import check_fields
from hyjax.util.errors import InputError

T = TypeVar("T")
if TYPE_CHECKING:  # fields are JAX's in computations; NumPy's arrays and numbers may be given all the same
    Scalar: TypeAlias = Any
    Vector: TypeAlias = Any
else:
    Scalar = Float[Array | np.ndarray, ""] | float
    Vector = Float[Array | np.ndarray, "3"]


@dataclass_transform(frozen_default=True, eq_default=False)
def pytree(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass and a pytree whose every field is a leaf."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True, eq=False)(cls))


class Light:
    """Base class of all kinds of light; see `hyjax.light.kinds` for how to add a kind.

    A kind is a `pytree` with a `color`, `KEYS` and its illuminance on a surface. All else has a default: a
    light casts no shadow, cannot be rendered by Blender, and each of its keys in a file is a field.
    """

    KEYS: ClassVar[tuple[FileKey, ...]]
    UNIFORM: ClassVar[bool] = False  # whether it falls on every surface alike, also where none is known
    STRENGTH: ClassVar[str] = "luminous_flux"  # the field that its illuminance is proportional to
    color: Vector

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        """Illuminance (lux) on surfaces at positions p with unit normals n, before shadows and colour."""
        raise NotImplementedError

    def shadow_views(self) -> ShadowViews | None:
        """Views of the light's shadow map; None if it casts no shadow."""
        return None

    def view_weight(
        self,
        cosine: Float[Array, "..."],
        squared: Float[Array, "..."],
        to_light: Sequence[Float[Array, "..."]],
    ) -> Float[Array, "..."]:
        """Share of one shadow view in the illuminance of a surface.

        Args:
            cosine: of the angle of incidence, at least 0.
            squared: distance to the view's origin, squared; 1 for parallel light.
            to_light: unit vector to the view's origin, by components.
        """
        return cosine / squared

    def mask_visibility(self, visibility: Float[Array, "*s"], position: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        """Visibility by the shadow map, set to 0 where no light arrives for reasons outside the map."""
        return visibility

    def emitter(self) -> Emitter | None:
        """Description of the light for another renderer; None if it falls on every surface alike.

        Raises:
            InputError: the kind declares none.
        """
        if self.UNIFORM:
            return None
        raise InputError(f"blender: cannot render a {type(self).__name__}; its kind declares no emitter")

    def check_values(self, name: str) -> None:
        """Raise `InputError` for invalid values, once per light. Traced values are let through.

        Args:
            name: of the light in messages.
        """
        if self not in _CHECKED:
            check_fields(self, self.KEYS, name)
            _CHECKED.add(self)

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        """Light of an entry in a lights file.

        Args:
            values: checked values of all `KEYS`, `color` and `temperature`; defaults filled in.
            world_up: the capture's unit vector against gravity.

        Raises:
            InputError: values that do not go together.
        """
        return cls(**fields_of(cls.KEYS, values), color=color_of(values))  # type: ignore[call-arg]

    def to_entry(self) -> dict[str, Any]:
        """Light as plain numbers, an entry of a lights file; the inverse of `from_entry`."""
        return values_of(self.KEYS, self) | {"color": plain(self.color)}

    def normalized(self) -> Self:
        """Light of the same geometry, white and of strength 1."""
        one, white = np.asarray(1.0, np.float32), np.ones(3, np.float32)
        return dataclasses.replace(self, color=white, **{self.STRENGTH: one})  # type: ignore[type-var]


_CHECKED: "weakref.WeakSet[Light]" = weakref.WeakSet()
LIGHT_KINDS: dict[str, type[Light]] = {}
"""Kinds of light by their names in a lights file; `register_light` adds to it."""


def register_light(name: str, cls: type[Light]) -> None:
    """Register a kind of light under its name in lights files.

    Raises:
        InputError: the name belongs to another kind, or the class is no `Light` with `KEYS`.
    """
    if not (isinstance(cls, type) and issubclass(cls, Light) and hasattr(cls, "KEYS")):
        raise InputError(f"lights: {cls!r} must be a subclass of Light, with KEYS")
    if cls.STRENGTH not in getattr(cls, "__dataclass_fields__", {}):
        raise InputError(f"lights: {cls.__name__} has no field {cls.STRENGTH!r}; STRENGTH must name its brightness")
    if LIGHT_KINDS.setdefault(name, cls) is not cls:
        raise InputError(f"lights: kind {name!r} is {LIGHT_KINDS[name].__name__}; choose another name")


def kind_name(light: Light) -> str:
    """Name under which a light's kind is registered.

    Raises:
        InputError: it is not registered.
    """
    for name, cls in LIGHT_KINDS.items():
        if type(light) is cls:
            return name
    raise InputError(f"lights: {type(light).__name__} is no registered kind of light; see register_light")


def color_of(values: Mapping[str, Any]) -> Vector:
    """Linear RGB by a file's `color` or `temperature`; white without either."""
    color, kelvin = values["color"], values["temperature"]
    if kelvin is None:
        return np.asarray((1.0, 1.0, 1.0) if color is None else color, np.float32)
    if color is not None:
        raise InputError("give either 'color' or 'temperature'")
    return blackbody(kelvin)
