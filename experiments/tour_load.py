"""The room tour under load: memory, open files and answers while two visitors change things.

    python -m experiments.tour_load [--minutes 60] [--size 256] [--out results/tour_load]

Takes as many minutes as it is told, and a core. Needs the extra `tour`. The tour of the built-in room runs in a
process of its own; the visitors speak its page's protocol over websockets, without a browser. A round is one change
(hour, sky, exposure, or a lamp put somewhere), after which every visitor waits for its picture. Now and then a
visitor breaks its connection and comes back, an upload breaks off halfway, and meshes come that are good, that are
none at the largest size allowed, or larger.

Expect: a picture for each change, open files that stay where they were, and memory that grows only until the tour's
caches are full (at 256 x 256 after more than 40 minutes).
"""

import dataclasses
import functools
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

import numpy as np
from tqdm import tqdm

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import panels
from experiments.records import Results, Row, machine, of_kind
from experiments.tour_latency import resident, served, wait_until_still
from experiments.tour_visitor import Visitor
from hyjax.tour.sky import Weather
from hyjax.tour.tools import MOST_UPLOADED
from hyjax.util.errors import InputError

EVERY = 10.0
"""Seconds between two samples."""
SETTLED = 300.0
"""Seconds after which memory must no longer grow."""
WAIT = 120.0
"""Seconds for a picture, after which it counts as not answered."""
FIRST_WAIT = 900.0
"""Seconds for the first one."""
QUIET = 0.4
"""Seconds without a picture until the next change, so that a finer picture is not taken for the next one's."""
REACTION = 0.5
"""Seconds between choosing a lamp and the click that puts it."""
LONGEST_REST = 10.0
"""Seconds that are waited for such a pause."""
VISITORS = 2
LAMPS = "Bulb", "Spot", "Strip"
"""Not candles, whose pictures follow each other without an end."""
UPLOAD, REFUSAL = "Bring a mesh", "That does not work"
"""Label of a button, and title of a notice."""
ORIGIN = (0.0, 0.0, 1.4)
"""Within the built-in room, which clicks start from."""


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    minutes: float = 60.0
    size: int = 256
    """Pixels a side."""
    pause: float = 0.5
    """Seconds between two changes."""
    seed: int = 0
    """Of the order of changes."""


@experiment("The room tour under load")
def main(config: Config, start: Start) -> None:
    if config.minutes <= 0 or config.pause < 0:
        raise InputError("minutes: must be above 0, and the pause not below")
    results = start()
    with served(config.size) as (url, process):
        load = Load(url, np.random.default_rng(config.seed))
        wait_until_still(process.pid)
        begun, sampled = time.monotonic(), -np.inf
        with tqdm(total=round(60 * config.minutes), unit="s", desc="load") as bar:
            while (now := time.monotonic() - begun) < 60 * config.minutes:
                if process.poll() is not None:
                    raise InputError("tour_load: the tour has ended; see above")
                if now - sampled >= EVERY:
                    sampled = now
                    _sample(results, now, process.pid, load)
                    bar.update(round(now) - bar.n)
                load.round()
                time.sleep(config.pause)
        load.leave()
        _sample(results, time.monotonic() - begun, process.pid, load)


class Load:
    """Visitors of a tour, and what they have done.

    Attributes:
        counts: of what was done and answered, by name.

    Args:
        url: of the tour.
        random: draws what is done next.
    """

    def __init__(self, url: str, random: np.random.Generator) -> None:
        self._url, self._random = url, random
        names = ("asked", "answered", "rounds", "breaks", "uploads", "refused uploads", "broken uploads")
        self.counts = dict.fromkeys(names, 0)
        self._visitors = [Visitor(url, 1.0 + 0.5 * number) for number in range(VISITORS)]
        for visitor in self._visitors:
            visitor.wait_for_controls("Hour", "Weather", "Exposure", UPLOAD, "Begin anew")
        self._box, self._weather = _box(), 0
        for lamp in LAMPS:  # until all is compiled
            self._ask(functools.partial(self._put_lamp, lamp=lamp), FIRST_WAIT)
        for change in self._changes():
            self._ask(change, FIRST_WAIT)
        self.counts = dict.fromkeys(self.counts, 0)

    def round(self) -> None:
        """One change, and the pictures after it."""
        self.counts["rounds"] += 1
        number = self.counts["rounds"]
        if number % 25 == 0:
            self._come_back()
        if number % 60 == 30:
            self._upload("stool.ply", self._box)
        if number % 150 == 10:
            self._upload("noise.ply", bytes(MOST_UPLOADED))
            self._upload("large.ply", bytes(MOST_UPLOADED + 1))
        if number % 90 == 0:
            self._visitors[self.counts["breaks"] % VISITORS].upload(UPLOAD, "half.ply", bytes(8 << 20), share=0.5)
            self.counts["broken uploads"] += 1
            self._come_back()
        if number % 40 == 0:
            self._visitors[0].set("Begin anew", True)
            self._weather = 0
            self._settle()
        self._ask(self._changes()[self._random.integers(len(self._changes()))])

    def leave(self) -> None:
        """Close all pages."""
        for visitor in self._visitors:
            visitor.leave()

    def _changes(self) -> list[Callable[[Visitor], None]]:
        draw = self._random.uniform
        return [  # not rounded: the same value again would be no change
            lambda visitor: visitor.set("Hour", draw(6, 20)),
            self._turn_weather,
            lambda visitor: visitor.set("Exposure", draw(-2, 2)),
            lambda visitor: visitor.set("North", draw(0, 360)),
            self._put_lamp,
        ]

    def _turn_weather(self, visitor: Visitor) -> None:
        self._weather = (self._weather + 1) % len(get_args(Weather))
        visitor.set("Weather", get_args(Weather)[self._weather])

    def _put_lamp(self, visitor: Visitor, lamp: str | None = None) -> None:
        visitor.set(lamp or str(self._random.choice(LAMPS)), True)
        time.sleep(REACTION)  # or the click comes first, and puts nothing
        angle = self._random.uniform(0, 2 * np.pi)
        visitor.click((float(np.cos(angle)), float(np.sin(angle)), -0.5), ORIGIN)

    def _ask(self, change: Callable[[Visitor], None], wait: float = WAIT) -> None:
        """Make a change as one visitor, and wait until all have a picture of it, or it was refused."""
        visitor = self._visitors[self.counts["rounds"] % VISITORS]
        before, refused = [each.pictures for each in self._visitors], visitor.answers.get(REFUSAL, 0)
        change(visitor)
        end = time.monotonic() + wait
        waiting = set(range(VISITORS))
        while waiting and time.monotonic() < end:
            waiting -= {k for k in waiting if self._visitors[k].pictures > before[k]}
            if visitor.answers.get(REFUSAL, 0) > refused:  # a lamp that would hang nowhere
                waiting.clear()
            time.sleep(0.005)
        self.counts["asked"] += VISITORS
        self.counts["answered"] += VISITORS - len(waiting)
        self._settle()

    def _settle(self) -> None:
        """Wait until no more pictures come."""
        end = time.monotonic() + LONGEST_REST
        while time.monotonic() < end:
            if all(each.pictures and time.monotonic() - each.last > QUIET for each in self._visitors):
                return
            time.sleep(0.02)

    def _come_back(self) -> None:
        """Break a visitor's connection, and open another in its place."""
        place = self.counts["breaks"] % VISITORS
        self._visitors[place].vanish()
        self._visitors[place] = Visitor(self._url, 1.0 + 0.5 * place)
        self._visitors[place].wait_for_controls("Hour", UPLOAD, "Begin anew")
        self.counts["breaks"] += 1
        self._settle()

    def _upload(self, name: str, content: bytes) -> None:
        """Upload a file, and wait for the notice where it is refused."""
        visitor = self._visitors[0]
        refused = visitor.answers.get(REFUSAL, 0)
        visitor.upload(UPLOAD, name, content)
        self.counts["uploads"] += 1
        end = time.monotonic() + (5.0 if content is self._box else WAIT)
        while time.monotonic() < end:
            if visitor.answers.get(REFUSAL, 0) > refused:
                self.counts["refused uploads"] += 1
                break
            time.sleep(0.05)
        self._settle()


def _box() -> bytes:
    import trimesh

    content: bytes = trimesh.creation.box((0.4, 0.4, 1.2)).export(file_type="ply")
    return content


def _sample(results: Results, seconds: float, pid: int, load: Load) -> None:
    files = len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208
    threads = len(os.listdir(f"/proc/{pid}/task"))  # noqa: PTH208
    numbers = {"mebibytes": resident(pid), "open_files": files, "threads": threads}
    results.add(kind="sample", seconds=seconds, **numbers, counts=dict(load.counts))


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    samples = of_kind(rows, "sample")
    if len(samples) < 2:
        return ["No load has been measured yet."]
    last = samples[-1]
    settled = min(SETTLED, 0.5 * last["seconds"])
    early = [row for row in samples if settled <= row["seconds"] < settled + 60] or samples[:1]
    late = [row for row in samples[:-1] if row["seconds"] >= last["seconds"] - 60] or samples[-2:-1]
    rows_of = []
    for label, name in (("memory, MiB", "mebibytes"), ("open files", "open_files"), ("threads", "threads")):
        before, after = (float(np.median([row[name] for row in part])) for part in (early, late))
        most = max(row[name] for row in samples)
        change = f"{100 * (after / before - 1):+.1f} %"
        rows_of.append([label, f"{before:.0f}", f"{after:.0f}", change, f"{most:.0f}"])
    counts = last["counts"]
    header = ["", f"after {settled / 60:.1f} minutes", "in the last minute", "change", "most"]
    text = (
        f"{counts['rounds']} changes in {last['seconds'] / 60:.0f} minutes by {VISITORS} visitors; "
        f"{machine(last)}. {counts['answered']} of {counts['asked']} pictures came. {counts['breaks']} connections "
        f"broke off, {counts['broken uploads']} uploads with them; of {counts['uploads']} whole uploads "
        f"{counts['refused uploads']} were refused."
    )
    minutes = [row["seconds"] / 60 for row in samples]
    kinds = {"memory of the tour, MiB": "mebibytes", "open files": "open_files"}
    curves = {title: {title: (minutes, [row[name] for row in samples])} for title, name in kinds.items()}
    return [
        Table(f"Medians of a minute; {text}", header, rows_of),
        Plot("load", "Memory and open files of the tour.", panels(curves, "-", xlabel="minutes", ylim=(0, None))),
    ]


if __name__ == "__main__":
    run(main)
