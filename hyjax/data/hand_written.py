"""Hand-written files: YAML or JSON, and the first thing that is wrong with the keys of a mapping in them."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from hyjax.util.errors import InputError, did_you_mean


def read_plain(path: Path, kind: str) -> Any:
    """Plain data of a YAML or JSON file.

    Args:
        path: of the file.
        kind: what it should be, for the error.

    Raises:
        InputError: no such file, or neither YAML nor JSON.
    """
    import yaml

    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))  # JSON is a part of YAML
    except OSError:
        raise InputError(f"{path}: no such {kind}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" (line {mark.line + 1}: {getattr(error, 'problem', '')})" if mark else ""
        raise InputError(f"{path}: neither YAML nor JSON{line}") from None


def check_keys(where: str, content: Any, known: Collection[str], required: Collection[str]) -> None:
    """Check that an entry is a mapping with these keys.

    Args:
        where: of the entry, for the error.
        content: the entry.
        known: keys that it may have, in the order in which they are told.
        required: those that it must have.

    Raises:
        InputError: no mapping, an unknown key (the nearest right one is named), or a missing one.
    """
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a mapping with {', '.join(known)}")
    for key in content:
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise InputError(f"{where}: unknown key {key!r}{hint}; there are {', '.join(known)}")
    for key in required:
        if key not in content:
            raise InputError(f"{where}: key {key!r} is missing")
