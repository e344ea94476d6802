"""Colour: the curves between light and display, luminance, colour temperature.

An image called `linear` holds amounts of light, one called `display` holds what a file or a screen stores
(primaries of Rec. 709). Light adds and multiplies only in `linear`.

Between them lie the curve of sRGB (IEC 61966-2-1) and a shoulder, since cameras hold bright light back. By sRGB's
curve alone, what a photo shows as white was hardly brighter than what it shows as nearly white: under weaker light
white paper turns grey, and under stronger light orange turns lemon yellow. The shoulder is that of Reinhard et
al., *Photographic tone reproduction for digital images* (SIGGRAPH 2002), equation 4, from `SHOULDER` on, where its
slope is 1. Few cameras say what theirs is; this one stands for all. A stronger one draws JPEG's blocks and
specks out of what is nearly white.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, UInt8

from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

# Luminance of linear Rec. 709 red, green and blue.
LUMINANCE = (0.2126, 0.7152, 0.0722)
SHOULDER, WHITE = 0.7, 1.2
"""Linear values: where the shoulder begins, and what is shown as white."""
WIDTH = (WHITE - SHOULDER) / (1.0 - SHOULDER)
"""Width of the shoulder, in units of what is left above it on the display."""
AnyArray = TypeVar("AnyArray", jax.Array, np.ndarray)
"""Array of JAX or NumPy."""
BLACKBODY_KELVIN = (1667.0, 25000.0)
"""Temperatures between which the approximation of a black body's colour holds."""


@checked_arguments(display=["display"])
@jax.jit
def to_linear(display: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Display-encoded values in [0, 1] → linear light in [0, `WHITE`], which is 1.2. Bytes are divided by 255."""
    return released(decoded(display))


@checked_arguments
@jax.jit
def to_display(linear: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Linear light → display-encoded values in [0, 1]; what is brighter than `WHITE`, 1.2, is clipped to it."""
    return encoded(held(linear))


def held(linear: AnyArray) -> AnyArray:
    """Light as the shoulder holds it back: `WHITE` becomes 1. Brighter light goes on with slope 1."""
    xp = linear.__array_namespace__()
    # `where`, so that the gradient at white is that of what is darker; `minimum` has the mean of both sides.
    up_to_white = xp.where(linear <= WHITE, linear, WHITE)
    t = (xp.maximum(up_to_white, SHOULDER) - SHOULDER) / (1.0 - SHOULDER)
    shoulder = SHOULDER + (1.0 - SHOULDER) * t * (1.0 + t / WIDTH**2) / (1.0 + t)
    return xp.where(linear <= SHOULDER, linear, shoulder + (linear - up_to_white))


def released(held_light: AnyArray) -> AnyArray:
    """Light that the shoulder has held back: the inverse of `held`, without cancellation near its start."""
    xp = held_light.__array_namespace__()
    up_to_white = xp.where(held_light <= 1.0, held_light, 1.0)
    y = (xp.maximum(up_to_white, SHOULDER) - SHOULDER) / (1.0 - SHOULDER)
    t = 2.0 * y / (1.0 - y + xp.sqrt((1.0 - y) ** 2 + 4.0 / WIDTH**2 * y))
    shoulder = SHOULDER + (1.0 - SHOULDER) * t
    return xp.where(held_light <= SHOULDER, held_light, shoulder + (held_light - up_to_white))


def encoded(linear: AnyArray) -> AnyArray:
    """sRGB's encoding alone, clipped to [0, 1]: for shares and colours, and for filters as pictures."""
    xp = linear.__array_namespace__()
    # `where` and not `maximum`, whose gradient at a tie is half: black pixels keep the slope of the light they get.
    return xp.where(linear < 0.0, 0.0, unclipped(xp.clip(linear, None, 1.0)))


def unclipped(linear: AnyArray) -> AnyArray:
    """sRGB's encoding, continued above 1 and below 0.

    >>> [round(float(x), 4) for x in unclipped(jnp.array([0.18, 1.0, 2.0]))]
    [0.4614, 1.0, 1.3533]
    """
    xp = linear.__array_namespace__()
    power = 1.055 * _power(xp.maximum(linear, 0.0031308), 1.0 / 2.4) - 0.055
    return xp.where(linear <= 0.0031308, linear * 12.92, power)


def decoded(display: AnyArray) -> AnyArray:
    """The inverse of sRGB's encoding."""
    xp = display.__array_namespace__()
    # Both branches are evaluated and differentiated: the power sees only values from its own side.
    power = _power((xp.maximum(display, 0.04045) + 0.055) / 1.055, 2.4)
    return xp.where(display <= 0.04045, display / 12.92, power)


def _power(base: AnyArray, exponent: float) -> AnyArray:
    """Power of numbers above 0, to rounding: XLA's CPU backend takes four times longer for `**`."""
    xp = base.__array_namespace__()
    exact = base.astype(jnp.promote_types(base.dtype, jnp.float32))
    return xp.exp(exponent * xp.log(exact)).astype(base.dtype)


@jax.jit
def to_display_bytes(linear: Float[Array, "*s"]) -> UInt8[Array, "*s"]:
    """Linear light → display-encoded bytes, as a file or a screen takes them."""
    return jnp.round(255.0 * to_display(linear)).astype(jnp.uint8)


@checked_arguments
def luminance(linear: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Luminance of linear RGB (Rec. 709 weights)."""
    return sum(weight * linear[..., k] for k, weight in enumerate(LUMINANCE))  # type: ignore[return-value]


@checked_arguments
def blackbody(kelvin: Float[ArrayLike, ""] | Int[ArrayLike, ""]) -> Float[Array, "3"]:
    """Linear RGB of luminance 1 with the hue of a black body; for 1667 to 25000 K.

    Chromaticity by the cubic approximation of Kim et al. (US patent 7024034), as tabulated in *Planckian locus*;
    colours outside the gamut (below about 1900 K) are clipped to it.

    Raises:
        InputError: a known temperature outside 1667 to 25000 K.

    Example:
        >>> bool(blackbody(3000.0)[0] > blackbody(3000.0)[2])
        True
    """
    coldest, hottest = BLACKBODY_KELVIN
    if (known := concrete(kelvin)) is not None and not ((known >= coldest) & (known <= hottest)).all():
        raise InputError(f"kelvin: must be from {coldest:g} to {hottest:g} K, got {shown(kelvin)}")
    return _blackbody(jnp.asarray(kelvin, jnp.float32))


@jax.jit
def _blackbody(t: Float[Array, ""]) -> Float[Array, "3"]:
    u = 1e3 / t
    x = jnp.where(
        t <= 4000.0,
        -0.2661239 * u**3 - 0.2343589 * u**2 + 0.8776956 * u + 0.179910,
        -3.0258469 * u**3 + 2.1070379 * u**2 + 0.2226347 * u + 0.240390,
    )
    y = jnp.where(
        t <= 2222.0,
        -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683,
        jnp.where(
            t <= 4000.0,
            -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867,
            3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483,
        ),
    )
    xyz = jnp.stack([x / y, jnp.ones_like(x), (1.0 - x - y) / y])
    to_rgb = jnp.array(
        [
            [3.2404542, -1.5371385, -0.4985314],
            [-0.9692660, 1.8760108, 0.0415560],
            [0.0556434, -0.2040259, 1.0572252],
        ]
    )
    rgb = jnp.maximum(jnp.matmul(to_rgb, xyz, precision="highest"), 0.0)
    return rgb / luminance(rgb)
