"""The registry of metrics: one added from outside the package is judged, scored and reported like the others."""

import csv
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Bool, Float

from experiments.judging import better_text, judge, text_of
from hyjax import InputError
from hyjax.configuration import Configuration
from hyjax.light.color import to_linear
from hyjax.light.shaded import Shaded
from hyjax.metrics import METRICS, LpipsWeights, Metric, plain_metrics, register_metric
from hyjax.tuning import report as frame_report
from hyjax.tuning.cases import Case, scores
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.evaluation import mean_scores
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.report_page import page as frame_page
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.scene import Target

SIZE = 32
EVERYWHERE = np.ones((SIZE, SIZE), bool)


def mean_error(
    image: Float[Array, "h w c"], reference: Float[Array, "h w c"], *, valid: Bool[Array, "h w"] | None = None
) -> Float[Array, ""]:
    return jnp.mean(mean_error_map(image, reference), where=valid)


def mean_error_map(image: Float[Array, "h w c"], reference: Float[Array, "h w c"]) -> Float[Array, "h w"]:
    return jnp.mean(jnp.abs(image - reference), axis=-1)


MAE = Metric(mean_error, mean_error_map, digits=3, better="lower", label="MAE")


@pytest.fixture
def mae() -> Iterator[Metric]:
    register_metric("mae", MAE)
    yield MAE
    del METRICS["mae"]


def picture(seed: int) -> jax.Array:
    return jax.random.uniform(jax.random.key(seed), (SIZE, SIZE, 3))


def test_a_metric_from_outside_judges_by_region(mae: Metric) -> None:
    target = picture(0)
    left = EVERYWHERE.copy()
    left[:, SIZE // 2 :] = False
    off = jnp.where(jnp.asarray(left)[..., None], target, jnp.abs(target - 0.25))
    found = judge({"off": off}, target, {"left": left, "right": ~left, "all": EVERYWHERE}, None)["off"]
    error = np.abs(np.asarray(off - target))
    assert found["left"]["mae"] == 0.0
    assert found["right"]["mae"] == pytest.approx(error[~left].mean(), rel=1e-5)
    assert found["all"]["mae"] == pytest.approx(error.mean(), rel=1e-5)
    assert set(found["all"]) == {"psnr", "ssim", "mae"}  # without weights no learned metric
    assert "MAE: lower is better" in better_text() and text_of(None, "mae") == "–"


def test_a_metric_from_outside_is_one_of_the_tuners_scores(mae: Metric) -> None:
    rng = np.random.default_rng(0)
    frame, target = (jnp.asarray(rng.uniform(0.1, 0.9, (SIZE, SIZE, 3)), jnp.float32) for _ in range(2))
    valid = jnp.asarray(rng.uniform(size=(SIZE, SIZE)) < 0.5)
    shaded = Shaded(target, jnp.ones_like(target), jnp.eye(3), 1.0 * valid[..., None], jnp.ones(()), jnp.zeros(3))
    case = Case(shaded, frame, frame, target, valid)
    found = scores([case, case], [target, jnp.where(valid[..., None], target, 0.0)])
    assert found["loss"] == 0.0 and found["mae"] == 0.0 and found["psnr"] == np.inf
    worse = scores([case], [0.5 * target])
    assert list(worse) == ["loss", "psnr", "ssim", "mae"]
    assert worse["mae"] > 0.05 and worse["ssim"] < 1.0
    assert {"tuning_mae", "held_out_mae", "tuning_psnr"} <= set(frame_report.score_columns())


def test_a_metric_from_outside_is_in_reports_of_frames_and_in_rows_of_sweeps(
    mae: Metric, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scores of a frame are what `tune` reports and what a sweep's rows hold."""
    rng = np.random.default_rng(0)
    shown = rng.uniform(0.1, 0.8, (SIZE, SIZE, 3)).astype(np.float32)
    target = Target(shown, EVERYWHERE, False)
    found = PictureLoss().scores(np.asarray(to_linear(jnp.asarray(shown))) * 1.1, target)
    assert set(found) == {"loss", "psnr", "ssim", "mae", "psnr_raw"} and 0 < found["mae"] < 0.1
    assert mean_scores([found, found])["mae"] == pytest.approx(found["mae"])
    time = FrameTime(10.0, 11.0, 20.0, 0.5)
    candidate = Candidate(Configuration(), found | {"relative": 1.0}, None, time)
    tuned = Tuned(Configuration(), [candidate], [Budget("9 ms", 9.0)], [candidate], [], [], [], [], {})
    frame_report.write_pareto_csv(tmp_path / "pareto.csv", tuned)
    (row,) = csv.DictReader((tmp_path / "pareto.csv").read_text(encoding="utf-8").splitlines())
    assert float(row["tuning_mae"]) == pytest.approx(found["mae"], rel=1e-4) and row["held_out_mae"] == ""
    assert ">MAE</th>" in frame_page(tuned, [])


def test_scores_are_those_of_the_metrics_themselves() -> None:
    target, image = picture(0), picture(1)
    found = judge({"x": image}, target, {"all": EVERYWHERE}, None)["x"]["all"]
    assert found["psnr"] == pytest.approx(float(METRICS["psnr"].function(image, target)), rel=1e-5)
    assert set(plain_metrics()) == {"psnr", "ssim"}


def test_lpips_by_the_registry_is_lpips(lpips_weights: LpipsWeights) -> None:
    metric, (a, b) = METRICS["lpips"], (jnp.tile(picture(seed), (2, 2, 1)) for seed in (0, 1))
    assert metric.prepare is not None
    mean = float(jnp.mean(metric.map(a, metric.prepare(b, lpips_weights))))
    assert mean == pytest.approx(float(metric.function(a, b, lpips_weights)), rel=0.1)
    found = judge({"a": a}, b, {"all": np.ones(a.shape[:2], bool)}, lpips_weights)
    assert found["a"]["all"]["lpips"] == pytest.approx(mean, rel=1e-4)


@pytest.mark.parametrize("name", ["psnr", "loss", "no name", ""])
def test_names_that_are_taken_or_none(name: str) -> None:
    with pytest.raises(InputError, match="name: "):
        register_metric(name, MAE)


def test_better_is_higher_or_lower() -> None:
    with pytest.raises(InputError, match="better: must be higher or lower, got 'more'"):
        Metric(mean_error, mean_error_map, digits=3, better="more", label="MAE")  # type: ignore[arg-type]
