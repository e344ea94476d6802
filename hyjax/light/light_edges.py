"""Light edges: the photo's own light, sharpened along those that a small picture of the photo shows.

The estimate of E_old lives on the scan's vertices, where borders of shadows and creases are blurred. A small
network tells for each difference between neighbouring pixels which share s of it is light and not paint; the sharp
log E is nearest to the light's share of the photo's differences, and to the estimate's in the place of the rest:

    minimise Σ α (e − e₀)² + |∇e − (s ∇log I + (1 − s) ∇e₀)|²,

with I the photo's brightness and e₀ the estimate. So E_old is multiplied by exp c, where

    (α + L) c = −div s ∇(log I − e₀).

The network is a U-Net that sees blocks of 2 × 2 pixels as one, plain functions of its weights: what needs it waits
for no import of Flax. `experiments.light_edges` trains it on generated rooms, whose light is known.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.finite import finite_or_zero
from hyjax.core.presets import GUIDED_KAPPA
from hyjax.core.pyramid import downsample
from hyjax.core.screened import screened_poisson
from hyjax.core.stencil import Edges, gradient
from hyjax.core.upsampling import guided_upsample
from hyjax.light.photo_light import LEAST_PHOTO_LIGHT
from hyjax.light.shading import mix_channels
from hyjax.light.view import View
from hyjax.util.errors import InputError
from hyjax.util.geometry import components

Weights = Mapping[str, Float[Array, "..."]]
"""Kernels (k, k, inputs, outputs) and biases of the layers, as `stem.kernel` and `stem.bias`."""

FIDELITY = 4e-3
"""α: differences of the photo count over some 16 pixels, beyond which the estimate does."""
LONGEST_SIDE = 180
"""Usual longest side, in pixels, of what the network sees: pictures are pooled by the whole factor that comes
nearest to it, as a ratio."""
STRENGTH = 0.5
"""Share of the correction that is taken: the better of 0.5 and 1 on the real pair Piano."""
LEAST_LIGHT = 2e-3
"""Linear light of the photo that darker pixels are taken to have."""
LEAST_DEPTH = 0.05
"""Depth in metres that nearer points are taken to have."""
AXES = ("NHWC", "HWIO", "NHWC")
"""Axes of pictures, kernels and results."""
OTHER_WEIGHTS = "light_edges: not the weights of this network; hyjax.guide.edge_weights.edge_weights() are"
"""Message about weights that do not fit."""
FEATURES = 12
"""Number of features of a pixel, see `edge_features`."""


@jax.jit
def own_light(illuminance: Float[Array, "h w c"]) -> Float[Array, "h w 3"]:
    """The photo's own light, the last three channels of refined light."""
    return jnp.maximum(illuminance[..., -3:], LEAST_PHOTO_LIGHT)


@jax.jit
def sharpened(illuminance: Float[Array, "h w c"], correction: Float[Array, "h w 1"]) -> Float[Array, "h w c"]:
    """Refined light, of which the photo's own is multiplied by a correction, see `edge_correction`."""
    # Chosen by channel: XLA's CPU backend takes longer to join parts of the channels.
    own = np.arange(illuminance.shape[-1]) >= illuminance.shape[-1] - 3
    return jnp.where(own, jnp.maximum(illuminance, LEAST_PHOTO_LIGHT) * correction, illuminance)


@jax.jit
def edge_correction(view: View, light: Float[Array, "h w 3"], weights: Weights) -> Float[Array, "h w 1"]:
    """Correction exp c that the photo's own light is multiplied by.

    Args:
        view: of the frame, with a pose; its pixels that are not finite are black.
    """
    if view.pose is None:
        raise InputError("light_edges: need the view's pose, as the network sees normals in the camera's axes")
    scales = _scales(weights)
    inner = [f"{part}{k}" for part in ("down", "up", "merge") for k in range(scales - 1)]
    layers = ["stem", "head", *(f"block{k}" for k in range(scales)), *inner]
    wanted = {f"{layer}.{part}" for layer in layers for part in ("kernel", "bias")}
    fit = wanted == {*weights} and weights["stem.kernel"].shape[2:3] == (4 * FEATURES,)
    if not fit or any(weights[f"{x}.bias"].shape != weights[f"{x}.kernel"].shape[-1:] for x in layers):
        raise InputError(OTHER_WEIGHTS)
    shape = view.frame.shape[:2]
    factor = _pooling(max(shape))
    buffer = view.gbuffer
    normal, depth, hit = (x[::factor, ::factor] for x in (buffer.normal, buffer.depth, buffer.hit))
    turned = mix_channels(normal, jnp.asarray(view.pose)[:3, :3])  # n R; XLA is slow with so small matrices
    normal = finite_or_zero(jnp.where(hit[..., None], turned, 0.0))
    depth = jnp.where(hit & jnp.isfinite(depth), depth, 1.0)
    frame, light = (downsample(x, factor) for x in (finite_or_zero(view.frame), light))
    log_frame = jnp.log(jnp.maximum(frame, LEAST_LIGHT))
    log_light = jnp.mean(jnp.log(light), axis=-1)
    try:
        shares = light_shares(weights, edge_features(log_frame, log_light, normal, depth))
    except (TypeError, ValueError):
        raise InputError(OTHER_WEIGHTS) from None
    correction = STRENGTH * corrected(jnp.mean(log_frame, axis=-1), log_light, shares)
    # Under the frame, as a cascade's last level is: a blur of it across a border would be a halo.
    # Twice: XLA's CPU backend takes twice as long for one channel as for two.
    twice = jnp.stack([correction, correction], axis=-1)
    return jnp.exp(guided_upsample(twice, factor, view.display, GUIDED_KAPPA)[..., :1])


def _pooling(longest: int) -> int:
    """Factor by which a picture is pooled for the network, by its longest side."""
    factor = max(1, longest // LONGEST_SIDE)
    return factor + 1 if longest**2 > factor * (factor + 1) * LONGEST_SIDE**2 else factor


def corrected(
    log_frame: Float[Array, "*b h w"],
    log_light: Float[Array, "*b h w"],
    shares: Edges,
    fidelity: Float[ArrayLike, ""] = FIDELITY,
) -> Float[Array, "*b h w"]:
    """Correction c of the estimate's logarithm, with the fidelity α."""
    differences = gradient(log_frame - log_light)
    return screened_poisson((shares[0] * differences[0], shares[1] * differences[1]), fidelity)


def edge_features(
    log_frame: Float[Array, "*b h w 3"],
    log_light: Float[Array, "*b h w"],
    normal: Float[Array, "*b h w 3"],
    depth: Float[Array, "*b h w"],
) -> Float[Array, "*b h w f"]:
    """Features of the pixels: brightness and its differences, hue, estimate, surface; all about one in size.

    Args:
        normal: in the camera's axes; 0 where there is none.
        depth: in metres.
    """
    bright = jnp.mean(log_frame, axis=-1)
    hue = log_frame - bright[..., None]
    level, light = (x - jnp.mean(x, axis=(-2, -1), keepdims=True) for x in (bright, log_light))
    (down, right), steep = (_on_grid(gradient(x)) for x in (bright, jnp.log(jnp.maximum(depth, LEAST_DEPTH))))
    steepness = jnp.clip(10 * jnp.sqrt(jnp.maximum(steep[0] ** 2 + steep[1] ** 2, 1e-12)), 0.0, 2.0)
    parts = [level / 2, 3 * right, 3 * down, light, (level - light) / 2, steepness]
    # Joined with channels first: last, XLA's CPU backend finds every part anew for each value.
    return jnp.moveaxis(jnp.stack([*parts, *components(hue), *components(normal)], axis=-3), -3, -1)


def _on_grid(edges: Edges) -> tuple[Float[Array, "*b h w"], Float[Array, "*b h w"]]:
    """Values of edges at the pixels above and to the left of them; 0 at the border."""
    none = [(0, 0)] * (edges[0].ndim - 2)
    return jnp.pad(edges[0], [*none, (0, 1), (0, 0)]), jnp.pad(edges[1], [*none, (0, 0), (0, 1)])


def light_shares(weights: Weights, features: Float[Array, "*b h w f"]) -> Edges:
    """Share s, in [0, 1], of light in the difference along each edge, as the network has it."""
    height, width, count = features.shape[-3:]
    x = features.reshape(-1, height, width, count)
    x = jnp.pad(x, [(0, 0), (0, height % 2), (0, width % 2), (0, 0)], "edge")
    logits = _pixels(_network(weights, _blocks(x)))[:, :height, :width]
    shares = jax.nn.sigmoid(logits - 1.0).reshape(*features.shape[:-1], 2)
    return shares[..., :-1, :, 1], shares[..., :-1, 0]


def _scales(weights: Weights) -> int:
    return sum(name.startswith("block") for name in weights) // 2


def _network(weights: Weights, x: Float[Array, "b h w c"]) -> Float[Array, "b h w o"]:
    """U-Net: each scale adds to what it gets, and the finer ones to what the coarser ones make of it."""

    def layer(name: str, x: Array, stride: int = 1) -> Array:
        kernel, bias = weights[f"{name}.kernel"], weights[f"{name}.bias"]
        x = x.astype(kernel.dtype)
        return jax.lax.conv_general_dilated(x, kernel, (stride, stride), "SAME", dimension_numbers=AXES) + bias

    scales = _scales(weights)
    x, finer = jax.nn.silu(layer("stem", x)), []
    for k in range(scales):
        x = x + jax.nn.silu(layer(f"block{k}", x))
        if k + 1 < scales:
            finer.append(x)
            x = jax.nn.silu(layer(f"down{k}", x, 2))
    for k in reversed(range(scales - 1)):
        x = layer(f"up{k}", x)
        x = jax.image.resize(x, (*finer[k].shape[:3], x.shape[-1]), "linear") + finer[k]
        x = x + jax.nn.silu(layer(f"merge{k}", x))
    return layer("head", x)


def _blocks(x: Float[Array, "b h w c"]) -> Float[Array, "b hh hw c4"]:
    """Blocks of 2 × 2 pixels as one, their channels one after the other."""
    b, h, w, c = x.shape
    return x.reshape(b, h // 2, 2, w // 2, 2, c).transpose(0, 1, 3, 2, 4, 5).reshape(b, h // 2, w // 2, 4 * c)


def _pixels(x: Float[Array, "b hh hw c4"]) -> Float[Array, "b h w c"]:
    b, h, w, c = x.shape
    return x.reshape(b, h, w, 2, 2, c // 4).transpose(0, 1, 3, 2, 4, 5).reshape(b, 2 * h, 2 * w, c // 4)
