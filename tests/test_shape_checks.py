"""Annotations of arrays are checked in the tests: a wrong shape or type is refused, wherever it is given."""

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import hyjax
from hyjax.light.shading import mix_channels


def test_an_array_without_channels_is_refused() -> None:
    with pytest.raises(hyjax.InputError, match=r"^each: must be a float array of shape h x w x l"):
        hyjax.colored(jnp.zeros((4, 5)), [hyjax.AmbientLight(jnp.asarray(1.0), jnp.ones(3))])


def test_sizes_that_should_be_one_are_compared() -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        mix_channels(jnp.zeros((4, 5, 2)), jnp.zeros((3, 3)))


def test_the_functions_own_refusal_comes_first() -> None:
    with pytest.raises(hyjax.InputError):
        hyjax.conductance(np.zeros((3, 3)), 1.0)
