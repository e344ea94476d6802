"""Time from a control of the widget to its picture: a κ, a count of steps, a lamp's strength and its place.

    python -m experiments.explore_latency [--size 512x512] [--rounds 15] [--out results/explore_latency]

A widget of the built-in room is sent what its page sends, all movements in turns: while a control moves, when a
draft will do, and when it rests. Measured: milliseconds from the message to the JPEG that goes to the page, without
the time that the process waited for other work; how much of it are the stages of the relighting; and the rest,
which is the widget's own. The first round, which compiles, is left out.

Takes about three minutes on two cores.

Expect: κ and counts of steps at the cost of a cascade; a strength dearer, a place dearer still.
"""

import dataclasses
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

import hyjax
from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import middle
from experiments.records import Row, of_kind
from experiments.timing import check_repeats

if TYPE_CHECKING:
    from hyjax.exploration.widget import Explorer  # needs the extra `notebooks`

GOALS = {"κ of a level": 15, "steps of a level": 30, "strength of a lamp": 25, "place of a lamp": 80}
"""Change → milliseconds that it should take while a control moves."""
MOVES = {True: "moves", False: "rests"}
MOVE = (True, True, False)
"""Messages of one movement: whether a draft will do. The first, which comes upon another change, is not counted."""


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    size: str = "512x512"
    lights: str = "evening-lamps"
    """A named set-up."""
    rounds: int = 15


@experiment("The widget's latency", "change")
def main(config: Config, start: Start) -> None:
    check_repeats(config.rounds)
    results = start()
    scene = hyjax.Scene.open(hyjax.SceneSettings(size=config.size), progress=True)
    widget: Any = scene.explore(lights=config.lights)
    widget._received(None, {"kind": "ready"})
    widget.wait()
    lamp = next(n for n, lamp in enumerate(widget.state["lamps"]) if lamp["place"])
    for number in tqdm(range(config.rounds + 1), "changing", unit="round"):
        for name in GOALS:
            for step, draft in enumerate(MOVE):
                content = messages(widget, lamp, len(MOVE) * number + step)[name]
                taken = changed(widget, content | {"draft": draft}, wait=not draft)
                if number and step:
                    results.add(kind="change", name=name, draft=draft, round=number, **taken)


def messages(widget: "Explorer", lamp: int, number: int) -> dict[str, dict[str, Any]]:
    """What the page sends for each change; with another number another value, hence another picture."""
    share = 0.45 + 0.4 * np.sin(1 + number)  # never what it was before
    level = {"kind": "level", "cascade": "schedule", "index": 1}
    x, y = widget.state["lamps"][lamp]["place"]
    values: list[dict[str, Any]] = [
        level | {"key": "kappa", "value": 0.1 * share},
        level | {"key": "steps", "value": 5 + number % 5},
        {"kind": "strength", "index": lamp, "value": 1000.0 * share},
        {"kind": "place", "index": lamp, "value": [x + 0.01 * (-1) ** number, y]},
    ]
    return dict(zip(GOALS, values, strict=True))


def changed(widget: Any, content: dict[str, Any], *, wait: bool) -> dict[str, float]:
    """Milliseconds to the picture of a change: by the clock, of them the stages', and those of the processor.

    `wait` is for all that follows it, as after the last of a movement.
    """
    arrived, times = threading.Event(), dict[str, float]()

    def shown(_: Any) -> None:
        if not arrived.is_set():
            times.update(wall=time.perf_counter() - wall, cpu=time.process_time() - cpu)
            arrived.set()

    widget.observe(shown, "picture")
    try:
        wall, cpu = time.perf_counter(), time.process_time()
        widget._received(None, content)
        if not arrived.wait(600.0):
            raise TimeoutError(f"no picture: {widget.message}")
        stages = {name: ms for name, ms in widget.times if name != "JPEG"}
    finally:
        widget.unobserve(shown, "picture")
        if wait:
            widget.wait()
    found = {key: 1e3 * seconds for key, seconds in times.items()}
    return found | {"stages": sum(stages.values())}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table of the changes."""
    lines = []
    for name, goal in GOALS.items():
        for draft, word in MOVES.items():
            own = [row for row in of_kind(rows, "change") if (row["name"], row["draft"]) == (name, draft)]
            times = [min(row["wall"], row["cpu"]) for row in own]
            # The stages are by the clock on the wall, so their share is, too.
            parts = times, [row["wall"] for row in own], [row["wall"] - row["stages"] for row in own]
            cells = ["–" if (found := middle(part)) is None else found.text(0) for part in parts]
            lines.append([f"{name}, control {word}", *cells, str(goal) if draft else ""])
    settings = rows[0]["settings"]
    caption = (
        f"From a control's message to the picture at {settings['size']}, {settings['lights']}: medians of "
        f"{settings['rounds']} rounds (95 % intervals), milliseconds."
    )
    header = ["", "without waiting", "by the clock", "of it the widget's own", "goal"]
    return [Table(caption, header, lines)]


if __name__ == "__main__":
    run(main)
