"""The best schedule for a frame rate on this device: `hyjax tune` as a function."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from hyjax.data.capture import Capture
from hyjax.guide.choose import open_guide
from hyjax.tuning.bench import open_bench
from hyjax.tuning.journal import check_free
from hyjax.tuning.result import Tuned
from hyjax.tuning.run import tune_bench
from hyjax.tuning.search import Effort
from hyjax.tuning.settings import TuneSettings
from hyjax.util.files import make_writable


def tune(
    *,
    settings: TuneSettings | None = None,
    fps: float | Sequence[float] | None = None,
    budget_ms: float | Sequence[float] | None = None,
    capture: Capture | None = None,
    effort: Effort | None = None,
) -> Tuned:
    """Find, on this device, the schedule whose relit frames come closest to the target's within each time budget.

    Args:
        settings: what to tune for and on; a budget, in them or below, is all that is needed.
        fps: frame rates, one or several, in the place of the settings'.
        budget_ms: budgets in milliseconds, likewise.
        capture: frames that were opened before, in the place of those that the settings name.
        effort: how long to look at each budget.

    Returns:
        Schedules, measured, with their history and the front of quality against time. Its `schedule` goes into
        `hyjax.relight` as it is.

    Raises:
        InputError: any of these cannot be used, or a budget is out of reach on this device.
    """
    settings = settings or TuneSettings()
    if fps is not None:
        settings = dataclasses.replace(settings, fps=_several(fps))
    if budget_ms is not None:
        settings = dataclasses.replace(settings, budget_ms=_several(budget_ms))
    settings.check()
    guide = open_guide(settings.guide)
    if settings.joint:
        from hyjax.tuning.joint import check_joint  # with flax, which only learned guides need

        check_joint(guide, settings.out)
    if settings.out is not None:
        make_writable(settings.out)
        check_free(settings.out, settings.resume)
    return tune_bench(open_bench(settings, capture=capture, guide=guide), settings, effort=effort)


def _several(values: float | Sequence[float]) -> tuple[float, ...]:
    return tuple(float(value) for value in np.atleast_1d(np.asarray(values, float)))
