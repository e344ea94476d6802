"""Real places under two lights: the protocol's fit, its scores, and a generated room through an S-curve camera."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import dark_frames, readme_picture, real, real_bench, real_captures, real_fit
from experiments.real_bench import UP, through_shades
from experiments.real_fit import Target, checkerboard, chosen_lights, fit_strengths, shown, slope, smooth_picture
from experiments.real_methods import BEST, BLUR_4, FEW_UNKNOWNS, GAINS, METHODS, NEW, PHOTO, SMOOTH, SMOOTH_BEST
from experiments.real_scores import ratio_scores
from experiments.records import of_kind
from hyjax.data import builtin_room
from hyjax.data.builtin_room import load_room
from hyjax.util.errors import InputError

SHAPE = (64, 96)


def test_strengths_and_polynomials_come_back() -> None:
    rng = np.random.default_rng(0)
    columns = rng.uniform(0.05, 0.3, (*SHAPE, 3, 3))
    true = np.array([[0.5, 1.0, 0.2], [0.0, 0.3, 0.6], [1.0, 0.0, 0.4]])
    picture = np.einsum("hwkc,kc->hwc", columns, true)
    target = Target(shown(picture), checkerboard(SHAPE))
    np.testing.assert_allclose(fit_strengths(columns, target), true, atol=0.02)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    photo = columns[:, :, 0]
    wanted = photo * np.exp(0.3 * x - 0.5 * x * y)[..., None] * [1.0, 0.8, 0.6]
    found = smooth_picture(photo, 2, Target(shown(wanted), checkerboard(SHAPE)))
    np.testing.assert_allclose(shown(found), shown(wanted), atol=0.01)
    assert 0.4 < checkerboard(SHAPE).mean() < 0.6


def test_the_slope_is_that_of_display_values() -> None:
    light = np.concatenate([np.linspace(0.01, 0.69, 50), np.linspace(0.71, 1.19, 50), np.linspace(1.21, 4.0, 20)])
    np.testing.assert_allclose(slope(light), (shown(light + 1e-6) - shown(light - 1e-6)) / 2e-6, rtol=1e-6)
    assert slope(np.array([1.2])) == pytest.approx(slope(np.array([1.1999])), rel=1e-3), "burnt pixels weigh little"


def test_the_lights_and_terms_that_help_are_chosen() -> None:
    rng = np.random.default_rng(0)
    columns = rng.uniform(0.05, 0.3, (*SHAPE, 6, 3))
    picture = np.einsum("hwkc,k->hwc", columns[:, :, [0, 2, 5]], [0.3, 1.0, 0.6])
    target = Target(shown(picture), checkerboard(SHAPE))
    assert chosen_lights(columns, range(1, 6), [0], target, 2) == [2, 5]
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    photo = columns[:, :, 0]
    wanted = photo * np.exp(0.4 * x**3 - 0.5 * y)[..., None] * [1.0, 0.8, 0.6]
    target = Target(shown(wanted), checkerboard(SHAPE))
    found = smooth_picture(photo, 3, target, 3)
    np.testing.assert_allclose(shown(found), shown(wanted), atol=0.01)


def test_a_shade_lets_light_up_and_down_alone() -> None:
    lamp, right = np.array([[0.2, 0.5, 1.0]]), np.array([1.0, 0.0, 0.0])
    points = lamp + np.stack([UP, -UP, right, UP + right])
    shares = through_shades(points, lamp)
    np.testing.assert_allclose(shares, [[1, 0], [0, 1], [0, 0], [1, 0]])
    assert 0 < through_shades(lamp + 0.25 * UP + right, lamp)[0, 0] < 1


def test_scores_of_ratios_see_the_light_alone() -> None:
    rng = np.random.default_rng(1)
    true, held = rng.normal(size=(*SHAPE, 3)).cumsum(axis=1), np.ones(SHAPE, bool)
    assert ratio_scores(2 * true + 1, true, held)["sie"] == pytest.approx(0, abs=1e-9)
    assert ratio_scores(true + 1, true, held)["lfe"] == pytest.approx(0, abs=1e-9)
    worse = ratio_scores(true[:, ::-1], true, held)
    assert worse["sie"] > 0.5 and worse["lfe"] > 0.05


@pytest.mark.slow
def test_a_generated_room_through_an_s_curve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_bench, "LAMP_GRID", (2, 1, 1))
    monkeypatch.setattr(real_fit, "ITERATIONS", 20)  # from the least squares of linear light
    config = real.Config(
        pairs=(), rooms=("builtin-0",), geometries=("true",), room_size="96x72", quality=0.25, out=tmp_path / "out"
    )
    rows = real.main(config)
    (first, second) = of_kind(rows, "picture")
    for row in (first, second):
        scores = row["methods"]
        assert set(scores) == set(METHODS) and all(np.isfinite(s["psnr"]) for s in scores.values())
        assert scores[SMOOTH]["psnr"] > scores[GAINS]["psnr"] > scores[PHOTO]["psnr"] - 0.5
        assert scores[NEW]["psnr"] > scores[GAINS]["psnr"]
        assert scores[BLUR_4]["sie"] < scores[NEW]["sie"]
        assert row["unknowns"][BEST] == row["unknowns"][SMOOTH_BEST] == row["unknowns"][SMOOTH] == FEW_UNKNOWNS
    assert {file.name for file in config.out.glob("*.png")} == {"builtin-0-true-ab.png", "builtin-0-true-ba.png"}


@pytest.mark.slow
def test_dark_and_burnt_shares_of_every_set_up(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    monkeypatch.setattr(builtin_room, "load_room", lambda **_: small)
    config = dark_frames.Config(
        captures=(scan,), setups=("evening-lamps",), frames=1, size="64", out=tmp_path / "out"
    )
    rows = dark_frames.main(config)
    found = of_kind(rows, "capture")
    assert [row["capture"] for row in found] == ["built-in room", scan.name]
    for row in found:
        (share,) = row["shares"]
        assert 0 <= share["evening-lamps"]["black"] <= 0.3 and share["evening-lamps"]["too_dark"] is False
    table, *_ = dark_frames.blocks(rows, config.out)
    assert [line[1] for line in table.rows] == ["evening-lamps"] * 2
    with pytest.raises(InputError, match="no set-up 'dawn'"):
        dark_frames.main(dataclasses.replace(config, setups=("dawn",)))


def test_bad_options_are_one_line(tmp_path: Path) -> None:
    for options, message in (
        ({"pairs": ()}, "at least one pair"),
        ({"folder": tmp_path}, "no folder NAME/"),
        ({"geometries": ("fine",)}, "neither true nor rough"),
    ):
        with pytest.raises(InputError, match=message):
            real.main(real.Config(out=tmp_path / "out", **options))  # type: ignore[arg-type]


def test_a_pair_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_bench, "open_relit_pairs", lambda _: [SimpleNamespace(name="Art")])
    monkeypatch.setattr(real_captures, "DATA", tmp_path)
    for call in (
        lambda: real.main(real.Config(out=tmp_path / "a", folder=tmp_path, pairs=("Piano",))),
        lambda: readme_picture.main(readme_picture.Config(out=tmp_path / "b", folder=tmp_path)),
        real_captures.real_captures,
    ):
        with pytest.raises(InputError, match="has no 'Piano'; it has Art"):
            call()
