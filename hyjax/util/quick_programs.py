"""Programs that are wanted at once: compiled without optimisation, and optimised on other threads later."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import jax

CASCADE_OPTIONS: dict[str, bool | int] = {}
"""XLA's options of the cascades on processors: less time to compile, and as much to run. Light and shadow maps run
more slowly with them."""
if jax.__version_info__ < (0, 11):  # later ones have no other emitters
    CASCADE_OPTIONS["xla_cpu_use_fusion_emitters"] = False
WIDE_OPTIONS: dict[str, bool | int] = {"xla_cpu_prefer_vector_width": 512}
"""XLA's options of all other optimised programs on processors: vectors of up to 512 bits, where there are any. XLA
keeps to 256, for processors that slow down with wider ones; here colours, above all, are decoded sooner."""
QUICK_OPTIONS: dict[str, bool | int] = {
    **CASCADE_OPTIONS,
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}
"""XLA's options of quick programs: several times less time to compile, and more to run."""
QUICK_SUFFIX = ".quick.program"
THREADS = 2
"""Number of threads that optimise."""
_lock = threading.Lock()
_contexts = 0
_optimiser: ThreadPoolExecutor | None = None


@contextlib.contextmanager
def quick_programs(wanted: bool = True) -> Iterator[None]:
    """Context in which programs that are not kept yet are compiled without optimisation, and run slower for it.

    See `optimise_programs`. What has not been optimised at the end is the next time.
    """
    global _contexts, _optimiser
    with _lock:
        _contexts += wanted
    try:
        yield
    finally:
        with _lock:
            _contexts -= wanted
            pool, _optimiser = (None, _optimiser) if _contexts else (_optimiser, None)
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)


def cascade_options() -> dict[str, bool | int]:
    """XLA's options of optimised cascades here."""
    return CASCADE_OPTIONS if jax.default_backend() == "cpu" else {}


def wide_options() -> dict[str, bool | int]:
    """XLA's options of other optimised programs here; none where the user has set them."""
    own = "xla_cpu_prefer_vector_width" in os.environ.get("XLA_FLAGS", "")
    return WIDE_OPTIONS if jax.default_backend() == "cpu" and not own else {}


def are_quick() -> bool:
    """Whether programs are to be compiled without optimisation."""
    return _contexts > 0 and jax.default_backend() == "cpu"


def optimise_programs() -> None:
    """Optimise each quick program that is run from now on, on another thread; it takes over once it is compiled."""
    global _optimiser
    with _lock:
        if _contexts and _optimiser is None:
            _optimiser = ThreadPoolExecutor(THREADS, thread_name_prefix="optimised programs")


def submit(task: Callable[[], None]) -> Future[None] | None:
    """Submit a task to the threads that optimise; None, without running it, where no programs are optimised."""
    pool = _optimiser  # another thread may let go of it
    try:
        return None if pool is None else pool.submit(task)
    except RuntimeError:  # the pool has just been shut down
        return None


def submit_once(tasks: dict[object, Callable[[], None]], key: object) -> None:
    """Submit a program's optimisation, if programs are being optimised; cancelled, it comes back into `tasks`."""
    if _optimiser is None or (task := tasks.pop(key, None)) is None:
        return

    def restore(future: Future[None]) -> None:
        if future.cancelled():
            tasks[key] = task

    future = submit(task)
    if future is None:
        tasks[key] = task
    else:
        future.add_done_callback(restore)
