"""ONNX model of a flat trace: one or a few nodes for each of JAX's operations on arrays.

What is broadcast stays small where the operation that uses it broadcasts by itself, as ONNX's elementwise ones do.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import onnx
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal
from onnx import TensorProto, helper, numpy_helper

from hyjax.export.graph import Graph
from hyjax.util.errors import InputError

OPSET = 18
IR_VERSION = 9
TYPES = {"float32": TensorProto.FLOAT, "bool": TensorProto.BOOL, "int32": TensorProto.INT32}

ELEMENTWISE = {
    "abs": "Abs",
    "add": "Add",
    "and": "And",
    "div": "Div",
    "eq": "Equal",
    "exp": "Exp",
    "floor": "Floor",
    "ge": "GreaterOrEqual",
    "gt": "Greater",
    "le": "LessOrEqual",
    "log": "Log",
    "lt": "Less",
    "max": "Max",
    "min": "Min",
    "mul": "Mul",
    "neg": "Neg",
    "not": "Not",
    "or": "Or",
    "pow": "Pow",
    "sqrt": "Sqrt",
    "sub": "Sub",
}
REDUCTIONS = {"reduce_sum": "ReduceSum", "reduce_max": "ReduceMax", "reduce_min": "ReduceMin"}


def write_onnx(graph: Graph) -> bytes:
    """The graph as a serialised ONNX model."""
    closed = jax.make_jaxpr(graph.flat)(*graph.specs)
    writer = Writer()
    inner = writer.function(closed, [port.name for port in graph.inputs])
    writer.node("Identity", inner, name=graph.output.name)

    def described(port: Any) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(port.name, TensorProto.FLOAT, port.shape)

    content = helper.make_graph(
        writer.used_nodes(graph.output.name),
        graph.name,
        [described(port) for port in graph.inputs],
        [described(graph.output)],
        writer.used_constants(),
    )
    model = helper.make_model(
        content, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="hyjax"
    )
    onnx.checker.check_model(model)
    return model.SerializeToString()


class Writer:
    """Nodes and constants of a model while it is written."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[tuple[str, tuple[int, ...], bytes], onnx.TensorProto] = {}
        self._names: dict[Any, str] = {}
        self._narrow: dict[str, str] = {}  # of what is broadcast: its full name → that of the small array

    def function(self, closed: ClosedJaxpr, inputs: Sequence[str]) -> list[str]:
        """Write a flat trace; the names of its outputs."""
        jaxpr = closed.jaxpr
        self._names |= dict(zip(jaxpr.invars, inputs, strict=True))
        constants = {v: self.constant(np.asarray(c)) for v, c in zip(jaxpr.constvars, closed.consts)}
        self._names |= constants
        for equation in jaxpr.eqns:
            self._write(equation)
        return [self._read(variable) for variable in jaxpr.outvars]

    def node(self, kind: str, inputs: Sequence[str], *, name: str = "", **attributes: Any) -> str:
        """Write a node of one output; its name."""
        name = name or f"t{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def constant(self, value: np.ndarray) -> str:
        """Name of a constant; equal ones are kept once."""
        key = str(value.dtype), value.shape, value.tobytes()
        if key not in self.constants:
            self.constants[key] = numpy_helper.from_array(np.ascontiguousarray(value), f"c{len(self.constants)}")
            if value.ndim == 0:  # `ascontiguousarray` makes a list of a number
                self.constants[key] = numpy_helper.from_array(value, f"c{len(self.constants) - 1}")
        return self.constants[key].name

    def integers(self, values: Sequence[int]) -> str:
        """Name of a constant list of whole numbers, such as a shape."""
        return self.constant(np.asarray(values, np.int64))

    def used_nodes(self, output: str) -> list[onnx.NodeProto]:
        """Nodes that the output depends on."""
        needed, kept = {output}, []
        for node in reversed(self.nodes):
            if node.output[0] in needed:
                kept.append(node)
                needed |= set(node.input)
        self.nodes = kept[::-1]
        return self.nodes

    def used_constants(self) -> list[onnx.TensorProto]:
        """Constants that the nodes read."""
        needed = {name for node in self.nodes for name in node.input}
        return [tensor for tensor in self.constants.values() if tensor.name in needed]

    def _read(self, variable: Any) -> str:
        if isinstance(variable, Literal):
            return self.constant(np.asarray(variable.val, _aval(variable).dtype))
        return self._names[variable]

    def _write(self, equation: JaxprEqn) -> None:
        kind, out = equation.primitive.name, equation.outvars[0]
        inputs = [self._read(variable) for variable in equation.invars]
        if kind in ELEMENTWISE:
            self._names[out] = self.node(ELEMENTWISE[kind], self._small(equation, inputs))
        elif kind in REDUCTIONS:
            axes = self.integers(equation.params["axes"])
            self._names[out] = self.node(REDUCTIONS[kind], [*inputs, axes], keepdims=0)
        elif kind in TRANSLATIONS:
            self._names[out] = TRANSLATIONS[kind](self, equation, inputs)
        else:
            raise InputError(f"export: ONNX: no translation of JAX's operation {kind!r}")

    def _small(self, equation: JaxprEqn, inputs: list[str]) -> list[str]:
        """Inputs of an elementwise operation, small ones where another has the full shape."""
        full = [name not in self._narrow and _aval(v).ndim > 0 for name, v in zip(inputs, equation.invars)]
        if not any(full):
            return inputs
        return [self._narrow.get(name, name) for name in inputs]

    def broadcast(self, equation: JaxprEqn, inputs: list[str]) -> str:
        """Reshape and, where an operation does not broadcast by itself, expand."""
        shape, places = equation.params["shape"], equation.params["broadcast_dimensions"]
        sizes = dict(zip(places, _aval(equation.invars[0]).shape))
        narrow = self.node(
            "Reshape", [inputs[0], self.integers([sizes.get(axis, 1) for axis in range(len(shape))])]
        )
        if all(sizes.get(axis, 1) == length for axis, length in enumerate(shape)):
            return narrow
        wide = self.node("Expand", [narrow, self.integers(shape)])
        self._narrow[wide] = narrow
        return wide


def _aval(variable: Any) -> Any:
    """Shape and type of a variable of a trace."""
    return variable.aval


def _slice(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    params, shape = equation.params, _aval(equation.invars[0]).shape
    strides = params["strides"] or (1,) * len(shape)
    wanted = list(zip(range(len(shape)), params["start_indices"], params["limit_indices"], strides))
    cut = [part for part in wanted if part[1:] != (0, shape[part[0]], 1)]
    if not cut:
        return inputs[0]
    axes, starts, ends, steps = zip(*cut)
    return writer.node("Slice", [*inputs, *map(writer.integers, (starts, ends, axes, steps))])


def _pad(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    low, high, between = zip(*equation.params["padding_config"])
    if any(between) or min(*low, *high) < 0:
        raise InputError("export: ONNX: no translation of padding that cuts, or between values")
    return writer.node("Pad", [inputs[0], writer.integers([*low, *high]), inputs[1]])


def _reshape(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    return writer.node("Reshape", [inputs[0], writer.integers(_aval(equation.outvars[0]).shape)])


def _stack(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    axis = equation.params["axis"]
    parts = [writer.node("Unsqueeze", [name, writer.integers([axis])]) for name in inputs]
    return writer.node("Concat", parts, axis=axis)


def _power(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    exponent = equation.params["y"]
    if exponent == 2:
        return writer.node("Mul", [inputs[0], inputs[0]])
    return writer.node("Pow", [inputs[0], writer.constant(np.asarray(exponent, np.float32))])


def _convert(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    return writer.node("Cast", inputs, to=TYPES[str(np.dtype(equation.params["new_dtype"]))])


def _product(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    (left, right), batch = equation.params["dimension_numbers"]
    shapes = [_aval(variable).shape for variable in equation.invars]
    if batch != ((), ()) or tuple(left) != (len(shapes[0]) - 1,) or (tuple(right), len(shapes[1])) != ((0,), 2):
        raise InputError("export: ONNX: no translation of this product of arrays")
    return writer.node("MatMul", inputs)


def _convolution(writer: Writer, equation: JaxprEqn, inputs: list[str]) -> str:
    params = equation.params
    left, right, out = params["dimension_numbers"]
    if params["lhs_dilation"] != (1, 1) or params["batch_group_count"] != 1:
        raise InputError("export: ONNX: no translation of a transposed convolution")
    picture = writer.node("Transpose", [inputs[0]], perm=left)
    kernel = writer.node("Transpose", [inputs[1]], perm=right)
    low, high = zip(*params["padding"])
    result = writer.node(
        "Conv",
        [picture, kernel],
        strides=params["window_strides"],
        dilations=params["rhs_dilation"],
        pads=[*low, *high],
        group=params["feature_group_count"],
    )
    return writer.node("Transpose", [result], perm=np.argsort(out).tolist())


TRANSLATIONS: dict[str, Callable[[Writer, JaxprEqn, list[str]], str]] = {
    "broadcast_in_dim": Writer.broadcast,
    "concatenate": lambda w, e, names: w.node("Concat", names, axis=e.params["dimension"]),
    "conv_general_dilated": _convolution,
    "convert_element_type": _convert,
    "copy": lambda w, e, names: names[0],
    "dot_general": _product,
    "integer_pow": _power,
    "pad": _pad,
    "reshape": _reshape,
    "select_n": lambda w, e, names: w.node("Where", [names[0], names[2], names[1]]),
    "slice": _slice,
    "squeeze": _reshape,
    "expand_dims": _reshape,
    "stack": _stack,
    "stop_gradient": lambda w, e, names: names[0],
    "transpose": lambda w, e, names: w.node("Transpose", names, perm=list(e.params["permutation"])),
}
