"""Target ONNX: a graph written operation by operation from the function's trace, checked by ONNX Runtime."""

from hyjax.export.artifact import Artifact, load, run_by_position
from hyjax.export.graph import Graph, Named
from hyjax.export.onnx_writer import write_onnx

EXTRA = "export-onnx"
PACKAGES = ("onnx", "onnxruntime")


def convert(graph: Graph, triple: str | None) -> Artifact:
    """The function as an ONNX model."""
    runtime = load("onnxruntime", EXTRA)
    load("onnx", EXTRA)
    content = write_onnx(graph)
    session = runtime.InferenceSession(content, providers=["CPUExecutionProvider"])

    def run(inputs: Named) -> object:
        return session.run([graph.output.name], inputs)[0]

    return Artifact({f"{graph.name}.onnx": content}, run)
