"""Whatever a public function is given, it returns a result or an `InputError` that names the argument."""

import dataclasses
import json
import logging
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hostile import (
    CALLS,
    GBUFFER,
    LIGHT,
    MAY_MAKE_SENSE,
    PICTURE,
    SCHEDULE,
    SHADED,
    VIEW,
    H,
    W,
    more_calls,
    nonsense,
    raw_answers,
)

import hyjax
from hyjax import video
from hyjax.light.color import WHITE
from hyjax.util import argument_kinds

SYNONYMS = {"setup": "lights", "lam": "lam"}


def hostile() -> Iterator[Any]:
    for name, (_, given) in CALLS.items():
        for argument in given:
            yield pytest.param(name, argument, id=f"{name}-{argument}")


@pytest.mark.parametrize(("name", "argument"), [*hostile()])
def test_nonsense_is_refused_by_name(name: str, argument: str) -> None:
    """Sizes that disagree may be laid to any of the arguments."""
    function, given = CALLS[name]
    for kind, value in nonsense(name, argument, given[argument]):
        try:
            function(**given | {argument: value})
        except hyjax.InputError as error:
            message = str(error)
            named = [argument, SYNONYMS.get(argument, argument)] + ([*given] if kind == "other_size" else [])
            words = "|".join(re.escape(word) for word in named)
            assert "\n" not in message and re.search(rf"\b({words})\b", message), (kind, message)
        except Exception as error:
            raise AssertionError(f"{name}({argument}={kind}): {type(error).__name__}: {error}") from error
        else:
            assert kind in MAY_MAKE_SENSE, f"{name}({argument}={kind}) is taken"
            assert kind != "text" or argument == "schedule"


@pytest.mark.slow
def test_nothing_raw_of_what_reads_writes_and_holds_a_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that compute nothing; `python -m tests.hostile` calls all."""
    monkeypatch.chdir(tmp_path)  # a text may be taken for a path
    calls = more_calls(tmp_path)
    raw = [
        f"{name}({argument}={kind}): {error!r}"
        for name in sorted(calls.keys() - COMPUTING)
        for argument, kind, error in raw_answers(name, calls[name])
        if error is not None
    ]
    assert not raw, "\n".join(raw)


COMPUTING = {
    "Scene",
    "Scene.shade",
    "Scene.relit",
    "Relighter",
    "Relighter.relit",
    "Relighter.picture",
    "cast_shadow_maps",
}


def test_a_memory_of_other_channels_is_refused() -> None:
    for count in (1, 3):
        given = CALLS["steady"][1] | {"channels": jnp.ones((H, W, count))}
        with pytest.raises(hyjax.InputError, match=rf"^channels: {count} of this frame, 2 in the memory"):
            video.steady(**given)


CHEAP = ("conductance", "diffuse_step", "downsample", "composite", "luminance", "to_linear", "charbonnier")
LISTED = [
    pytest.param(name, marks=[] if name in CHEAP else [pytest.mark.slow])
    for name, (_, given) in CALLS.items()
    if any(isinstance(value, jax.Array) for value in given.values()) and name not in ("recall", "steady")
]


@pytest.mark.parametrize("name", LISTED)
def test_lists_and_double_precision_are_taken(name: str) -> None:
    """With the result that arrays in single precision have."""
    function, given = CALLS[name]
    arrays = [argument for argument, value in given.items() if isinstance(value, jax.Array)]
    usual = function(**given)
    for convert in (
        lambda x: x.tolist(),
        lambda x: np.asarray(x, float) if x.dtype == jnp.float32 else np.asarray(x),
    ):
        result = function(**given | {argument: convert(given[argument]) for argument in arrays})
        for a, b in zip(jax.tree.leaves(usual), jax.tree.leaves(result), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)
            assert jnp.asarray(a).dtype == jnp.asarray(b).dtype


@pytest.mark.parametrize("name", ["View.of", "to_linear", "psnr", "ssim"])
def test_pictures_of_bytes_are_scaled_and_that_is_said_once(name: str, caplog: pytest.LogCaptureFixture) -> None:
    function, given = CALLS[name]
    argument = next(iter(given))
    frame = np.asarray(255 * PICTURE).astype(np.uint8)
    argument_kinds._told.clear()
    with caplog.at_level(logging.WARNING):
        results = [
            function(**given | {argument: value}) for value in (frame, frame, frame.astype(np.float32) / 255)
        ]
    first, _, usual = map(jax.tree.leaves, results)
    assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(first, usual))
    assert [record.message.split(":")[0] for record in caplog.records] == [argument]


def test_a_guide_and_a_mask_of_bytes_are_refused() -> None:
    with pytest.raises(hyjax.InputError, match=r"^guide: must be a float array .* got uint8 of shape .* by 255$"):
        hyjax.conductance(np.zeros((H, W, 3), np.uint8), 20.0)
    with pytest.raises(
        hyjax.InputError, match=r"^valid: .* got uint8 of shape .*; compare a mask of bytes with 0$"
    ):
        hyjax.metrics.psnr(PICTURE, PICTURE, valid=np.full((H, W), 255, np.uint8))


def test_lists_of_whole_numbers_are_no_display_picture() -> None:
    """Values from 0 to 255 may be meant, which bytes would say."""
    with pytest.raises(hyjax.InputError, match=r"^display: must be a float array"):
        hyjax.to_linear([[[255, 128, 0]]])  # type: ignore[arg-type]
    assert np.array_equal(hyjax.to_linear([[[1, 0, 0]]]), np.float32([[[WHITE, 0.0, 0.0]]]))  # type: ignore[arg-type]


def test_a_preset_by_name_and_a_single_light() -> None:
    by_name, usual = (hyjax.level_edges(PICTURE, s) for s in ("shadow", hyjax.Schedule.preset("shadow")))
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(by_name), jax.tree.leaves(usual)))
    one, several = (hyjax.shade_each(GBUFFER, lights) for lights in (LIGHT, [LIGHT]))
    assert np.array_equal(one, several)
    assert hyjax.LightSetup.of(LIGHT).lights == (LIGHT,)
    with pytest.raises(hyjax.InputError, match=r"^shadow_schedule: no preset 'shadw' \(did you mean 'shadow'\?\)"):
        hyjax.relight(VIEW, SHADED, PICTURE, SCHEDULE, shadow_schedule="shadw")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": jnp.array([0.0, jnp.nan, 0.0])}, r"position: must be three finite numbers"),
        (
            {"position": jnp.zeros(2)},
            r"position: must be three finite numbers, .* got float32 of shape \(2,\)",
        ),
        ({"position": [0.0, 0.0, 1.0]}, r"position: must be three finite numbers, as an array"),
        ({"position": np.array(["a", "b", "c"])}, r"position: must be three finite numbers"),
        ({"color": -jnp.ones(3)}, r"color: must be three finite numbers, none negative"),
        ({"luminous_flux": float("inf")}, r"luminous_flux: must be a finite number"),
        ({"luminous_flux": None}, r"luminous_flux: must be a finite number"),
        ({"direction": np.zeros(3)}, r"direction: must not be the zero vector"),
        ({"outer_angle": 3.0}, r"outer_angle: must lie in"),
        ({"radius": -0.1}, r"radius: must lie in"),
    ],
)
def test_values_of_lights_are_checked_where_they_are_used(change: dict[str, Any], message: str) -> None:
    down, up = np.array([0.0, 0.0, -1.0], np.float32), np.array([0.5, 0.5, 2.0], np.float32)
    spot = hyjax.SpotLight(up, down, 800.0, np.ones(3, np.float32), 0.3, 0.6)
    VIEW.shade(spot)
    bad = dataclasses.replace(spot, **change)
    for use in (lambda: VIEW.shade([LIGHT, bad]), lambda: VIEW.shade(hyjax.LightSetup((LIGHT, bad)))):
        with pytest.raises(hyjax.InputError, match=rf"^lights\[1\]\.{message}"):
            use()


def test_traced_lights_and_pictures_pass() -> None:
    def mean(flux: jax.Array, guide: jax.Array) -> jax.Array:
        light = dataclasses.replace(LIGHT, luminous_flux=flux)
        return jnp.mean(VIEW.shade(light).illuminance) + jnp.mean(hyjax.conductance(guide, flux)[0])

    value, slope = jax.jit(jax.value_and_grad(mean))(jnp.float32(800.0), PICTURE)
    assert np.isfinite(value) and slope > 0
    each = jax.vmap(mean, (0, None))(jnp.array([1.0, 800.0]), PICTURE)
    assert each.shape == (2,) and np.isclose(each[1], value)


@pytest.mark.parametrize("steps", [[(4, 10**12)], [(8, 60_000), (4, 60_000)]])
def test_steps_are_bounded(steps: list[tuple[int, int]]) -> None:
    with pytest.raises(hyjax.InputError, match="100000"):
        hyjax.Schedule.uniform(steps)


@pytest.mark.parametrize("level", [{"lam": "0.1"}, {"kappa": True}, {"fidelity": False}, {"lam": [0.1, True]}])
def test_text_and_truth_values_are_no_numbers_of_a_schedule(level: dict[str, Any]) -> None:
    text = json.dumps({"levels": [{"factor": 2, "steps": 2, "kappa": 0.1} | level]})
    with pytest.raises(hyjax.InputError, match=f"'{next(iter(level))}' must be numbers"):
        hyjax.Schedule.from_json(text)


@pytest.mark.parametrize(
    "settings",
    [
        lambda: hyjax.TuneSettings(fps=(True,)),
        lambda: hyjax.TuneSettings(fps=("60",)),  # type: ignore[arg-type]
        lambda: hyjax.TuneSettings(fps=(60.0,), time_limit=float("nan")).check(),
        lambda: hyjax.TuneSettings(fps=(60.0,), time_limit=float("inf")).check(),
        lambda: hyjax.TuneSettings(fps=(1e300,)).check(),
        lambda: hyjax.RelightSettings(kappa=float("inf")).check(),
        lambda: hyjax.RelightSettings(sampling=True),
        lambda: hyjax.tune(fps="60"),  # type: ignore[arg-type]
        lambda: hyjax.tune(fps=[60, "30"]),  # type: ignore[list-item]
    ],
)
def test_settings_are_checked_before_any_work(settings: Callable[[], Any]) -> None:
    with pytest.raises(hyjax.InputError):
        settings()


@pytest.mark.slow
def test_the_command_that_counts_raw_answers_runs() -> None:
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile", "blackbody"], cwd=root, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0 and done.stdout.startswith("0 of "), done.stderr[-500:]
