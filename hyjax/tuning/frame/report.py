"""Report of a run on the whole frame: configurations, table, plot, contact sheet and page."""

from pathlib import Path

from hyjax.tuning.frame.result import FrameTuned
from hyjax.util.files import write_text


def summary(tuned: FrameTuned) -> list[str]:
    """Sentences that say what came out."""
    return [f"{c.name}: {c.time.median:.1f} ms, {c.tuning['relative']:.3f}" for c in tuned.best]


def write_results(out: Path, tuned: FrameTuned) -> None:
    """Write all files of a run.

    Raises:
        InputError: a file cannot be written.
    """
    write_text(out / "configuration.json", tuned.configuration.to_json() + "\n")
