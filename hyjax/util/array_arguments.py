"""Arrays that callers give: turned into what an annotation wants where that is clear, refused by name where not.

An annotation is jaxtyping's, such as `Float[Array, "h w f"]`. Type, number of axes and sizes are looked at, never
the values, so that traced arrays pass as others do.
"""

import logging
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hyjax.util.errors import InputError, shown

Sizes = dict[str, tuple[int, str]]
"""Size of each named axis, and the argument that it was first seen in."""

MAY_BE_EMPTY = ("n",)
"""Named axes that may have no entries, beside those that end in `_1`: steps may be none, and edges of one row."""
LARGEST = float(np.finfo(np.float32).max)
SCALED = "%s: a picture of bytes is taken for display values of 0 to 255, and divided by 255 (told once)"
KINDS = (("float32", "float"), ("bool", "bool"), ("int32", "integer"), ("uint8", "uint8"), ("complex64", "complex"))
_log = logging.getLogger(__name__)
_told: set[str] = set()


class Rule:
    """What an argument of one type must be. Called with its name, its value and the sizes seen so far.

    Attributes:
        wanted: what would be right, for messages.
    """

    wanted: str

    def fits(self, value: Any) -> bool:
        """Whether the value is of this type at all, so that what is wrong with it is said by this rule."""
        raise NotImplementedError

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        """The value to pass on.

        Raises:
            InputError: it is of another type.
        """
        raise NotImplementedError

    def refusal(self, name: str, value: Any) -> InputError:
        """Error for a value of another type."""
        got = described(value) if hasattr(value, "dtype") and hasattr(value, "shape") else shown(value)
        return InputError(f"{name}: must be {self.wanted}, got {got}")


class ArrayRule(Rule):
    """What an array argument must be.

    Args:
        annotations: of jaxtyping, alternatives that differ in type alone.
        display: whether it is a display-encoded picture: one of bytes is divided by 255, which is logged once.
    """

    def __init__(self, annotations: Iterable[Any], *, display: bool = False) -> None:
        every = list(annotations)
        names = {name for annotation in every for name in annotation.dtypes}
        self._types = frozenset(jnp.dtype(name) for name in names if hasattr(jnp, name) or name == "bool")
        self._kind = " or ".join(said for name, said in KINDS if name in names) or "number"
        if "int32" in names and "uint8" in names:
            self._kind = self._kind.replace(" or uint8", "")
        self._display, self._on_host = display, all(each.array_type is np.ndarray for each in every)
        axes = every[0].dim_str.split()
        variadic = [k for k, axis in enumerate(axes) if axis == "..." or axis.startswith("*")]
        self._any_rank = bool(variadic)
        first = variadic[0] if variadic else len(axes)
        # Axes after a variadic one are counted from the end; a size that is fixed has no name.
        self._axes = [
            (k if k < first else k - len(axes), axis, int(axis) if axis.isdecimal() else None)
            for k, axis in enumerate(axes)
            if k not in variadic and (axis.isidentifier() or axis.isdecimal()) and axis != "_"
        ]
        self.floats, self.may_be_empty = "float32" in names, False
        self._rank = len(axes) - len(variadic)
        self._scalar = not axes
        self.wanted = self._describe(axes)

    def fits(self, value: Any) -> bool:
        return isinstance(value, jax.Array | list | tuple | int | float) or hasattr(value, "__array__")

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        """The array that the argument stands for; a single number stays one.

        Raises:
            InputError: it cannot be used.
        """
        if not isinstance(value, jax.Array):
            if self._scalar and isinstance(value, int | float | np.number) and not isinstance(value, bool):
                return self._number(name, value)
            value = self._converted(name, value)
        if value.dtype not in self._types:
            value = self._scaled(name, value)
        shape = value.shape
        if len(shape) != self._rank and not (self._any_rank and len(shape) > self._rank):
            raise self.refusal(name, value)
        for k, axis, fixed in self._axes:
            size = shape[k]
            if fixed is not None:
                if size != fixed:
                    raise self.refusal(name, value)
                continue
            known = sizes.get(axis)
            if known is None:
                sizes[axis] = size, name
                if size == 0 and not (self.may_be_empty or axis in MAY_BE_EMPTY or axis.endswith("_1")):
                    raise InputError(f"{name}: is empty; must be {self.wanted}, got {described(value)}")
            elif size != known[0]:
                raise InputError(
                    f"{name}: must be {self.wanted}, got {described(value)}; {axis} is {known[0]} by {known[1]}"
                )
        return value

    def _describe(self, axes: list[str]) -> str:
        """What would be right, for messages."""
        kind = f"{'an' if self._kind[0] in 'aeiou' else 'a'} {self._kind}"
        if self._scalar:
            return "a number" if self._kind == "float" else f"{kind} number"
        if self._any_rank and len(axes) == 1:
            return f"{kind} array"
        return f"{kind} array of shape {' x '.join('...' if axis.startswith('*') else axis for axis in axes)}"

    def _number(self, name: str, value: Any) -> Any:
        if isinstance(value, np.complexfloating):
            raise self.refusal(name, value)
        try:
            too_large = isinstance(value, int | float) and LARGEST < abs(float(value)) < np.inf
        except OverflowError:
            too_large = True
        if too_large:
            raise InputError(f"{name}: must be {self.wanted}, got {shown(value)}, which is too large")
        return value

    def _converted(self, name: str, value: Any) -> Any:
        """An array from NumPy's, nested lists, or another library's."""
        given = value
        if not isinstance(value, np.ndarray):
            if not (isinstance(value, list | tuple | np.generic) or hasattr(value, "__array__")):
                raise self.refusal(name, value)
            listed = isinstance(value, list | tuple)
            on_device = listed and any(isinstance(x, jax.Array) for x in jax.tree.leaves(value))
            try:
                value = jnp.asarray(value) if on_device else np.asarray(value)
            except (TypeError, ValueError, OverflowError, MemoryError):
                raise InputError(f"{name}: must be {self.wanted}, got {shown(given)}") from None
            if listed and value.dtype == np.int64 and np.dtype(np.int64) not in self._types:
                value = value.astype(float)  # 0 for 0.0, as people write lists
        if value.dtype == np.float64 and not self._on_host and jax.dtypes.canonicalize_dtype(float) != np.float64:
            with np.errstate(over="ignore"):
                value = value.astype(np.float32)
        return value

    def _scaled(self, name: str, value: Any) -> Any:
        """A picture of bytes in [0, 1], where one is wanted.

        Raises:
            InputError: another type, or none is wanted.
        """
        if value.dtype != np.uint8 or not self._display:
            hint = "; divide a picture of bytes by 255" if value.dtype == np.uint8 else ""
            raise InputError(f"{name}: must be {self.wanted}, got {described(value)}{hint}")
        if name not in _told:
            _told.add(name)
            _log.warning(SCALED, name)
        return jnp.asarray(value, jnp.float32) / 255.0


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
