"""Shaders of a cascade against the functions of `hyjax.core`, kernel by kernel."""

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax.core.cascade import cascade, level_edges
from hyjax.core.pyramid import cell_pyramid, upsample
from hyjax.core.refine import fill_visibility
from hyjax.core.schedule import PRESETS, Schedule
from hyjax.core.upsampling import guided_upsample
from hyjax.device.cascade_program import CascadeWriter
from hyjax.device.precision_check import precision_check
from hyjax.device.program import Groups, Program, grid_of
from hyjax.device.renderer import channel_groups
from hyjax.device.webgpu import ShaderEngine

EXACT = 1e-5


def pictures(shape: tuple[int, int], channels: int, features: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return tuple(rng.random((*shape, n), np.float32) for n in (channels, features))


def run(
    device: Any, schedule: Schedule, source: np.ndarray, guide: np.ndarray, precision: Any = "f32"
) -> tuple[ShaderEngine, str]:
    """Engine after a cascade, and the buffer of its result."""
    dtype = np.float32 if precision == "f32" else np.float16
    program, groups = Program(source.shape[:2], precision), Groups(-(-source.shape[2] // 4))
    program.picture("source", program.size, groups)
    program.picture("guide", program.size, Groups(-(-guide.shape[2] // 4)))
    name = CascadeWriter(program, "guide", guide.shape[2]).cascade("cascade", "source", schedule, groups)
    engine = ShaderEngine(program, 0, {}, device)
    engine.upload("source", channel_groups(source).astype(dtype))
    engine.upload("guide", channel_groups(guide).astype(dtype))
    engine.run("frame")
    return engine, name


def picture(
    engine: ShaderEngine, name: str, shape: tuple[int, int], channels: int, dtype: Any = np.float32
) -> np.ndarray:
    planes = engine.download(name, dtype)
    size = 4 * shape[0] * shape[1]
    planes = planes[: len(planes) // size * size].reshape(-1, *shape, 4)
    return np.moveaxis(planes, 0, 2).reshape(*shape, -1)[..., :channels]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "shape"),
    list(zip([name for name in PRESETS if name != "naive-1000"], itertools.cycle([(45, 67), (64, 48)]))),
)
def test_presets(device: Any, name: str, shape: tuple[int, int]) -> None:
    (source, guide), schedule = pictures(shape, 6, 3), Schedule.preset(name)
    result = picture(*run(device, schedule, source, guide), shape, 6)
    assert np.abs(result - np.asarray(cascade(jnp.asarray(source), jnp.asarray(guide), schedule))).max() < EXACT


@pytest.mark.slow
@settings(max_examples=6)
@given(
    shape=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    channels=st.integers(1, 9),
    features=st.integers(1, 6),
    steps=st.lists(st.integers(0, 9), min_size=3, max_size=3),
    factor=st.integers(1, 3),
    options=st.fixed_dictionaries(
        {
            "pooling": st.sampled_from(["edges", "guide"]),
            "upsampling": st.sampled_from(["bilinear", "guide"]),
            "norm": st.sampled_from(["l2", "mean_abs"]),
            "fidelity": st.sampled_from([None, 0.3]),
            "kappa": st.floats(0.01, 1.0),
        }
    ),
)
def test_any_schedule(
    device: Any,
    shape: tuple[int, int],
    channels: int,
    features: int,
    steps: list[int],
    factor: int,
    options: dict[str, Any],
) -> None:
    schedule = Schedule.uniform([(4 * factor, steps[0]), (2 * factor, steps[1]), (factor, steps[2])], **options)
    source, guide = pictures(shape, channels, features)
    result = picture(*run(device, schedule, source, guide), shape, channels)
    assert np.abs(result - np.asarray(cascade(jnp.asarray(source), jnp.asarray(guide), schedule))).max() < EXACT


def test_cell_means_and_conductances(device: Any) -> None:
    source, guide = pictures((45, 67), 4, 3)
    for pooling in ("edges", "guide"):
        schedule = Schedule.uniform([(6, 1), (3, 1)], kappa=0.2, pooling=pooling)
        engine, _ = run(device, schedule, source, guide)
        means = cell_pyramid(jnp.asarray(source), [6, 3])
        for factor, expected in means.items():
            cells = picture(engine, f"cascade means {factor}", expected.shape[:2], 4)
            assert np.abs(cells - np.asarray(expected)).max() < EXACT
        edges = sorted(name for name in engine.program.buffers if name.startswith("edges"))
        for name, (down, right) in zip(
            sorted(edges, key=lambda n: -int(n.split()[1])), level_edges(guide, schedule)
        ):
            rows, columns = right.shape[0], down.shape[1]
            found = engine.download(name)[: 2 * rows * columns].reshape(rows, columns, 2)
            assert np.abs(found[:-1, :, 0] - np.asarray(down)).max() < EXACT
            assert np.abs(found[:, :-1, 1] - np.asarray(right)).max() < EXACT
            assert not found[-1, :, 0].any() and not found[:, -1, 1].any()


@pytest.mark.parametrize("factor", [2, 3, 8])
def test_upsampling(device: Any, factor: int) -> None:
    """A level without steps leaves cell means and their interpolation."""
    shape, (source, guide) = (33, 50), pictures((33, 50), 4, 3)
    coarse = cell_pyramid(jnp.asarray(source), [factor])[factor]
    plain = run(device, Schedule.uniform([(factor, 0)]), source, guide)
    assert np.abs(picture(*plain, shape, 4) - np.asarray(upsample(coarse, factor, shape))).max() < EXACT
    guided = run(device, Schedule.uniform([(factor, 0)], upsampling="guide", kappa=0.1), source, guide)
    expected = guided_upsample(coarse, factor, jnp.asarray(guide), 0.1)
    assert np.abs(picture(*guided, shape, 4) - np.asarray(expected)).max() < EXACT


def test_half_precision(device: Any) -> None:
    if "shader-f16" not in device.features:
        pytest.skip("this adapter has no half precision")
    shape, (source, guide), schedule = (64, 48), pictures((64, 48), 4, 3), Schedule.preset("hyjax")
    engine, name = run(device, schedule, source, guide, "f16")
    result = picture(engine, name, shape, 4, np.float16)
    expected = np.asarray(cascade(jnp.asarray(source), jnp.asarray(guide), schedule))
    assert 1e-6 < np.abs(result - expected).max() < 2e-3


@pytest.mark.slow
def test_filling(device: Any) -> None:
    """(value, weight) of four lights, completed where nothing is known, and far from it."""
    shape, lights = (40, 56), 4
    rng = np.random.default_rng(1)
    raw, guide = rng.random((*shape, lights), np.float32), rng.random((*shape, 3), np.float32)
    known = rng.random((*shape, lights)) < 0.5
    known[:, 20:], known[..., 3] = False, False
    program = Program(shape)
    source = program.picture("visibility", shape, Groups(0, 2))
    program.picture("guide", shape, Groups(1))
    writer = CascadeWriter(program, "guide", 3)
    filled = writer.levels("filling", source, Schedule.preset("hyjax"), Groups(0, 2), total=True)
    result = program.picture("result", shape, Groups(0, 1))
    guides, constants = writer.interpolation(filled, 4)
    bind, constants["first"] = [source, filled.buffer, "filling totals", result, *guides], "0u"
    files = ["filled", "interpolate", "fill"]
    program.launch("frame", "filling", files, bind, grid_of(shape), Groups(0, 1), constants=constants)
    engine = ShaderEngine(program, lights, {}, device)
    engine.upload(
        "visibility", np.concatenate([channel_groups(raw * known), channel_groups(known.astype(np.float32))])
    )
    engine.upload("guide", channel_groups(guide))
    engine.run("frame")
    expected = np.asarray(fill_visibility(jnp.asarray(raw), jnp.asarray(known), jnp.asarray(guide)))
    assert np.abs(picture(engine, "result", shape, lights) - expected).max() < EXACT


def test_the_check_of_precision_says_half_is_right(device: Any) -> None:
    if "shader-f16" not in device.features:
        pytest.skip("this adapter has no half precision")
    results = []
    for precision in ("f32", "f16"):
        engine = ShaderEngine(precision_check(precision), 1, {}, device)
        engine.run("check")
        results.append(engine.download("result"))
    assert results[0].std() > 0.1
    assert np.abs(results[1] - results[0]).mean() < 2e-3 * np.abs(results[0]).mean()
