"""Freed memory is kept: large arrays come back without new pages."""

import subprocess
import sys

import pytest

COUNT = """
import resource, sys, threading
import numpy as np
from hyjax.util.memory import keep_freed_memory
kept = keep_freed_memory() if sys.argv[1] == "keep" else None
def work():
    for _ in range(11):
        np.ones(12_000_000)
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
faults = []
thread = threading.Thread(target=work)
thread.start()
thread.join()
print(kept, faults[-1] - faults[0])
"""


def faults_of(how: str, **environment: str) -> tuple[str, int]:
    command = [sys.executable, "-c", COUNT, how]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment or None)
    kept, faults = done.stdout.split()
    return kept, int(faults)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator is set up on Linux alone")
def test_large_arrays_come_back_without_new_pages() -> None:
    kept, few = faults_of("keep")
    if kept == "False":
        pytest.skip("another C library than glibc, or an environment that sets it up")
    _, many = faults_of("leave")
    assert few < 0.1 * many, "96 MB, ten times over"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator is set up on Linux alone")
def test_the_environment_has_the_last_word() -> None:
    assert faults_of("keep", GLIBC_TUNABLES="glibc.malloc.hugetlb=1")[0] == "False"
