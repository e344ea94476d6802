"""Targets by name: a module with `convert`, `EXTRA` and `PACKAGES` each, loaded when it is asked for."""

import importlib
from types import ModuleType

TARGETS = {
    "stablehlo": "to_stablehlo",
    "iree": "to_iree",
    "onnx": "to_onnx",
    "litert": "to_litert",
    "coreml": "to_coreml",
}
"""A target is a file, a line here, and its word in `hyjax.export.settings.Target`."""


def open_target(name: str) -> ModuleType:
    """Module of a target."""
    return importlib.import_module(f"hyjax.export.{TARGETS[name]}")
