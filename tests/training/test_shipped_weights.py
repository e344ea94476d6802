"""Shipped weights on a room that they were not trained on: better than random ones and than the RGB guide."""

import functools

import jax
import jax.numpy as jnp
import pytest
from flax import nnx

from hyjax.core.schedule import DEFAULT_KAPPA
from hyjax.guide import GuideNetwork
from hyjax.guide.choose import RGB, FrameGuide, open_guide
from hyjax.guide.inference import Guide
from hyjax.pairs.loader import PairLoader
from hyjax.pairs.registry import open_pairs
from hyjax.training.objective import Losses, batch_losses
from hyjax.training.settings import TrainSettings
from hyjax.training.targets import Sample
from hyjax.training.validation import sample_of

SETTINGS = TrainSettings(factors=(16,))
KAPPAS = (2, 4, 8)
"""In multiples of the usual one; every guide gets the best of them."""
MEASURE = jax.jit(functools.partial(batch_losses, settings=SETTINGS))


@pytest.fixture(scope="module")
def crops() -> Sample:
    """Four crops of a generated room of another seed than those of training (0) and validation (1)."""
    pairs = open_pairs("rooms?seed=7&frames=0:4")
    return sample_of(next(PairLoader([pairs], size=256, batch=4, seed=0, augment=False)))


def losses_of(guide: FrameGuide, crops: Sample) -> dict[str, float]:
    """Mean losses of super-resolution by 16 and of the borders, each at the guide's best κ."""
    features = jnp.stack([guide.features(image) for image in crops.image])
    found = [
        MEASURE(features, jnp.log(k * DEFAULT_KAPPA), crops, jax.random.key(0), jnp.asarray(0)) for k in KAPPAS
    ]
    return {name: min(float(getattr(losses, name)) for losses in found) for name in Losses._fields}


@pytest.mark.slow
def test_the_shipped_small_guide_beats_random_weights_and_the_rgb_guide(crops: Sample) -> None:
    network = GuideNetwork("mobilenetv4_conv_small", 16, rngs=nnx.Rngs(0))
    network.eval()
    small = losses_of(open_guide("small"), crops)
    for other in (Guide(network), RGB):
        theirs = losses_of(other, crops)
        for name, share in (("depth", 0.98), ("shading", 0.98), ("border", 0.9)):
            assert small[name] < share * theirs[name], f"{name} against {other.name}: {small} and {theirs}"
