"""Run all examples, and keep their pictures for the gallery of the documentation.

    python -m examples [SIZE] [--keep]

`--keep` writes the gallery's page, and the pictures as small JPEGs into docs/examples.
"""

import runpy
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from examples.gallery import gallery_page

FOLDER = Path(__file__).parent
DOCS = FOLDER.parent / "docs"
GALLERY = DOCS / "examples"
MOST_BYTES = 60_000
WIDEST = 1280
QUALITIES = (88, 80, 70, 60, 45)


def examples() -> list[Path]:
    """The examples, in order."""
    return sorted(FOLDER.glob("[0-9]*.py"))


def run_example(path: Path, options: Sequence[str] = ()) -> Path:
    """Run an example as a program; its picture."""
    arguments, sys.argv = sys.argv, [str(path), *options]
    try:
        runpy.run_path(str(path), run_name="__main__")
    finally:
        sys.argv = arguments
    return Path("out/examples") / f"{path.stem}.png"


def keep(picture: Path) -> None:
    """Write a picture into the gallery, as a JPEG of at most 60 kB."""
    image = Image.open(picture).convert("RGB")
    image.thumbnail((WIDEST, WIDEST))
    out = GALLERY / f"{picture.stem}.jpg"
    for quality in QUALITIES:
        image.save(out, quality=quality, optimize=True)
        if out.stat().st_size <= MOST_BYTES:
            return


def main(arguments: Sequence[str]) -> None:
    """Run them one after the other in this process, which compiles what they share once."""
    options = [text for text in arguments if not text.startswith("--")]
    for path in examples():
        start = time.perf_counter()
        picture = run_example(path, options)
        if "--keep" in arguments:
            keep(picture)
            (DOCS / "gallery.md").write_text(gallery_page(examples()), encoding="utf-8")
        print(f"== {path.name}: {time.perf_counter() - start:.1f} s\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
