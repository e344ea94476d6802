"""Functions compiled to machine code by Numba, kept among the files that can be computed again."""

import atexit
import importlib.util
import json
import logging
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hyjax.util.cache import cache_folder
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable

IMPORTS = (
    "import importlib, json, sys; sys.path[:] = json.loads(sys.argv[1])\n"
    "for name in sys.argv[2:]: importlib.import_module(name); print(name, flush=True)"
)
"""Program that imports modules, whose functions are compiled and kept by that, and names each when it is done."""
_log = logging.getLogger(__name__)
_told: set[Path] = set()
"""Folders that could not be used, reported once each."""
_beside: "list[subprocess.Popen[str]]" = []
"""Process that compiles for this one, while it runs."""
_done: set[str] = set()
"""Modules that it is done with."""
_lock = threading.Lock()


def compiled(*signature: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: machine code of a function, which leaves other threads running.

    Numba's cache notices when the function's own file changes, and no other: what it calls must lie there too.

    Args:
        signature: types of its arguments, so that it is compiled at once and once; none for a function that only
            others of these call, which is compiled and kept as part of them.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        _wait_for(function.__module__)
        import numba as typed_numba

        numba: Any = typed_numba  # whose types do not know its settings
        folder, config = _folder(), numba.config
        options: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            if not signature:
                return numba.njit(no_cpython_wrapper=True, **options)(function)
            return numba.njit(*signature, cache=True, **options)(function)
        except Exception as error:  # A damaged file shows itself in a dozen ways, a folder that is full in others.
            if folder not in _told:
                _told.add(folder)
                _log.warning("%s: the compiled rasteriser cannot be kept there (%s)", folder, error)
            return numba.njit(*signature, **options)(function)
        finally:
            config.CACHE_DIR = before

    return decorate


def compile_beside(modules: Sequence[str]) -> None:
    """Begin to compile the functions of modules in a process of its own, unless all are kept.

    Numba leaves other threads of its process little time: beside it this one can load and read. Whoever imports one
    of the modules waits for that process, and compiles what it could not.
    """
    if _beside or not sys.executable:
        return
    try:
        if all(name in sys.modules or _is_kept(name) for name in modules):
            return
        make_writable(_folder())
        # Without the folder that it is begun in, whose files are anybody's.
        command = [sys.executable, "-P", "-c", IMPORTS, json.dumps([str(path) for path in sys.path]), *modules]
        streams: Any = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, text=True, **streams)
    except (InputError, OSError):
        return
    _beside.append(process)
    atexit.register(_end)


def _is_kept(module: str) -> bool:
    """Whether machine code is kept that is newer than a module's source: Numba looks more closely."""
    spec = importlib.util.find_spec(module)
    source = Path(spec.origin if spec and spec.origin else "")
    python = "".join(map(str, sys.version_info[:2]))
    files = _folder().glob(f"{source.parent.name}_*/{source.stem}.*py{python}*.nbi")
    return any(file.stat().st_mtime > source.stat().st_mtime for file in files)


def _wait_for(module: str) -> None:
    with _lock:
        while _beside and module not in _done:
            output = _beside[0].stdout
            if name := output.readline() if output else "":
                _done.add(name.strip())
            else:
                _end()


def _end() -> None:
    while _beside:
        with _beside.pop() as process:
            process.kill()


def _folder() -> Path:
    return cache_folder() / "numba"
