"""Programs of JAX that are kept in a folder: traced, lowered and compiled once for a machine, later only read.

Nothing is kept unless `keep_programs` was called, as the commands do; a relighter then runs the functions of the
pure layers by `run_kept`. A program is found by its function, the tree
and shapes of its arguments, the source of the package, JAX, the machine and the settings of both, so that one made
elsewhere, or by another version, is not found. As JAX's own cache of compiled programs, the folder must be one that
only its owner can write to.
"""

import functools
import glob
import hashlib
import logging
import math
import os
import pickle
import platform
import re
import secrets
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import jax
import numpy as np
from jax.experimental import serialize_executable

from hyjax.util.cache import remove_oldest, tell_unkept, touch
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, remove, remove_stale
from hyjax.util.quick_programs import (
    QUICK_OPTIONS,
    QUICK_SUFFIX,
    are_quick,
    cascade_options,
    submit_once,
    wide_options,
)

P = ParamSpec("P")
T = TypeVar("T", covariant=True)
SOURCES = ("core", "light", "util", "pipeline.py")
"""Sources of kept programs: the pure layers."""
CASCADES = ("pipeline.refine_illuminance", "pipeline.refine_visibility")
"""Functions that are mostly cascades."""
LONG = ("light.photo_light.interreflection",)
"""Functions that are optimised at once: without it, they run longer than that takes."""
MOST_BYTES = 300_000_000
"""Most bytes of kept programs, some four million a size of picture; those that were used longest ago go first."""
OPTION = re.compile("XLA_|(?:PJRT_)?NPROC$|JAX_(?!.*_CACHE(?:_|$))")
"""Pattern of variables that may change a program; those of JAX's own cache change none."""
LEAST_SECONDS = "jax_persistent_cache_min_compile_time_secs"
MOST_AREAS = 0.6
"""Share of a process's areas of memory up to which compiled programs stay."""
_log = logging.getLogger(__name__)
_folder: Path | None = None
_told = False
_lock = threading.Lock()
_functions: dict[tuple[Any, ...], Any] = {}
"""Programs of functions that have been run, by function and names of static arguments."""


def keep_programs(folder: Path | None) -> None:
    """Keep programs in a folder from now on; None for none."""
    global _folder
    _folder = folder


def keeps_programs() -> bool:
    """Whether programs are kept."""
    return _folder is not None


class KeptFunction(Generic[P, T]):
    """A function as `jax.jit` makes it, whose compiled programs are kept.

    To be used as a decorator, on functions of the pure layers. Arguments whose class is not this package's, such as
    a kind of light of someone else, have code that is not known here: their programs are not kept.

    Args:
        function: of arrays, or pytrees of them.
        static: names of keyword arguments that programs are made for each value of.
    """

    def __init__(self, function: Callable[P, T], static: Iterable[str] = ()) -> None:
        functools.update_wrapper(self, function)
        self._name = f"{function.__module__}.{function.__qualname__}".removeprefix("hyjax.")
        self._function, self._static = function, tuple(sorted(static))
        self._jitted = jax.jit(function, static_argnames=self._static)
        self._ready: dict[Any, Callable[..., T]] = {}
        self._making: dict[Any, threading.Lock] = {}
        self._to_optimise: dict[Any, Callable[[], None]] = {}

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        if _folder is None:
            return self._jitted(*args, **kwargs)
        program, arrays = self._made(args, kwargs)
        return program(*args, **arrays)

    def make_ready(self, *args: Any, **kwargs: Any) -> None:
        """Read or compile the program for arguments of these shapes, without running it."""
        if _folder is not None:
            self._made(args, kwargs)

    def _made(self, args: Any, kwargs: dict[str, Any]) -> tuple[Callable[..., T], dict[str, Any]]:
        """Program for arguments, and the named ones that it takes."""
        key, arrays = self._key(args, kwargs)
        if key is None:
            return self._jitted, kwargs
        if key not in self._ready:
            with self._making.setdefault(key, threading.Lock()):  # threads that ask for the same wait for it
                if key not in self._ready:
                    self._ready[key] = self._program(key, args, arrays)
        submit_once(self._to_optimise, key)
        return self._ready[key], arrays

    def optimise(self, *args: Any) -> None:
        """Compile the optimised program for arguments of these shapes, where programs are and it is not kept."""
        key, _ = self._key(args, {})
        if key is not None and (file := self._file(key)) is not None:
            with self._making.setdefault(key, threading.Lock()):
                if not file.is_file():
                    self._optimise(key, file, lambda: _lowered(self._function, self._name, args, {}))

    def _key(self, args: Any, kwargs: dict[str, Any]) -> tuple[tuple[Any, ...] | None, dict[str, Any]]:
        """Key of the program for arguments, none where they are traced, and the named ones that it takes."""
        arrays = {name: value for name, value in kwargs.items() if name not in self._static}
        leaves, tree = jax.tree.flatten((args, arrays))
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return None, arrays
        static = tuple([(name, kwargs[name]) for name in self._static if name in kwargs])
        return (static, tree, *map(_signature, leaves)), arrays

    def is_kept(self, *args: Any) -> bool:
        """Whether the optimised program for arguments of these shapes is kept."""
        key, _ = self._key(args, {})
        file = None if key is None else self._file(key)
        return file is not None and file.is_file()

    def _file(self, key: tuple[Any, ...]) -> Path | None:
        static, tree, *shapes = key
        if _folder is None or len(jax.local_devices()) > 1 or not _is_known(tree):
            return None
        signature = repr((static, str(tree), [(shape, str(dtype)) for shape, dtype in shapes]))
        digest = hashlib.sha256(signature.encode()).hexdigest()[:24]
        return _folder / f"{self._name}-{_surroundings()}-{digest}.program"

    def _program(self, key: tuple[Any, ...], args: Any, kwargs: Any) -> Callable[..., T]:
        static, tree, *_ = key
        function, file = functools.partial(self._function, **dict(static)), self._file(key)
        if file is None:
            return functools.partial(self._jitted, **dict(static))
        quick_file = file.with_suffix(QUICK_SUFFIX)
        if (program := _read_kept(file, tree)) is not None:
            return program
        quick = are_quick() and self._name not in LONG
        if quick and (program := _read_kept(quick_file, tree)) is not None:
            shaped = jax.tree.map(_shape_of, (args, kwargs))
            self._to_optimise[key] = functools.partial(
                self._optimise, key, file, lambda: _lowered(function, self._name, *shaped)
            )
            return program
        if not (file.is_file() or quick_file.is_file()):
            _tell_of_others(file, self._name)
        lowered = _lowered(function, self._name, args, kwargs)
        if quick:
            self._to_optimise[key] = functools.partial(self._optimise, key, file, lambda: lowered)
            return _compiled(lowered, quick_file, QUICK_OPTIONS)
        return _compiled(lowered, file, self._options())

    def _options(self) -> dict[str, bool | int]:
        return cascade_options() if self._name in CASCADES else wide_options()

    def _optimise(self, key: Any, file: Path, lower: Callable[[], jax.stages.Lowered]) -> None:
        """Compile a quick program once more, in its place."""
        try:
            self._ready[key] = _compiled(lower(), file, self._options())
        except Exception as error:  # of XLA: the quick one stays
            _log.info("%s: not optimised (%s)", file, error)


def forget_programs_in_time() -> bool:
    """Whether compiled programs were forgotten, as the system would soon refuse memory for more.

    Each takes areas of memory, of which Linux allows a process some number. They are made again when they are run.
    To be called between long steps.
    """
    try:
        areas = Path("/proc/self/maps").read_bytes().count(b"\n")
        most = int(Path("/proc/sys/vm/max_map_count").read_bytes())
    except (OSError, ValueError):  # not on this system
        return False
    if areas <= MOST_AREAS * most:
        return False
    _log.info("compiled programs take %d of %d areas of memory, and are forgotten", areas, most)
    with _lock:
        _functions.clear()
    jax.clear_caches()
    return True


def run_kept(function: Callable[..., Any], *arrays: Any, **static: Any) -> Any:
    """Result of a pure function, by its kept program.

    Args:
        function: of the pure layers, at the top of its module.
        arrays: arguments by place, or pytrees of them.
        static: arguments by name that programs are made for each value of.
    """
    if _folder is None:
        return function(*arrays, **static)
    return kept_function(function, static)(*arrays, **static)


def make_ready(function: Callable[..., Any], *arrays: Any, **static: Any) -> None:
    """Read or compile a function's kept program, if any are kept, without running it. Arguments: see `run_kept`."""
    if _folder is not None:
        kept_function(function, static).make_ready(*arrays, **static)


def kept_function(function: Callable[..., Any], static: Iterable[str] = ()) -> KeptFunction[..., Any]:
    """The function whose programs `run_kept` runs, by its pure one and the names of its static arguments."""
    key = function, *sorted(static)
    with _lock:
        if key not in _functions:
            _functions[key] = KeptFunction(function, static)
        return _functions[key]


def _lowered(function: Callable[..., Any], name: str, args: Any, kwargs: Any) -> jax.stages.Lowered:
    """Lowered function, of another name each time."""

    def unknown(*args: Any, **kwargs: Any) -> Any:
        return function(*args, **kwargs)

    unknown.__name__ = f"{name}_{secrets.token_hex(8)}"  # in the key of JAX's cache
    return jax.jit(unknown).lower(*args, **kwargs)


def _compiled(lowered: jax.stages.Lowered, file: Path, options: dict[str, Any]) -> jax.stages.Compiled:
    """Compiled program, kept in a file. Past JAX's own cache: XLA cannot write a CPU program that it has read."""
    with _unwritten:
        compiled = lowered.compile(compiler_options=options)
    try:
        _write(file, compiled)
        if not file.name.endswith(QUICK_SUFFIX):
            remove(file.with_suffix(QUICK_SUFFIX))
        remove_oldest(file.parent, "*.program", MOST_BYTES)
    except InputError as error:  # of a full disk
        tell_unkept(file.parent, error)
    except Exception as error:  # of JAX, for what cannot be serialised: costs time only
        _log.info("%s: not kept (%s)", file, error)
    return compiled


def _signature(leaf: Any) -> tuple[tuple[int, ...], Any]:
    """Shape and type of an argument, weak or not: an array of JAX has what others are first converted to."""
    if isinstance(leaf, jax.Array):
        return leaf.shape, leaf.dtype
    return np.shape(leaf), jax.numpy.result_type(leaf)


def _shape_of(leaf: Any) -> jax.ShapeDtypeStruct:
    known = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(known.shape, known.dtype, weak_type=known.weak_type)


class _Unwritten:
    """Context in which JAX's own cache is not written to, for several threads at a time."""

    def __init__(self) -> None:
        self._inside, self._least, self._lock = 0, 0.0, threading.Lock()

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._least = getattr(jax.config, LEAST_SECONDS)
                jax.config.update(LEAST_SECONDS, math.inf)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                jax.config.update(LEAST_SECONDS, self._least)


_unwritten = _Unwritten()


def _read_kept(file: Path, tree: Any) -> Callable[..., Any] | None:
    """Program of a file; None if there is none that is whole."""
    try:
        content = file.read_bytes()
        if hashlib.sha256(content[32:]).digest() != content[:32]:
            raise ValueError("its checksum is wrong")
        payload, out_tree = pickle.loads(content[32:])
        program = serialize_executable.deserialize_and_load(payload, tree, out_tree)
        touch(file)
        return program
    except FileNotFoundError:
        return None
    except Exception as error:  # Damage shows itself in a dozen ways; all mean the same.
        _log.warning("%s: damaged (%s), it is made again", file, error)
        return None


def _write(file: Path, compiled: jax.stages.Compiled) -> None:
    payload, _, out_tree = serialize_executable.serialize(compiled)
    content = pickle.dumps((payload, out_tree))
    file.parent.mkdir(parents=True, exist_ok=True)
    remove_stale(file.parent)
    with atomic_write(file) as part:
        part.write_bytes(hashlib.sha256(content).digest() + content)


def _is_known(tree: Any) -> bool:
    """Whether all classes in a tree are Python's or this package's."""
    data = tree.node_data()
    known = data is None or data[0].__module__.split(".")[0] in ("builtins", "hyjax")
    return known and all(map(_is_known, tree.children()))


def _tell_of_others(file: Path, name: str) -> None:
    """Report once that the folder of a program's file has such of another machine only."""
    global _told
    folder, here = file.parent, f"{name}-{_surroundings()}-"
    kept = [each.name for each in folder.glob(f"{glob.escape(name)}-*.program")]
    if not _told and kept and not any(each.startswith(here) for each in kept):
        _told = True
        _log.warning("%s: programs in it are of another version, source or machine, and are made anew", folder)


@functools.cache
def _surroundings() -> str:
    """Key of the environment that a compiled program depends on."""
    package, sources = Path(__file__).parents[1], hashlib.sha256()
    for place in SOURCES:
        for file in sorted((package / place).rglob("*.py")) or [package / place]:
            sources.update(file.read_bytes())
    device, cpuinfo = jax.devices()[0], Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    features = sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    options = sorted(f"{k}={v}" for k, v in os.environ.items() if OPTION.match(k))
    options += [str(getattr(jax.config, name)) for name in ("jax_enable_x64", "jax_default_matmul_precision")]
    machine = platform.machine(), device.platform, device.device_kind, device.client.platform_version, *features
    versions = sources.hexdigest(), jax.__version__, jax.lib.__version__, str(os.cpu_count())
    return hashlib.sha256(repr((*versions, *machine, *options)).encode()).hexdigest()[:12]
