"""Settings objects made in Python: their types are checked where they are made."""

from pathlib import Path
from typing import Any

import pytest

from hyjax.relighting.settings import RelightSettings
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.settings import SceneSettings
from hyjax.tour.settings import TourSettings
from hyjax.training.settings import TrainSettings
from hyjax.tuning.settings import TuneSettings
from hyjax.util.errors import InputError


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (SceneSettings, {"size": 640}, r"^size: must be str \| None, got 640$"),
        (FusionSettings, {"voxel": "fine"}, r"^voxel: must be float \| None, got 'fine'$"),
        (FusionSettings, {"confidence": None}, r"^confidence: must be float, got None$"),
        (SceneSettings, {"seed": 1.5}, r"^seed: must be int, got 1.5$"),
        (SceneSettings, {"capture": 3}, r"^capture: must be Path \| None, got 3$"),
        (RelightSettings, {"frames": [0]}, r"^frames: must be str, got \[0\]$"),
        (RelightSettings, {"scene": "room"}, r"^scene: must be SceneSettings, got 'room'$"),
        (RelightSettings, {"kappa": "x"}, r"^kappa: must be float \| None, got 'x'$"),
        (
            RelightSettings,
            {"renderer": "povray"},
            r"^renderer: 'povray' is unknown; use one of shadow_map, blender, webgpu$",
        ),
        (RelightSettings, {"save_filters": "yes"}, r"^save filters: must be bool, got 'yes'$"),
        (TuneSettings, {"fps": 60}, r"^fps: must be tuple\[float, \.\.\.\], got 60$"),
        (TuneSettings, {"scene": SceneSettings()}, r"^scene: must be TuneScene, got SceneSettings"),
        (TourSettings, {"port": "eighty"}, r"^port: must be int, got 'eighty'$"),
        (TrainSettings, {"batch": 2.5}, r"^batch: must be int, got 2.5$"),
    ],
)
def test_a_field_of_another_type_is_refused_in_one_line(kind: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        kind(**options)
    assert "\n" not in str(caught.value)


def test_text_is_taken_for_a_path_and_a_path_for_a_name() -> None:
    settings = RelightSettings(SceneSettings("scan"), lights=Path("lamps.yaml"), out="made")  # type: ignore[arg-type]
    assert settings.scene.capture == Path("scan") and settings.out == Path("made")
    assert settings.lights == "lamps.yaml"


def test_a_list_is_taken_for_a_tuple_and_a_whole_number_for_a_fraction() -> None:
    settings = TuneSettings(fps=[30, 60])  # type: ignore[arg-type]
    assert settings.fps == (30, 60) and RelightSettings(kappa=1).kappa == 1
