"""Screenshots of the room tour for the documentation: an afternoon, and the evening with a bulb on the table."""

import contextlib
import io
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from experiments.browser import browser
from hyjax.util.errors import InputError

SIZE = {"width": 1200, "height": 673}
PIXELS = "640x480"
WAIT = 120_000.0  # milliseconds
AFTERNOON, EVENING = "16", "21.5"
TABLE = 0.5, 0.81
"""Place of the bulb, in shares of the scene."""
GAP = 8
STILL_CORES = 0.05
"""Share of a core below which the tour has compiled all that it compiles ahead."""


def tour_picture() -> UInt8[np.ndarray, "h w 3"]:
    """Both, side by side.

    Raises:
        InputError: there is no browser, or the tour does not start.
    """
    with served(PIXELS, "--engine", "server") as (url, process), browser() as launched:
        page = launched.new_page(viewport=SIZE)
        page.goto(url)
        page.wait_for_selector("body[data-state=ready]", timeout=WAIT)
        for _ in range(10):
            page.locator("#wipe").press("ArrowLeft")
        at_hour(page, AFTERNOON)
        wait_until_still(process.pid)
        afternoon = screenshot(page)
        at_hour(page, EVENING)
        page.get_by_role("button", name="Add a lamp").click()
        box = page.locator("#over").bounding_box()
        page.mouse.click(box["x"] + TABLE[0] * box["width"], box["y"] + TABLE[1] * box["height"])
        wait_until_still(process.pid)
        evening = screenshot(page)
    between = np.full((afternoon.shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([afternoon, between, evening], axis=1)


def at_hour(page: Any, hour: str) -> None:
    """Set the hour."""
    page.locator("#daylight").get_by_label("Hour").fill(hour)


def screenshot(page: Any) -> UInt8[np.ndarray, "h w 3"]:
    """Picture that the page shows."""
    page.wait_for_timeout(2000)
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


@contextlib.contextmanager
def served(size: str, *others: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A tour of the built-in room in a process of its own, with other options: its address and the process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hyjax.cli", "tour", "--quiet"]
        options = ["--size", size, "--port", str(port), "--out", folder, *others]
        process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if "http" not in line:
                raise InputError("tour: it did not start; see above")
            yield line.split()[5], process
        finally:
            process.terminate()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


def wait_until_still(pid: int) -> None:
    """Wait until a process does nothing for a second."""
    before = -np.inf
    while (now := processor_seconds(pid)) - before > STILL_CORES:
        before = now
        time.sleep(1.0)


def processor_seconds(pid: int) -> float:
    """Time that a process has had of the processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
