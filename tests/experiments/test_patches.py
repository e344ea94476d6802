"""Patches of one material: the measure on a wall under a known light, and a run on a scan."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import patches
from experiments.blocks import Table
from experiments.records import of_kind
from hyjax.data.builtin_room import RoomCapture
from hyjax.light.kinds import PointLight
from hyjax.light.shading import shade_each
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError
from hyjax.util.files import write_text


def test_a_wall_is_even_once_its_true_light_is_divided_out(room: RoomCapture) -> None:
    scene = Scene.open(SceneSettings(mesh="true"), capture=room)
    buffer = scene.gbuffer(scene.frame(0).camera)
    middle = np.asarray(buffer.position)[np.asarray(buffer.hit)].mean(axis=0)
    lamp = PointLight(jnp.asarray(middle), jnp.float32(800.0), jnp.ones(3))
    lux = np.asarray(shade_each(buffer, (lamp,)))
    mask = np.asarray(buffer.hit) & (lux[..., 0] > 1)
    paint = np.array([0.6, 0.5, 0.4])
    photo = paint * lux / lux.max()
    before, after = (
        patches.unevenness(photo, mask),
        patches.unevenness(photo * lux.max() / np.maximum(lux, 1), mask),
    )
    assert before["deviation"] > 0.3 and before["robust"] > 0.3
    assert after["deviation"] < 1e-3 and after["robust"] < 1e-3


def test_pixels_of_a_polygon() -> None:
    mask = patches.inside([(2, 1), (6, 1), (6, 4), (2, 4)], (8, 10))
    assert mask.shape == (8, 10) and mask[1:5, 2:7].all() and mask.sum() == 20


def test_the_drawn_patches_can_be_read() -> None:
    drawn = patches.read_patches(Path(patches.__file__).with_suffix(".json"))
    assert 10 <= len(drawn) <= 15 and len({patch.capture for patch in drawn}) == 5


@pytest.mark.slow
def test_patches_of_a_scan(scan: Path, tmp_path: Path) -> None:
    file = tmp_path / "patches.json"
    corners = "[[20, 20], [120, 20], [120, 90], [20, 90]]"
    write_text(file, f'[{{"capture": "{scan.name}", "frame": 0, "material": "paint", "corners": {corners}}}]')
    config = patches.Config(folder=scan.parent, patches=file, size="64x48", out=tmp_path / "out")
    rows = patches.main(config)
    (row,) = of_kind(rows, "patch")
    assert row["scores"]["photo"]["deviation"] > 0 and 0 <= row["light"]["exponent"] <= 1.2
    assert patches.ratio(row, "photo's light kept") == pytest.approx(1, abs=0.05)
    table = patches.blocks(rows, tmp_path)[0]
    assert isinstance(table, Table)
    assert [line[0] for line in table.rows] == [scan.name, "median", "worst"]
    with pytest.raises(InputError, match="'attic' has no patch"):
        patches.main(dataclasses.replace(config, captures=("attic",)))
    write_text(file, '[{"capture": "x", "frame": 0, "material": "paint", "corners": [[1, 1], [2, 2]]}]')
    with pytest.raises(InputError, match="needs three corners"):
        patches.main(config)
    write_text(file, '[{"capture": "x"}]')
    with pytest.raises(InputError, match="missing required field"):
        patches.main(config)
