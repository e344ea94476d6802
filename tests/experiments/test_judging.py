"""Scores by region, and what many frames say together."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.judging import beside_jump, judge, middle, pick, regions, summarise
from hyjax.light.gbuffer import GBuffer

SIZE = 32


def gbuffer(depth: np.ndarray) -> GBuffer:
    zeros = jnp.zeros((*depth.shape, 3))
    return GBuffer(zeros, zeros, jnp.asarray(depth, jnp.float32), jnp.asarray(depth > 0))


def picture(seed: int) -> jax.Array:
    return jax.random.uniform(jax.random.key(seed), (SIZE, SIZE, 3))


def test_regions_are_disjoint_and_cover_the_picture() -> None:
    rough, accurate = np.full((SIZE, SIZE), 2.0), np.full((SIZE, SIZE), 2.0)
    rough[:4] = 0.0  # a hole
    accurate[:, 20:] = 3.0  # a border that the rough surface lacks
    found = regions(gbuffer(rough), gbuffer(accurate))
    parts = [found[name] for name in ("holes", "silhouettes", "elsewhere")]
    assert (np.sum(parts, axis=0) == 1).all() and found["all"].all()
    assert found["holes"][:4].all() and found["holes"].sum() == 4 * SIZE
    assert found["silhouettes"][10, 19] and found["silhouettes"][10, 20]
    assert found["elsewhere"][10, 5]


def test_a_slope_is_no_jump() -> None:
    slope = np.linspace(2.0, 3.0, SIZE)[None].repeat(SIZE, axis=0)  # 1.6 % a pixel at most
    assert not beside_jump(slope).any()
    slope[:, 16:] += 0.5
    assert set(np.flatnonzero(beside_jump(slope, 0)[0])) == {15, 16}


def test_the_target_itself_is_perfect_and_noise_is_not() -> None:
    target, noise = picture(0), picture(1)
    mask = np.zeros((SIZE, SIZE), bool)
    mask[:16] = True
    half = jnp.where(mask[..., None], noise, target)
    found = judge({"same": target, "half": half}, target, {"wrong": mask, "right": ~mask}, None)
    assert found["same"]["wrong"] == {"psnr": float("inf"), "ssim": pytest.approx(1.0, abs=1e-5)}
    assert found["half"]["right"]["psnr"] == float("inf")
    expected = -10 * np.log10(np.mean((np.asarray(noise) - np.asarray(target))[:16] ** 2))
    assert found["half"]["wrong"]["psnr"] == pytest.approx(expected, rel=1e-4)
    assert found["half"]["wrong"]["ssim"] < 0.5


@given(st.integers(0, 1000))
def test_what_is_not_valid_counts_nowhere(seed: int) -> None:
    target, other = picture(0), picture(1)
    valid = np.zeros((SIZE, SIZE), bool)
    valid[8:24, 8:24] = True
    changed = jnp.where(valid[..., None], other, picture(seed + 2))
    everywhere = {"all": np.ones_like(valid)}
    a, b = (judge({"x": x}, target, everywhere, None, valid)["x"]["all"] for x in (other, changed))
    assert a == b


def test_specks_say_nothing() -> None:
    speck = np.zeros((100, 100), bool)
    speck[0, :9] = True
    image = jnp.full((100, 100, 3), 0.5)
    assert judge({"x": image}, image, {"speck": speck}, None) == {"x": {}}


def test_summaries() -> None:
    found = summarise([1.0, None, 3.0, 2.0])  # neighbours not alike
    assert found is not None and found.count == 3
    assert found.mean == pytest.approx(2.0) and found.half == pytest.approx(4.302653 / 3**0.5, rel=1e-5)
    assert found.text(2) == "2.00 ±2.48"
    alone = summarise([5.0])
    assert alone is not None and alone.half is None and alone.text(1) == "5.0"
    assert summarise([None]) is None
    same = summarise([5.0, 5.0])
    assert same is not None and same.half == 0.0


def test_intervals_of_medians_lie_within_the_values() -> None:
    assert middle([None]) is None
    few = middle([1.0, None, 2.0])
    assert few is not None and few.low is None and few.text(1) == "1.5" and few.text(1, sign="+") == "+1.5"
    five, six = middle([1.0, -1.0, 1.0, -1.0, 1.0]), middle([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    assert five is not None and five.low is None  # their range holds the median with 94 %,
    assert six is not None and six.low == -six.high == -1.0  # that of six with 97 %
    walk = [26.0 + 0.5 * n for n in range(12)]  # each frame like the next: summarise says more than their range
    slow, wide = middle(walk), summarise(walk)
    assert slow is not None and wide is not None and slow.low is not None and slow.high is not None
    assert wide.half is not None and 2 * wide.half > walk[-1] - walk[0]
    assert walk[0] <= slow.low < slow.median < slow.high <= walk[-1] and slow.median == np.median(walk)
    rng, inside, runs = np.random.default_rng(0), 0, 200
    for _ in range(runs):
        values = [rng.standard_normal()]
        for _ in range(59):
            values.append(0.5 * values[-1] + 0.866 * rng.standard_normal())
        found = middle(values)
        assert found is not None and found.low is not None and found.high is not None
        inside += found.low < 0 < found.high
    assert 0.85 < inside / runs <= 1.0
    assert found.text(2) == f"{found.median:.2f} ({found.low:.2f} to {found.high:.2f})"


def test_neighbours_that_are_alike_count_for_less() -> None:
    """The interval of correlated values holds their true mean nearly as often as it says, the naive one not."""
    rng, inside, naive, runs = np.random.default_rng(0), 0, 0, 300
    for _ in range(runs):
        values = [rng.standard_normal()]
        for _ in range(99):
            values.append(0.7 * values[-1] + 0.714 * rng.standard_normal())
        found = summarise(values)
        assert found is not None and found.half is not None
        inside += abs(found.mean) < found.half
        naive += abs(found.mean) < 1.98 * np.std(values, ddof=1) / 10
    assert naive / runs < 0.7
    assert 0.87 < inside / runs <= 1.0


def test_rims_of_holes_are_no_silhouettes() -> None:
    depth = np.full((SIZE, SIZE), 2.0)
    depth[10:20, 10:20] = 0.0
    assert not beside_jump(depth).any()


def test_picking() -> None:
    assert pick({"a": {"b": 3}}, "a", "b") == 3
    assert pick({"a": {}}, "a", "b", "c") is None
