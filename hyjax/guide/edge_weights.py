"""Weights of the network that tells light from paint, which come with hyjax."""

import functools
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array

from hyjax.configuration import LightOptions
from hyjax.light.light_edges import Weights
from hyjax.light.photo_light import SurfaceLight
from hyjax.util.tensors import read_tensors

WEIGHTS_FILE = Path(__file__).with_name("trained") / "light_edges.safetensors"


@functools.lru_cache(maxsize=1)
def edge_weights() -> dict[str, Array]:
    """Weights for `hyjax.light.light_edges`, read once; `experiments.light_edges` writes the file."""
    arrays, _ = read_tensors(WEIGHTS_FILE)
    with jax.ensure_compile_time_eval():  # also where a function is being traced
        return {name: jax.device_put(np.asarray(array, np.float32)) for name, array in arrays.items()}


def configured_edges(options: LightOptions, light: SurfaceLight | None) -> Weights | None:
    """Weights that a configuration asks for; None where no light is divided out, or a part of it stays on.

    What is divided by the sharpened light must be the whole of it: a lamp that stays on would shine around the
    shadows of the others.
    """
    if light is None or light.kept is not None or light.is_even or not options.edges:
        return None
    return edge_weights()
