"""What docstrings and the README show runs as shown."""

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import hyjax

ROOT = Path(__file__).parents[1]
MODULES = sorted(m.name for m in pkgutil.iter_modules(hyjax.__path__) if m.name not in ("cli", "__main__"))


@pytest.mark.parametrize("name", MODULES)
def test_docstrings(name: str) -> None:
    failed, _ = doctest.testmod(importlib.import_module(f"hyjax.{name}"))
    assert failed == 0


def test_some_docstring_has_an_example() -> None:
    """Else the test above could not fail."""
    assert doctest.testmod(importlib.import_module("hyjax.schedule")).attempted > 0


def test_the_snippet_of_the_readme() -> None:
    snippets = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(snippet, {})
