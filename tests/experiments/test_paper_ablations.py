"""The ablations and explanatory figures, small, from end to end; and what shadows are judged by."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import ablation_cascade, ablation_shadow, structure
from experiments.ablation_shadow import compare
from experiments.records import read_rows
from hyjax.data.builtin_room import RoomCapture
from hyjax.geometry.mesh import save_mesh
from hyjax.util.errors import InputError

SIZE = 96
Shadow = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture(scope="module")
def true_mesh(room: RoomCapture, tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("mesh") / "true.ply"
    save_mesh(file, room.reference())
    return str(file)


def square(left: int, size: int = 64) -> Shadow:
    """Visibility with a shadow of 20 pixels a side."""
    visible = np.ones((size, size))
    visible[20:40, left : left + 20] = 0.0
    return visible


def test_the_true_shadow_is_perfect() -> None:
    everywhere = np.ones((64, 64), bool)
    assert compare(square(20), square(20), everywhere) == {"overlap": 1.0, "edge_error": 0.0, "border_offset": 0.0}


def test_a_shifted_shadow() -> None:
    found = compare(square(25), square(20), np.ones((64, 64), bool))
    assert found is not None
    assert found["overlap"] == pytest.approx(15 / 25)
    assert 1.0 < found["border_offset"] < 5.0  # two of four sides moved by five


def test_a_lost_shadow_is_the_worst() -> None:
    found = compare(np.ones((64, 64)), square(20), np.ones((64, 64), bool))
    assert found is not None
    assert found["overlap"] == 0.0 and found["border_offset"] == ablation_shadow.FARTHEST_PIXELS


def test_no_shadow_is_not_judged_and_what_does_not_count_is_not_either() -> None:
    lit, counted = np.ones((64, 64)), np.ones((64, 64), bool)
    assert compare(lit, lit, counted) is None
    counted[:, 32:] = False
    changed = square(20)
    changed[:, 45:] = 0.0
    assert compare(changed, square(20), counted) == compare(square(20), square(20), counted)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_reference")
def test_ablation_of_the_cascade(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation_cascade, "SWEEP", (50, 1000, ablation_cascade.CONVERGED))
    config = ablation_cascade.Config(
        capture=scan, mesh="captured", reference="fused", frames=1, size=SIZE, repeats=3, out=tmp_path
    )
    ablation_cascade.main(config)
    rows = read_rows(tmp_path / "rows.jsonl")
    found = {(r["mode"], r["schedule"]): r for r in rows if r["kind"] == "distance"}
    converged = f"naive-{ablation_cascade.CONVERGED}"
    for mode in ("paper", "linear"):
        distance = {name: found[mode, name]["to_converged"] for name in ("naive-50", "naive-1000", "paper-50")}
        assert 0.0 < distance["naive-1000"] < 0.7 * distance["naive-50"]
        assert 0.0 < distance["paper-50"] < distance["naive-50"] < 0.5
        # The converged result is not the accurate surface's, and its frame not that surface's.
        assert found[mode, converged]["to_converged"] == 0.0 < 0.005 < found[mode, converged]["to_accurate"] < 0.5
        assert all(10 < found[mode, name]["psnr"] < 60 for name in (*distance, converged))
    for name in ("naive-50", "paper-50", converged):  # the modes are no one thing under two names
        for key in ("to_accurate", "psnr"):
            assert found["paper", name][key] != pytest.approx(found["linear", name][key], rel=1e-3)
    assert {r["schedule"] for r in rows if r["kind"] == "time"} == set(ablation_cascade.SCHEDULES)
    for name in ("side_by_side.png", "steps.png", "ablation_cascade.md"):
        assert (tmp_path / name).stat().st_size > 100


def test_distances_of_filters_are_of_display_values_where_they_count() -> None:
    a, b = jnp.full((2, 2, 3), 0.5), jnp.full((2, 2, 3), 0.25).at[0].set(0.5)
    lower = jnp.array([[0.0, 0.0], [1.0, 1.0]])
    assert ablation_cascade.rms(a, b, lower, "paper") == pytest.approx(0.25, rel=1e-5)
    assert ablation_cascade.rms(a, b, jnp.ones((2, 2)), "paper") == pytest.approx(0.25 / 2**0.5, rel=1e-5)
    assert ablation_cascade.rms(a, b, lower, "linear") == pytest.approx(0.735357 - 0.537099, rel=1e-4)


@pytest.mark.slow
def test_ablation_of_the_shadow_pass(
    room: RoomCapture, scan: Path, true_mesh: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a rough surface that lies 10 cm off, and on the accurate one."""
    monkeypatch.setattr(ablation_shadow, "STEPS", (0, 8))
    rough = room.reference().copy()
    rough.apply_translation((0.1, 0.1, 0.0))
    save_mesh(tmp_path / "rough.ply", rough)
    config = ablation_shadow.Config(
        capture=scan, mesh=str(tmp_path / "rough.ply"), reference=true_mesh, frames=2, size=SIZE, out=tmp_path
    )
    ablation_shadow.main(config)
    scores = [r for r in read_rows(tmp_path / "rows.jsonl") if r["kind"] == "score"]

    def mean(surface: str, mode: str, method: str, steps: int = 0, key: str = "overlap") -> float:
        wanted = (surface, mode, method, 1, steps)
        keys = ("surface", "mode", "method", "factor", "steps")
        return float(np.mean([r[key] for r in scores if tuple(r[k] for k in keys) == wanted]))

    for mode in ("paper", "linear"):
        assert mean("accurate", mode, "raw") == 1.0
        assert mean("accurate", mode, "together") + 0.05 < mean("accurate", mode, "separate", 8) < 1.0
        assert mean("rough", mode, "raw") < 0.95 and mean("rough", mode, "raw", key="border_offset") > 0.5
    # Without a step the separate pass is what it starts from.
    assert mean("rough", "paper", "separate", 0) == mean("rough", "paper", "raw")
    assert mean("rough", "paper", "separate", 8) != mean("rough", "paper", "raw")
    for name in ("side_by_side.png", "steps.png", "ablation_shadow.md"):
        assert (tmp_path / name).stat().st_size > 100


@pytest.mark.parametrize("experiment", [ablation_cascade, ablation_shadow])
def test_a_reference_that_no_frame_sees(experiment: Any, room: RoomCapture, scan: Path, tmp_path: Path) -> None:
    far = room.reference().copy()
    far.apply_translation((500.0, 0.0, 0.0))
    save_mesh(tmp_path / "far.ply", far)
    config = experiment.Config(capture=scan, reference=str(tmp_path / "far.ply"), size=SIZE, out=tmp_path / "out")
    with pytest.raises(InputError, match="no ray of any frame met both surfaces"):
        experiment.main(config)


def test_structure_comes_out_of_noise(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structure, "STEPS", (10, 1000))
    structure.main(structure.Config(capture=scan, size=SIZE, out=tmp_path))
    found = {r["schedule"]: r for r in read_rows(tmp_path / "rows.jsonl") if r["kind"] == "spread"}
    assert found["noise"]["between"] < 0.2 < found["1000 steps"]["between"]
    assert found["1000 steps"]["variance"] < found["10 steps"]["variance"] < found["noise"]["variance"]


def test_no_repeats_are_refused_before_the_first_slow_step(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="repeats: must be at least 1"):
        ablation_cascade.main(ablation_cascade.Config(capture=scan, repeats=0, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_size_too_small(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="size: must be at least 64"):
        structure.main(structure.Config(capture=scan, size=7, out=tmp_path))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("frame", "message"), [(9, "past the end"), (-9, "past the end")])
def test_frames_that_are_not_there(scan: Path, tmp_path: Path, frame: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        structure.main(structure.Config(capture=scan, frame=frame, out=tmp_path))
