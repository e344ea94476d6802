"""Annotations checked at every call: jaxtyping's import hook with beartype, as the tests use it."""

import functools
import operator
from collections.abc import Callable
from types import UnionType
from typing import Any, Self, Union, get_args, get_origin

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype

CHECKED = ("core", "light", "metrics", "video", "pipeline")
AN_INT_IS_A_FLOAT = BeartypeConf(is_pep484_tower=True)


def with_numpy(hint: Any) -> Any:
    """An annotation that also takes NumPy's arrays, as JAX does."""
    if hint is Self:  # beartype knows it only where it decorates the whole class
        return Any
    if hint is jax.Array:
        return jax.Array | np.ndarray
    if getattr(hint, "array_type", None) is jax.Array:
        return hint.dtype[jax.Array | np.ndarray, hint.dim_str]
    origin, parts = get_origin(hint), tuple(with_numpy(part) for part in get_args(hint))
    if origin in (Union, UnionType):
        return functools.reduce(operator.or_, parts)
    return origin[parts] if origin in (tuple, list, dict) else hint


def typechecker(function: Any) -> Any:
    function.__annotations__ = {name: with_numpy(hint) for name, hint in function.__annotations__.items()}
    return beartype(function, conf=AN_INT_IS_A_FLOAT)


def checked(target: Any = None, **_: Any) -> Any:
    """In place of `jaxtyping.jaxtyped`: functions and methods are checked, dataclasses and inner functions are not.

    JAX fills dataclasses that are pytrees with anything, and those of settings are checked by `check()`. An inner
    function would be decorated again at each call of the outer one.
    """
    if target is None:
        return checked
    if target == "context":  # of the package's own checks
        return ORIGINAL(target)
    if isinstance(target, type) or "<locals>" in getattr(target, "__qualname__", ""):
        return target
    if isinstance(target, classmethod | staticmethod):
        return type(target)(checked(target.__func__))
    if isinstance(target, property):
        return target
    return refuse_or_check(target, ORIGINAL(target, typechecker=typechecker))


def refuse_or_check(plain: Callable[..., Any], strict: Callable[..., Any]) -> Callable[..., Any]:
    """`strict`; but where the function itself refuses its input, the caller sees that `InputError`."""

    @functools.wraps(plain)
    def call(*arguments: Any, **options: Any) -> Any:
        try:
            return strict(*arguments, **options)
        except jaxtyping.TypeCheckError as wrong:
            from hyjax.util.errors import InputError

            jaxtyping.config.update("jaxtyping_disable", True)
            try:
                plain(*arguments, **options)
            except InputError:
                raise
            except Exception:
                raise wrong from None
            finally:
                jaxtyping.config.update("jaxtyping_disable", False)
            raise

    return call


ORIGINAL = jaxtyping.jaxtyped


def install() -> None:
    """Before `hyjax` is imported. What tests start as a process of its own goes unchecked."""
    jaxtyping.jaxtyped = checked
    jaxtyping.install_import_hook([f"hyjax.{name}" for name in CHECKED], "beartype.beartype")
