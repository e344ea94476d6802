"""Set-up of our workers by Dask: Ctrl-C is the driver's, which then ends its workers."""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Hook of Dask, called in the process' first thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
