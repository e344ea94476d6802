"""Experiments on tuning whole frames, as small as they go: rows, tables, presets, figures."""

import json
from pathlib import Path

import pytest
from extras import need

from experiments import frame_tuning
from hyjax.configuration import Configuration
from hyjax.data.builtin_room import load_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.scene import TuningScene

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
    monkeypatch.setattr("hyjax.tuning.proof.ROUNDS", 3)
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
    for name in ("quality", "balanced", "fast"):
        made = json.loads((folder / f"{name}.json").read_text())
        assert made["name"] == name and made["measured"] is None
    assert (tmp_path / "out" / "contact_sheet.png").is_file()


def test_presets_are_chosen_by_tuning_rooms_and_time() -> None:
    def row(name: str, ms: float, loss: float) -> dict:
        text = Configuration().to_json()
        tuning = {"relative": loss}
        return {
            "name": name,
            "form": "hyjax",
            "median_ms": ms,
            "default_ms": 10.0,
            "tuning": tuning,
            "configuration": text,
        }

    rows = [row("a", 16.0, 0.8), row("b", 14.0, 0.9), row("c", 6.0, 0.99), row("d", 4.0, 1.04), row("e", 2.0, 1.2)]
    chosen = frame_tuning.chosen_presets([*rows, row("fast", 1.0, 0.5)])
    assert {name: found["name"] for name, found in chosen.items()} == {"quality": "b", "balanced": "c", "fast": "d"}


def test_presets_that_come_with_hyjax_differ() -> None:
    texts = {Configuration.preset(name).to_json() for name in ("quality", "balanced", "fast", "default", "paper")}
    assert len(texts) == 5
    assert Configuration.preset("fast").scale > Configuration.preset("quality").scale
