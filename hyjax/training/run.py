"""Training run: from settings to weights, with a log, pictures and checkpoints.

The folder of a run holds

- `settings.json`: what it depends on; a run is only resumed with the same settings,
- `log.jsonl`: a line for each update and each validation,
- `checkpoints/`: the last good states,
- `validation/NNNNNN.png`: validation crops as they are super-resolved at that iteration,
- `curve.png`: losses over iterations,
- `guide.safetensors`: the weights with the lowest validation loss so far, and `last.safetensors`, those of the last
  validation.

A run killed at any moment and resumed goes on with the same numbers, on a CPU to the last bit (on a GPU with
XLA_FLAGS=--xla_gpu_deterministic_ops=true).
"""

import contextlib
import json
import logging
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from hyjax.guide import save_guide
from hyjax.pairs.loader import PairLoader
from hyjax.pairs.registry import open_pairs
from hyjax.training.checkpoints import Checkpoints
from hyjax.training.curve import draw_curve
from hyjax.training.log import TrainingLog
from hyjax.training.settings import TrainSettings
from hyjax.training.state import Progress, TrainState, Updater
from hyjax.training.validation import Validation, sample_of
from hyjax.util.arguments import checked_arguments
from hyjax.util.claims import claimed
from hyjax.util.environment import environment
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.files import make_writable

_log = logging.getLogger(__name__)

MEMORY_MARGIN = 0.9
"""Largest share of the free memory for an update."""


@checked_arguments
def train(
    settings: TrainSettings,
    out: Path,
    *,
    resume: bool = False,
    command: str = "",
    progress: bool = True,
) -> dict[str, Any]:
    """Train a guide network.

    With several hosts, call `jax.distributed.initialize` first and this with the same arguments on every one; `out`
    must be a folder that all of them see.

    Args:
        settings: see there.
        out: folder of the run, made if need be.
        resume: go on from the last checkpoint in `out`.
        command: how it was called, for the weights' metadata.
        progress: show a bar on stderr.

    Returns:
        The last validation: losses by name.

    Raises:
        InputError: settings, data or folder cannot be used, the run in `out` is another one, memory does not
            suffice, or the loss is no longer finite (the last good state stays in the checkpoints).
    """
    settings = settings.check()
    optional_module("matplotlib", "train", "train")
    make_writable(out)
    alone = out if jax.process_index() == 0 else None  # hosts share the folder
    with claimed(alone), contextlib.closing(Checkpoints(out / "checkpoints")) as checkpoints:
        log = TrainingLog(out, settings, resume)
        return _train(settings, out, log, checkpoints, resume, command, progress)


def _train(
    settings: TrainSettings,
    out: Path,
    log: TrainingLog,
    checkpoints: Checkpoints,
    resume: bool,
    command: str,
    progress: bool,
) -> dict[str, Any]:
    leads = jax.process_index() == 0
    sources = [open_pairs(spec) for spec in settings.pairs]
    judges = [open_pairs(spec) for spec in settings.validation] or sources
    resumed = resume and checkpoints.latest() is not None
    updater = Updater(settings, started=resumed)
    loader = PairLoader(
        sources,
        size=settings.size,
        batch=settings.batch // jax.process_count(),
        seed=settings.seed,
        shard=(jax.process_index(), jax.process_count()),
    )
    state, start = updater.initial(), 0
    if resumed:
        state, position = checkpoints.restore(state)
        state, start = updater.placed(state), int(state.iteration)
        loader.restore(position)
        if start >= settings.iterations:
            raise InputError(f"iterations: the run in {out} has {start} already; give more to go on with it")
    try:
        batch = updater.spread(sample_of(next(loader)))
        _check_memory(updater.prepare(state, batch), settings)
        validation = Validation(updater, judges)
        if settings.shading_weight and not any(batch.normal.any() for batch in validation.batches):
            _log.warning(
                "no normals in the validation's depth: its loss on shading is 0, and the training's may be"
            )
        # Only now: a run that was refused blocks no folder.
        data = [f"{source.name}: {len(source)} pairs, {source.fingerprint}" for source in sources]
        log.open(start, environment() | {"data": data}, write=leads)
        with tqdm(
            total=settings.iterations,
            initial=start,
            desc="training",
            unit="update",
            disable=not (progress and leads),
        ) as bar:
            for done in range(start + 1, settings.iterations + 1):
                state, outcome = updater.update(state, batch)
                position = loader.state()
                batch = updater.spread(sample_of(next(loader)))  # while the device is busy
                ends = done == settings.iterations
                if not bool(outcome.sound):
                    checkpoints.save(state, position)
                    if leads:
                        _export(updater, state, out / "last.safetensors", settings, command)
                    raise InputError(
                        f"{out}: the loss became {float(outcome.loss)} at iteration {done}, its gradient "
                        f"{float(outcome.gradient)}; the weights before that are in {out / 'last.safetensors'}: go "
                        "on with --start, a lower --learning-rate or --clip, and another --out"
                    )
                log.add(iteration=done, **_numbers(outcome))
                bar.update()
                bar.set_postfix_str(f"loss {float(outcome.loss):.3f}")
                if ends or done % settings.validate_every == 0:
                    log.add(iteration=done, validation=validation(state))
                    validation.draw(state, out / "validation" / f"{done:06d}.png" if leads else None)
                    if leads:
                        draw_curve(out / "curve.png", log.lines)
                        for name in ("last", "guide") if log.last_is_best() else ("last",):
                            _export(updater, state, out / f"{name}.safetensors", settings, command)
                # Last: a run killed before this does all of the above again.
                if ends or done % settings.checkpoint_every == 0:
                    checkpoints.save(state, position)
    except jax.errors.JaxRuntimeError as error:
        line = [*str(error).splitlines(), type(error).__name__][0]
        raise InputError(
            f"device: {jax.default_backend()} no longer works ({line}); if for want of memory, lower --batch (now "
            f"{settings.batch}) or --size (now {settings.size}), with another --out"
        ) from None
    return log.validations()[-1]["validation"]


def _numbers(update: Progress) -> dict[str, float]:
    parts = {name: float(value) for name, value in update.parts._asdict().items()}
    return {
        "loss": float(update.loss),
        **parts,
        "gradient": float(update.gradient),
        "kappa": float(update.kappa),
    }


def _check_memory(needed: int, settings: TrainSettings) -> None:
    """Raise `InputError` for a batch beyond this machine's memory, before the system kills the program."""
    free = _free_memory()
    if needed > MEMORY_MARGIN * free:
        raise InputError(
            f"batch: an update needs {needed / 2**30:.1f} GiB and {free / 2**30:.1f} GiB are free; lower --batch "
            f"(now {settings.batch}) or --size (now {settings.size})"
        )


def _free_memory() -> float:
    """Memory in bytes for an update on this host's device; infinite where the system has no figure."""
    limits = jax.local_devices()[0].memory_stats()
    if limits and "bytes_limit" in limits:
        return limits["bytes_limit"] - limits.get("bytes_in_use", 0)
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, ValueError, StopIteration):  # no Linux
        return math.inf


def _export(updater: Updater, state: TrainState, path: Path, settings: TrainSettings, command: str) -> None:
    metadata = {
        "iteration": str(int(state.iteration)),
        "command": command,
        "settings": json.dumps(settings.record()),
    }
    kappa = float(np.exp(np.asarray(state.weights["log_kappa"])))
    save_guide(path, updater.network(state), kappa=kappa, metadata=metadata)
