"""Time of a frame as a sum of stages, whose prices follow from timed trials by non-negative least squares.

    t(x) = Σ_k price_k · work_k(x),   price_k ≥ 0

Work is counted in pixels at the size that a stage runs at, over those of the frame: light and shadow maps at
the size over scale and sampling, a level of a cascade at its cells for each of its steps.
A surrogate adds what the sum leaves (`TimeModel.residual`).

Source: Lawson and Hanson, *Solving least squares problems*, 1974, chapter 23.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from hyjax.choices.table import NO_STEPS
from hyjax.core.cascade import LEAST_SAMPLES
from hyjax.guide.choose import NO_GUIDE
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.surrogate import Surrogate

ALL_VIEWS = 24
"""Views that count for a soft light of which all are drawn."""
USUAL_GUIDE_SIZE = 512
"""Longer side of pictures, in pixels, that a network's work is relative to."""
RIDGE = 0.02
"""Weight that keeps prices small where trials do not tell them."""
RESIDUAL_NOISE = 0.05
"""Standard deviation of the logarithm of a measured time."""
SHORTEST_RATIO = 1e-3
"""Time over the default's; shorter ones count as this one."""


def stage_work(space: Space, choices: Mapping[str, Any]) -> Float[np.ndarray, "k"]:
    """Work of each stage under choices."""
    values = dict(space.fixed) | {p.name: p.default for p in space.parameters} | dict(choices)
    seen = space.seen(values)
    scale, sampling = values.get("scale", 1), values.get("sampling", 1)
    pixels = 1.0 / (scale * sampling) ** 2  # of the size that is worked at
    views = min(values.get("views") or ALL_VIEWS, ALL_VIEWS) / ALL_VIEWS
    guide, divided = values.get("guide", NO_GUIDE), values.get("photo_light") == "divided"
    network = (values.get("guide_size") or USUAL_GUIDE_SIZE) / USUAL_GUIDE_SIZE
    work = [
        1.0,  # composite and bytes, at full size
        pixels,
        pixels * views / (1 if sampling == 1 else LEAST_SAMPLES**2),
        pixels * views * (values.get("least_share", 0.0) == 0.0),
        pixels * values.get("map_scale", 1.0),
        pixels * (divided + (divided and bool(values.get("bounces")))),
        pixels * (guide != NO_GUIDE),
        network**2 * (guide not in (NO_GUIDE, "rgb")),
        pixels * (values.get("upsampling") == "guide"),
        pixels * (values.get("pooling") == "edges"),
    ]
    for cascade in ("cascade", "shadow_pass"):
        levels = () if seen.get(cascade, NO_STEPS) == NO_STEPS else space.levels(values, cascade)
        cells = [(1 / (scale * max(factor, sampling)) ** 2, steps) for factor, steps in levels]
        work.append(sum(count for count, _ in cells))
        work.append(sum(count * steps for count, steps in cells))
    return np.array(work, float)


@dataclasses.dataclass(frozen=True)
class TimeModel:
    """Times of choices over the default's, from trials.

    Attributes:
        residual: of the logarithms of times over the sum of stages.
    """

    space: Space
    prices: Float[np.ndarray, "k"]
    residual: Surrogate

    @classmethod
    def fit(cls, space: Space, trials: Sequence[Choices], times: Sequence[float]) -> "TimeModel":
        """Model of timed trials.

        Args:
            times: of them, over the default's.
        """
        work = np.stack([stage_work(space, choices) for choices in trials])
        measured = np.maximum(np.asarray(times, float), SHORTEST_RATIO)
        # Relative errors, and each stage's price over the work that the dearest trial has of it.
        size = np.maximum(work.max(axis=0), 1e-12)
        rows = np.concatenate([work / size / measured[:, None], RIDGE * np.eye(len(size))])
        found, _ = nnls(rows, np.concatenate([np.ones(len(measured)), np.zeros(len(size))]))
        prices = found / size
        left = np.log(measured) - np.log(np.maximum(work @ prices, SHORTEST_RATIO))
        noise = np.full(len(trials), RESIDUAL_NOISE)
        return cls(space, prices, Surrogate.fit(space, list(trials), left, noise))

    def stages(self, choices: Sequence[Choices]) -> Float[np.ndarray, "n"]:
        """Sum of the stages alone."""
        work = np.stack([stage_work(self.space, each) for each in choices])
        return np.maximum(work @ self.prices, SHORTEST_RATIO)

    def __call__(self, choices: Sequence[Choices]) -> Float[np.ndarray, "n"]:
        """Times over the default's."""
        return self.stages(choices) * np.exp(self.residual.predict(choices)[0])
