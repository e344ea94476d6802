"""Target ONNX: a graph written operation by operation from the function's trace, checked by ONNX Runtime."""

import numpy as np
from jaxtyping import Float

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph, Named
from hyjax.util.extras import optional_module

EXTRA = "export-onnx"
PACKAGES = ("onnx", "onnxruntime")


def convert(graph: Graph, triple: str | None = None) -> Artifact:
    """The function as an ONNX model."""
    runtime = optional_module("onnxruntime", EXTRA, "export")
    optional_module("onnx", EXTRA, "export")
    from hyjax.export.onnx_writer import write_onnx

    content = write_onnx(graph)
    options = runtime.SessionOptions()
    options.log_severity_level = 3
    session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])

    def run(inputs: Named) -> Float[np.ndarray, "..."]:
        return session.run([graph.output.name], inputs)[0]

    return Artifact({f"{graph.name}.onnx": content}, run)
