"""The super-resolution experiment on small pairs whose answer is known."""

import dataclasses
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from extras import need
from reference.arkit_export import write_depth

from experiments import depth_sr
from experiments.blocks import html, markdown
from experiments.depth_methods import DADA, Method, Task, make_task, methods, scattered_bicubic
from experiments.depth_sr import Config, Tile, choose, errors, main, per_pair, tiles
from experiments.records import FILE, Results, of_kind, read_rows
from hyjax.core.pyramid import downsample
from hyjax.core.schedule import Schedule
from hyjax.guide.choose import RGB, RgbGuide
from hyjax.pairs.registry import open_pairs
from hyjax.util.errors import InputError
from hyjax.util.images import write_png


def write_pairs(folder: Path, count: int, seed: int) -> Path:
    """Two planes, one before the other, of different colour: a frame that shows every border, and no other."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((70, 70))  # not a multiple of the tile
    for k in range(count):
        near = (columns - rng.uniform(20, 50)) + rng.uniform(-1, 1) * (rows - 32) > 0
        depth = np.where(near, 1200.0, 2500.0) + 5 * rows
        depth[60:, :20] = 0  # a hole
        image = np.where(near[..., None], rng.uniform(0, 0.4, 3), rng.uniform(0.6, 1, 3))
        write_png(folder / f"p{k}_rgb.png", image.astype(np.float32))
        write_depth(folder / f"p{k}_depth.png", depth)
    return folder


@pytest.fixture
def config(tmp_path: Path) -> Config:
    pairs, tuning = (f"folder:{write_pairs(tmp_path / name, 2, seed)}" for seed, name in enumerate("ab"))
    return Config((pairs,), (tuning,), ("rgb",), (4,), steps=60, tile=64, peers=False, out=tmp_path / "out")


def test_a_frame_that_shows_the_borders_is_worth_something(
    config: Config, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the frame, and with a learned guide that tells nothing."""

    class Blind(RgbGuide):
        def features(self, display: object) -> object:
            return jnp.zeros_like(display)

    monkeypatch.setattr(depth_sr, "open_guide", lambda name: RGB if name == "rgb" else Blind(name, "blind"))
    main(dataclasses.replace(config, guides=("rgb", "blind")))
    rows = read_rows(config.out / FILE)
    scores = of_kind(rows, "score")
    rmse = {
        method: np.sqrt(np.mean([row["mse"] for row in scores if row["method"] == method]))
        for method in dict.fromkeys(row["method"] for row in scores)
    }
    assert list(rmse) == ["bicubic", "rgb, 60 steps", "rgb, paper-80", "blind, 60 steps", "blind, paper-80"]
    assert rmse["rgb, 60 steps"] < 0.3 * rmse["bicubic"] and rmse["rgb, paper-80"] < 0.9 * rmse["bicubic"]
    assert rmse["blind, 60 steps"] > 0.8 * rmse["bicubic"]
    assert {row["pair"] for row in scores} == {"p0", "p1"} and {row["unit"] for row in scores} == {"metres"}
    assert all(row["mse_borders"] > row["mse"] for row in scores if row["method"] == "bicubic")
    printed = capsys.readouterr().out
    assert "RMSE cm" in printed and "| x4 | rgb, 60 steps | kappa " in printed
    assert all((config.out / f"{name}.png").is_file() for name in ("errors", "depth_sr"))
    shown = depth_sr.blocks(rows, config.out)
    assert html(shown) and printed.startswith(markdown(shown))
    table = shown[0]
    bicubic = next(row for row in table.rows if row[1] == "bicubic")
    own = [row for row in scores if row["method"] == "bicubic"]
    assert bicubic[3].startswith(f"{100 * np.mean(np.sqrt(list(per_pair(own, 'mse').values()))):.2f} ±")
    assert bicubic[-2] == "1.00 ±0.00"
    assert bicubic[-1] == f"{1e4 * rmse['bicubic'] ** 2:.1f}"


def test_parameters_are_the_best_on_the_tuning_pairs(tmp_path: Path, config: Config) -> None:
    """A method whose parameter is its error, the other way round for the coarser factor."""
    options = [{"off": 0.3}, {"off": 0.1}, {"off": 0.2}]
    depth, valid = np.ones((64, 64)), np.ones((64, 64), bool)
    tile = Tile("", "", 0, "metres", np.zeros((64, 64, 3)), depth, valid)
    tuning = [(make_task(tile.image, depth, valid, {}, factor, 0.5), tile) for factor in (4, 8)]

    def run(task: Task, options: dict[str, float]) -> np.ndarray:
        off = options["off"] if task.factor == 4 else 1 - options["off"]
        return np.ones((64, 64, 1)) + off

    results = Results(tmp_path / "out", "depth_sr", config)
    chosen = choose(results, tuning, (4, 8), [Method("m", options, run)])
    assert chosen == {(4, "m"): options[1], (8, "m"): options[0]}
    np.testing.assert_allclose(
        [row["rmse"] for row in of_kind(results.rows, "tuning")], [0.3, 0.1, 0.2, 0.7, 0.9, 0.8], rtol=1e-6
    )


def test_the_published_protocol_tunes_nothing_and_keeps_to_the_source(config: Config) -> None:
    rows = main(dataclasses.replace(config, protocol="dada"))
    assert not of_kind(rows, "tuning")
    assert [row["options"] for row in of_kind(rows, "chosen")] == [{}, DADA]
    scores = of_kind(rows, "score")
    assert [row["method"] for row in scores[:2]] == ["bicubic", "dada, rgb, 60 steps"]
    assert all(row["mae"] > 0 and row["mae"] ** 2 <= row["mse"] for row in scores)


def test_interpolation_of_cells_reproduces_a_plane_also_beside_unknown_ones() -> None:
    rows, columns = np.indices((32, 32))
    depth, valid = 1.0 + 0.02 * rows + 0.01 * columns, np.ones((32, 32), bool)
    valid[8:16, 12:20] = False
    task = make_task(np.zeros((32, 32, 3)), np.where(valid, depth, 0.0), valid, {}, 4, 0.0)
    assert int(np.sum(~np.asarray(task.known))) == 4
    inside = slice(2, 30), slice(2, 30)
    np.testing.assert_allclose(scattered_bicubic(task)[..., 0][inside], depth[inside], atol=1e-5)


def test_errors_are_means_over_what_is_valid() -> None:
    depth = np.where(np.arange(16) < 8, 1.0, 2.0) * np.ones((16, 1))
    valid = np.ones((16, 16), bool)
    valid[:4] = False
    tile = Tile("", "", 0, "metres", np.zeros((16, 16, 3)), np.where(valid, depth, 0), valid)
    estimate = depth + np.where(np.abs(np.arange(16) - 7.5) < 2, 0.3, 0.1)
    estimate[:4] = 1e6
    found = errors(estimate, tile)
    np.testing.assert_allclose(found["mae"], (4 * 0.3 + 12 * 0.1) / 16)
    np.testing.assert_allclose(found["mse"], (4 * 0.09 + 12 * 0.01) / 16)
    np.testing.assert_allclose(
        found["mse_borders"], (4 * 0.09 + 4 * 0.01) / 8
    )  # one pixel each side and three more
    flat = tile._replace(depth=np.where(valid, 1.0, 0.0))
    assert errors(estimate, flat)["mse_borders"] is None


def test_tiles_lie_side_by_side_where_depth_is_valid(tmp_path: Path) -> None:
    text = f"folder:{write_pairs(tmp_path / 'a', 1, 0)}"
    pair, found = open_pairs(text)[0], tiles(text, 20)
    assert [tile.index for tile in found] == list(range(9))
    np.testing.assert_array_equal(found[5].depth, pair.depth[20:40, 40:60])
    np.testing.assert_array_equal(found[5].image, pair.image[20:40, 40:60])
    assert [tile.index for tile in tiles(text, 10)] == [i for i in range(49) if i not in (42, 43)]


def test_peers_smooth_and_keep_to_the_source() -> None:
    need("experiments")
    rng = np.random.default_rng(0)
    image, valid = rng.uniform(size=(32, 32, 3)).astype(np.float32), np.ones((32, 32), bool)
    depth = rng.uniform(1, 3, (32, 32)).astype(np.float32)
    task = make_task(image, depth, valid, {}, 4, 0.5)
    peers = methods([], Schedule.preset("paper-80"), 1, True)[1:]
    assert [method.name for method in peers] == ["guided filter", "global smoother"]
    for method in peers:
        for options in method.candidates:
            got = method.run(task, options)
            assert got.shape == (32, 32, 1) and np.all(np.isfinite(got))
            if options["adjusted"]:
                np.testing.assert_allclose(downsample(got, 4), task.source, rtol=1e-5)


BAD = [
    ({"factors": (3,)}, "factors: 3 must be at least 2 and divide the tile"),
    ({"factors": (64,)}, "factors: 64 must"),
    ({"factors": ()}, "factors: each needs"),
    ({"tile": 48, "factors": (12,)}, "factors: 12 and the schedule's level 16"),
    ({"steps": 0}, "steps: must be at least 1"),
    ({"schedule": "paper-8"}, "no preset 'paper-8' (did you mean"),
    ({"tile": 128}, "b: no tile of 128 pixels a side with 30% of valid depth"),
    ({"guides": ("nothing.safetensors",)}, "nothing.safetensors"),
    ({"guides": ("rgb", "rgb")}, "give each a file name of its own"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_input_is_refused(config: Config, change: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        main(dataclasses.replace(config, **change))
    assert message in str(caught.value)


def test_nothing_is_chosen_on_what_is_reported(config: Config) -> None:
    with pytest.raises(InputError, match="is reported on as well"):
        main(dataclasses.replace(config, tuning=config.pairs))


def test_without_opencv(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InputError, match="--no-peers"):
        main(dataclasses.replace(config, peers=True))
