"""Learning curve of a training run as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hyjax.util.files import atomic_write

SMOOTHING = 50
"""Number of updates of the moving average."""


def draw_curve(path: Path, lines: Sequence[dict[str, Any]]) -> None:
    """Write losses over iterations as a PNG."""
    from matplotlib.figure import Figure

    updates = [line for line in lines if "loss" in line]
    validations = [line for line in lines if "validation" in line]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    iterations = np.array([line["iteration"] for line in updates])
    losses = np.array([line["loss"] for line in updates])
    axes.plot(iterations, losses, color="0.75", lw=0.5, label="training")
    if len(losses) >= SMOOTHING:
        mean = np.convolve(losses, np.full(SMOOTHING, 1 / SMOOTHING), mode="valid")
        axes.plot(iterations[SMOOTHING - 1 :], mean, color="0.5", label=f"training, mean of {SMOOTHING}")
    if validations:
        at = [line["iteration"] for line in validations]
        axes.plot(at, [line["validation"]["loss"] for line in validations], "o-", ms=3, label="validation")
        axes.axhline(
            validations[-1]["validation"]["rgb"]["loss"], ls="--", color="k", lw=1, label="validation, RGB guide"
        )
    axes.legend()
    axes.set(xlabel="iteration", ylabel="loss", yscale="log")
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=120)
