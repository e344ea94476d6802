"""Checked arguments: one front door for public functions, by their own annotations.

A function that is decorated takes what is clear (lists for arrays, one light for several) and refuses all else with
an `InputError` that begins with the argument's name. Types, ranks and sizes are looked at where the function is
called; nothing of that is left in compiled programs.
"""

import collections.abc
import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, ParamSpec, TypeVar, Union, overload

import jax
import jax.numpy as jnp
import numpy as np

from hyjax.util.array_arguments import LARGEST, ArrayRule, Rule, Sizes
from hyjax.util.errors import InputError, did_you_mean, shown

P = ParamSpec("P")
T = TypeVar("T")
MOST: dict[Any, float] = {int: 1 << 62, float: LARGEST}
"""Largest numbers that are taken."""


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
        function: to be decorated.
        display: names of arguments that are display-encoded pictures, see `ArrayRule`.
    """
    if function is None:
        return functools.partial(checked_arguments, display=display)
    known: tuple[list[tuple[str, Rule | None]], dict[str, Rule]] | None = None

    def prepare() -> tuple[list[tuple[str, Rule | None]], dict[str, Rule]]:
        """Rules by position and by name; at the first call, when all that annotations name is there."""
        positional: list[tuple[str, Rule | None]] = []
        rules: dict[str, Rule] = {}
        plain: Any = inspect.unwrap(function)
        given = {name: hint for name, hint in plain.__annotations__.items() if name != "return"}
        hints = typing.get_type_hints(types.SimpleNamespace(__annotations__=given), plain.__globals__)
        for parameter in inspect.signature(function).parameters.values():
            rule = rule_of(hints.get(parameter.name, Any), display=parameter.name in display)
            if rule is not None:
                rules[parameter.name] = rule
            if parameter.kind is parameter.POSITIONAL_OR_KEYWORD:
                positional.append((parameter.name, rule))
        return positional, rules

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal known
        if known is None:  # several threads may come here at once: each makes whole ones
            known = prepare()
        positional, rules = known
        sizes: Sizes = {}
        given = [
            value if rule is None else rule(name, value, sizes) for (name, rule), value in zip(positional, args)
        ]
        for name in kwargs:
            if (rule := rules.get(name)) is not None:
                kwargs[name] = rule(name, kwargs[name], sizes)
        return function(*given, *args[len(given) :], **kwargs)

    return call


class PlainRule(Rule):
    """A number, a text or a truth value; bool counts as itself alone."""

    NAMES: typing.ClassVar = {int: "a whole number", float: "a number", bool: "True or False", str: "a text"}
    TYPES: typing.ClassVar[dict[type, tuple[type, ...]]] = {
        int: (int, np.integer),
        float: (int, float, np.integer, np.floating),
        bool: (bool, np.bool_),
        str: (str,),
    }

    def __init__(self, kind: Any) -> None:
        self._kind, self._types, self.wanted = kind, self.TYPES[kind], self.NAMES[kind]

    def fits(self, value: Any) -> bool:
        if self._kind is float and isinstance(value, jax.Array):
            return value.shape == () and jnp.issubdtype(value.dtype, jnp.floating)
        if isinstance(value, int | float) and MOST.get(self._kind, np.inf) < abs(value) < np.inf:
            return False
        return isinstance(value, self._types) and not (isinstance(value, bool) and self._kind is not bool)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if not self.fits(value):
            raise self.refusal(name, value)
        return self._kind(value) if self._kind in (int, bool) else value


class LiteralRule(Rule):
    """One of some words."""

    def __init__(self, words: Sequence[Any]) -> None:
        self._words, self.wanted = words, f"one of {', '.join(map(str, words))}"

    def fits(self, value: Any) -> bool:
        return isinstance(value, str)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if any(type(value) is type(word) and value == word for word in self._words):
            return value
        if isinstance(value, str):
            hint = did_you_mean(value, map(str, self._words))
            raise InputError(f"{name}: {shown(value)} is unknown{hint}; use {self.wanted}")
        raise self.refusal(name, value)


class TupleRule(Rule):
    """Some things of given types, as a tuple or a list."""

    def __init__(self, rules: Sequence[Rule | None]) -> None:
        self._rules = rules
        each = list(dict.fromkeys(rule.wanted if rule else "anything" for rule in rules))
        self.wanted = f"{len(rules)} values, each {' and '.join(each)}"

    def fits(self, value: Any) -> bool:
        return isinstance(value, tuple | list)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if not isinstance(value, tuple | list) or len(value) != len(self._rules):
            raise self.refusal(name, value)
        pairs = enumerate(zip(self._rules, value))
        return tuple([x if rule is None else rule(f"{name}[{k}]", x, sizes) for k, (rule, x) in pairs])


class SequenceRule(Rule):
    """Several things of one type; a single one stands for a sequence of one."""

    def __init__(self, rule: Rule | None) -> None:
        self._rule, self.wanted = rule, f"several, each {rule.wanted}" if rule else "several values"

    def fits(self, value: Any) -> bool:
        if isinstance(value, str | bytes | dict) or getattr(value, "ndim", 1) == 0:
            return False
        return isinstance(value, collections.abc.Iterable)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        rule = self._rule
        if isinstance(rule, ClassRule) and rule.fits(value):
            value = (value,)
        if not self.fits(value):
            raise self.refusal(name, value)
        return value if rule is None else tuple(rule(f"{name}[{k}]", x, {}) for k, x in enumerate(value))


class ClassRule(Rule):
    """An object of a class, with its `check_values` if it has one; else with checks of fields that hold floats."""

    def __init__(self, cls: Any) -> None:
        self.cls = cls
        self.wanted = f"{'an' if cls.__name__[0] in 'AEIO' else 'a'} {cls.__name__}"
        self._checks_itself = hasattr(cls, "check_values")
        self._fields: list[tuple[str, Rule]] | None = None

    def fits(self, value: Any) -> bool:
        return isinstance(value, self.cls)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if not isinstance(value, self.cls):
            raise self.refusal(name, value)
        if self._fields is None:
            self._fields = list(_array_fields(self.cls))
        if self._checks_itself:
            value.check_values(name)
            return value
        own: Sizes = {}
        for field, rule in self._fields:
            content = getattr(value, field)
            if isinstance(content, list | str):  # a field is not replaced
                raise rule.refusal(f"{name}.{field}", content)
            rule(f"{name}.{field}", content, own)
        return value


class CallableRule(Rule):
    """A function."""

    wanted = "a function"

    def fits(self, value: Any) -> bool:
        return callable(value)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if not callable(value):
            raise self.refusal(name, value)
        return value


class UnionRule(Rule):
    """Whichever of several rules takes the value."""

    def __init__(self, rules: Sequence[Rule], optional: bool) -> None:
        self.rules, self._optional = rules, optional
        self.wanted = " or ".join([*(rule.wanted for rule in rules), *(["None"] if optional else [])])

    def fits(self, value: Any) -> bool:
        return (value is None and self._optional) or any(rule.fits(value) for rule in self.rules)

    def __call__(self, name: str, value: Any, sizes: Sizes) -> Any:
        if value is None and self._optional:
            return None
        for rule in self.rules:
            if rule.fits(value):
                return rule(name, value, sizes)
        raise self.refusal(name, value)


def rule_of(hint: Any, *, display: bool = False) -> Rule | None:
    """The rule of an annotation; None for one that says nothing that can be checked.

    >>> rule_of(int | None).wanted
    'a whole number or None'
    """
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (Union, types.UnionType):
        return _union_rule(parts, display)
    if hasattr(hint, "dim_str"):
        return ArrayRule([hint], display=display)
    if origin is Literal:
        return LiteralRule(parts)
    if origin is tuple and parts and parts[-1] is not Ellipsis:
        return TupleRule([rule_of(part) for part in parts])
    if origin in (tuple, collections.abc.Sequence, collections.abc.Iterable, list):
        return SequenceRule(rule_of(parts[0]))
    if origin is collections.abc.Callable:
        return CallableRule()
    if hint in PlainRule.TYPES:
        return PlainRule(hint)
    return ClassRule(hint) if isinstance(hint, type) and hint not in (object, Any) else None


def _union_rule(parts: tuple[Any, ...], display: bool) -> Rule | None:
    optional, arrays = type(None) in parts, [part for part in parts if hasattr(part, "dim_str")]
    rules: list[Rule | None] = []
    if arrays:
        rules.append(ArrayRule(arrays, display=display))  # which takes lists and numbers as well
    taken = (float, np.number, type(None)) if arrays else (type(None),)
    for part in parts:
        listed = arrays and typing.get_origin(part) is collections.abc.Sequence
        if part not in arrays and part not in taken and not listed:
            rules.append(rule_of(part))
    if not all(rules):
        return None
    return UnionRule([rule for rule in rules if rule], optional) if len(rules) > 1 or optional else rules[0]


def _array_fields(cls: type) -> Iterator[tuple[str, Rule]]:
    """Fields of a dataclass that are arrays of floats, or objects with such fields."""
    if not dataclasses.is_dataclass(cls) or hasattr(cls, "check"):
        return
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        if (rule := rule_of(hints[field.name])) is not None and _of_floats(rule):
            yield field.name, rule


def _of_floats(rule: Rule) -> bool:
    if isinstance(rule, UnionRule):
        return all(map(_of_floats, rule.rules))
    if isinstance(rule, ArrayRule):
        rule.may_be_empty = True
        return rule.floats
    return isinstance(rule, ClassRule)
