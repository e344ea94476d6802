"""The best schedule for a frame rate on this device: what `hyjax tune` does, as a function."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hyjax.data.capture import Capture
from hyjax.files import make_writable
from hyjax.guide.choose import open_guide
from hyjax.tuning.bench import check_names, open_bench
from hyjax.tuning.clocked import Stage
from hyjax.tuning.journal import check_free
from hyjax.tuning.request import parse_budgets, split_frames
from hyjax.tuning.result import Tuned
from hyjax.tuning.run import tune_bench
from hyjax.tuning.search import Effort
from hyjax.tuning.watch import check_time_limit


def tune(
    *,
    fps: float | Sequence[float] = (),
    budget_ms: float | Sequence[float] = (),
    capture: Capture | Path | str | None = None,
    mesh: str | None = None,
    target: str | None = None,
    lights: str = "two-colors",
    stage: Stage = "cascade",
    frames: str | None = None,
    holdout: str | None = None,
    size: tuple[int, int] | None = (512, 512),
    guide: str = "rgb",
    seed: int = 0,
    time_limit: float | None = None,
    effort: Effort | None = None,
    extra: bool = True,
    joint: bool = False,
    recalibrate: bool = False,
    voxel: float = 0.03,
    repair_mesh: bool = False,
    out: Path | str | None = None,
    resume: bool = False,
    settings: dict[str, Any] | None = None,
    progress: bool = True,
) -> Tuned:
    """Find, on this device, the schedule whose relit frames come closest to the target's within each time budget.

    Args:
        fps: frame rates, one or several.
        budget_ms: budgets in milliseconds, besides or instead.
        capture: frames with poses, or the folder that holds them; None for the built-in room.
        mesh: the rough one, see `open_bench`.
        target: the accurate one, see `open_bench`.
        lights: a named set-up or a lights file.
        stage: whether the budgets are for the diffusion (`"cascade"`) or for the whole frame (`"frame"`).
        frames: what to tune on, as for `hyjax relight --frames`; default: four of the first three quarters.
        holdout: what is only reported on; default: four of the last quarter.
        size: (height, width) to work at; None as captured.
        guide: what guides the diffusion, see `open_guide`; `"rgb"` is the frame itself.
        seed: of the search and of the simulated scan. The same seed on the same latency table makes the same search
            (unless a time limit cuts it short); the clock has the last word on what fits.
        time_limit: seconds after which the search only finishes what it has.
        effort: how long to look at each budget.
        extra: also tune for a few more budgets, which draw the curve of quality against time.
        joint: also tune the last layer of a learned guide with κ, λ and α of the best schedule for the first
            budget; needs `out`, where `guide.safetensors` and `joint.json` are then.
        recalibrate: make the device's latency table anew.
        voxel: of a fused `mesh`, in metres.
        repair_mesh: drop unusable triangles of a mesh file instead of refusing it.
        out: folder for schedules, table, plot and report, written as they are found; None writes nothing.
        resume: go on with what an interrupted run left in `out`.
        settings: recorded as they are.
        progress: show bars on stderr.

    Returns:
        Schedules, measured, with their history and the front of quality against time. Its `schedule` goes into
        `hyjax.relight` as it is.

    Raises:
        InputError: any of these cannot be used, or a budget is out of reach on this device.
    """
    budgets = parse_budgets(_several(fps), _several(budget_ms))
    opened = open_guide(guide)
    if joint:
        from hyjax.tuning.joint import check_joint

        check_joint(opened, None if out is None else Path(out))
    check_names(mesh, target, lights)
    check_time_limit(time_limit)
    if out is not None:
        out = Path(out)
        make_writable(out)
        check_free(out, resume)
    bench = open_bench(
        capture,
        mesh,
        target,
        lights,
        size=size,
        guide=opened,
        voxel=voxel,
        seed=seed,
        repair=repair_mesh,
        progress=progress,
    )
    chosen, held = split_frames(len(bench.capture), frames, holdout)
    return tune_bench(
        bench,
        budgets,
        frames=chosen,
        holdout=held,
        stage=stage,
        seed=seed,
        time_limit=time_limit,
        effort=effort,
        extra=extra,
        joint=joint,
        recalibrate=recalibrate,
        out=out,
        resume=resume,
        settings=(settings or {}) | {"meshes": bench.description},
        progress=progress,
    )


def _several(values: float | Sequence[float]) -> list[float]:
    return [float(value) for value in np.atleast_1d(np.asarray(values, float))]
