"""A function without loops, branches and inner calls: the form that runtimes of graphs can take.

Traces a function, and evaluates its trace operation by operation: calls are opened, `scan` is written out step by
step, of functions with one backend for each platform the plain one is taken, and what depends on no input is
computed here, once. What remains is a list of operations on arrays, none of which is empty.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from hyjax.util.errors import InputError

LARGEST_FLOAT = float(np.finfo(np.float32).max)
INNER_NAMES = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Names under which operations hold a function that they call."""
MOST_REPEATED_VALUES = 4096
"""Values of a constant that is a smaller one repeated; larger ones are left to the runtime."""
MOST_STEPS = 2000
"""Steps in all that are written out: each is some fifteen operations."""


def unrolled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of arrays, without loops, branches and calls once it is traced.

    >>> def double(x):
    ...     return jax.lax.fori_loop(0, 3, lambda _, y: 2 * y, x)
    >>> flat = jax.make_jaxpr(unrolled(double))(1.0)
    >>> [equation.primitive.name for equation in flat.eqns], float(unrolled(double)(1.0))
    (['mul', 'mul', 'mul'], 8.0)
    """

    def flat(*inputs: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*inputs)
        outputs = _evaluate(closed.jaxpr, closed.consts, jax.tree.leaves(inputs))
        return jax.tree.unflatten(jax.tree.structure(shape), outputs)

    return flat


def fenced(function: Callable[..., Any], *, primitive: str) -> Callable[..., Any]:
    """A flat function that compilers cannot move operations of one kind in: a barrier follows each.

    >>> flat = jax.make_jaxpr(fenced(lambda x: x.T + 1, primitive="transpose"))(jnp.ones((2, 3)))
    >>> [equation.primitive.name for equation in flat.eqns]
    ['transpose', 'optimization_barrier', 'add']
    """

    def with_barriers(*inputs: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*inputs)
        values = dict(zip(closed.jaxpr.invars, jax.tree.leaves(inputs), strict=True))
        values |= dict(zip(closed.jaxpr.constvars, closed.consts, strict=True))

        def read(variable: Any) -> Any:
            return variable.val if isinstance(variable, Literal) else values[variable]

        for equation in closed.jaxpr.eqns:
            results = equation.primitive.bind(*map(read, equation.invars), **equation.params)
            if not equation.primitive.multiple_results:
                results = [results]
            if equation.primitive.name == primitive:
                results = [jax.lax.optimization_barrier(result) for result in results]
            values |= dict(zip(equation.outvars, results, strict=True))
        return jax.tree.unflatten(jax.tree.structure(shape), [read(v) for v in closed.jaxpr.outvars])

    return with_barriers


def _evaluate(jaxpr: Jaxpr, consts: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
    values: dict[Any, Any] = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *inputs], strict=True))

    def read(variable: Any) -> Any:
        return variable.val if isinstance(variable, Literal) else values[variable]

    for equation in jaxpr.eqns:
        results = _apply(equation, [read(variable) for variable in equation.invars])
        values |= dict(zip(equation.outvars, results, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(equation: JaxprEqn, values: list[Any]) -> list[Any]:
    """Results of one operation."""
    name, params = equation.primitive.name, equation.params
    if name == "platform_index":
        return [next(k for k, names in enumerate(params["platforms"]) if names is None)]
    if name == "cond":
        index, *values = values
        return _call(params["branches"][_constant(index, name)], values)
    if name == "scan":
        return _scan(params, values)
    shapes: list[Any] = [variable.aval for variable in equation.outvars]
    if all(0 in out.shape for out in shapes):  # runtimes stumble over arrays without values
        return [np.zeros(out.shape, out.dtype) for out in shapes]
    if name == "concatenate":
        values = [value for value in values if 0 not in np.shape(value)]
        if len(values) == 1:
            return values
    if name == "pad" and _is_constant(values[1]):
        # Infinities are miscompiled by some; this is as far from every value.
        values = [values[0], np.clip(np.asarray(values[1]), -LARGEST_FLOAT, LARGEST_FLOAT)]
    if name == "is_finite":
        return [jnp.abs(values[0]) <= LARGEST_FLOAT]
    if inner := next((params[key] for key in INNER_NAMES if key in params), None):
        return _call(inner, values)
    grows = (
        name == "broadcast_in_dim" and shapes[0].size > MOST_REPEATED_VALUES
    )  # a number as a picture fills files
    if all(_is_constant(value) for value in values) and not grows:
        with jax.ensure_compile_time_eval():
            results = equation.primitive.bind(*values, **params)
    else:
        results = equation.primitive.bind(*values, **params)
    return list(results) if equation.primitive.multiple_results else [results]


def _scan(params: dict[str, Any], values: list[Any]) -> list[Any]:
    """Results of a `scan`, step by step."""
    if "ft_in" in params:  # since JAX 0.11
        fixed, carried = (len(values) for values in params["ft_in"].unpack()[:2])
    else:
        fixed, carried = params["num_consts"], params["num_carry"]
    length = params["length"]
    if length > MOST_STEPS:
        raise InputError(f"export: {length} steps in a row are too many to write out; at most {MOST_STEPS}")
    constant, state, rows = values[:fixed], values[fixed : fixed + carried], values[fixed + carried :]
    collected: list[list[Any]] = []
    for step in reversed(range(length)) if params["reverse"] else range(length):
        with jax.ensure_compile_time_eval():
            here = [row[step] if _is_constant(row) else None for row in rows]
        here = [row[step] if value is None else value for row, value in zip(rows, here)]
        results = _call(params["jaxpr"], [*constant, *state, *here])
        state = results[:carried]
        collected.append(results[carried:])
    ordered = collected[::-1] if params["reverse"] else collected
    stacked = [jnp.stack(column) for column in zip(*ordered)] if ordered else []
    if not ordered:
        shapes = params["jaxpr"].out_avals[carried:]
        stacked = [jnp.zeros((0, *shape.shape), shape.dtype) for shape in shapes]
    return [*state, *stacked]


def _call(function: Any, values: Sequence[Any]) -> list[Any]:
    if isinstance(function, ClosedJaxpr):
        return _evaluate(function.jaxpr, function.consts, values)
    return _evaluate(function, [], values)


def _is_constant(value: Any) -> bool:
    return not isinstance(value, jax.core.Tracer)


def _constant(value: Any, what: str) -> int:
    if not _is_constant(value):
        raise InputError(f"export: a {what} that depends on the inputs cannot be written out")
    return int(value)
