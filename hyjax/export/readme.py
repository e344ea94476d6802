"""README of an exported file: inputs, parity, versions, and an example of a call."""

import platform
from pathlib import Path

import jinja2

from hyjax.export.artifact import Artifact
from hyjax.export.graph import Graph
from hyjax.util.environment import package_version

TEMPLATES = Path(__file__).with_name("templates")
EXAMPLES = {
    "stablehlo": (("Python", "python", "stablehlo.py.jinja"),),
    "iree": (("C", "c", "iree.c.jinja"),),
    "onnx": (
        ("Python", "python", "onnx.py.jinja"),
        ("JavaScript, with onnxruntime-web", "javascript", "onnx.js.jinja"),
    ),
    "litert": (("Python", "python", "litert.py.jinja"),),
    "coreml": (("Swift", "swift", "coreml.swift.jinja"),),
}
"""Examples of each target: heading, language and template of its examples."""


def write_readme(
    graph: Graph, artifact: Artifact, *, target: str, packages: tuple[str, ...], parity: float | None
) -> str:
    """The README's text.

    Args:
        parity: as measured; None where it could not be.
    """
    names = dict.fromkeys(("hyjax", "jax", *packages))
    values = {
        "graph": graph,
        "file": next(iter(artifact.files)).partition("/")[0],
        "files": dict.fromkeys(name.partition("/")[0] for name in artifact.files),
        "target": target,
        "size": artifact.size,
        "parity": parity,
        "unchecked": artifact.unchecked,
        "versions": {name: package_version(name) for name in names} | {"Python": platform.python_version()},
    }
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
        undefined=jinja2.StrictUndefined,
    )
    examples = [
        (heading, language, environment.get_template(name).render(values).strip())
        for heading, language, name in EXAMPLES[target]
    ]
    return environment.get_template("readme.md.jinja").render(values, examples=examples).rstrip() + "\n"
