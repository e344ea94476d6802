"""What schedules cost on a machine that tests can rely on: an additive model's times, and no clock."""

import numpy as np

from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.factors import FACTORS

# Roughly what 512x512 with two lights costs on two cores.
TRUTH = CostModel(
    fixed=1.2,
    level=(0.5, 0.3, 0.5, 0.5, 0.8, 1.0),
    step=(0.002, 0.003, 0.004, 0.016, 0.076, 0.34),
    finest=(3.5, 0.4, 0.3, 0.1, 0.2, 0.0),
)


def random_steps(count: int = 40) -> list[list[int]]:
    """Steps over the factors, some levels left out, the same every time."""
    rng = np.random.default_rng(3)
    rows = (rng.integers(0, 2, len(FACTORS)) * rng.integers(1, 40, len(FACTORS)) for _ in range(2 * count))
    return [row.tolist() for row in rows if row.any()][:count]
