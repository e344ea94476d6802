"""Every experiment that no other file runs, from its options to rows, tables and figures, as small as it goes."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import need
from test_depth_sr import write_pairs

from experiments import (
    bench_peers,
    conductances,
    first_picture,
    flicker,
    found_sources,
    guide_worth,
    live,
    readme_picture,
    real_bench,
    same_pictures,
    stage_times,
    truth,
)
from experiments.command import Experiment
from experiments.paper_bench import METHODS
from experiments.real_room import room_pair
from experiments.records import FILE, Row, of_kind, read_rows
from experiments.truth_methods import METHODS as METHODS_OF_TRUTH
from experiments.truth_methods import OPENCV, PHOTO, TRUE_ALL
from hyjax.photo_light.sources import PhotoWindow
from hyjax.relighting.settings import RelightSettings
from hyjax.util.errors import InputError
from hyjax.util.images import picture_shape

SIZE = 64
AMPLE = 1000.0  # milliseconds, in which every schedule fits


def rows_of(experiment: Experiment, config: Any, *files: str) -> list[Row]:
    """The rows of a finished run, whose page and figures are there."""
    rows = experiment(config)
    assert rows[-1]["kind"] == "finished" and len(rows) > 1
    for file in (f"{experiment.name}.md", *files):
        assert (config.out / file).stat().st_size > 100, file
    return rows


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_reference")
def test_flicker(scan: Path, tmp_path: Path) -> None:
    config = flicker.Config(capture=scan, frames="0,1", size=SIZE, out=tmp_path)
    scores = of_kind(rows_of(flicker.main, config, "differences.png", "flicker.png"), "score")
    second = [row for row in scores if "flicker" in row]
    assert len(scores) == 2 * len(second) > 2 and all(row["flicker"] > 0 for row in second)
    psnr = {row["method"]: row["psnr"] for row in second}
    assert psnr.pop(flicker.ACCURATE) is None  # infinite: it is the target
    assert all(5 < value < 60 for value in psnr.values())


@pytest.mark.slow
def test_found_sources(tmp_path: Path) -> None:
    config = found_sources.Config(seed=41, count=2, size="96x72", quality=0.1, out=tmp_path)
    rooms = of_kind(rows_of(found_sources.main, config, "random-41-0-both.png"), "room")
    assert [row["light"] for row in rooms] == ["both", "day"]
    counts = [sum(row["counts"][f"windows {verdict}"] for row in rooms) for verdict in ("found", "missed")]
    assert counts[0] > 0 and sum(counts) == 3


def test_two_windows_share_a_part_of_their_union() -> None:
    def window(x: float, width: float, normal: float = 1.0) -> PhotoWindow:
        center, inward, up = np.array([x, 0.0, 1.5]), np.array([0.0, normal, 0.0]), np.array([0.0, 0.0, 1.0])
        return PhotoWindow.facing("", center, inward, up, width, 1.0)

    overlap = found_sources._overlap
    assert overlap(window(0.0, 2.0), window(0.0, 2.0)) == pytest.approx(1.0)
    assert overlap(window(0.0, 2.0), window(1.0, 2.0)) == pytest.approx(1 / 3)
    assert overlap(window(0.0, 2.0), window(3.0, 2.0)) == overlap(window(0.0, 2.0), window(0.0, 2.0, -1.0)) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_reference")
def test_guide_worth(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guide_worth, "KAPPAS", (0.01, 0.1))
    config = guide_worth.Config(capture=scan, frames=1, size=SIZE, out=tmp_path)
    scores = of_kind(rows_of(guide_worth.main, config, "guide_worth.png"), "score")
    held = [row for row in scores if row["split"] == "held-out"]
    guides = {
        guide_worth.NONE,
        "rgb",
        guide_worth.POOLED,
        guide_worth.MEAN_ABS,
        "small",
        "small-half",
        guide_worth.SURFACE,
    }
    assert len(held) == len(guides) * len(METHODS) and {row["guide"] for row in held} == guides
    assert len({row["psnr"] for row in held if row["method"] == METHODS["linear"]}) == len(guides)


def test_conductances(tmp_path: Path) -> None:
    pairs = f"folder:{write_pairs(tmp_path / 'pairs', 2, 0)}"
    config = conductances.Config(pairs=pairs, guide="rgb", out=tmp_path / "out")
    rows = rows_of(conductances.main, config, "conductances.png")
    (guide,) = of_kind(rows, "guide")
    assert guide["guide"] == "rgb" and guide["kappa"] > 0
    found = of_kind(rows, "pair")
    medians = [row["jump"] for row in found]
    assert len(found) == 2 and min(medians) - 1e-6 <= conductances.JUMP_CONDUCTANCE <= max(medians) + 1e-6
    assert all(row["plain"] > 0.9 and row["area"] > 0.9 for row in found)  # planes of one colour


@pytest.mark.slow
def test_first_picture(scan: Path, tmp_path: Path) -> None:
    config = first_picture.Config(repeats=1, cold=1, size="64", capture=scan, out=tmp_path)
    rows = rows_of(first_picture.main, config, "first_picture.png")
    assert {row["start"] for row in of_kind(rows, "stages")} == {first_picture.COLD, first_picture.SECOND}
    starts = {row["start"]: row for row in of_kind(rows, "start")}
    first, cold = (starts.pop(name) for name in (first_picture.FIRST, first_picture.COLD))
    assert 0 < first["seconds"] <= cold["seconds"] and "cpu_seconds" not in first
    assert all(row["seconds"] > 0 and row["cpu_seconds"] > 0 for row in starts.values())


def test_the_bound_of_a_program_is_the_longer_of_two() -> None:
    rates = {"gb_per_second": 50.0, "operations_g": 400.0}
    assert stage_times.bound({"in_out_mb": 100.0, "operations_m": 100.0}, rates) == 2.0
    assert stage_times.bound({"in_out_mb": 10.0, "operations_m": 400.0}, rates) == 1.0


@pytest.mark.slow
def test_stage_times(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage_times, "SIZE", 2 * SIZE)
    rows = rows_of(stage_times.main, stage_times.Config(capture=scan, repeats=1, out=tmp_path), "stage_times.png")
    stages = {row["stage"]: row for row in of_kind(rows, "stage")}
    programs = {"view: to_linear", "cascade: refine_illuminance", "light edges: edge_correction"}
    assert {stage_times.HOST_PROGRAM, *programs, "composite: relit_picture"} < set(stages)
    assert all(row["median_ms"] > 0 for row in stages.values())
    assert stages["visibility: visibility"]["calls"] > 1
    (rates,) = of_kind(rows, "rates")
    for program in programs:
        row = stages[program]
        assert row["touched_mb"] >= row["in_out_mb"] > 0 and stage_times.bound(row, rates) > 0


@pytest.mark.slow
def test_bench_peers(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("experiments")
    found = bench_peers.peers.optional
    # torch takes minutes to compile, and is compared with in tests of its own.
    monkeypatch.setattr(bench_peers.peers, "optional", lambda name: None if name == "torch" else found(name))
    monkeypatch.setattr(bench_peers, "TuneScene", functools.partial(bench_peers.TuneScene, size=str(SIZE)))
    monkeypatch.setattr(bench_peers, "CASCADE_SIZE", SIZE)
    monkeypatch.setattr(bench_peers, "GUIDE_SIZES", (SIZE,))
    monkeypatch.setattr(bench_peers.peers, "STRENGTHS", bench_peers.peers.STRENGTHS[:1])
    config = bench_peers.Config(
        capture=scan,
        sizes=(64,),
        channels=(1,),
        frames=1,
        repeats=1,
        guard=True,
        out=tmp_path,
    )
    with pytest.raises(SystemExit):  # what was not measured holds no limit
        bench_peers.main(config)
    rows = read_rows(tmp_path / FILE)
    assert (tmp_path / "roofline.png").is_file()
    kinds = {row["kind"] for row in rows}
    assert {"conditions", "step", "cascade", "quality", "quality time", "guide"} <= kinds
    differences = [row["difference"] for row in of_kind(rows, "agreement")]
    assert differences and max(differences) < 1e-3


@pytest.mark.slow
def test_truth(weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place, name in ((truth, "TruthBench"), (truth, "LitBench"), (truth.LitBench, "pictures")):
        monkeypatch.setattr(place, name, functools.cache(getattr(place, name)))
    config = truth.Config(
        rooms=("builtin-0",), setups=("evening-lamps",), frames=1, photos=2, size="96x72", quality=0.25,
        weights=weights, out=tmp_path,
    )  # fmt: skip
    rows = rows_of(truth.main, config, "builtin-0.png", "gains.png")
    (picture,), (room,), (setup,) = (of_kind(rows, kind) for kind in ("picture", "room", "setup"))
    assert room["again"] > 35 and setup["bounces"] > 0
    found = picture["methods"]
    assert set(METHODS_OF_TRUTH) - {OPENCV} <= set(found)
    for scores in found.values():
        assert 3 < scores["raw"]["psnr"] < scores["fitted"]["psnr"] + 0.2 and len(scores["gains"]) == 3
    assert found[TRUE_ALL]["fitted"]["psnr"] > found[PHOTO]["fitted"]["psnr"]
    # An interrupted run goes on without judging again what it has, or, here, relighting it for the sheet.
    lines = (tmp_path / FILE).read_text().splitlines(keepends=True)
    (tmp_path / FILE).write_text("".join(line for line in lines if '"kind": "picture"' in line))
    monkeypatch.setattr(truth, "judge", None)
    again = truth.main(dataclasses.replace(config, resume=True))
    assert of_kind(again, "picture") == [picture] and [row["room"] for row in of_kind(again, "room")] == [
        "builtin-0"
    ]
    with pytest.raises(InputError, match="frames: must be between 1 and photos"):
        truth.main(dataclasses.replace(config, frames=3))


@pytest.mark.slow
def test_readme_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(readme_picture, "KEPT_PICTURE", tmp_path / "readme.jpg")
    monkeypatch.setattr(real_bench, "LAMP_GRID", (2, 1, 1))
    config = readme_picture.Config(
        folder=tmp_path / "none",
        room="builtin-0",
        shown=("evening-lamps:1",),
        photos=2,
        size=(96, 72),
        quality=0.25,
        keep=True,
        out=tmp_path,
    )
    (picture,) = of_kind(rows_of(readme_picture.main, config, "readme.png", "readme.jpg"), "picture")
    assert 10 < picture["psnr_db"] < 40
    assert "without the real place" in capsys.readouterr().err
    heights = [picture_shape(tmp_path / "readme.png")[0]]
    monkeypatch.setattr(real_bench, "open_relit_pairs", lambda _: [room_pair("builtin-0", "96x72", 0.25)])
    config = dataclasses.replace(config, folder=tmp_path, pair="builtin-0")
    _, real = of_kind(rows_of(readme_picture.main, config, "readme.png"), "picture")
    assert real["setup"] == "fitted" and 10 < real["psnr_db"] < 40
    heights.append(picture_shape(tmp_path / "readme.png")[0])
    assert heights[1] == 2 * heights[0] + readme_picture.GAP


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:relight. nothing of the frame is known")  # its surface came late
def test_live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "SIZES", ((64, 48),))
    removal = live.removal
    monkeypatch.setattr(live, "removal", lambda mesh, voxel: removal(mesh, voxel, seconds=0.4))
    rows = rows_of(live.main, live.Config(seconds=1.0, voxel=0.08, out=tmp_path))
    (walk,) = of_kind(rows, "walk")
    assert walk["updates"] > 0 and walk["pictures"] > 0 and walk["faces"] > 1000
    assert walk["taken"] + walk["dropped"] == live.FPS
    assert {row["since"] < 0 for row in of_kind(rows, "removal")} == {True, False}


def test_same_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Pictures of two runs; a number stands in for what the command makes."""
    shift = {"before": 0.0, "same": 0.0, "near": 0.5e-6, "far": 1e-3}
    monkeypatch.setattr("hyjax.Scene.open", lambda settings: None)

    def run(name: str, against: Path | None) -> None:
        def relit(settings: RelightSettings, scene: None) -> dict[str, np.ndarray]:
            return {"000.relit": np.full((2, 2, 3), 0.5 + shift[name] * settings.video)}

        monkeypatch.setattr(same_pictures, "relit", relit)
        same_pictures.main(same_pictures.Config(data=tmp_path, out=tmp_path / name, against=against))

    run("before", None)
    assert len(list((tmp_path / "before").iterdir())) == len(same_pictures.SETUPS) * len(same_pictures.MODES)
    run("same", tmp_path / "before")
    assert "largest difference 0\n" in capsys.readouterr().out
    run("near", tmp_path / "before")
    with pytest.raises(InputError, match=r"more than 1e-06: .*room-noon-window-video 0\.001"):
        run("far", tmp_path / "before")
