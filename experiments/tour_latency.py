"""Latency of the room tour from a change to its picture, and its memory, measured in the browser.

    python -m experiments.tour_latency [--changes 1000] [--size 512] [--out results/tour_latency]

Takes five minutes on two cores, and the browser, which renders without a GPU here, has its share of them. Needs
chromium, playwright and the extra `tour`. The tour of the built-in room runs in a process of its own. A key on the
slider of the hour makes one change; the next one waits for its picture, and comes before shadows become fine. Timed
by the browser's own clock: from the moment that it sends the change until it has received the picture. Begun
when the tour has compiled what it compiles ahead, and warmed up by changes that do not count.

Expect: a median below 100 ms for a picture of 512 x 512 pixels on two cores, and memory that stays where it was
after the first hundred changes.
"""

import base64
import contextlib
import dataclasses
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.blocks import Block, Plot, Table
from experiments.browser import browser
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind
from hyjax.util.errors import InputError

HOUR = 2  # which slider, from the top
PICTURE_LENGTH = 10_000  # what is longer than this, in base64, is a picture
THERE_AND_BACK = 20  # changes until the slider turns round
REST = 40  # milliseconds without a picture until the next change: a drag, in which shadows stay coarse
LONG_REST = 1000  # after a slow picture, so that its fine one, which comes late, is not taken for the next change's
SLOW = 100
STILL = 0.05  # share of a core, below which the tour has compiled all that it compiles ahead
WAIT = 120.0


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    changes: int = 1000
    warm_up: int = 100
    """Changes that do not count."""
    size: int = 512
    """Pixels a side."""


@experiment("The room tour, from slider to picture")
def main(config: Config, start: Start) -> None:
    if config.changes < 2 or config.warm_up < 1:
        raise InputError("changes: need at least 2, after a warm-up of at least 1")
    results = start()
    with served(config.size) as (url, process), browser() as launched:
        page = launched.new_page(viewport={"width": 1280, "height": 720})
        monitor = SocketMonitor(page)
        page.goto(url)
        page.get_by_text("ms for this picture").wait_for(timeout=1e3 * WAIT)
        wait_until_still(process.pid)
        page.locator(".mantine-Slider-thumb").nth(HOUR).focus()
        waits: list[float] = []
        for number in tqdm(range(config.warm_up + config.changes), "changes"):
            rest = LONG_REST if waits and waits[-1] > SLOW else REST
            while 1e3 * (time.perf_counter() - monitor.reported_at) < rest:
                page.wait_for_timeout(5)
            monitor.reset()
            page.keyboard.press("ArrowRight" if number // THERE_AND_BACK % 2 else "ArrowLeft")
            end = time.monotonic() + WAIT
            while (wait := monitor.wait) is None:
                page.wait_for_timeout(1)
                if time.monotonic() > end:
                    raise InputError(f"tour_latency: no picture came for change {number}")
            waits.append(wait)
            if number % 20 == 0:
                results.add(kind="memory", change=number - config.warm_up, mebibytes=resident(process.pid))
        results.add(kind="waits", milliseconds=waits[config.warm_up :], first_ms=waits[0], size=config.size)
        page.screenshot(path=str(results.out / "page.png"))


class SocketMonitor:
    """Messages on a page's socket, as the browser reports them.

    Attributes:
        sent, received: when changes went and pictures came, in seconds of the browser's clock.
        reported_at: when the last picture was reported, in seconds of our clock.
    """

    def __init__(self, page: Any) -> None:
        self.sent: list[float] = []
        self.received: list[float] = []
        self.reported_at = 0.0
        self._session = page.context.new_cdp_session(page)
        self._session.on("Target.attachedToTarget", self._on_attached)
        self._session.on("Target.receivedMessageFromTarget", self._on_message)
        attach = {"autoAttach": True, "waitForDebuggerOnStart": False, "flatten": False}
        self._session.send("Target.setAutoAttach", attach)  # viser's socket belongs to a worker

    def reset(self) -> None:
        """Forget all messages."""
        self.sent.clear()
        self.received.clear()

    @property
    def wait(self) -> float | None:
        """Milliseconds from the first change to the first picture after it; None while there is none."""
        after = [when for when in self.received if self.sent and when > self.sent[0]]
        return 1e3 * (after[0] - self.sent[0]) if after else None

    def _on_attached(self, event: Any) -> None:
        message = json.dumps({"id": 1, "method": "Network.enable"})
        self._session.send("Target.sendMessageToTarget", {"sessionId": event["sessionId"], "message": message})

    def _on_message(self, event: Any) -> None:
        message = json.loads(event["message"])
        handlers = {
            "Network.webSocketFrameSent": self._on_sent,
            "Network.webSocketFrameReceived": self._on_received,
        }
        if message.get("method") in handlers:
            handlers[message["method"]](message["params"])

    def _on_sent(self, event: Any) -> None:
        if b"GuiUpdateMessage" in base64.b64decode(event["response"]["payloadData"]):
            self.sent.append(event["timestamp"])

    def _on_received(self, event: Any) -> None:
        if len(event["response"]["payloadData"]) > PICTURE_LENGTH:
            self.received.append(event["timestamp"])
            self.reported_at = time.perf_counter()


@contextlib.contextmanager
def served(size: int | str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A tour of the built-in room in a process of its own: its address and the process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "hyjax.cli",
            "tour",
            "--size",
            str(size),
            "--port",
            str(port),
            "--out",
            folder,
        ]
        process = subprocess.Popen([*command, "--quiet"], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if "http" not in line:
                raise InputError("tour_latency: the tour did not start; see above")
            yield line.split()[5], process
        finally:
            process.terminate()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


def wait_until_still(pid: int) -> None:
    """Wait until a process does nothing for a second."""
    before = -np.inf
    while (now := processor_seconds(pid)) - before > STILL:
        before = now
        time.sleep(1.0)


def processor_seconds(pid: int) -> float:
    """Time that a process has had of the processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> float:
    """Memory of a process in MiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) / 1024
    return float("nan")


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    waits = of_kind(rows, "waits")
    memory = of_kind(rows, "memory")
    if not waits:
        return ["No change has been timed yet."]
    values = np.asarray(waits[0]["milliseconds"])
    after = [row["mebibytes"] for row in memory if row["change"] >= 0] or [row["mebibytes"] for row in memory]
    table = Table(
        "From the change to its picture.",
        ["", "ms"],
        [
            ["median", f"{np.median(values):.0f}"],
            ["p95", f"{np.percentile(values, 95):.0f}"],
            ["largest", f"{values.max():.0f}"],
        ],
    )
    size = waits[0]["size"]
    text = (
        f"{len(values)} changes of the hour, pictures of {size} x {size}; {machine(waits[0])}. Memory of the tour: "
        f"{after[0]:.0f} MiB at the first of them, {after[-1]:.0f} MiB at the last, {max(after):.0f} MiB at most."
    )
    return [table, text, Plot("waits", "Waiting time and memory over the changes.", draw(values, memory))]


def draw(values: np.ndarray, memory: Sequence[Row]) -> Figure:
    figure = new_figure(10, 3.4)
    left, right = figure.subplots(1, 2)
    left.hist(values, bins=60)
    left.set(xlabel="ms from change to picture", ylabel="changes")
    right.plot([row["change"] for row in memory], [row["mebibytes"] for row in memory])
    right.set(xlabel="change", ylabel="memory of the tour, MiB", ylim=(0, None))
    return figure


if __name__ == "__main__":
    run(main)
