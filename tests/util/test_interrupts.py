"""An interrupt that falls where Python ignores exceptions."""

import subprocess
import sys

import pytest

CODE = """
import gc, signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job is started with it ignored
from hyjax.util.interrupts import defer_interrupts

def lose_it(phase, info):
    gc.callbacks.clear()
    raise {error}

{keep}
gc.callbacks.append(lose_it)
try:
    gc.collect()
    time.sleep({seconds})
    print("went on")
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize(
    ("keep", "error", "seconds", "expected"),
    [
        ("defer_interrupts()", "KeyboardInterrupt", 30, "interrupted"),
        ("", "KeyboardInterrupt", 0.2, "went on"),  # or else this module can be deleted
        ("defer_interrupts()", "ValueError('told')", 0.2, "went on"),
    ],
)
def test_an_interrupt_in_a_callback(keep: str, error: str, seconds: float, expected: str) -> None:
    code = CODE.format(keep=keep, error=error, seconds=seconds)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=25)
    assert done.stdout.split("\n")[0] == expected
    assert ("told" in done.stderr) == ("told" in error)
