"""Target IREE: a module for CPUs, called from C; checked by IREE's runtime on the machine that it is made on."""

import numpy as np
from jaxtyping import Float

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph, Named, lower_text
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

EXTRA = "export-iree"
PACKAGES = ("iree-base-compiler", "iree-base-runtime")
FLAGS = ("--iree-opt-level=O3",)


def convert(graph: Graph, triple: str | None = None) -> Artifact:
    """The function as a module of IREE's virtual machine.

    Args:
        graph: what to convert.
        triple: LLVM's name of another machine; the module then cannot be checked here.
    """
    compiler = optional_module("iree.compiler", EXTRA, "export")
    runtime = optional_module("iree.runtime", EXTRA, "export")
    machine = "--iree-llvmcpu-target-cpu=host" if triple is None else f"--iree-llvmcpu-target-triple={triple}"
    try:
        content = compiler.compile_str(
            lower_text(graph, graph.compact),
            input_type="stablehlo",
            target_backends=["llvm-cpu"],
            extra_args=[machine, *FLAGS],
        )
    except compiler.CompilerToolError as error:
        lines = [line.strip() for line in str(error).splitlines()]
        reason = next((line for line in lines if "error:" in line or "failed" in line), lines[0])
        raise InputError(f"export: IREE cannot compile {graph.name} ({reason:.200})") from None
    files = {f"{graph.name}.vmfb": content}
    if triple is not None:
        return Artifact(files, None, f"compiled for {triple}, which does not run here")
    config = runtime.Config("local-task")
    module = runtime.load_vm_module(runtime.VmModule.copy_buffer(config.vm_instance, content), config)

    def run(inputs: Named) -> Float[np.ndarray, "..."]:
        return np.asarray(module.main(*(inputs[port.name] for port in graph.inputs)).to_host())

    return Artifact(files, run)
