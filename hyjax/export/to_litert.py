"""Target LiteRT (TensorFlow Lite's successor): converted without TensorFlow, checked by LiteRT's interpreter.

The converter, litert-converter 0.5.0, names a version of typing_extensions that hyjax's other packages cannot use,
and does well without: it is installed without its dependencies.
"""

import numpy as np
from jaxtyping import Float

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph, Named, lower_text
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

EXTRA = "export-litert"
EXTRA_COMMAND = "pip install --no-deps litert-converter==0.5.0"
PACKAGES = ("litert-converter", "ai-edge-litert")


def convert(graph: Graph, triple: str | None = None) -> Artifact:
    """The function as a flatbuffer."""
    interpreter = optional_module("ai_edge_litert.interpreter", EXTRA, "export", besides=EXTRA_COMMAND)
    content = flatbuffer(graph)
    runner = interpreter.Interpreter(model_content=content).get_signature_runner(graph.name)

    def run(inputs: Named) -> Float[np.ndarray, "..."]:
        return np.asarray(runner(**inputs)[graph.output.name])

    return Artifact({f"{graph.name}.tflite": content}, run)


def flatbuffer(graph: Graph) -> bytes:
    """The function as the bytes of a .tflite file, with a signature of the graph's names."""
    ir, passes, api = (
        optional_module(f"litert_converter.{name}", EXTRA, "export", besides=EXTRA_COMMAND)
        for name in ("mlir.ir", "mlir.passmanager", "converter_api_ext")
    )
    context = ir.Context()
    api.prepare_mlir_context(context)
    try:
        with context:
            module = ir.Module.parse(lower_text(graph, graph.flat_with_barriers))
            api.set_signature(
                module.operation,
                signature_name=graph.name,
                input_names=[port.name for port in graph.inputs],
                output_names=[graph.output.name],
            )
            api.run_convert_to_tfl_passes(module, passes.PassManager(), api.ConvertToTFLConfig())
            return bytes(api.export_flatbuffer_to_bytes(module.operation))
    except RuntimeError as error:
        reason = next(iter(str(error).splitlines()), "") or "it gives no reason"
        raise InputError(f"export: LiteRT's converter cannot take {graph.name} ({reason:.200})") from None
