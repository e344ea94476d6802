"""Settings of a tour are checked before anything slow begins."""

from pathlib import Path

import pytest

from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.settings import SceneSettings
from hyjax.tour.settings import TourSettings
from hyjax.util.errors import InputError


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        (TourSettings(port=70000), "port"),
        (TourSettings(schedule=Path("missing.json")), "missing.json"),
        (TourSettings(scene=SceneSettings(size="7")), "size"),
        (TourSettings(scene=SceneSettings(fusion=FusionSettings(voxel=-1.0))), "voxel"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(settings: TourSettings, word: str) -> None:
    with pytest.raises(InputError, match=word):
        settings.check()


def test_a_tuned_schedule_becomes_the_default(tmp_path: Path) -> None:
    settings = TourSettings().check()
    first = next(iter(settings.open_schedules()))
    file = tmp_path / "mine.json"
    file.write_text(settings.open_schedules()["paper-50"].to_json())
    names = list(TourSettings(schedule=file).check().open_schedules())
    assert names[0].endswith("(mine.json)") and names[1] == first
