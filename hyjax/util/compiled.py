"""Functions compiled to machine code by Numba, kept among the files that can be computed again."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba as typed_numba

from hyjax.util.cache import cache_folder

numba: Any = typed_numba  # whose types do not know its settings
_log = logging.getLogger(__name__)
_told: set[Path] = set()
"""Folders that could not be used, reported once each."""


def compiled(*signature: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: machine code of a function, which leaves other threads running.

    Numba's cache notices when the function's own file changes, and no other: what it calls must lie there too.

    Args:
        signature: types of its arguments, so that it is compiled at once and once; none for a function that only
            others of these call, which is compiled and kept as part of them.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        folder, config = cache_folder() / "numba", numba.config
        options: Any = {"nogil": True, "error_model": "numpy"}
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            if not signature:
                return numba.njit(**options)(function)
            return numba.njit(*signature, cache=True, **options)(function)
        except Exception as error:  # A damaged file shows itself in a dozen ways, a folder that is full in others.
            if folder not in _told:
                _told.add(folder)
                _log.warning("%s: the compiled rasteriser cannot be kept there (%s)", folder, error)
            return numba.njit(*signature, **options)(function)
        finally:
            config.CACHE_DIR = before

    return decorate
