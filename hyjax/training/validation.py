"""Validation of a guide while it is trained: losses and pictures of crops that stay the same."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.core.diffusion import conductance
from hyjax.core.schedule import DEFAULT_KAPPA
from hyjax.core.stencil import least_around
from hyjax.core.superresolution import coarsen
from hyjax.pairs.augmentation import Crop
from hyjax.pairs.depth_pairs import DepthPairs
from hyjax.pairs.loader import PairLoader
from hyjax.training.objective import batch_losses, resolve, total
from hyjax.training.state import TrainState, Updater
from hyjax.training.targets import Sample, lit, random_shading, relative_depth
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.files import make_writable

BATCHES = 8
"""Number of validation batches."""
SHEET_CROPS = 8
"""Number of crops on a sheet."""
SEED = 1
"""Seed of crops, lamps and tints, so that crops differ from training even in the same pictures."""
HEADINGS = ("frame", "source", "under the frame", "under the guide", "truth", "conductances")


class Validation:
    """Validation on the same crops, lamps and tints every time."""

    def __init__(self, updater: Updater, sources: Sequence[DepthPairs]) -> None:
        self.updater, self.settings = updater, updater.settings
        loader = PairLoader(sources, size=self.settings.size, batch=self.settings.batch, seed=SEED, augment=False)
        batches = (next(loader) for _ in range(BATCHES))
        self.batches = [sample_of(batch) for batch in batches]
        self._losses = jax.jit(functools.partial(batch_losses, settings=self.settings))
        self.rgb = self._measure(lambda images: jnp.asarray(images), jnp.log(DEFAULT_KAPPA))

    def __call__(self, state: TrainState) -> dict[str, Any]:
        """Losses by name, `loss` their weighted sum; under `rgb` the losses of the RGB guide at its usual κ."""
        measured = self._measure(functools.partial(self.updater.features, state), state.weights["log_kappa"])
        return measured | {"rgb": self.rgb}

    def _measure(self, guide_of, log_kappa: Float[Array, ""]) -> dict[str, float]:  # type: ignore[no-untyped-def]
        found: dict[str, list[float]] = {}
        for number, batch in enumerate(self.batches):
            guide = guide_of(batch.image)
            for index, factor in enumerate(self.settings.factors):
                losses = self._losses(guide, log_kappa, batch, jax.random.key(number), jnp.asarray(index))
                found.setdefault("loss", []).append(float(total(losses, self.settings)))
                found.setdefault("border", []).append(float(losses.border))
                for name in ("depth", "shading"):
                    found.setdefault(f"{name} x{factor}", []).append(float(getattr(losses, name)))
        return {name: float(np.mean(values)) for name, values in found.items()}

    def draw(self, state: TrainState, path: Path | None) -> None:
        """Write a sheet of crops super-resolved by the largest factor.

        All hosts take part in computing it; all but one give None for the path.
        """
        rows: list[tuple[str, list[np.ndarray]]] = []
        for batch in self.batches:
            features = self.updater.features(state, batch.image)
            for i in range(len(features)):
                sample = Sample(*(jnp.asarray(field[i]) for field in batch))
                rows.append(self._row(f"crop {len(rows)}", sample, features[i], state.weights["log_kappa"]))
            if len(rows) >= SHEET_CROPS:
                break
        if path is not None:
            make_writable(path.parent)
            write_contact_sheet(path, rows, HEADINGS)

    def _row(
        self, label: str, sample: Sample, features: Float[Array, "h w f"], log_kappa: Float[Array, ""]
    ) -> tuple[str, list[Float[np.ndarray, "h w 3"]]]:
        factor = max(self.settings.factors)
        target, valid = random_shading(sample, jax.random.key(0)), lit(sample)
        if not bool(valid.any()):
            target, valid = jnp.repeat(relative_depth(sample)[..., None], 3, axis=-1), sample.valid
        sample = sample._replace(valid=valid)
        source, _ = coarsen(target, sample.valid, factor)
        rgb = _resolved(target, sample, sample.image, jnp.log(DEFAULT_KAPPA), factor, self.settings)
        resolved = _resolved(target, sample, features, log_kappa, factor, self.settings)
        brightest = float(np.percentile(np.asarray(target), 98))
        blocks = np.asarray(source).repeat(factor, axis=0).repeat(factor, axis=1)
        open_ = np.asarray(least_around(conductance(features, jnp.exp(log_kappa))))[..., None].repeat(3, axis=-1)
        shown = [
            np.asarray(x) / brightest
            for x in (blocks, rgb, resolved, jnp.where(sample.valid[..., None], target, 0))
        ]
        return label, [np.asarray(sample.image), *shown, open_]


@functools.partial(jax.jit, static_argnames=("factor", "settings"))
def _resolved(target, sample, features, log_kappa, factor, settings):  # type: ignore[no-untyped-def]
    uncounted = jnp.asarray(settings.steps_without_gradient // 2)
    return resolve(target, sample.valid, features, log_kappa, factor, uncounted, settings)


def sample_of(batch: Crop) -> Sample:
    """Sample of a batch for the loss, which treats metres and disparity alike."""
    return Sample(*(jnp.asarray(field) for field in (batch.image, batch.depth, batch.valid, batch.normal)))
