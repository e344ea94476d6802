"""Pool of workers by Dask distributed: processes of this machine, or of a scheduler elsewhere.

Those elsewhere are started by any of Dask's deployers, in an environment with hyjax and a folder that all see:

    dask scheduler
    dask worker ADDRESS --nthreads 1 --resources device=1      # one on each host
    dask worker ADDRESS --nthreads 1 --nworkers 7              # the others
"""

import contextlib
import importlib.util
import logging
import queue
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from hyjax.sweep.batch import Outcome, TaskBatch, run_batch
from hyjax.sweep.dispatch import Tell
from hyjax.util.cores import cores
from hyjax.util.errors import InputError

try:
    import dask

    if importlib.util.find_spec("distributed") is None:
        raise ImportError("distributed")
except ImportError:
    raise InputError("workers: Dask is not installed; pip install '.[tune]', or give --workers 0") from None

DEVICE_RESOURCE = {"device": 1}
"""Dask resource of a worker that may have the device for itself."""
SETUP_MODULE = "hyjax.sweep.worker_setup"
SETTLING_SECONDS = 0.1
"""Delay, in seconds, in which all batches of a lost worker are reported."""
POLL_SECONDS = 2.0
"""Interval, in seconds, of the search for lost workers of a scheduler."""
CONNECT_SECONDS = 10.0
"""Timeout, in seconds, of a connection to a scheduler."""
START_SECONDS = 60.0
"""Timeout, in seconds, of the start of workers."""
QUIET_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application")
CONFIG = {
    "logging": dict.fromkeys(QUIET_LOGGERS, "critical"),
    "distributed.scheduler.allowed-failures": 0,
    "distributed.nanny.pre-spawn-environ": {},
    "distributed.admin.system-monitor.log-length": 60,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.low-level-log-length": 8,
}
"""Dask's configuration of workers on this machine: silent, every death is reported, threads as in any process of
ours, and no memory of messages, which hold all tasks."""


class DaskPool:
    """Pool of a Dask scheduler's workers; see `hyjax.sweep.engine.Pool`."""

    def __init__(self, client: Any, stack: contextlib.ExitStack, tell: Tell, address: str | None) -> None:
        self._client, self._stack, self._tell, self._address = client, stack, tell, address
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._batches: dict[Any, TaskBatch] = {}
        self._threads: dict[str, int] = client.nthreads()
        self._looked = time.monotonic()

    @classmethod
    def open(cls, workers: int | None, scheduler: str | None, folder: Path, tell: Tell) -> "DaskPool":
        """Open workers on this machine or of a scheduler; see `Engine.open`."""
        with contextlib.ExitStack() as stack:
            from distributed import Client  # its defaults outlast the configuration below

            stack.enter_context(dask.config.set(CONFIG if scheduler is None else {"logging": CONFIG["logging"]}))
            for name in QUIET_LOGGERS:
                logging.getLogger(name).setLevel(logging.CRITICAL)
            count = 1 if scheduler else workers or cores()
            try:
                address = scheduler or stack.enter_context(_local_cluster(count))
                client = stack.enter_context(Client(address, timeout=CONNECT_SECONDS))
                client.wait_for_workers(count, timeout=START_SECONDS)
            except (OSError, TimeoutError, ValueError, RuntimeError) as error:
                what = f"scheduler {scheduler}" if scheduler else "workers"
                raise InputError(f"{what}: cannot be reached ({str(error).splitlines()[0]})") from None
            if scheduler is not None:
                if any(threads != 1 for threads in client.nthreads().values()):
                    raise InputError("workers: need one thread each; start them with: dask worker --nthreads 1")
                blind = [name for name, sees in client.run(Path.is_dir, folder).items() if not sees]
                if blind:
                    raise InputError(f"{folder}: worker {blind[0]} does not see this folder; choose a shared --out")
            return cls(client, stack.pop_all(), tell, scheduler)
        raise AssertionError

    def places(self, timing: bool) -> int:
        if not timing:
            return 2 * max(1, sum(self._threads.values()))
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        if not any(worker["resources"].get("device") for worker in workers):
            raise InputError("time: no worker has the device; start one with: dask worker --resources device=1")
        return 1

    def submit(self, batch: TaskBatch, timing: bool) -> None:
        resources = DEVICE_RESOURCE if timing else None
        future = self._client.submit(run_batch, batch, pure=False, resources=resources)
        self._batches[future] = batch
        future.add_done_callback(self._ended.put)

    def collect(self) -> list[tuple[TaskBatch, Outcome | None]]:
        if time.monotonic() - self._looked > POLL_SECONDS:  # many workers leave no pause between results
            self._look()
        futures = [self._next()]
        if futures[0].status != "finished":
            time.sleep(SETTLING_SECONDS)
        while not self._ended.empty():
            futures.append(self._ended.get())
        return [self._outcome(future) for future in futures]

    def _outcome(self, future: Any) -> tuple[TaskBatch, Outcome | None]:
        from distributed import KilledWorker

        batch = self._batches.pop(future)
        try:
            # Waits where the worker died with the result in its memory: Dask runs the batch again by itself then.
            return batch, future.result()
        except KilledWorker:
            return batch, None
        except CancelledError:
            name = self._address or "of this machine"
            raise InputError(f"scheduler {name}: lost; the rows so far are kept, resume goes on") from None

    def _next(self) -> Any:
        """Next future that has ended."""
        while True:
            with contextlib.suppress(queue.Empty):
                return self._ended.get(timeout=POLL_SECONDS)
            self._look()

    def _look(self) -> None:
        """Report workers lost by a scheduler elsewhere, which runs their tasks again by itself."""
        self._looked = time.monotonic()
        if self._address is None:
            return
        try:
            threads = self._client.nthreads()
        except (OSError, TimeoutError):
            raise InputError(f"scheduler {self._address}: lost; the rows so far are kept, resume goes on") from None
        for gone in self._threads.keys() - threads.keys():
            self._tell(f"worker {gone} lost; its tasks run again")
        if self._threads and not threads:
            self._tell("no worker is left; waiting for one")
        self._threads = threads

    def close(self) -> None:
        self._stack.close()


@contextlib.contextmanager
def _local_cluster(count: int) -> Iterator[Any]:
    """Cluster of workers on this machine, the first of which has the device."""
    from distributed import Nanny, Scheduler, SpecCluster

    options: dict[str, Any] = {"host": "127.0.0.1", "nthreads": 1, "memory_limit": None, "preload": [SETUP_MODULE]}
    options |= {"dashboard": False, "silence_logs": logging.CRITICAL}
    first = {"cls": Nanny, "options": options | {"resources": DEVICE_RESOURCE}}
    specs = {number: {"cls": Nanny, "options": options} for number in range(1, count)}
    scheduler = {
        "cls": Scheduler,
        "options": {"host": "127.0.0.1", "port": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
    }
    cluster = SpecCluster(workers={0: first} | specs, scheduler=scheduler, silence_logs=logging.CRITICAL)
    try:
        yield cluster
    finally:
        cluster.close()
