"""Kinds of arguments: values that an annotation takes, and conversions of others."""

import collections.abc
import dataclasses
import functools
import itertools
import logging
import math
import os
import types
import typing
import weakref
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Union

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, jaxtyped

from hyjax.util.errors import InputError, did_you_mean, shown

LARGEST_FLOAT = float(np.finfo(np.float32).max)
LARGEST_WHOLE = 1 << 62
NUMBERS: Any = (int, float, np.integer, np.floating)
EMPTY_AXES = ("n", "o", "h_1", "w_1", "ch_1", "cw_1")
"""Axes that may have no entries: steps and rays may be none, and edges of one row or column."""
TYPE_NAMES: dict[Any, str] = {
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    Path: "a path",
    str: "a text",
    type(None): "None",
}
DTYPE_NAMES: dict[Any, str] = {"float32": "a float", "bool": "a bool", "int32": "an integer", "uint8": "a uint8"}
SCALED_MESSAGE = "%s: a picture of bytes is taken for display values of 0 to 255, and divided by 255 (said once)"
_log = logging.getLogger(__name__)
_told: set[str] = set()
_checked: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()
"""Objects whose fields have been looked at; they are frozen."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """Values that an annotation takes.

    Attributes:
        wanted: what would be right, for messages.
        arrays: annotations of jaxtyping.
        classes: of other values; float and int are for numbers of Python and NumPy.
        words: of a literal.
        each: kind of the entries of a sequence.
        parts: kinds of a tuple's entries.
        display: whether bytes are taken for display values of 0 to 255.
        may_be_empty: whether arrays may be; their axes of `EMPTY_AXES` always may.
        anything: whether the annotation says nothing that can be checked.
    """

    wanted: str = ""
    arrays: tuple[Any, ...] = ()
    classes: tuple[Any, ...] = ()
    words: tuple[Any, ...] = ()
    each: "Kind | None" = None
    parts: "tuple[Kind, ...]" = ()
    display: bool = False
    may_be_empty: bool = False
    anything: bool = False

    def __call__(self, name: str, value: Any, seen: "Seen") -> Any:
        """Value to pass on: as it is, or converted."""
        if self.anything:
            return value
        if isinstance(value, np.ndarray) and not self.on_host:
            value = _narrowed(value)
        if not self.takes(value):
            readings = (reading for reading in self._readings(value) if self.takes(reading))
            given, value = value, next(readings, None)
            if value is None:
                raise self.refusal(name, given, seen)
            if getattr(given, "dtype", None) == np.uint8 and name not in _told:
                _told.add(name)
                _log.warning(SCALED_MESSAGE, name)
        seen[name] = self, value
        if isinstance(value, tuple) and (self.parts or self.each):
            parts: Any = self.parts or itertools.repeat(self.each)
            return tuple([part(f"{name}[{k}]", x, seen) for k, (part, x) in enumerate(zip(parts, value))])
        check_content(name, value)
        return value

    def takes(self, value: Any) -> bool:
        """Whether a value is of this kind as it is; a tuple's entries are not looked at."""
        if self.anything:
            return True
        if isinstance(value, bool | np.bool_ | str):
            of = str if isinstance(value, str) else type(value)
            return of in self.classes or any(type(value) is type(word) and value == word for word in self.words)
        if isinstance(value, NUMBERS):
            if int in self.classes and isinstance(value, int):
                return abs(value) <= LARGEST_WHOLE
            return float in self.classes and not LARGEST_FLOAT < abs(value) < math.inf
        if isinstance(value, tuple):
            return len(value) == len(self.parts) if self.parts else self.each is not None
        if isinstance(value, self.arrays):
            return (
                self.may_be_empty
                or 0 not in value.shape
                or all(n or axis in EMPTY_AXES for axis, n in self.sizes(value).items())
            )
        return any(map(functools.partial(_is_one, value), self.classes))

    @property
    def on_host(self) -> bool:
        """Whether arrays are NumPy's alone, in the precision that they have."""
        return bool(self.arrays) and all(kind.array_type is np.ndarray for kind in self.arrays)

    def _readings(self, value: Any) -> Iterator[Any]:
        """Possible conversions of a value, the likeliest first."""
        if isinstance(value, np.generic):
            yield value.item()
        if isinstance(value, str) and Path in self.classes:
            yield Path(value)
        if self.each is not None and self.each.classes and self.each.takes(value):
            yield (value,)
        if isinstance(value, list) or (self.each and _is_iterable(value)):
            yield tuple(value)
        if self.arrays and (isinstance(value, list | tuple) or hasattr(value, "__array__")):
            yield from self._arrays(value)

    def _arrays(self, value: Any) -> Iterator[Any]:
        listed = isinstance(value, list | tuple)
        on_device = listed and any(isinstance(x, jax.Array) for x in jax.tree.leaves(value))
        try:
            array: Any
            if self.on_host:
                array = np.asarray(value)
            else:
                array = value if isinstance(value, jax.Array) else (jnp if on_device else np).asarray(value)
        except (TypeError, ValueError, OverflowError, MemoryError):  # of a key, a traced array, a ragged list
            return
        narrowed = (lambda x: x) if self.on_host else _narrowed
        yield narrowed(array)
        # 0 for 0.0, as people write lists; 255 in a display picture may be meant for a byte.
        if (listed or self.on_host) and array.dtype == np.int64 and not (self.display and array.max(initial=0) > 1):
            yield narrowed(array.astype(float))
        if self.display and array.dtype == np.uint8:
            yield (np.asarray(array, np.float32) if self.on_host else jnp.asarray(array, jnp.float32)) / 255.0

    def refusal(self, name: str, value: Any, seen: "Seen") -> InputError:
        """Error for a value of another kind, or of another size than those before it."""
        if isinstance(value, str) and self.words:
            hint = did_you_mean(value, map(str, self.words))
            return InputError(f"{name}: {shown(value)} is unknown{hint}; use {self.wanted}")
        if not (hasattr(value, "dtype") and hasattr(value, "shape")):
            return InputError(f"{name}: must be {self.wanted}, got {shown(value)}")
        got = f"must be {self.wanted}, got {described(value)}"
        if value.dtype == np.uint8 and self.arrays:
            remedy = (
                "compare a mask of bytes with 0" if "bool" in self.wanted else "divide a picture of bytes by 255"
            )
            return InputError(f"{name}: {got}; {remedy}")
        sizes = self.sizes(value)
        for axis, size in sizes.items():
            for other, (kind, earlier) in seen.items():
                if (expected := kind.sizes(earlier).get(axis, size)) != size:
                    return InputError(f"{name}: {got}; {axis} is {expected} by {other}")
        return InputError(f"{name}: {'' if all(sizes.values()) else 'is empty; '}{got}")

    def sizes(self, value: Any) -> dict[str, int]:
        """Sizes of an array's named axes; axes before a variadic one are left out."""
        axes = self.arrays[0].dim_str.split() if self.arrays else ()
        sizes = [*zip(axes[::-1], getattr(value, "shape", ())[::-1])]
        return {axis: size for axis, size in reversed(sizes) if axis.isidentifier()}


Seen = dict[str, tuple[Kind, Any]]
"""Kinds and values of arguments by name."""


def kind_of(hint: Any, **options: Any) -> Kind:
    """The kind of values that an annotation takes; the options are `display` and `may_be_empty` of `Kind`.

    >>> kind_of(int | None).wanted
    'a whole number or None'
    """
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (Union, types.UnionType):
        return _any_of([kind_of(part, **options) for part in parts])
    if hasattr(hint, "dim_str"):
        both: Any = (hint.dtype[np.ndarray, hint.dim_str],)
        if hint.array_type is not np.ndarray:
            both = (hint.dtype[jax.Array, hint.dim_str], *both)
        return Kind(_array_name(hint), both, () if hint.dim_str else (float,), **options)
    if origin is Literal:
        return Kind(f"one of {', '.join(map(str, parts))}", words=parts)
    if origin is tuple and parts and parts[-1] is not Ellipsis:
        kinds = tuple(map(kind_of, parts))
        names = " and ".join(dict.fromkeys(kind.wanted or "anything" for kind in kinds))
        return Kind(f"{len(kinds)} values, each {names}", parts=kinds)
    if origin in (tuple, collections.abc.Sequence, collections.abc.Iterable, list):
        entry = kind_of(parts[0])
        return Kind(f"several, each {entry.wanted}" if entry.wanted else "several values", each=entry)
    if origin is collections.abc.Callable:
        return Kind("a function", classes=(collections.abc.Callable,))
    if hint is float:
        return Kind(TYPE_NAMES[float], (Float[Array, ""],), (float,))
    if isinstance(hint, type) and issubclass(hint, np.generic):  # of jaxtyping's ArrayLike
        return Kind()
    if origin is os.PathLike:
        return Kind("a path", classes=(os.PathLike,))
    if origin in (dict, Mapping):
        return Kind("a mapping", classes=(Mapping,))
    if isinstance(hint, type) and hint is not object and hint.__module__ != "typing":  # BinaryIO has no instances
        article = "an" if hint.__name__[0] in "AEIO" else "a"
        return Kind(TYPE_NAMES.get(hint, f"{article} {hint.__name__}"), classes=(hint,))
    return Kind(anything=True)


def _any_of(kinds: Sequence[Kind]) -> Kind:
    """The kind of a union; arrays take lists of numbers as well, and those of no axes take numbers."""
    arrays = sum((kind.arrays for kind in kinds), ())
    entry = None if any(a.dim_str for a in arrays) else next((kind.each for kind in kinds if kind.each), None)
    return Kind(
        " or ".join(dict.fromkeys(kind.wanted for kind in kinds if kind.wanted)),
        arrays,
        sum((kind.classes for kind in kinds), ()),
        sum((kind.words for kind in kinds), ()),
        entry,
        next((kind.parts for kind in kinds if kind.parts), ()),
        any(kind.display for kind in kinds),
        any(kind.may_be_empty for kind in kinds),
        any(kind.anything for kind in kinds),
    )


def _array_name(hint: Any) -> str:
    kind = next((said for name, said in DTYPE_NAMES.items() if name in hint.dtypes), "a number")
    axes = ["..." if axis.startswith("*") else axis for axis in hint.dim_str.split()]
    if not axes:
        return "a number"
    return f"{kind} array" + ("" if axes == ["..."] else f" of shape {' x '.join(axes)}")


def _is_one(value: Any, cls: Any) -> bool:
    """Whether a value is of a class, or has any of a protocol's names, as part of it may be all that is used."""
    if not getattr(cls, "_is_protocol", False):
        return isinstance(value, cls)
    names = {*vars(cls), *getattr(cls, "__annotations__", ())}
    return any(
        hasattr(type(value), name) or name in getattr(value, "__dict__", ()) for name in names if name[0] != "_"
    )


def _is_iterable(value: Any) -> bool:
    no_sequence = isinstance(value, str | bytes | Mapping) or getattr(value, "ndim", 1) == 0
    return isinstance(value, collections.abc.Iterable) and not no_sequence


def _narrowed(array: Any) -> Any:
    """Doubles in single precision, unless JAX is set to have them."""
    if array.dtype != np.float64 or jax.dtypes.canonicalize_dtype(float) == np.float64:
        return array
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def check_content(name: str, value: Any) -> None:
    """Raise `InputError` for an object whose own checks fail, or whose arrays are not as its fields say."""
    if hasattr(value, "check_values"):
        value.check_values(name)
        return
    fields = _fields_of(value.__class__)
    if fields and _checked.get(id(value)) is not value:
        seen: Seen = {}
        with jaxtyped("context"):
            for field, kind in fields:
                content = getattr(value, field)
                if not kind.takes(content):
                    raise kind.refusal(f"{name}.{field}", content, seen)
                seen[f"{name}.{field}"] = kind, content
                check_content(f"{name}.{field}", content)
        _checked[id(value)] = value


@functools.cache
def _fields_of(cls: Any) -> tuple[tuple[str, Kind], ...]:
    """Fields of a dataclass without arrays of whole numbers, which callers may map; none of one with checks."""
    if not dataclasses.is_dataclass(cls) or hasattr(cls, "check"):
        return ()
    hints = typing.get_type_hints(cls)
    kinds = ((f.name, kind_of(hints[f.name], may_be_empty=True)) for f in dataclasses.fields(cls))
    return tuple((name, kind) for name, kind in kinds if all("float32" in a.dtypes for a in kind.arrays))


def described(value: Any) -> str:
    """Type and shape of an array, for messages.

    >>> described(np.zeros((4, 5), np.uint8))
    'uint8 of shape (4, 5)'
    """
    return f"{value.dtype} of shape {value.shape}"


def is_numeric(array: np.ndarray) -> bool:
    """Whether an array holds real numbers: no truth values, text, or objects.

    >>> is_numeric(np.ones(2)), is_numeric(np.array(["1"])), is_numeric(np.array(True))
    (True, False, False)
    """
    return jnp.issubdtype(array.dtype, np.integer) or jnp.issubdtype(array.dtype, np.floating)
