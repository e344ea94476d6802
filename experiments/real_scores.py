"""Scores of relit pictures of real places: of pictures, and of the ratio of their light to the photo's.

SIE is the root mean square difference of standardised log ratios; LFE the mean length of the difference between the
gradients of log ratios that were blurred by 3 px. Both follow 3DLP (arXiv 2606.26738) as we read it: they
look at the change of the light alone, so the texture of the photo does not flatter a picture.
"""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from experiments.judging import judge
from experiments.real_bench import RealPlace
from experiments.real_fit import checkerboard
from experiments.real_methods import Made
from hyjax.metrics import LpipsWeights
from hyjax.photo_light.radiance import linear

FLOOR = 2e-3
"""Linear value below which ratios are noise."""
BLUR = 3.0
"""Standard deviation of the blur of LFE, in pixels."""


def scores(place: RealPlace, made: Mapping[str, Made], weights: LpipsWeights | None) -> dict[str, dict[str, float]]:
    """Scores of each method on the blocks that nothing was fitted on, burnt pixels left out."""
    held = place.valid & ~checkerboard(place.valid.shape)
    target = jnp.asarray(place.target, jnp.float32)
    shown = {name: jnp.asarray(one.display, jnp.float32) for name, one in made.items()}
    found = judge(shown, target, {"held": held}, weights, place.valid)
    true = log_ratio(place.target, place.photo)
    return {
        name: found[name]["held"] | ratio_scores(log_ratio(one.display, place.photo), true, held)
        for name, one in made.items()
    }


def log_ratio(picture: Float[np.ndarray, "h w 3"], photo: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Logarithm of a picture's light over the photo's."""
    return np.log(np.maximum(linear(picture), FLOOR)) - np.log(np.maximum(linear(photo), FLOOR))


def ratio_scores(
    ratio: Float[np.ndarray, "h w 3"], true: Float[np.ndarray, "h w 3"], held: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """SIE and LFE of a log ratio."""
    own, other = (_standardised(values[held]) for values in (ratio, true))
    difference = ndimage.gaussian_filter(ratio - true, (BLUR, BLUR, 0))
    slopes = np.gradient(difference, axis=(0, 1))
    length = np.sqrt(sum(slope**2 for slope in slopes))
    return {"sie": float(np.sqrt(((own - other) ** 2).mean())), "lfe": float(length[held].mean())}


def _standardised(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    spread = values.std(axis=0)
    return (values - values.mean(axis=0)) / np.where(spread > 1e-9, spread, 1.0)
