"""Difference of two runs of `paper_table` on the same frames, such as under another guide.

    python -m experiments.paper_difference --first results/paper_table/a --second results/paper_table/b
        [--out results/paper_difference]

Second minus first, frame by frame, so that what frames differ in among themselves does not hide what the two runs
differ in. Each method multiplies as it is meant to. Takes a second; both runs must be finished or be resumed first.

Expect: small differences with small intervals, where the two tables' own intervals overlap by far."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.judging import better_text, pick, summarise, text_of
from experiments.paper_bench import BENCHMARKS, METHODS, OWN_GROUP
from experiments.plotting import panels
from experiments.records import FILE, Row, is_finished, of_kind, read_rows
from hyjax.metrics import METRICS
from hyjax.util.errors import InputError

SAME = ("capture", "size", "seed")
"""Settings that decide what pictures are judged."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    first: Path
    """Folder of a run of `paper_table`."""
    second: Path
    """Folder of another."""


@experiment("One run of the benchmarks against another")
def main(config: Config, start: Start) -> None:
    first, second = (judged(folder) for folder in (config.first, config.second))
    shared = sorted(first.keys() & second.keys())
    if not shared:
        raise InputError(
            f"second: {config.second} has judged no frame that {config.first} has; give runs on the same"
        )
    settings = [rows[shared[0]]["settings"] for rows in (first, second)]
    for name in SAME:
        ours, theirs = (own[name] for own in settings)
        if ours != theirs:
            told = f"second: {config.second} had {name} {theirs} and {config.first} {ours}"
            raise InputError(f"{told}; compare runs on the same pictures")
    results = start()
    for index in shared:
        for benchmark in BENCHMARKS:
            for mode, group in OWN_GROUP.items():
                for metric in METRICS:
                    place = ("scores", benchmark, group, METHODS[mode], "all", metric)
                    values = {"first": pick(first[index], *place), "second": pick(second[index], *place)}
                    row = {"index": index, "benchmark": benchmark, "method": METHODS[mode], "metric": metric}
                    results.add(kind="pair", **row, **values)


def judged(folder: Path) -> dict[int, Row]:
    """Index → row of the frames that a run has judged.

    Raises:
        InputError: there is no finished run of `paper_table`.
    """
    rows = read_rows(folder / FILE)
    if not is_finished(rows) or rows[-1]["experiment"] != "paper_table":
        raise InputError(f"{folder}: holds no finished run of paper_table")
    return {row["index"]: row for row in rows if row.get("scores")}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    pairs = of_kind(rows, "pair")
    if not pairs:
        return ["No two runs have been compared yet."]
    lines = []
    for benchmark in BENCHMARKS:
        for method in METHODS.values():
            cells = []
            for metric in METRICS:
                found = summarise(differences(pairs, benchmark, method, metric))
                cells.append(("+" if found is not None and found.mean >= 0 else "") + text_of(found, metric))
            lines.append([f"{benchmark}, {method}", *cells])
    settings = pairs[0]["settings"]
    caption = (
        f"{settings['second']} minus {settings['first']}: mean over {len({row['index'] for row in pairs})} frames "
        f"± 95 % interval. {better_text()}."
    )
    table = Table(caption, ["benchmark, method", *(metric.label for metric in METRICS.values())], lines)
    return [table, Plot(main.name, "Difference in PSNR, frame by frame.", figure(pairs))]


def differences(pairs: Sequence[Row], benchmark: str, method: str, metric: str) -> list[float]:
    """Second minus first of every frame that has both."""
    own = [r for r in pairs if (r["benchmark"], r["method"], r["metric"]) == (benchmark, method, metric)]
    return [row["second"] - row["first"] for row in own if None not in (row["first"], row["second"])]


def figure(pairs: Sequence[Row]) -> Figure:
    """A panel for each benchmark, the differences of each method in order."""
    shown: dict[str, dict[str, Any]] = {}
    for benchmark in BENCHMARKS:
        values = {method: np.sort(differences(pairs, benchmark, method, "psnr")) for method in METHODS.values()}
        shown[benchmark] = {method: (range(len(each)), each) for method, each in values.items()}
    return panels(shown, "-", xlabel="frames, in order", ylabel="PSNR, dB more")


if __name__ == "__main__":
    run(main)
