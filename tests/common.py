"""What `conftest.py` and single tests share."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hyjax.util.quick_programs import QUICK_OPTIONS

if TYPE_CHECKING:
    import trimesh

    from hyjax.data.builtin_room import RoomCapture

# Most of what tests compile runs once: optimising it takes longer than it saves, and so do fusion emitters.
UNOPTIMISED = " ".join(
    f"--{name}={str(value).lower()}"
    for name, value in {**QUICK_OPTIONS, "xla_cpu_parallel_codegen_split_count": 1}.items()
)


def data_folder() -> Path:
    """$HYJAX_DATA, or shared/data beside the checkout."""
    return Path(os.environ.get("HYJAX_DATA") or Path(__file__).parents[2] / "shared" / "data")


def without_gradients(patch: pytest.MonkeyPatch) -> None:
    """Have a tuning run of the diffusion propose nothing by gradients, which are compiled for most of a minute."""
    from hyjax.tuning.cascade import CascadeStage
    from hyjax.tuning.evaluator import CascadeEvaluator

    patch.setattr(CascadeEvaluator, "refined", lambda _, choices, batch: choices)
    patch.setattr(CascadeEvaluator, "relaxed", lambda _, choices, trial: choices)
    patch.setattr(CascadeStage, "polished", lambda _, configuration, expired: configuration)


def coarse_surface(room: "RoomCapture") -> "trimesh.Trimesh":
    """The room's surface by a tenth of its vertices, for each of which light transport is traced."""
    return room.reference().simplify_quadric_decimation(face_count=24_000)
