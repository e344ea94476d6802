"""Surrogate of loss and time over a space of choices: a Gaussian process that is additive over the parameters.

    k(x, x') = Σ_p s² k_p(x_p, x'_p) + r² Π_p k_p(x_p, x'_p)

The sum learns what each choice brings by itself from one trial each, the product what is left where several meet.
k_p is 1 for equal values of a choice without order and 0 for others, and a Gaussian of the distance for ordered
values and ranges.

Source: Duvenaud, Nickisch and Rasmussen, *Additive Gaussian processes*, NeurIPS 2011.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from hyjax.tuning.space import Space

LENGTH_SCALE = 0.4
"""Length scale of the Gaussians, in the range of a parameter."""
JOINT_RATIO = 0.3
"""r over s."""
SPREADS = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Values of s that are tried: the likeliest is taken."""


@dataclasses.dataclass(frozen=True)
class Surrogate:
    """Predictions from trials.

    Attributes:
        weights: K⁻¹ y.
        factor: of K, by Cholesky.
        spread: s.
    """

    space: Space
    features: Float[np.ndarray, "n p"]
    weights: Float[np.ndarray, "n"]
    factor: Any
    spread: float

    @classmethod
    def fit(
        cls,
        space: Space,
        trials: Sequence[Mapping[str, Any]],
        values: Float[np.ndarray, "n"],
        noise: Float[np.ndarray, "n"],
    ) -> "Surrogate":
        """Surrogate of the values of trials.

        Args:
            values: relative to the default's, as logarithms: the prior mean is 0.
        """
        features, best = embed(space, trials), None
        for spread in SPREADS:
            matrix = spread**2 * covariance(space, features, features) + np.diag(np.square(noise) + 1e-8)
            factor = cho_factor(matrix, lower=True)
            weights = cho_solve(factor, values)
            likelihood = -0.5 * float(values @ weights) - float(np.log(np.diag(factor[0])).sum())
            if best is None or likelihood > best[0]:
                best = likelihood, cls(space, features, weights, factor, spread)
        assert best is not None
        return best[1]

    def predict(
        self, choices: Sequence[Mapping[str, Any]]
    ) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Mean and standard deviation at choices."""
        features = embed(self.space, choices)
        across = self.spread**2 * covariance(self.space, features, self.features)
        prior = self.spread**2 * (len(self.space.parameters) + JOINT_RATIO**2)
        explained = np.einsum("mn,nm->m", across, cho_solve(self.factor, across.T))
        return across @ self.weights, np.sqrt(np.maximum(prior - explained, 0.0))


def embed(space: Space, trials: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "n p"]:
    """Place of each parameter's value; -1 where it is not active."""
    rows = [
        [p.place(choices[p.name]) if p.name in choices else -1.0 for p in space.parameters] for choices in trials
    ]
    return np.array(rows, float).reshape(len(trials), len(space.parameters))


def covariance(space: Space, a: Float[np.ndarray, "n p"], b: Float[np.ndarray, "m p"]) -> Float[np.ndarray, "n m"]:
    """The kernel over s², see the module."""
    total, product = np.zeros((len(a), len(b))), np.ones((len(a), len(b)))
    for column, parameter in enumerate(space.parameters):
        first, second = a[:, column, None], b[None, :, column]
        likeness = (first == second).astype(float)
        if parameter.continuous or parameter.ordered:
            near = np.exp(-0.5 * ((first - second) / LENGTH_SCALE) ** 2)
            likeness = np.where((first < 0) | (second < 0), likeness, near)
        total, product = total + likeness, product * likeness
    return total + JOINT_RATIO**2 * product
