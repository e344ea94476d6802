"""Target StableHLO, serialised by `jax.export`, for CPUs, GPUs and TPUs; checked by calling it again."""

import jax
import numpy as np
from jax import export
from jaxtyping import Float

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph, Named, lower

EXTRA = ""
PACKAGES = ("jax", "jaxlib")
PLATFORMS = ("cpu", "cuda", "rocm", "tpu")


def convert(graph: Graph, triple: str | None = None) -> Artifact:
    """The function as `jax.export` serialises it, and as portable StableHLO of a CPU for other compilers."""
    content = bytes(lower(graph, graph.compact, *PLATFORMS).serialize())
    portable = lower(graph, graph.compact, "cpu").mlir_module_serialized
    call = jax.jit(export.deserialize(bytearray(content)).call)

    def run(inputs: Named) -> Float[np.ndarray, "..."]:
        return np.asarray(call(*(inputs[port.name] for port in graph.inputs)))

    return Artifact({f"{graph.name}.jaxexport": content, f"{graph.name}.mlirbc": bytes(portable)}, run)
