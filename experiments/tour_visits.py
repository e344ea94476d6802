"""Visits of the room tour: how long a change takes to be a picture, and memory over many changes.

    python -m experiments.tour_visits [--changes 60] [--minutes 5] [--out results/tour_visits]

A tour of the built-in room at 640 x 480 runs in a process of its own, its pictures drawn by the server; a visitor
without a browser changes something and waits for the picture (`--changes` times for each kind of change). *Draft*
is the first picture that shows the change, *fine* the last. Then visitors change everything for some minutes, break
off and come back, while the process's memory, files and threads are counted.

Takes five minutes on two cores, and `--minutes` more.

Expect: 50 ms from any change to its draft on a fast machine, three times as much on a slow one.
"""

import contextlib
import dataclasses
import json
import logging
import random
import socket
import time
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from experiments.tour_picture import PIXELS, served, wait_until_still

VISITORS = 2
SETTLED = 0.5
"""Share of the minutes after which memory is compared with that of the end."""
KINDS = {
    "brightness": "brightness of a lamp",
    "hour": "hour",
    "exposure": "exposure",
    "lamp": "a lamp moves",
    "furniture": "furniture moves",
    "frame": "another frame",
}


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    changes: int = 60
    """Of each kind."""
    minutes: float = 5.0
    """Of many changes; 0 leaves them out."""


class Visitor:
    """A visitor without a browser."""

    def __init__(self, url: str) -> None:
        from websockets.sync.client import connect

        self.wire, self.number = connect(f"{url.replace('http', 'ws')}/socket", max_size=None), 0

    def picture(self, plan: dict[str, Any], frame: int = 0, *, fine: bool = True) -> tuple[float, float]:
        """Seconds until the first picture of a plan, and until the last."""
        self.number += 1
        begun, first = time.perf_counter(), 0.0
        message = {"task": "picture", "number": self.number, "plan": plan, "view": {"frame": frame}}
        self.wire.send(json.dumps(message))
        while True:
            answer = self.wire.recv(timeout=300)
            assert isinstance(answer, bytes), answer
            head = json.loads(answer.partition(b"\n")[0])
            if head["picture"] != self.number:
                continue
            first = first or time.perf_counter() - begun
            if not head["draft"] or not fine:
                return first, time.perf_counter() - begun


@experiment("Visits of the room tour", "change")
def main(config: Config, start: Start) -> None:
    results = start()
    logging.getLogger("websockets.client").setLevel(logging.CRITICAL)  # of visits that are broken off
    with served(PIXELS, "--engine", "server") as (url, process):
        wait_until_still(process.pid)
        page = json.loads(urllib.request.urlopen(f"{url}/page.json").read())
        plan, visitor = page["server"]["plan"], Visitor(url)
        centre = np.mean(page["scene"]["bounds"], axis=0).tolist()
        lamp = {"kind": "bulb", "position": centre}
        piece = {"seed": chair(url, plan)} if config.changes else None
        for kind in KINDS:
            times = []
            for step in range(config.changes + 3):  # the first ones compile
                changed, frame = change(kind, step, {**plan, "lamps": [lamp]}, piece)
                times.append(visitor.picture(changed, frame))
            for first, last in times[3:]:
                results.add(kind="change", of=kind, draft_ms=1e3 * first, fine_ms=1e3 * last)
        for row in load(url, process.pid, plan, centre, config.minutes) if config.minutes else ():
            results.add(kind="load", **row)


def chair(url: str, plan: dict[str, Any]) -> list[float]:
    """A point of a piece of furniture: the first that is found from below the middle of the first frame."""
    visitor = Visitor(url)
    for column in range(100, 600, 50):
        message = {"task": "furniture", "number": 1, "plan": plan, "places": [[column, 420]]}
        visitor.wire.send(json.dumps(message))
        answer = json.loads(visitor.wire.recv(timeout=300))
        if "new" in answer:
            seed: list[float] = answer["new"]["seed"]
            return seed
    raise AssertionError("there is no furniture in view")


def change(kind: str, step: int, plan: dict[str, Any], piece: dict[str, Any] | None) -> tuple[dict[str, Any], int]:
    """Plan and frame after one more change."""
    (lamp,) = plan["lamps"]
    if kind == "brightness":
        return {**plan, "lamps": [{**lamp, "lumen": 300 + 10 * step}]}, 0
    if kind == "hour":
        return {**plan, "hour": 9 + 0.1 * step % 10}, 0
    if kind == "exposure":
        return {**plan, "exposure": -1 + 0.02 * step % 2}, 0
    if kind == "lamp":
        x, y, z = lamp["position"]
        return {**plan, "lamps": [{**lamp, "position": [x + 0.01 * step, y, z]}]}, 0
    if kind == "furniture":
        pose = np.eye(4)
        pose[0, 3] = 0.01 * step
        return {**plan, "pieces": [{**(piece or {}), "pose": pose.reshape(-1).tolist()}]}, 0
    return plan, step % 20


def load(url: str, pid: int, plan: dict[str, Any], centre: Sequence[float], minutes: float) -> Iterator[Row]:
    """Memory, open files and threads of the tour, at each tenth of the minutes."""
    chance, begun, made = random.Random(0), time.monotonic(), 0
    visitors = [Visitor(url) for _ in range(VISITORS)]
    for part in range(1, 11):
        while time.monotonic() - begun < 6.0 * minutes * part:
            number = chance.randrange(VISITORS)
            lamps = [
                {
                    "kind": kind,
                    "position": [v + chance.uniform(-1, 1) for v in centre],
                    "lumen": chance.uniform(0, 2000),
                }
                for kind in chance.sample(("bulb", "spot", "candle", "strip"), 2)
            ]
            changed = {**plan, "hour": chance.uniform(0, 24), "lamps": lamps}
            visitors[number].picture(changed, chance.randrange(20), fine=chance.random() < 0.5)
            made += 1
            if chance.random() < 0.05:  # one breaks off
                with contextlib.suppress(OSError):
                    visitors[number].wire.socket.shutdown(socket.SHUT_RDWR)
                visitors[number] = Visitor(url)
        status = Path(f"/proc/{pid}/status").read_text().splitlines()
        memory = next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024
        threads = next(int(line.split()[1]) for line in status if line.startswith("Threads"))
        files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
        yield {"minutes": minutes * part / 10, "pictures": made, "mib": memory, "threads": threads, "files": files}


def blocks(rows: Sequence[Row], folder: Any) -> list[Block]:
    """Tables from the rows."""
    changes, loads = of_kind(rows, "change"), of_kind(rows, "load")
    lines = []
    for kind, text in KINDS.items():
        own = [row for row in changes if row["of"] == kind]
        if own:
            values = [np.percentile([row[name] for row in own], (50, 95)) for name in ("draft_ms", "fine_ms")]
            lines.append([text, *(f"{value:.0f}" for pair in values for value in pair)])
    made: list[Block] = [
        Table(
            f"From a change to its picture of {PIXELS} from the server; {len(changes)} changes.",
            ["", "draft, median ms", "p95", "fine, median ms", "p95"],
            lines,
        )
    ]
    if loads:
        before = loads[round(SETTLED * len(loads)) - 1]
        last = loads[-1]
        names = {"mib": "memory, MiB", "files": "open files", "threads": "threads"}
        made.append(
            Table(
                f"{last['pictures']} changes in {last['minutes']:g} minutes by {VISITORS} visitors who break off.",
                ["", f"after {before['minutes']:g} minutes", "at the end", "change", "most"],
                [
                    [
                        text,
                        f"{before[key]:.0f}",
                        f"{last[key]:.0f}",
                        f"{100 * (last[key] / before[key] - 1):+.1f} %",
                        f"{max(row[key] for row in loads):.0f}",
                    ]
                    for key, text in names.items()
                ],
            )
        )
    made.append(f"{machine(rows[0])}.")
    return made


if __name__ == "__main__":
    run(main)
