"""Fuzzing of all readers: mutated files give a result or an `InputError`, in bounded time and memory.

`python -m tests.fuzz --help` runs more cases than the tests do.
"""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS), str(TESTS / "data")]  # where helpers of other tests are
