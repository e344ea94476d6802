"""Griffe extension: docstrings as mkdocstrings reads them.

Examples become code blocks, since Markdown would take them for quotations; parameters that are described together
(`width, height: in pixels`) get an entry each."""

import re
from typing import Any

import griffe

DOCTEST = re.compile(r"^(?P<indent> *)>>> .*(?:\n(?! *\n) *\S.*)*", re.MULTILINE)
EXAMPLE = re.compile(r"^Example:\n(?P<body>(?:    (?!>>> ).*\n?|\n)+)", re.MULTILINE)


TOGETHER = re.compile(
    r"^(?P<indent> +)(?P<names>\w+(?:, \w+)+): (?P<text>.*(?:\n(?P=indent) +\S.*)*)", re.MULTILINE
)


class DoctestBlocks(griffe.Extension):
    """Fences around doctests and the code under `Example:`; an entry for each parameter."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object."""
        if obj.docstring:
            text = EXAMPLE.sub(_fenced_example, obj.docstring.value)
            obj.docstring.value = TOGETHER.sub(_apart, DOCTEST.sub(_fenced, text))


def _fenced(found: re.Match[str]) -> str:
    indent = found["indent"]
    return f"{indent}```pycon\n{found[0]}\n{indent}```"


def _fenced_example(found: re.Match[str]) -> str:
    return f"Example:\n    ```python\n{found['body'].rstrip()}\n    ```\n\n"


def _apart(found: re.Match[str]) -> str:
    return "\n".join(f"{found['indent']}{name}: {found['text']}" for name in found["names"].split(", "))
