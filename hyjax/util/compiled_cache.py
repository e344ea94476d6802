"""Compiled programs in the cache folder: JAX's own cache of them, and `hyjax.util.programs`."""

import contextlib
import functools
import glob
import logging
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from hyjax.util.cache import cache_folder, remove_oldest, tell_unkept
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.programs import keep_programs

JAX_PATTERN = "*-cache"
"""Names of JAX's files."""
MOST_BYTES = 1 << 30
"""Most bytes of JAX's own cache, from which the oldest programs are removed when a process begins."""
DAMAGED = re.compile("Error reading persistent compilation cache entry for '(.+?)'")
_log = logging.getLogger(__name__)


def keep_compiled() -> None:
    """Keep compiled programs in the cache folder from now on, as the commands do, for the next process or notebook.

    To be called before anything is compiled. It sets JAX's own cache of compiled programs to that folder, too. A
    folder that cannot be written is a warning, and costs time only.

    Example:
        >>> import hyjax
        >>> hyjax.keep_compiled()  # doctest: +SKIP
        >>> scene = hyjax.Scene.open(hyjax.SceneSettings())  # doctest: +SKIP
    """
    folder = cache_folder() / "compiled"
    try:
        make_writable(folder)
    except InputError as error:
        tell_unkept(folder, error)
    else:
        keep_programs(folder)
        remove_oldest(folder, JAX_PATTERN, MOST_BYTES)
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        # Another process may be writing the same program just now.
        warnings.filterwarnings("ignore", "Error writing persistent compilation cache")
        warnings.filterwarnings("always", DAMAGED.pattern)
        warnings.showwarning = functools.partial(_show, folder, set(), warnings.showwarning)


def _show(
    folder: Path, reported: set[Path], show: Callable[..., None], message: Warning | str, *rest: Any, **options: Any
) -> None:
    """A warning; of all of JAX's about damage, one line. It leaves damaged files where they are: they go here."""
    damaged = DAMAGED.match(str(message))
    if damaged is None:
        show(message, *rest, **options)
        return
    if folder not in reported:
        reported.add(folder)
        _log.warning("%s: programs in it are damaged, they are compiled again", folder)
    for file in folder.glob(f"{glob.escape(damaged[1])}-*"):
        with contextlib.suppress(OSError):
            file.unlink()
