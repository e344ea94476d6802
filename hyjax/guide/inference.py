"""Guides from trained networks: weights are folded once, the rest is one compiled function."""

import functools
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from hyjax.core.finite import finite_or_zero
from hyjax.core.schedule import DEFAULT_KAPPA
from hyjax.guide.layers import ConvNorm
from hyjax.guide.network import GuideNetwork, normalise
from hyjax.guide.weights import kappa_of, load_network
from hyjax.util.arguments import checked_arguments


def fold(network: GuideNetwork, *, kappa: float = DEFAULT_KAPPA) -> GuideNetwork:
    """Fold a network for inference: without batch norms, and with `DEFAULT_KAPPA` as the κ of its features.

    The last layer's bias is left out: only differences of features between pixels count, so it changes nothing, and
    adding it would write the network's largest array twice.

    Args:
        network: with the statistics to be used; left as it is.
        kappa: κ that goes with its features. Features and κ scale alike, so they are divided out in the last layer.
    """
    folded = nnx.clone(network)
    for _, module in nnx.iter_modules(folded):
        if isinstance(module, ConvNorm):
            module.fold()
    for block in folded.decoder.blocks:
        block.fold()
    (head,) = folded.segmentation_head
    head.kernel.set_value(head.kernel[...] * (DEFAULT_KAPPA / kappa))
    head.bias = None
    return folded


class Guide:
    """Features of frames from a trained network, as a pure compiled function.

    Attributes:
        name: its name in tables.
        fingerprint: hash of the weights.
        metadata: of the file with the weights.
        network: for inference, see `fold`.
    """

    def __init__(
        self,
        network: GuideNetwork,
        *,
        kappa: float = DEFAULT_KAPPA,
        name: str = "guide",
        fingerprint: str = "",
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self.name = name
        self.fingerprint = fingerprint
        self.metadata = dict(metadata or {})
        self.network = fold(network, kappa=kappa)
        self._graph, self._state = nnx.split(self.network)

    @checked_arguments(display=["display"])
    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Guide features of a frame, scaled to `DEFAULT_KAPPA`; each up to a constant.

        Args:
            display: display-encoded, in [0, 1], of any size; one of bytes is divided by 255.
        """
        return _features(self._graph, self._state, display)


def load_guide(path: str | os.PathLike[str], name: str | None = None) -> Guide:
    """Open a guide from a file with weights.

    Args:
        path: see `hyjax.guide.weights.load_network`.
        name: its name in tables; by default the file's name.
    """
    network, metadata = load_network(path)
    kappa = kappa_of(metadata, path)
    _, state = nnx.split(network)
    digest = hashlib.sha256(str(sorted(metadata.items())).encode())
    for leaf in jax.tree.leaves(state):
        digest.update(jnp.asarray(leaf).tobytes())
    return Guide(
        network,
        kappa=kappa,
        name=name or Path(path).name,
        fingerprint=digest.hexdigest()[:16],
        metadata=metadata,
    )


@functools.partial(jax.jit, static_argnums=0)
def _features(graph: Any, state: Any, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
    return nnx.merge(graph, state)(normalise(finite_or_zero(display))[None])[0]
