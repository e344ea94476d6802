"""Experiments on tuning whole frames, as small as they go: rows, tables, presets, figures."""

import json
from pathlib import Path

import pytest
from clocks import few_rounds
from extras import need

from experiments import frame_tuning, install_size, number_search, space_race, sweep_overhead
from hyjax.configuration import Configuration
from hyjax.data.builtin_room import load_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.scene import TuningScene
from hyjax.tuning.space import Space
from hyjax.util.errors import InputError

need("tune")


@pytest.fixture(scope="module")
def room() -> TuningScene:
    capture = load_room(n_frames=6, width=80, height=60, quality=0.25, progress=False)
    rough, accurate = (Scene.open(SceneSettings(mesh=mesh), capture=capture) for mesh in ("scan", "true"))
    return TuningScene("room", rough, accurate)


@pytest.fixture
def small(room: TuningScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """One small room in the place of all, two set-ups."""
    monkeypatch.setattr(frame_tuning, "SETUPS", ("two-colors", "golden-hour"))
    monkeypatch.setattr("hyjax.tuning.bench.open_room", lambda *_: room)
    monkeypatch.setattr("hyjax.tuning.settings.SETUPS", ("two-colors",))
    few_rounds(monkeypatch)
    # Gradients are compiled for most of a minute, and tests of their own look at them.
    for module_name in ("evaluator", "stage"):
        monkeypatch.setattr(f"hyjax.tuning.{module_name}.refine_numbers", lambda own, *_, **__: own)


@pytest.mark.slow
def test_tuning(small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "presets"
    folder.mkdir()
    monkeypatch.setattr(frame_tuning, "FOLDER", folder)
    config = frame_tuning.Config(
        rooms=("builtin-0",),
        report=("builtin-3",),
        size="80x60",
        frames=1,
        trials=4,
        presets=True,
        out=tmp_path / "out",
    )
    rows = frame_tuning.main(config)
    names = {row["name"] for row in rows if row["kind"] == "preset"}
    assert {"default", "quality", "balanced", "fast", "paper"} <= names
    assert any(row["kind"] == "candidate" and row["front"] for row in rows)
    made = {file.stem: json.loads(file.read_text()) for file in folder.iterdir()}
    assert {"quality"} <= made.keys() <= {"quality", "balanced", "fast"}  # in so small a room all may take as long
    assert all(made[name]["name"] == name and made[name]["measured"] is None for name in made)
    assert (tmp_path / "out" / "contact_sheet.png").is_file()


def test_presets_are_chosen_by_tuning_rooms_and_time() -> None:
    def row(name: str, ms: float, loss: float, edges: bool = True) -> dict:
        text = Configuration().with_choices({"light_edges": edges}).to_json()
        tuning = {"relative": loss}
        return {
            "name": name,
            "form": "hyjax",
            "median_ms": ms,
            "default_ms": 10.0,
            "tuning": tuning,
            "configuration": text,
        }

    rows = [row("a", 16.0, 0.8), row("b", 14.0, 0.9), row("c", 5.0, 0.99), row("d", 4.0, 0.98), row("e", 2.0, 1.2)]
    held = {"light_edges": True}
    rows += [row("fast", 5.0, 1.01), row("default", 1.0, 0.5), row("without", 2.0, 0.7, edges=False)]
    chosen = frame_tuning.chosen_presets(rows, held)
    assert {name: found["name"] for name, found in chosen.items()} == {"quality": "b", "balanced": "d", "fast": "e"}
    # One configuration has one name, and a preset for which there is none stays.
    assert [*frame_tuning.chosen_presets([row("a", 4.0, 0.9)], held)] == ["quality"]


def test_presets_that_come_with_hyjax_differ() -> None:
    presets = [Configuration.preset(name) for name in ("quality", "balanced", "fast", "default", "paper")]
    assert len({str(sorted(preset.values().items(), key=str)) for preset in presets}) == 5
    assert Configuration.preset("fast").scale > Configuration.preset("quality").scale


def test_searches_of_numbers_are_compared_with_the_gradients() -> None:
    def room(name: str, ratio: float) -> dict:
        return {"room": name, "scores": {"relative": [1.0, ratio]}}

    shared = {"kind": "search", "settings": {"room": "a", "size": "160x120", "quality": 1.0}, "device": "cpu: cpu"}
    shared |= {"cpu_count": 2, "versions": {"jax": "0"}}
    rows = [
        shared
        | {"method": method, "sampler_seed": seed, "losses": losses, "seconds": [1.0, 0.5, 0.5], "rooms": rooms}
        for method, seed, losses, rooms in (
            ("gradients", 0, [1.0, 0.8, 0.82], [room("a", 0.8), room("b", 0.85)]),
            ("TPE", 0, [1.0, 0.9, 0.79], [room("a", 0.79), room("b", 0.9)]),
            ("TPE", 1, [1.0, 0.95, 0.97], [room("a", 0.95), room("b", 0.92)]),
        )
    ]
    table, plot = number_search.blocks(rows, Path())
    gradients, tpe = table.rows
    assert gradients == ["gradients", "1", "3", "0.50", "-20.0 %", "2", "-15.0 %"]
    assert tpe[4:] == ["-13.0 % (-21.0 to -5.0)", "3, never", "-9.0 % (-10.0 to -8.0)"]
    (axes,) = plot.figure.axes
    assert [line.get_label() for line in axes.lines][:2] == ["gradients", "TPE"]
    scores = {"relative": [1.0, 0.85], "ssim": [0.86, 0.87], "psnr": [25.0, 26.0], "psnr_raw": [24.0, 25.5]}
    preset = shared | {"kind": "preset", "preset": "fast", "numbers": "as it comes", "room": "b", "scores": scores}
    (only,) = number_search.blocks([preset], Path())
    assert only.rows == [["fast", "as it comes", "b", "-15.0 %", "+0.0100", "+1.00", "+1.50"]]
    assert len(number_search.blocks([*rows, preset], Path())) == 3
    config = number_search.Config(report=("builtin-0",))
    with pytest.raises(InputError, match="searched on as well"):
        number_search.main(config)


def test_races_count_what_keeps_the_default_s_time() -> None:
    shared = {"kind": "race", "settings": {"room": "a", "size": "160x120", "quality": 0.3}, "device": "cpu: cpu"}
    shared |= {"cpu_count": 2, "versions": {"jax": "0"}, "seconds": [2.0] * 20}
    rows = [
        shared
        | {"method": method, "search_seed": 0, "losses": losses, "times": times}
        | {
            "rooms": [
                {"room": name, "scores": {"relative": [1.0, held]}} for name, held in (("a", 0.8), ("b", 0.9))
            ]
        }
        for method, losses, times, held in (
            ("hyjax tune", [1.0, 0.8] + [0.7] * 18, [1.0] * 20, 0.85),
            ("TPE", [1.0] * 9 + [0.75, 0.6] + [0.9] * 9, [1.0] * 10 + [1.2] + [0.9] * 9, 0.9),
        )
    ]
    table, plot = space_race.blocks(rows, Path())
    assert list(table.header[3:]) == ["4 trials", "10 trials", "20 trials", "trials to our tenth", "b"]
    ours, tpe = table.rows
    assert ours[:6] == ["hyjax tune", "1", "40", "-30.0 %", "-30.0 %", "-30.0 %"] and ours[6] == "2"
    assert tpe[3:6] == ["+0.0 %", "-25.0 %", "-25.0 %"] and tpe[6] == "10", (
        "one that takes longer counts for nothing"
    )
    assert len(plot.figure.axes) == 2
    with pytest.raises(InputError, match="searched on as well"):
        space_race.main(space_race.Config(report=("builtin-0",)))


def test_samplers_begin_at_the_default() -> None:
    optuna = pytest.importorskip("optuna")
    space = Space.of(truth=True)
    fixed = optuna.trial.FixedTrial({p.name: space_race.as_suggested(p) for p in space.parameters})
    choices = {p.name: space_race.suggested(fixed, p) for p in space.parameters}
    assert space.complete(choices) == space.default


def test_the_overhead_is_over_the_tasks_and_over_the_ideal() -> None:
    row = {
        "kind": "overhead",
        "settings": {"tasks": 1000, "milliseconds": 10.0, "workers": 2},
        "device": "cpu: cpu",
    }
    row |= {"cpu_count": 2, "versions": {"jax": "0"}, "took": 5.2, "tasks": 10.2, "rows": 1000, "start": 1.0}
    (table,) = sweep_overhead.blocks([row], Path())
    assert table.rows == [["1000", "10", "2", "5.0", "5.2", "4.0", "2.0", "1.0"]]


def test_an_installation_is_parted_by_what_frameworks_need() -> None:
    needs = {
        "jax": ["jaxlib"],
        "jaxlib": ["numpy", "absent"],
        "numpy": [],
        "numba": ["numpy", "llvmlite"],
        "llvmlite": [],
    }
    found = install_size.closure({name: {"needs": wanted} for name, wanted in needs.items()})
    assert found == {"jax", "jaxlib", "numpy"}
    settings = {"settings": {"least": 10.0}}
    rows = [{"kind": "install", "cpu": 30.0} | settings]
    for name, megabytes in {"jax": 40.0, "numpy": 5.0, "numba": 33.0}.items():
        rows.append(
            {"kind": "package", "name": name, "megabytes": megabytes, "framework": name in found} | settings
        )
    (table,) = install_size.blocks(rows, Path())
    assert [cells[1].strip("*") for cells in table.rows] == ["45", "40", "5", "33", "33", "0", "78"]
