"""Experiments on tuning whole frames, as small as they go: rows, tables, presets, figures."""

import json
from pathlib import Path

import pytest
from extras import need

from experiments import frame_tuning, tuning_search
from hyjax.configuration import Configuration
from hyjax.data.builtin_room import load_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.frame.scene import TuningScene
from hyjax.tuning.frame.space import Space
from hyjax.tuning.frame.study import Study
from hyjax.tuning.frame.trial import Trial
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
    monkeypatch.setattr("hyjax.tuning.frame.bench.open_room", lambda *_: room)
    monkeypatch.setattr("hyjax.tuning.settings.SETUPS", ("two-colors",))
    monkeypatch.setattr("hyjax.tuning.frame.proof.ROUNDS", 3)
    # Gradients are compiled for most of a minute, and tests of their own look at them.
    for module_name in ("evaluator", "stage"):
        monkeypatch.setattr(f"hyjax.tuning.frame.{module_name}.refine_numbers", lambda own, *_, **__: own)


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


def test_searches_are_compared_by_their_journals(tmp_path: Path) -> None:
    """The best within a time after so many trials, on the first frames that all were judged on."""
    space = Space.of(truth=True)
    for name, gain in (("before", 0.0), ("now", 0.1)):
        (tmp_path / name).mkdir()
        study = Study(tmp_path / name, "frame", {})
        study.add(space, Trial(space.default, "default", (1.0, 1.0), 1.0))
        for scale in (2, 3, 4):
            losses = (0.8 + 0.1 * scale - gain,) * (2 if scale < 4 else 1)
            study.add(space, Trial(space.complete({"scale": scale}), "screening", losses, 1.0 / scale))
    folders = (tmp_path / "before", tmp_path / "now")
    rows = tuning_search.main(tuning_search.Config(study=folders, limits=(0.4, 1.0), out=tmp_path / "out"))
    ends = {(row["study"], row["limit"]): row["loss"] for row in rows if row["kind"] == "end"}
    assert ends == pytest.approx({("before", 0.4): 1.1, ("before", 1.0): 1.0, ("now", 0.4): 1.0, ("now", 1.0): 0.9})
    first = {(row["study"], row["limit"]): row["loss"] for row in rows if row["kind"] == "best"}
    assert first["now", 1.0] == pytest.approx(0.9) and next(iter(rows))["cases"] == 1
    with pytest.raises(InputError, match="study: none given"):
        tuning_search.main(tuning_search.Config(out=tmp_path / "none"))


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
