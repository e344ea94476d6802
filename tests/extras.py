"""Packages that tests need beyond README's command: extras of hyjax, and what it is compared with."""

import os
import re
import tomllib
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import pytest

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MODULE_NAMES = {"opencv-contrib-python-headless": "cv2", "mkdocs-material": "material"} | dict.fromkeys(
    ("iree-base-compiler", "iree-base-runtime"), "iree"
)
"""Modules that are not called like their distribution."""
MARK = "needs the extra "
"""How the reason of a skipped test begins."""
TOLERATED = 0.03
"""Share of skipped tests that needs no advice."""
PEERS = "torch", "torchvision", "timm", "segmentation_models_pytorch", "lpips", "playwright"
"""Packages to compare with or to test in: no extra brings them, `.ci/run` installs them."""
PLAIN = "test", "train"
"""Extras that README's command brings."""

needs_blender = pytest.mark.skipif(
    find_spec("bpy") is None and not os.environ.get("HYJAX_BLENDER"),
    reason="no Blender: bpy is not installed here and HYJAX_BLENDER names no python that has it",
)


def modules_of(requirements: list[str]) -> set[str]:
    """Modules that requirements bring."""
    names = [re.split(r"[\[<>=!;~ ]", requirement)[0] for requirement in requirements]
    return {MODULE_NAMES.get(name, name.replace("-", "_")) for name in names}


EXTRAS = {name: modules_of(wanted) for name, wanted in PROJECT["optional-dependencies"].items()}
"""Modules by the extra that brings them."""
EXTRAS["export-litert"] |= {"litert_converter"}  # by a command of its own


def missing(extra: str) -> list[str]:
    """Modules of an extra, or a peer, that are not installed."""
    return [module for module in sorted({extra} if extra in PEERS else EXTRAS[extra]) if not find_spec(module)]


def bringing(module: str) -> set[str]:
    """Extras or peers that bring a module or its package; empty for what README's command installs."""
    package = module.partition(".")[0]
    names = {name for name, modules in EXTRAS.items() if package in modules} | ({package} & set(PEERS))
    return names if names.isdisjoint(PLAIN) else set()


def need(*names: str) -> None:
    """Skip the test, or the whole module at whose top this stands, where an extra or a peer is not installed.

    With `HYJAX_EXTRAS=required` it fails instead, as where all have been installed.
    """
    for name in filter(missing, names):
        reason = f"needs {name}: pip install {name}" if name in PEERS else f"{MARK}{name}: pip install '.[{name}]'"
        if os.environ.get("HYJAX_EXTRAS") == "required":
            pytest.fail(reason)
        pytest.skip(reason, allow_module_level=True)


def advice(reasons: Iterable[str], count: int) -> str:
    """A line on what to install, where more than `TOLERATED` of the tests were skipped; else nothing.

    Args:
        reasons: of the skipped tests, one each.
        count: of all tests.
    """
    reasons = list(reasons)
    if len(reasons) <= TOLERATED * count:
        return ""
    extras = sorted({extra for reason in reasons for extra in re.findall(rf"{MARK}([\w-]+):", reason)})
    install = f"; for more of them: pip install '.[{','.join(extras)}]' -c constraints.txt" if extras else ""
    return f"{len(reasons)} of {count} tests were skipped{install}"
