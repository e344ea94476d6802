"""Gallery page of the documentation, from the examples' docstrings."""

import re
from pathlib import Path

HEAD = """# Gallery

![real captures, and the same frames relit](../experiments/figures/real_captures.jpg)

*Real captures, and the same frames by the evening lamps and by a low sun, as they come (`python -m
experiments.gallery real_captures`): a chair and an office corridor by a phone (laan labs, MIT), a printed board
likewise (PSegs, Apache-2.0), a piano and a drum (Middlebury's stereo pictures; Scharstein et al., GCPR 2014).*

Each example is a program of 30 to 80 lines on the built-in room:

    python examples/01_first_relight.py

leaves its picture in `out/examples/`. A size may follow, such as `160x120`. `python -m examples` runs them all, in
some minutes: most of that is compiling. `python -m examples --keep` writes this page and its pictures.
"""
ENTRY = """
## {title} {{ #{stem} }}

{about}

![{title}](examples/{stem}.jpg)

*{picture}*

??? example "examples/{stem}.py"
    ```python
    --8<-- "examples/{stem}.py"
    ```
"""
DOCSTRING = re.compile(r'"""(?P<title>[^:]+): (?P<about>.+?\.)\n.*?Picture: (?P<picture>.+?)\n"""', re.DOTALL)


def gallery_page(examples: list[Path]) -> str:
    """Text of the page."""
    return HEAD + "".join(_entry(path) for path in examples)


def _entry(path: Path) -> str:
    parts = DOCSTRING.match(path.read_text(encoding="utf-8"))
    assert parts, f"{path}: its docstring needs a title, a colon, a sentence and 'Picture: ...'"
    about, picture = (" ".join(parts[name].split()) for name in ("about", "picture"))
    sentences = (text[0].upper() + text[1:] for text in (about, picture))
    return ENTRY.format(title=parts["title"], stem=path.stem, about=next(sentences), picture=next(sentences))
