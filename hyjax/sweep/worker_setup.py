"""What Dask does first in a worker of ours: Ctrl-C is the driver's, which then ends its workers."""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask, in the process' first thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
