"""The ablations and explanatory figures, small, from end to end; and what shadows are judged by."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import paper, paper_cascade, paper_shadow, structure
from experiments.paper_bench import METHODS
from experiments.paper_shadow import compare
from experiments.records import of_kind, read_rows
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
    assert found["overlap"] == 0.0 and found["border_offset"] == paper_shadow.FARTHEST_PIXELS


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
    monkeypatch.setattr(paper_cascade, "SWEEP", (50, 1000, paper_cascade.CONVERGED))
    common: Any = {"mesh": "captured", "reference": "fused", "few": 1, "size": SIZE, "repeats": 3}
    config = paper.Config(capture=scan, parts=("cascade",), out=tmp_path, **common)
    paper.main(config)
    rows = read_rows(tmp_path / "rows.jsonl")
    found = {(r["mode"], r["schedule"]): r for row in of_kind(rows, "cascade") for r in row["scores"]}
    converged = f"naive-{paper_cascade.CONVERGED}"
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
    times = {(r["mode"], r["schedule"]): r for r in of_kind(rows, "time")}
    assert {name for _, name in times} == set(paper_cascade.SCHEDULES)
    for mode in ("paper", "linear"):
        assert times[mode, "paper-50"]["ratio"][0] == 1.0 < times[mode, "naive-1000"]["ratio"][0]
        assert times[mode, "naive-1000"]["ms"][0] > times[mode, "naive-50"]["ms"][0] > 0
    for name in ("cascade.png", "cascade_steps.png", "paper.md"):
        assert (tmp_path / name).stat().st_size > 100
    text = (tmp_path / "paper.md").read_text()
    assert f"at {SIZE} x {SIZE}" in text and f"commit {rows[0]['commit'][:10]}" in text and "cpu: " in text
    # With the rows there are, nothing is judged or timed again.
    monkeypatch.setattr(paper_cascade, "judge", None)
    monkeypatch.setattr(paper_cascade, "times", None)
    again = paper.main(dataclasses.replace(config, resume=True))
    assert [of_kind(again, kind) for kind in ("cascade", "time")] == [of_kind(rows, k) for k in ("cascade", "time")]
    # Killed between two rows of times, it adds those that are missing.
    path, told = tmp_path / "rows.jsonl", of_kind(rows, "time")
    lines = [json.dumps(row) + "\n" for row in (*of_kind(rows, "cascade"), *told[:4])]
    path.write_text("".join(lines))
    timed = [{key: row[key] for key in ("mode", "schedule", "rounds", "ms", "ratio")} for row in told]
    monkeypatch.setattr(paper_cascade, "times", lambda *_: timed)
    again = of_kind(paper.main(dataclasses.replace(config, resume=True)), "time")
    assert [(row["mode"], row["schedule"]) for row in again] == [(row["mode"], row["schedule"]) for row in told]
    # Ablations are no benchmarks: of these still no frame can be judged.
    monkeypatch.setattr("experiments.paper.load_lpips", lambda _: {})
    monkeypatch.setattr("experiments.paper_bench.Bench.row", lambda _, index, __: {"index": index})
    path.write_text("".join(lines).replace('["cascade"]', '["benchmarks", "cascade"]'))
    with pytest.raises(InputError):
        paper.main(dataclasses.replace(config, parts=("benchmarks", "cascade"), frames="0", resume=True))


def test_distances_of_filters_are_of_display_values_where_they_count() -> None:
    a, b = jnp.full((2, 2, 3), 0.5), jnp.full((2, 2, 3), 0.25).at[0].set(0.5)
    lower = jnp.array([[0.0, 0.0], [1.0, 1.0]])
    assert paper_cascade.rms(a, b, lower, "paper") == pytest.approx(0.25, rel=1e-5)
    assert paper_cascade.rms(a, b, jnp.ones((2, 2)), "paper") == pytest.approx(0.25 / 2**0.5, rel=1e-5)
    assert paper_cascade.rms(a, b, lower, "linear") == pytest.approx(0.735357 - 0.537099, rel=1e-4)


@pytest.mark.slow
def test_ablation_of_the_shadow_pass(
    room: RoomCapture, scan: Path, true_mesh: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a rough surface that lies 10 cm off, and on the accurate one."""
    monkeypatch.setattr(paper_shadow, "STEPS", (0, 8))
    rough = room.reference().copy()
    rough.apply_translation((0.1, 0.1, 0.0))
    save_mesh(tmp_path / "rough.ply", rough)
    surfaces = {"mesh": str(tmp_path / "rough.ply"), "reference": true_mesh}
    paper.main(paper.Config(capture=scan, parts=("shadow",), few=2, size=SIZE, out=tmp_path, **surfaces))
    scores = [r for row in of_kind(read_rows(tmp_path / "rows.jsonl"), "shadow") for r in row["scores"]]

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
    for name in ("shadow.png", "shadow_steps.png", "paper.md"):
        assert (tmp_path / name).stat().st_size > 100


@pytest.mark.parametrize("part", ["cascade", "shadow"])
def test_a_reference_that_no_frame_sees(part: Any, room: RoomCapture, scan: Path, tmp_path: Path) -> None:
    far = room.reference().copy()
    far.apply_translation((500.0, 0.0, 0.0))
    save_mesh(tmp_path / "far.ply", far)
    far_away = str(tmp_path / "far.ply")
    config = paper.Config(capture=scan, parts=(part,), reference=far_away, size=SIZE, out=tmp_path / "out")
    with pytest.raises(InputError, match="no ray of any frame met both surfaces"):
        paper.main(config)


def test_panels_share_their_axes_and_name_their_lines() -> None:
    rng = np.random.default_rng(0)
    distances = [
        {"mode": mode, "schedule": name, "to_converged": rng.random(), "to_accurate": rng.random()}
        for mode in METHODS
        for name in ("paper-50", *map(paper_cascade.naive_name, paper_cascade.SWEEP))
    ]
    methods = [("raw", 1, 0), ("together", 1, 0)]
    methods += [("separate", factor, steps) for factor in paper_shadow.SIZES for steps in paper_shadow.STEPS]
    shadows = [
        {"mode": mode, "surface": surface, "method": method, "factor": factor, "steps": steps}
        | dict.fromkeys(paper_shadow.METRICS, rng.random())
        for mode in METHODS
        for surface in paper_shadow.SURFACES
        for method, factor, steps in methods
    ]
    for figure in (paper_cascade.figure(distances), paper_shadow.figure(shadows)):
        (legend,) = [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]
        named = {text.get_text() for text in legend.get_texts()}
        for axes in figure.axes:
            assert {line.get_label() for line in axes.lines} == named
            assert axes.get_xlim() == figure.axes[0].get_xlim()
    columns = len(paper_shadow.METRICS)
    for above, below in zip(figure.axes[:columns], figure.axes[columns:], strict=True):
        assert above.get_ylim() == below.get_ylim()


def test_structure_comes_out_of_noise(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structure, "STEPS", (10, 1000))
    structure.main(structure.Config(capture=scan, size=SIZE, out=tmp_path))
    found = {r["schedule"]: r for r in read_rows(tmp_path / "rows.jsonl") if r["kind"] == "spread"}
    assert found["noise"]["between"] < 0.2 < found["1000 steps"]["between"]
    assert found["1000 steps"]["variance"] < found["10 steps"]["variance"] < found["noise"]["variance"]


def test_no_repeats_are_refused_before_the_first_slow_step(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="repeats: must be at least 1"):
        paper.main(paper.Config(capture=scan, repeats=0, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_size_too_small(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="size: must be at least 64"):
        structure.main(structure.Config(capture=scan, size=7, out=tmp_path))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("frame", "message"), [(9, "past the end"), (-9, "past the end")])
def test_frames_that_are_not_there(scan: Path, tmp_path: Path, frame: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        structure.main(structure.Config(capture=scan, frame=frame, out=tmp_path))
