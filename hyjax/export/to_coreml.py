"""Target Core ML: a package for Apple's devices, in single precision. It is not checked: it runs there only."""

import contextlib
import io
import logging
import platform
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph, lower_text
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

EXTRA = "export-coreml"
PACKAGES = ("stablehlo-coreml", "coremltools")


def convert(graph: Graph, triple: str | None = None) -> Artifact:
    """The function as an .mlpackage, for iOS 18 and macOS 15 or newer."""
    try:
        with _quiet():
            return _convert(graph)
    except InputError:
        raise
    except (ValueError, NotImplementedError) as error:
        reason = next(iter(str(error).splitlines()), "") or "it gives no reason"
        raise InputError(f"export: Core ML's converter cannot take {graph.name} ({reason:.200})") from None


def _convert(graph: Graph) -> Artifact:
    tools = optional_module("coremltools", EXTRA, "export")
    converter = optional_module("stablehlo_coreml", EXTRA, "export")
    from jax._src.interpreters import mlir
    from jax._src.lib.mlir import ir

    module = ir.Module.parse(lower_text(graph, graph.flat), context=mlir.make_ir_context())
    program = converter.convert(module, minimum_deployment_target=tools.target.iOS18)
    model = tools.convert(
        program,
        source="milinternal",
        minimum_deployment_target=tools.target.iOS18,
        pass_pipeline=converter.build_pass_pipeline(),
        compute_precision=tools.precision.FLOAT32,
        skip_model_load=platform.system() != "Darwin",
    )
    return Artifact(_files(_renamed(model, graph, tools), graph), None, "Core ML does not run on this system")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without coremltools' own progress, and its warnings that it is not on a Mac."""
    logger = logging.getLogger("coremltools")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _renamed(model: Any, graph: Graph, tools: Any) -> Any:
    """The model with the graph's names of inputs and output."""
    spec = model.get_spec()
    before = [feature.name for feature in (*spec.description.input, *spec.description.output)]
    for name, port in zip(before, (*graph.inputs, graph.output), strict=True):
        tools.utils.rename_feature(spec, name, port.name)
    return tools.models.MLModel(spec, weights_dir=model.weights_dir, skip_model_load=True)


def _files(model: Any, graph: Graph) -> dict[str, bytes]:
    name = f"{graph.name}.mlpackage"
    with tempfile.TemporaryDirectory() as folder:
        model.save(str(Path(folder) / name))
        paths = sorted(path for path in Path(folder).rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
