"""Checks of lights' values, where they are known (not traced)."""

import dataclasses
import functools
import math
import typing
from typing import Any

import numpy as np

from hyjax.light.kinds.file_keys import FileKey
from hyjax.util.argument_kinds import described, is_numeric
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

NO_BOUNDS = FileKey("", "any")


def check_fields(thing: Any, keys: tuple[FileKey, ...], name: str) -> None:
    """Raise `InputError` for an invalid number or vector of a light. Traced values are let through."""
    bounds = {key.field or key.name: key for key in keys}
    for field, shape in _shapes(thing.__class__).items():
        value, where = getattr(thing, field), f"{name}.{field}"
        if shape is None:
            if dataclasses.is_dataclass(value):
                check_fields(value, (), where)
            continue
        known = _known(value, shape, where)
        if known is not None:
            _check_bounds(known, bounds.get(field, NO_BOUNDS), where, is_color=field == "color")


def _known(value: Any, shape: tuple[int, ...], where: str) -> np.ndarray | None:
    """Values as numbers, or None while they are traced."""
    wanted = "three finite numbers, as an array" if shape else "a finite number"
    if isinstance(value, list | tuple | str) or value is None:
        raise InputError(f"{where}: must be {wanted}, got {shown(value)}")
    if getattr(value, "shape", shape) != shape:
        raise InputError(f"{where}: must be {wanted}, got {described(value)}")
    known = concrete(value)
    if known is not None and not (is_numeric(known) and known.shape == shape and np.isfinite(known).all()):
        raise InputError(f"{where}: must be {wanted}, got {shown(known.tolist())}")
    return known


def _check_bounds(known: np.ndarray, key: FileKey, where: str, *, is_color: bool) -> None:
    if is_color and (known < 0).any():
        raise InputError(f"{where}: must be three finite numbers, none negative, got {known.tolist()}")
    if key.form == "direction" and not known.any():
        raise InputError(f"{where}: must not be the zero vector")
    if key.form != "number":
        return
    number = float(known)
    least, most = (math.radians(bound) if key.degrees else bound for bound in (key.least, key.most))
    if not least <= number <= most * (1 + 1e-6) or (key.positive and number <= 0):
        raise InputError(f"{where}: must lie in {'(' if key.positive else '['}{least:g}, {most:g}], got {number:g}")


@functools.cache
def _shapes(cls: Any) -> dict[str, tuple[int, ...] | None]:
    """Shapes of the fields that are numbers or vectors; None for others."""
    hints, shapes = typing.get_type_hints(cls), dict[str, tuple[int, ...] | None]()
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        arrays = [part for part in (hint, *typing.get_args(hint)) if hasattr(part, "dim_str")]
        sides = arrays[0].dim_str.split() if arrays else []
        if all(side.isdecimal() for side in sides):  # a shape with names is the kind's own matter
            shapes[field.name] = tuple(map(int, sides)) if arrays else None
    return shapes
