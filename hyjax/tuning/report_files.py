"""Files of a tuning report with names made from labels."""

import re
from collections.abc import Mapping
from pathlib import Path

from hyjax.util.files import make_writable, remove, write_text


def file_stem(text: str, otherwise: str) -> str:
    """Text as the stem of a file's name; `otherwise` if nothing of it is left.

    >>> file_stem("tuned 3.4 ms", "schedule"), file_stem("/", "schedule")
    ('tuned-3.4-ms', 'schedule')
    """
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.") or otherwise


def write_folder(folder: Path, texts: Mapping[str, str], stale: str) -> None:
    """Write files into a folder, and remove those of an earlier time.

    Args:
        folder: made if it is not there.
        texts: by name.
        stale: pattern of the names that are removed where they are not among the texts.
    """
    make_writable(folder)
    for path in folder.glob(stale):
        if path.name not in texts:
            remove(path)
    for name, text in texts.items():
        write_text(folder / name, text)
