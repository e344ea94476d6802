"""Loss of a relit picture against its target, which a frame is tuned by, and its scores in all metrics."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hyjax.light.color import to_display
from hyjax.metrics import LpipsWeights, Metric, load_lpips, lpips, plain_metrics, psnr
from hyjax.metrics.exposure import fit_gains
from hyjax.metrics.losses import LossWeights, display_loss
from hyjax.tuning.scene import Target

BRIGHTNESS_WEIGHT = 0.5
"""Weight of display values as they are, beside those under fitted gains."""


@dataclasses.dataclass(frozen=True)
class PictureLoss:
    """Loss of a relit picture: display values, their slopes at four scales, and LPIPS if it is given a weight.

    Three gains, in linear light, may bring exposure and white balance nearest to the target first: a viewer's eye
    does so, too, and no method can know them. A further term compares display values without gains: what the gains
    hide would get worse without it.

    Attributes:
        perceptual: weight of LPIPS.
        weights: of its network; None without.
        brightness: weight of display values without gains.
    """

    perceptual: float = 0.0
    weights: LpipsWeights | None = None
    brightness: float = BRIGHTNESS_WEIGHT

    @classmethod
    def of(cls, perceptual: float = 0.0) -> "PictureLoss":
        """Loss with LPIPS at this weight."""
        LossWeights(perceptual=perceptual)
        return cls(perceptual, load_lpips() if perceptual else None)

    def gains(self, image: Float[np.ndarray, "h w 3"], target: Target) -> Float[np.ndarray, "3"]:
        """Gains that the picture is multiplied with; ones where nothing may be fitted."""
        if not target.fitted:
            return np.ones(3, np.float32)
        return fit_gains(image, target.picture, valid=target.valid).astype(np.float32)

    def scores(self, image: Float[np.ndarray, "h w 3"], target: Target) -> dict[str, float]:
        """Loss and all metrics of the registry by name; `psnr_raw` is that of the picture as it is."""
        gains = self.gains(image, target)
        own = self._scores(image * gains, target.picture, target.valid)
        brightness, raw = _raw_scores(*map(jnp.asarray, (image, target.picture, target.valid)))
        own["loss"] += self.brightness * brightness
        return {name: float(value) for name, value in own.items()} | {"psnr_raw": float(raw)}

    def _scores(self, image: np.ndarray, picture: np.ndarray, valid: np.ndarray) -> dict[str, Array]:
        found = _plain_scores(*map(jnp.asarray, (image, picture, valid)), tuple(plain_metrics().items()))
        if self.weights is not None:
            shown, known = (jnp.where(valid[..., None], x, 0.0) for x in (to_display(jnp.asarray(image)), picture))
            distance = lpips(shown, known, self.weights)
            found |= {"lpips": distance, "loss": found["loss"] + self.perceptual * distance}
        return found

    def value(
        self,
        image: Float[Array, "h w 3"],
        gains: Float[Array, "3"],
        picture: Float[Array, "h w 3"],
        valid: Bool[Array, "h w"],
    ) -> Float[Array, ""]:
        """The loss alone, for gradients: arguments as they stand, linear and display values."""
        weights, perceptual = self.weights, None
        if weights is not None:

            def perceptual(a: Array, b: Array) -> Array:
                return lpips(a, b, weights)

        terms = LossWeights(perceptual=self.perceptual)
        fitted = display_loss(to_display(image * gains), picture, valid, weights=terms, perceptual=perceptual)
        return fitted + self.brightness * _brightness_term(image, picture, valid)


@functools.partial(jax.jit, static_argnames="metrics")
def _plain_scores(
    image: Float[Array, "h w 3"],
    picture: Float[Array, "h w 3"],
    valid: Bool[Array, "h w"],
    metrics: tuple[tuple[str, Metric], ...],
) -> dict[str, Array]:
    shown = to_display(image)
    found = {"loss": display_loss(shown, picture, valid)}
    return found | {name: metric.function(shown, picture, valid=valid) for name, metric in metrics}


def _brightness_term(
    image: Float[Array, "h w 3"], picture: Float[Array, "h w 3"], valid: Bool[Array, "h w"]
) -> Float[Array, ""]:
    """Difference of display values as they are."""
    return display_loss(to_display(image), picture, valid, weights=LossWeights(gradient=0.0))


@jax.jit
def _raw_scores(
    image: Float[Array, "h w 3"], picture: Float[Array, "h w 3"], valid: Bool[Array, "h w"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    return _brightness_term(image, picture, valid), psnr(to_display(image), picture, valid=valid)
