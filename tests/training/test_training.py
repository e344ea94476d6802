"""Training: the loss, one update, and whole runs on a toy encoder: resumed, on two devices, on bad input."""

import dataclasses
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import UNOPTIMISED
from reference.toy_encoder import ToyEncoder

from hyjax.cli import Train, main, parse
from hyjax.guide import ENCODERS, load_guide
from hyjax.pairs.augmentation import Crop
from hyjax.training.checkpoints import Checkpoints
from hyjax.training.objective import batch_losses, border_loss, schedule_of, total
from hyjax.training.run import train
from hyjax.training.settings import TrainSettings, paper_settings
from hyjax.training.state import TrainState, Updater
from hyjax.training.targets import Sample
from hyjax.training.validation import Validation, sample_of
from hyjax.util.errors import InputError
from hyjax.util.images import read_image, write_png

SIZE = 32
SETTINGS = TrainSettings(
    encoder="toy",
    features=4,
    pairs=(),
    size=SIZE,
    batch=2,
    iterations=6,
    factors=(8,),
    schedule="naive-50",  # one level: the gradient is quick to compile
    validate_every=3,
    checkpoint_every=2,
)


class KeptUpdater(Updater):
    """Updater whose programs serve all runs that differ in their length alone."""

    programs: ClassVar[dict[TrainSettings, tuple[int, Any, Any]]] = {}

    def prepare(self, state: TrainState, batch: Sample) -> int:
        key = dataclasses.replace(self.settings, iterations=1, validate_every=1, checkpoint_every=1)
        if key not in self.programs:
            self.programs[key] = super().prepare(state, batch), self._update, self._features
        needed, self._update, self._features = self.programs[key]
        return needed


@pytest.fixture(autouse=True)
def toy_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """A network that compiles in seconds."""
    monkeypatch.setitem(ENCODERS, "toy", ToyEncoder)
    monkeypatch.setattr("hyjax.training.run.Updater", KeptUpdater)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Four pictures of a square before a wall, with depth."""
    root = tmp_path_factory.mktemp("pairs")
    rng = np.random.default_rng(0)
    for k in range(4):
        near = np.zeros((48, 48), bool)
        top, left = rng.integers(4, 20, 2)
        near[top : top + 20, left : left + 20] = True
        image = np.where(near[..., None], rng.random(3), rng.random(3)) + 0.02 * rng.random((48, 48, 3))
        write_png(root / f"pair{k}_rgb.png", np.clip(image, 0, 1).astype(np.float32))
        write_depth(root / f"pair{k}_depth.png", np.where(near, 1000, 2000))
    yield root


def write_depth(path: Path, millimetres: np.ndarray) -> None:
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(*millimetres.shape[::-1], 1, "uint16")
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(millimetres.astype(np.uint16)[..., None])
    output.close()


def sample(seed: int = 0, size: int = SIZE) -> Sample:
    """Half near, half far, its border in the middle column."""
    rng = np.random.default_rng(seed)
    depth = np.where(np.arange(size) < size // 2, 1.0, 2.0) * np.ones((size, 1))
    normal = np.broadcast_to([0.0, 0.0, -1.0], (size, size, 3))
    arrays = rng.random((size, size, 3)), depth, np.ones((size, size), bool), normal
    return Sample(*(jnp.asarray(a, bool if a.dtype == bool else jnp.float32) for a in arrays))


def batched(*samples: Sample) -> Sample:
    return Sample(*(jnp.stack(fields) for fields in zip(*samples, strict=True)))


def guide_with(strength: float, column: int = SIZE // 2) -> jax.Array:
    """A guide that jumps at a column."""
    return strength * jnp.broadcast_to((jnp.arange(SIZE) >= column)[None, :, None], (SIZE, SIZE, 2)).astype(float)


# ---- objective ----


@pytest.mark.slow
@pytest.mark.parametrize("through", ["cascade", "steps"])
def test_the_right_guide_loses_least(through: str) -> None:
    settings = dataclasses.replace(SETTINGS, through=through, steps_without_gradient=5, steps_with_gradient=20)
    batch = batched(sample())
    found = {
        name: batch_losses(guide[None], jnp.log(0.02), batch, jax.random.key(0), jnp.asarray(0), settings)
        for name, guide in {"right": guide_with(1.0), "blind": guide_with(0.0), "wrong": guide_with(1.0, 9)}.items()
    }
    for name in ("depth", "shading", "border"):
        right, blind, wrong = (float(getattr(found[guide], name)) for guide in ("right", "blind", "wrong"))
        assert right < 0.7 * blind, name
        assert right < wrong, name


def test_losses_of_weight_zero_are_left_out_of_the_sum() -> None:
    settings = dataclasses.replace(SETTINGS, shading_weight=0.0, border_weight=0.0)
    losses = batch_losses(
        guide_with(0.0)[None], jnp.zeros(()), batched(sample()), jax.random.key(0), jnp.asarray(0), settings
    )
    assert losses.shading == losses.border == 0 and losses.depth > 0
    assert total(losses, settings) == losses.depth


@pytest.mark.slow
@pytest.mark.parametrize("through", ["cascade", "steps"])
def test_gradient_against_finite_differences(through: str) -> None:
    settings = dataclasses.replace(SETTINGS, through=through, steps_without_gradient=0, steps_with_gradient=8)
    with jax.enable_x64(True):
        crop = Sample(*(jnp.asarray(np.asarray(x), bool if x.dtype == bool else jnp.float64) for x in sample()))
        rng = np.random.default_rng(1)
        features = jnp.asarray(0.3 * rng.standard_normal((1, SIZE, SIZE, 2)))
        direction = jnp.asarray(rng.standard_normal(features.shape))

        def loss(features: jax.Array, log_kappa: jax.Array) -> jax.Array:
            key = jax.random.key(0)
            return total(batch_losses(features, log_kappa, batched(crop), key, jnp.asarray(0), settings), settings)

        log_kappa, step = jnp.asarray(-1.0), 1e-6
        slope, slope_kappa = jax.jit(jax.grad(loss, (0, 1)))(features, log_kappa)
        value = jax.jit(loss)
        along = (value(features + step * direction, log_kappa) - value(features - step * direction, log_kappa)) / (
            2 * step
        )
        np.testing.assert_allclose(jnp.vdot(slope, direction), along, rtol=1e-4)
        along = (value(features, log_kappa + step) - value(features, log_kappa - step)) / (2 * step)
        np.testing.assert_allclose(slope_kappa, along, rtol=1e-4)


def test_a_cell_that_is_partly_unknown_is_not_called_free_of_borders() -> None:
    seen = sample()
    half = seen._replace(valid=seen.valid & (jnp.arange(SIZE) < SIZE // 2))
    wrong = guide_with(3.0, column=SIZE // 2 + 6)  # a border where nothing is known
    schedule = schedule_of(SETTINGS, jnp.asarray(1.0))
    assert border_loss(wrong, jnp.zeros(()), half, schedule) < border_loss(wrong, jnp.zeros(()), seen, schedule)


def test_without_normals_a_guide_that_stops_everything_is_not_the_best() -> None:
    seen = sample()._replace(normal=jnp.zeros((SIZE, SIZE, 3)))
    schedule = schedule_of(SETTINGS, jnp.asarray(1.0))
    rows, columns = jnp.indices((SIZE, SIZE))
    everywhere = 5.0 * ((rows + columns) % 2)[..., None] * jnp.ones(2)
    right = border_loss(5.0 * (columns >= SIZE // 2)[..., None] * jnp.ones(2), jnp.zeros(()), seen, schedule)
    assert right < 0.2 * border_loss(everywhere, jnp.zeros(()), seen, schedule)


# ---- runs ----


def settings_for(folder: Path, **changes: object) -> TrainSettings:
    return dataclasses.replace(SETTINGS, pairs=(f"folder:{folder}",), **changes)  # type: ignore[arg-type]


def log_of(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


KILLED = """
import os, signal, sys
sys.path[:0] = {paths!r}
from pathlib import Path
import test_training as t
t.ENCODERS["toy"] = t.ToyEncoder
update, calls = t.Updater.update, []

def killing(self, state, batch):
    calls.append(0)
    if len(calls) == 6:
        os.kill(os.getpid(), signal.SIGKILL)
    return update(self, state, batch)

t.Updater.update = killing
t.train(t.settings_for(Path({folder!r})), Path({out!r}), progress=False)
"""


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_bits(folder: Path, tmp_path: Path) -> None:
    """Killed in its sixth update, of which the checkpoint of the fourth and five lines of the log are left.

    What stands behind the checkpoint, a line cut off among it, is made again; a finished run does not go on.
    """
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(settings_for(folder), whole, progress=False)
    paths = [str(Path(__file__).parents[k]) for k in (0, 1)]
    done = run_python(KILLED.format(paths=paths, folder=str(folder), out=str(parts)), count=1)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert [line["iteration"] for line in log_of(parts) if "loss" in line] == [1, 2, 3, 4, 5]
    assert Checkpoints(parts / "checkpoints").latest() == 4
    with (parts / "log.jsonl").open("a") as file:
        file.write('{"iteration": 5, "loss": 123}\n{"itera')
    train(settings_for(folder), parts, resume=True, progress=False)
    with pytest.raises(InputError, match=r"iterations: the run in .* has 6 already; give more to go on with it"):
        train(settings_for(folder), parts, resume=True, progress=False)
    expected, found = (
        [(line["iteration"], line["loss"]) for line in log_of(out) if "loss" in line] for out in (whole, parts)
    )
    assert found == expected and [iteration for iteration, _ in found] == [1, 2, 3, 4, 5, 6]
    assert len({loss for _, loss in found}) == 6
    for name in ("curve.png", "settings.json", "validation/000006.png"):
        assert (parts / name).stat().st_size > 0
    one, other = (load_guide(out / "guide.safetensors") for out in (whole, parts))
    picture = jnp.asarray(np.random.default_rng(0).random((SIZE, SIZE, 3), np.float32))
    np.testing.assert_array_equal(one.features(picture), other.features(picture))


@pytest.mark.slow
def test_training_lowers_the_loss_and_leaves_a_guide(folder: Path, tmp_path: Path) -> None:
    settings = settings_for(folder, iterations=20, learning_rate=1e-2, validate_every=10)
    last = train(settings, tmp_path, command="hyjax train", progress=False)
    validations = [line["validation"]["loss"] for line in log_of(tmp_path) if "validation" in line]
    assert last["loss"] == validations[-1] < 0.8 * validations[0]
    guide = load_guide(tmp_path / "guide.safetensors")
    assert guide.metadata["command"] == "hyjax train" and json.loads(guide.metadata["settings"])["batch"] == 2
    frame = jnp.asarray(read_image(folder / "pair0_rgb.png"))
    assert guide.features(frame).shape == (*frame.shape[:2], settings.features)


@pytest.mark.slow
@pytest.mark.parametrize("sound", [2, 3])  # right after a checkpoint, and later
def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_last_good_state(
    sound: int, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = itertools.count()

    def poisoned(batch: Crop) -> Sample:
        sample = sample_of(batch)
        return sample._replace(image=sample.image * jnp.nan) if next(count) == sound else sample

    monkeypatch.setattr("hyjax.training.run.sample_of", poisoned)
    with pytest.raises(
        InputError, match=rf"loss became nan at iteration {sound + 1}, .* go on with --start, a lower --learning"
    ):
        train(settings_for(folder), tmp_path, progress=False)
    assert [line["iteration"] for line in log_of(tmp_path) if "loss" in line] == [*range(1, sound + 1)]
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    state, _ = checkpoints.restore(Updater(settings_for(folder)).initial())
    assert int(state.iteration) == sound == checkpoints.latest()
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(state))
    load_guide(tmp_path / "last.safetensors")


@pytest.mark.slow
def test_a_run_killed_in_its_last_validation_can_be_finished(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_for(folder, iterations=2, validate_every=2, checkpoint_every=1)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Validation, "__call__", Mock(side_effect=KeyboardInterrupt))
        train(settings, tmp_path, progress=False)
    assert not (tmp_path / "guide.safetensors").exists()
    train(settings, tmp_path, resume=True, progress=False)
    load_guide(tmp_path / "guide.safetensors")
    assert [line["iteration"] for line in log_of(tmp_path)] == [1, 2, 2]


@pytest.mark.slow
def test_the_command_trains_and_compares_with_the_rgb_guide(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    given = [
        "--pairs",
        f"folder:{folder}",
        "--encoder",
        "toy",
        "--features",
        "4",
        "--size",
        str(SIZE),
        "--batch",
        "2",
    ]
    given += ["--iterations", "1", "--factors", "8", "--schedule", "naive-50", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["hyjax", "train", "--quiet", *given])
    main()
    told = capsys.readouterr().out.splitlines()
    assert told[0].split() == ["validation", "guide", "RGB", "guide"]
    assert [line.split()[0] for line in told[1:3]] == ["loss", "border"]
    assert told[-1].endswith(f"relight with --guide {tmp_path / 'out' / 'guide.safetensors'}")


def test_the_papers_recipe_is_only_a_default(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, expected in (
        ([], TrainSettings()),
        (["--paper"], paper_settings()),
        (["--paper", "--size", "64"], dataclasses.replace(paper_settings(), size=64)),
    ):
        monkeypatch.setattr(sys, "argv", ["hyjax", "train", *given])
        command = parse()
        assert isinstance(command, Train) and command.settings == expected


@pytest.mark.slow
def test_too_little_memory_names_what_to_lower(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("hyjax.training.run._free_memory", lambda: 1e6)
        with pytest.raises(
            InputError, match=r"batch: an update needs .* lower --batch \(now 2\) or --size \(now 32\)"
        ):
            train(settings_for(folder), tmp_path, progress=False)
    train(settings_for(folder, iterations=1), tmp_path, progress=False)  # what was refused blocks nothing


@pytest.mark.slow
def test_a_batch_that_no_devices_can_share_is_refused() -> None:
    Updater(dataclasses.replace(SETTINGS, batch=3))  # one device takes any
    code = (
        "import sys; sys.argv = ['hyjax', 'train', '--batch', '3', '--pairs', 'rooms']\n"
        "from hyjax.cli import main; main()"
    )
    done = run_python(code, count=2)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1] == "hyjax: batch: 3 crops cannot be divided among 2 devices"


def devices(count: int) -> dict[str, str]:
    """An environment in which the processor counts as several devices, and which takes what was compiled in it."""
    kept = {
        "JAX_COMPILATION_CACHE_DIR": os.environ["HYJAX_TESTS_COMPILED"],
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    return os.environ | kept | {"XLA_FLAGS": f"{UNOPTIMISED} --xla_force_host_platform_device_count={count}"}


def run_python(code: str, count: int) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], env=devices(count), capture_output=True, text=True)


@pytest.fixture(scope="module")
def alone(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict]:
    """Log of a run on one device of one host."""
    out = tmp_path_factory.mktemp("alone")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ENCODERS, "toy", ToyEncoder)
        train(settings_for(folder, iterations=3, validate_every=1), out, progress=False)
    return log_of(out)


def assert_same_run(log: list[dict], expected: list[dict]) -> None:
    assert [line["iteration"] for line in log] == [line["iteration"] for line in expected]
    found, wanted = ([line.get("validation", line)["loss"] for line in lines] for lines in (log, expected))
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


@pytest.mark.slow
def test_two_hosts_make_the_same_updates_and_resume(folder: Path, tmp_path: Path, alone: list[dict]) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    code = f"""
import sys
sys.path[:0] = {[str(Path(__file__).parents[k]) for k in (0, 1)]!r}
import jax
jax.distributed.initialize("127.0.0.1:{port}", 2, int(sys.argv[1]))
assert jax.process_count() == 2 and jax.device_count() == 2
from pathlib import Path
import hyjax.training.run
import test_training as t
t.ENCODERS["toy"], hyjax.training.run.Updater = t.ToyEncoder, t.KeptUpdater
for iterations, resume in ((2, False), (3, True)):
    settings = t.settings_for(Path({str(folder)!r}), iterations=iterations, validate_every=1)
    t.train(settings, Path({str(tmp_path)!r}), resume=resume, progress=False)
"""
    hosts = [
        subprocess.Popen([sys.executable, "-c", code, str(k)], env=devices(1), stderr=subprocess.PIPE, text=True)
        for k in range(2)
    ]
    try:
        for host in hosts:
            _, errors = host.communicate(timeout=300)
            assert host.returncode == 0, errors
    finally:
        for host in hosts:
            host.kill()
    assert_same_run(log_of(tmp_path), alone)
    load_guide(tmp_path / "guide.safetensors")
