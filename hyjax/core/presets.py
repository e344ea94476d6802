"""Presets of schedules: ours, the paper's, and its baselines."""

import dataclasses
from typing import Any

# The paper names no κ; these are for display-encoded RGB guides in [0, 1] and
# norm l2: with pooled edges by experiments/guide_worth.py (best for our mode 0.005 to 0.02, the paper's 0.05 to
# 0.2). κ, α and steps of our presets were chosen together, by hand, on tuning frames of 7-Scenes' kitchen (five of
# its first three quarters) and of the built-in room (seed 0): a flat optimum.
DEFAULT_KAPPA = 0.02
PAPER_KAPPA = 0.05
GUIDED_KAPPA = 0.05
GUIDED_FIDELITY = 0.1


@dataclasses.dataclass(frozen=True)
class Preset:
    """Steps and options of a named schedule.

    Attributes:
        steps: (downsampling factor of the full frame, steps); the paper writes 512/factor instead.
        options: of `Schedule.uniform`, where they are not its defaults.
    """

    steps: tuple[tuple[int, int], ...]
    options: dict[str, Any] = dataclasses.field(default_factory=dict)


GUIDED_OPTIONS: dict[str, Any] = {
    "kappa": GUIDED_KAPPA,
    "fidelity": GUIDED_FIDELITY,
    "pooling": "guide",
    "upsampling": "guide",
}

PRESETS: dict[str, Preset] = {
    # Ours: of the shading, of the visibility, and of a scan's, whose rims are frayed by centimetres.
    "hyjax": Preset(((16, 3), (8, 4), (4, 6)), GUIDED_OPTIONS),
    "hyjax-shadow": Preset(((1, 2),)),
    "hyjax-scan-shadow": Preset(((4, 5), (1, 2))),
    # The paper's.
    "paper-50": Preset(((16, 5), (8, 10), (4, 15), (2, 20))),
    "paper-80": Preset(((16, 10), (8, 15), (4, 25), (2, 30))),
    # Of this one it says "reducing the number of iterations and maintaining operation at higher resolutions".
    "shadow": Preset(((1, 8),)),
    "naive-50": Preset(((2, 50),)),
    "naive-1000": Preset(((2, 1000),)),
}
