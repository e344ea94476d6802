"""The paper's benchmarks from end to end, on the built-in room exported as an ARKitScenes scan with laser scans."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.arkit_export import export_arkit_scan
from reference.laser_export import export_laser_scans

import hyjax
from experiments import paper
from experiments.judging import pick
from experiments.paper import Config, main
from experiments.paper_bench import BENCHMARKS, GROUPS, METHODS, Bench, in_the_middle
from experiments.records import read_rows
from experiments.references import Reference, open_reference
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import RoomCapture
from hyjax.data.capture import Capture
from hyjax.data.registry import open_capture
from hyjax.geometry.mesh import submesh
from hyjax.light.color import encoded
from hyjax.light.gbuffer import GBuffer
from hyjax.light.setup import LightSetup
from hyjax.util.errors import InputError

SIZE = 64


@pytest.fixture(scope="module")
def scan(room: RoomCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room with a tenth of its triangles missing for ARKit's mesh, and laser scans of the whole."""
    torn = np.random.default_rng(0).random(len(room.reference().faces)) < 0.1
    folder = tmp_path_factory.mktemp("arkit")
    made = export_arkit_scan(folder / "raw" / "Training", room, submesh(room.reference(), ~torn))
    splits = f"video_id,visit_id,fold\n{made.name},467138,Training\n"
    (folder / "raw" / "raw_train_val_splits.csv").write_text(splits)
    stands = []
    for index in (0, 2):
        pose = np.eye(4)
        pose[:3, 3] = room[index].camera.origin
        stands.append(pose)
    laser = folder / "laser_scanner_point_clouds" / "467138"
    laser.mkdir(parents=True)
    export_laser_scans(laser, room.reference(), stands, 400_000)
    return made


@pytest.fixture(scope="module", autouse=True)
def opened_once() -> Iterator[None]:
    """Laser scans become a surface once, not in every run."""
    opened: dict[tuple[str, str | None], Reference] = {}

    def once(capture: Capture, name: str | None = None) -> Reference:
        key = capture.name, name
        if key not in opened:
            opened[key] = open_reference(capture, name)
        return opened[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.paper_bench.open_reference", once)
        yield


@pytest.fixture(scope="module")
def config(scan: Path, weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Config:
    return Config(
        capture=scan,
        parts=("benchmarks",),
        frames="0,2",
        size=SIZE,
        weights=weights,
        out=tmp_path_factory.mktemp("whole"),
    )


@pytest.fixture(scope="module")
def rows(config: Config) -> list[dict[str, Any]]:
    main(config)
    assert config.out is not None
    return read_rows(config.out / "rows.jsonl")


@pytest.mark.slow
def test_the_whole_evaluation_on_an_arkitscenes_scan(config: Config, rows: list[dict[str, Any]]) -> None:
    frames = [row for row in rows if row["kind"] == "frame"]
    assert [row["index"] for row in frames] == [0, 2] and rows[-1]["kind"] == "finished"
    assert frames[0]["meshes"].startswith("captured mesh") and "laser scans" in frames[0]["meshes"]
    for row in frames:
        assert row["settings"]["size"] == SIZE and row["commit"] and row["versions"]["jax"]
        for benchmark in BENCHMARKS:
            for group in GROUPS:
                for method in ("bare mesh", "mean colour", *METHODS.values()):
                    found = pick(row, "scores", benchmark, group, method, "all")
                    assert 5 < found["psnr"] < 60 and 0 < found["ssim"] <= 1 and found["lpips"] > 0
        # Of no two methods are the pictures the same, and the accurate surface is no method of its own benchmark.
        for benchmark in BENCHMARKS:
            scores = row["scores"][benchmark]
            every = [found["all"]["psnr"] for group in GROUPS for found in scores[group].values()]
            assert len({round(value, 6) for value in every}) == len(every)
            assert ("accurate surface" in scores["light"]) == (benchmark != "relighting fidelity")
    for row in frames:  # the holes are filled, and black is not what the laser scans have there
        fidelity = row["scores"]["relighting fidelity"]["light"]
        assert fidelity[METHODS["linear"]]["holes"]["psnr"] > fidelity["bare mesh"]["holes"]["psnr"] + 5
    assert config.out is not None
    assert (config.out / "contact_sheet.png").stat().st_size > 1000
    text = (config.out / "paper.md").read_text()
    for benchmark in BENCHMARKS:
        assert f"{benchmark.capitalize()} at {SIZE} x {SIZE}: median over 2 frames" in text


@pytest.mark.slow
def test_scores_are_those_of_filters_made_by_hand(config: Config, rows: list[dict[str, Any]]) -> None:
    """The bare mesh and the accurate surface, from Lambert's law in NumPy, multiplied both ways."""
    capture = open_capture(config.capture)
    with config.bench(capture, Schedule.preset(config.schedule)) as bench:
        view, setups = bench.view(2), bench.setups
    (row,) = [row for row in rows if row.get("index") == 2]
    display = np.asarray(view.display, np.float64)

    def filter_by_hand(gbuffer: GBuffer, lights: str) -> np.ndarray:
        total, position, normal = 0.0, np.asarray(gbuffer.position), np.asarray(gbuffer.normal)
        for light in setups[lights].lights:
            assert isinstance(light, hyjax.PointLight)
            away = np.asarray(light.position) - position
            square = (away**2).sum(axis=-1)
            cosine = np.maximum((away * normal).sum(axis=-1), 0.0) / np.sqrt(square)
            lux = float(light.luminous_flux) / (4 * np.pi) * cosine / square * np.asarray(gbuffer.hit)
            total = total + lux[..., None] * np.asarray(light.color)
        return total / setups[lights].reference_lux

    for benchmark in ("mesh error correction", "multi-lighting consistency"):
        for method, gbuffer in (("bare mesh", view.rough), ("accurate surface", view.accurate)):
            own = filter_by_hand(gbuffer, BENCHMARKS[benchmark])
            relit = {"light": hyjax.to_display(hyjax.to_linear(display) * own)}
            relit["display values"] = display * np.asarray(encoded(own))
            for group, picture in relit.items():
                expected = -10 * np.log10(np.mean((np.asarray(picture) - display) ** 2))
                assert row["scores"][benchmark][group][method]["all"]["psnr"] == pytest.approx(expected, abs=2e-3)


@pytest.mark.slow
def test_interrupted_and_resumed(
    config: Config, rows: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = dataclasses.replace(config, out=tmp_path)
    judged: list[int] = []
    original = Bench.row

    def counted(bench: Bench, index: int, weights: Any) -> dict[str, Any]:
        if len(judged) == 1:
            raise KeyboardInterrupt
        judged.append(index)
        return original(bench, index, weights)

    with monkeypatch.context() as patch:
        patch.setattr(Bench, "row", counted)
        with pytest.raises(KeyboardInterrupt):
            main(own)
    assert judged == [0]
    with pytest.raises(InputError, match="interrupted run of 1 rows"):
        main(own)
    with pytest.raises(InputError, match=f"that run had size {SIZE} and this one has 128"):
        main(dataclasses.replace(own, size=128, resume=True))
    monkeypatch.setattr(paper, "write_contact_sheet", lambda *_: None)
    main(dataclasses.replace(own, resume=True))
    again = read_rows(tmp_path / "rows.jsonl")
    assert [row.get("scores") for row in again] == [row.get("scores") for row in rows]


def test_the_first_benchmark_has_its_lamp_in_the_middle_of_the_room() -> None:
    lamp = hyjax.PointLight(np.zeros(3), 9000.0, np.ones(3))
    moved = in_the_middle(LightSetup((lamp,), 300.0), np.array([[0.0, 1.0, -2.0], [4.0, 2.0, 6.0]]))
    assert np.array_equal(moved.lights[0].position, [2.0, 1.5, 2.0])
    assert moved.lights[0].luminous_flux == 9000.0 and moved.reference_lux == 300.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"capture": None, "reference": "laser"}, "room: has no laser scans"),
        ({"schedule": "paper-8"}, "paper-8"),
        ({"frames": "7"}, "past the end"),
        ({"weights": Path(__file__)}, "test_paper.py"),
    ],
)
def test_bad_input(change: dict[str, Any], message: str, config: Config, room: RoomCapture, tmp_path: Path) -> None:
    asked = dataclasses.replace(config, out=tmp_path / "out", **change)
    if "reference" in change:
        with pytest.raises(InputError, match=message):
            Bench(room, paper.Schedule.preset("paper-80"), "true", "laser", SIZE)
        return
    with pytest.raises(InputError, match=message) as caught:
        main(asked)
    assert "\n" not in str(caught.value)
