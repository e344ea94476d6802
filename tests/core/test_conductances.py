"""The figure of conductances: which edges are of which kind, and what is said of a guide that knows."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from reference.arkit_export import write_depth

from experiments import conductances
from experiments.conductances import JUMP_CONDUCTANCE, Config, compare, kinds, levels, main
from experiments.records import FILE, of_kind, read_rows
from hyjax.guide.choose import RgbGuide
from hyjax.pairs.depth_pairs import DepthPair
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

SIZE = 64


def pair_of(jump: int, crease: int, hole: int) -> DepthPair:
    """A wall that comes nearer at a column, turns at another, and has a column without depth."""
    columns = np.arange(SIZE) * np.ones((SIZE, 1))
    depth = np.where(columns < jump, 1.0, 2.0).astype(np.float32)
    normal = np.where((columns < crease)[..., None], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8]).astype(np.float32)
    valid = columns != hole
    return DepthPair("a", np.zeros((SIZE, SIZE, 3), np.float32), depth * valid, valid, "metres", normal)


def test_kinds_of_edges() -> None:
    count = 2 * 15 * 16  # at a quarter of 64 pixels: vertical, then horizontal ones
    colour = np.zeros(count)
    horizontal = colour[15 * 16 :].reshape(16, 15)
    horizontal[:, 1] = 1.0  # between cells 1 and 2 a border of colour
    horizontal[:, 3] = 2.0  # ... and where depth jumps
    horizontal[:7, 14] = 2.0
    found = kinds(pair_of(jump=16, crease=32, hole=44), colour)
    across = {kind: mask[15 * 16 :].reshape(16, 15) for kind, mask in found.items()}
    np.testing.assert_array_equal(np.flatnonzero(across["jump"].all(axis=0)), [3])
    np.testing.assert_array_equal(np.flatnonzero(across["crease"].all(axis=0)), [7])
    assert across["jump"].sum() == across["crease"].sum() == 16
    # colour as at the jump counts as texture, less does not, and next to jumps, creases and holes nothing does
    np.testing.assert_array_equal(np.argwhere(across["texture"]), [(i, 14) for i in range(7)])
    clear = [0, 1, 5, 12, 13, 14]  # the hole lies on edge 10
    np.testing.assert_array_equal(np.flatnonzero(across["plain"].any(axis=0)), clear)
    assert not (found["jump"][: 15 * 16].any() or found["crease"][: 15 * 16].any())


def test_the_area_is_the_probability_to_tell() -> None:
    rng = np.random.default_rng(0)
    squared = rng.integers(0, 6, 60).astype(float)  # with ties
    own = {kind: np.zeros(60, bool) for kind in ("jump", "crease", "texture", "plain")}
    own["jump"][:20] = own["texture"][20:30] = own["plain"][30:] = True
    won = [(a > b) + 0.5 * (a == b) for a in squared[:20] for b in squared[20:]]
    found = compare(squared, own, 1.5)
    np.testing.assert_allclose(found["area"], np.mean(won))
    np.testing.assert_allclose(found["plain"], np.median(2.25 / (2.25 + squared[30:])))
    assert found["crease"] is None
    own["jump"][:] = False
    assert compare(squared, own, 1.5)["area"] is None


def test_a_level_as_a_picture() -> None:
    distance = np.zeros((SIZE - 1, SIZE)), np.zeros((SIZE, SIZE - 1))
    distance[1][:, 20] = 9.0
    shown = levels(distance, 1.0, 4, (SIZE, SIZE - 1))
    assert shown.shape == (SIZE, SIZE - 1, 3)
    np.testing.assert_allclose(shown[:, 16:20], 0.1, rtol=1e-5)
    assert np.all(shown[:, :16] == 1) and np.all(shown[:, 20:] == 1)


class Red(RgbGuide):
    """Knows which of the colours tells objects apart."""

    def features(self, display: object) -> object:
        return display[..., :1]


@pytest.fixture
def config(tmp_path: Path) -> Config:
    folder = tmp_path / "boxes"
    folder.mkdir()
    rng = np.random.default_rng(0)
    rows, columns = np.indices((SIZE, SIZE))
    for k in range(2):
        near = (np.abs(rows - 30 - k) < 12) & (np.abs(columns - 30) < 12)
        image = np.stack([0.2 + 0.5 * near, 0.5 * ((columns // 7) % 2), np.zeros_like(near)], axis=-1)
        write_png(folder / f"{k}_rgb.png", np.clip(image + rng.normal(0, 0.01, image.shape), 0, 1))
        write_depth(folder / f"{k}_depth.png", np.where(near, 1000.0, 2000.0))
    return Config(f"folder:{folder}", "red", 1, out=tmp_path / "out")


def test_a_guide_that_knows_is_told_from_one_that_does_not(
    config: Config, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(conductances, "open_guide", lambda name: Red(name, "red"))
    main(config)
    rows = of_kind(read_rows(config.out / FILE), "pair")
    found = {name: [row for row in rows if row["guide"] == name] for name in ("rgb", "red")}
    assert [len(own) for own in found.values()] == [2, 2]
    for row in rows:
        np.testing.assert_allclose(row["jump"], JUMP_CONDUCTANCE, atol=0.02)
    assert all(row["area"] > 0.999 and row["texture"] > 0.9 and row["stopped"] == 0 for row in found["red"])
    assert all(row["area"] < 0.95 and row["texture"] < 0.15 and row["crease"] is None for row in found["rgb"])
    printed = capsys.readouterr().out
    assert "2 pictures of boxes" in printed and "| red | " in printed
    assert (config.out / "conductances.png").is_file()


def test_bad_input_is_refused(config: Config) -> None:
    with pytest.raises(InputError, match=r"^shown: 2 is not one of the pairs 0 to 1$"):
        main(dataclasses.replace(config, guide="rgb", shown=2))
    with pytest.raises(InputError, match="nothing"):
        main(dataclasses.replace(config, guide="nothing"))
    folder = Path(config.pairs.removeprefix("folder:"))
    for k in range(2):
        write_depth(folder / f"{k}_depth.png", np.full((SIZE, SIZE), 1000.0))
    with pytest.raises(InputError, match="depth nowhere jumps"):
        main(dataclasses.replace(config, guide="rgb"))
    assert not (config.out / FILE).exists()
