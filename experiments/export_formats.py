"""Exports for other runtimes: parity, size and time beside JAX, all in one process.

    python -m experiments.export_formats [--targets stablehlo iree onnx litert coreml] [--size 256] [--repeats 20]
        [--out results/export_formats]

Takes two minutes on two cores. Needs the packages of `pip install '.[export-onnx]'` and its like; a target whose
packages are missing, or that cannot take a function, has a row that says why. Every runtime is timed in turns with
JAX; Core ML is converted only.

Expect: runtimes of graphs compute a cascade operation by operation, and take some ten times as long as JAX; for the
network they take twice as long. IREE takes one to three times as long as JAX.
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
    """A table from the rows."""
    exports = of_kind(rows, "export")
    if not exports:
        return ["Nothing has been exported yet."]
    lines = [
        [
            row["function"],
            row["target"],
            "" if row.get("parity") is None else f"{row['parity']:.1e}",
            f"{row['bytes'] / 1024:.0f}" if row.get("bytes") else "",
            f"{row['median_ms']:.1f}" if "median_ms" in row else "",
            f"{row['p95_ms']:.1f}" if "p95_ms" in row else "",
            row.get("failed", ""),
        ]
        for row in exports
    ]
    caption = f"Size {exports[0]['settings']['size']}; {machine(exports[0])}. Parity: of the value range."
    header = ["function", "runtime", "parity", "kB", "median ms", "p95 ms", "not exported"]
    return [Table(caption, header, lines, names=2)]


if __name__ == "__main__":
    run(main)
