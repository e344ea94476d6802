"""Checked arguments: one front door for public functions, by their own annotations.

A function that is decorated takes what is clear (lists for arrays, one light for several) and refuses all else with
an `InputError` that begins with the argument's name. Types, ranks and sizes are looked at where the function is
called, the values of arrays never: traced arrays pass as others do, and nothing of it is left in compiled programs.
Arrays are compared with their annotations by jaxtyping.
"""

import functools
import inspect
import types
import typing
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar, overload

from jaxtyping import jaxtyped

from hyjax.util.argument_kinds import Kind, Seen, kind_of

P = ParamSpec("P")
T = TypeVar("T")


@overload
def checked_arguments(function: Callable[P, T]) -> Callable[P, T]: ...
@overload
def checked_arguments(*, display: Sequence[str]) -> Callable[[Callable[P, T]], Callable[P, T]]: ...
def checked_arguments(function: Any = None, *, display: Sequence[str] = ()) -> Any:
    """A function whose arguments are checked by its annotations before it is called.

    >>> @checked_arguments
    ... def half(count: int) -> float:
    ...     return count / 2
    >>> half(1.5)
    Traceback (most recent call last):
    hyjax.util.errors.InputError: count: must be a whole number, got 1.5

    Args:
        function: to be decorated; of a class what makes its objects.
        display: names of arguments that are display-encoded pictures: one of bytes is divided by 255, which is
            logged once.
    """
    if function is None:
        return functools.partial(checked_arguments, display=display)
    if isinstance(function, type):
        function.__init__ = checked_arguments(display=display)(function.__init__)  # type: ignore[misc]
        return function

    @functools.cache  # at the first call, when all that annotations name is there
    def prepare() -> tuple[list[str], dict[str, Kind]]:
        plain: Any = inspect.unwrap(function)
        given = plain.__annotations__.items()
        hints = {name: _resolved(hint, plain.__globals__) for name, hint in given if name != "return"}
        parameters = inspect.signature(function).parameters.values()
        by_place = [parameter.name for parameter in parameters if parameter.kind is parameter.POSITIONAL_OR_KEYWORD]
        return by_place, {name: kind_of(hint, display=name in display) for name, hint in hints.items()}

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        names, kinds = prepare()
        seen: Seen = {}
        with jaxtyped("context"):
            given = [kinds[name](name, value, seen) if name in kinds else value for name, value in zip(names, args)]
            for name in kwargs:
                if name in kinds:
                    kwargs[name] = kinds[name](name, kwargs[name], seen)
        return function(*given, *args[len(given) :], **kwargs)

    return call


def _resolved(hint: Any, names: dict[str, Any]) -> Any:
    """An annotation; `Any` where it names a module that type checkers alone load."""
    try:
        return typing.get_type_hints(types.SimpleNamespace(__annotations__={"it": hint}), names)["it"]
    except NameError:
        return Any
