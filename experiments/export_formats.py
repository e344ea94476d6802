"""Exports for other runtimes: parity, size and time beside JAX, all in one process.

    python -m experiments.export_formats [--targets stablehlo iree onnx litert coreml] [--size 256] [--repeats 20]
        [--out results/export_formats]

Takes two minutes on two cores. Needs the packages of `pip install '.[export-onnx]'` and its like; a target whose
packages are missing, or that cannot take a function, has a row that says why. Every runtime is timed in turns with
JAX; Core ML is converted only.

Expect: runtimes of graphs compute a cascade operation by operation, and take ten to twenty times as long as JAX;
for the network they take a quarter longer. IREE takes one to three times as long as JAX.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.export.graph import Graph, build_graph, measure_parity
from hyjax.export.settings import ExportSettings
from hyjax.export.targets import open_target
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.calibration import check_repeats
from hyjax.util.clock import measure_each
from hyjax.util.errors import InputError

Runtime = Literal["stablehlo", "iree", "onnx", "litert", "coreml"]
FUNCTIONS = ("cascade, hyjax", "cascade, paper-50", "guide, small")
JAX = "jax"


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    targets: tuple[Runtime, ...] = ("stablehlo", "iree", "onnx", "litert", "coreml")
    functions: tuple[Literal["cascade, hyjax", "cascade, paper-50", "guide, small"], ...] = FUNCTIONS
    """A cascade of a preset, guided by the frame; or the network."""
    size: str = "256"
    """Side length, or width x height."""
    repeats: int = 20


@experiment("Exports for other runtimes")
def main(config: Config, start: Start) -> None:
    check_repeats(config.repeats)
    graphs = {name: graph_of(name, config.size) for name in config.functions}
    results = start()
    for name, graph in graphs.items():
        calls: dict[str, Any] = {JAX: jax_call(graph)}
        made: dict[str, dict[str, Any]] = {JAX: {}}
        for target in config.targets:
            try:
                artifact = open_target(target).convert(graph)
            except (InputError, ValueError) as error:
                made[target] = {"failed": f"{error}".splitlines()[0]}
                continue
            made[target] = {"bytes": artifact.size}
            if artifact.run is not None:
                made[target]["parity"] = measure_parity(graph, artifact.run)
                calls[target] = lambda call=artifact.run, inputs=graph.examples: call(inputs)
        times = measure_each(calls, config.repeats, settled=True)
        for target, values in made.items():
            results.add(kind="export", function=name, target=target, **values, **times.get(target, {}))


def graph_of(name: str, size: str) -> Graph:
    """One of `FUNCTIONS`."""
    what, choice = name.split(", ")
    options: dict[str, Any] = {"what": "guide", "guide": choice} if what == "guide" else {"schedule": choice}
    return build_graph(ExportSettings(to="onnx", scene=SceneSettings(size=size), **options).check())


def jax_call(graph: Graph) -> Any:
    """The function by JAX, called with the examples."""
    function = jax.jit(graph.function)
    inputs = [jnp.asarray(graph.examples[port.name]) for port in graph.inputs]
    return lambda: function(*inputs)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """A table from the rows: a runtime a line, a function three columns; and why anything is missing."""
    exports = {(row["function"], row["target"]): row for row in of_kind(rows, "export")}
    if not exports:
        return ["Nothing has been exported yet."]
    functions, targets = (list(dict.fromkeys(names)) for names in zip(*exports))
    lines = []
    for target in targets:
        cells = [exports.get((function, target), {}) for function in functions]
        lines.append([target, *(text for row in cells for text in described(row))])
    first = next(iter(exports.values()))
    caption = f"Size {first['settings']['size']}; {machine(first)}. Parity: of the value range."
    header = ["", *(text for name in functions for text in (f"{name}: parity", "kB", "ms (p95)"))]
    failed = [
        f"{function} by {target}: {row['failed']}"
        for (function, target), row in exports.items()
        if row.get("failed")
    ]
    return [Table(caption, header, lines), *failed]


def described(row: Row) -> tuple[str, str, str]:
    """Parity, size and time of an export; empty where there is none."""
    return (
        "" if row.get("parity") is None else f"{row['parity']:.0e}",
        f"{row['bytes'] / 1024:.0f}" if row.get("bytes") else "",
        f"{row['median_ms']:.1f} ({row['p95_ms']:.1f})" if row.get("median_ms") else "",
    )


if __name__ == "__main__":
    run(main)
