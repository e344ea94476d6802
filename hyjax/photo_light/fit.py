"""Fit of the photo's own light: strengths of unknown sources, from the scan's own radiance.

Light that comes from what was scanned is T c, whatever the albedo; unknown is what comes from elsewhere:

    E = T c + B θ,   θ ≥ 0.

Two places on one plane likely have one albedo, so log c should differ as log E does (Retinex; Land & McCann 1971):

    minimise Σ |Δ log c − Δ log E| + max(0, log c / (0.9 E))² + (log q₉₅(c / E) − log 0.85)² + smoothness of θ,

where q₉₅ is a quantile of the albedo: nearly every room has something white, which tells how bright the light is.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

HIGHEST_ALBEDO = 0.9
WHITE_ALBEDO, WHITE_QUANTILE, WHITENESS = 0.85, 0.95, 0.1
"""Albedo of the whitest surfaces, their quantile, and the weight of this prior."""
SMOOTH_L1 = 0.02
"""Difference of logarithms below which the loss is quadratic."""
SMOOTHNESS = 1e-3
"""Weight of the smoothness of θ."""
MEAN_WEIGHT = 1e-4
"""Weight of the prior that draws the unknowns to the mean radiance."""
LOWEST_LOG, HIGHEST_LOG = -7.0, 8.0
"""Bounds of the logarithms of the unknowns, relative to the mean radiance."""
ITERATIONS = 200
"""Most iterations of L-BFGS-B."""
START_LOG = 1.5
"""Logarithm of the unknowns at the start, relative to the mean radiance."""
RADIANCE_FLOOR = 1e-3
"""Least radiance, and offset of the light, relative to the mean radiance."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class FitProblem:
    """Data of the fit. Radiances are relative to their geometric mean.

    Attributes:
        gathered: T c, light from what was scanned.
        basis: B, light of unit sources.
        radiance: c times π, at least `RADIANCE_FLOOR`.
        seen: vertices that any frame shows.
        pairs: of vertices on one plane.
        fitted: whether a pair takes part. A mask, so that fits to parts of the pairs share a program.
        neighbours: pairs of likely similar unknowns.
    """

    gathered: Float[Array, "v 3"]
    basis: Float[Array, "v k"]
    radiance: Float[Array, "v 3"]
    seen: Bool[Array, "v"]
    pairs: Int[Array, "n 2"]
    fitted: Bool[Array, "n"]
    neighbours: Int[Array, "e 2"]


def illuminance(problem: FitProblem, theta: Float[Array, "k 3"]) -> Float[Array, "v 3"]:
    """Illuminance E = T c + B θ of the points."""
    with jax.default_matmul_precision("highest"):  # a GPU would drop to 10 bits, and end the fit early
        return problem.gathered + problem.basis @ theta


def loss(log_theta: Float[Array, "k 3"], problem: FitProblem) -> Float[Array, ""]:
    """Objective of the fit; see the module's docstring."""
    log_light = jnp.log(illuminance(problem, jnp.exp(log_theta)) + RADIANCE_FLOOR)
    log_radiance = jnp.log(problem.radiance)
    residual = _difference(log_radiance - log_light, problem.pairs)
    excess = jnp.maximum(log_radiance - math.log(HIGHEST_ALBEDO) - log_light, 0.0)
    white = high_quantile(log_radiance - log_light, problem.seen, WHITE_QUANTILE)
    rough = _difference(log_theta, problem.neighbours)
    return (
        _mean(jnp.sqrt(residual**2 + SMOOTH_L1**2), where=problem.fitted[:, None])
        + _mean(jnp.where(problem.seen[:, None], excess, 0.0) ** 2)
        + WHITENESS * _mean((white - math.log(WHITE_ALBEDO)) ** 2)
        + SMOOTHNESS * _mean(rough**2)
        + MEAN_WEIGHT * _mean(log_theta**2)
    )


def high_quantile(values: Float[Array, "n c"], chosen: Bool[Array, "n"], quantile: float) -> Float[Array, "c"]:
    """Quantile of the chosen rows as `numpy.quantile` has it, from the largest alone."""
    most = min(int(np.ceil((1 - quantile) * (len(values) - 1))) + 2, len(values))
    largest, _ = jax.lax.top_k(jnp.where(chosen[:, None], values, jnp.finfo(values.dtype).min).T, most)
    place = (1 - quantile) * (chosen.sum() - 1)
    above = jnp.floor(place).astype(int)
    low, high = largest[:, jnp.minimum(above + 1, most - 1)], largest[:, above]
    return high + (place - above) * (low - high)


def _mean(
    values: Float[Array, "n c"] | Float[Array, "c"], where: Bool[Array, "n 1"] | None = None
) -> Float[Array, ""]:
    """Mean with a sum in double precision, where there is any."""
    return jnp.mean(values, dtype=float, where=where)


def _difference(values: Float[Array, "n c"], pairs: Int[Array, "m 2"]) -> Float[Array, "m c"]:
    return values[pairs[:, 0]] - values[pairs[:, 1]]


_value_and_gradient = jax.jit(jax.value_and_grad(loss))


def fit_sources(problem: FitProblem, iterations: int = ITERATIONS) -> Float[np.ndarray, "k 3"]:
    """Strengths θ of the unknown sources, by L-BFGS-B within bounds (Byrd et al. 1995)."""
    import jaxopt

    # A solver that compiles would do so for every fit. It goes on while the loss falls, however little.
    options: Any = {"value_and_grad": True, "jit": False, "maxiter": iterations, "options": {"ftol": 0.0}}
    solver = jaxopt.ScipyBoundedMinimize(fun=_value_and_gradient, method="L-BFGS-B", tol=1e-7, **options)
    start, *bounds = (
        np.full((problem.basis.shape[1], 3), log, np.float32) for log in (START_LOG, LOWEST_LOG, HIGHEST_LOG)
    )
    with jax.enable_x64(True):  # in single precision the loss would seem to stand still, at times early
        return np.exp(np.asarray(solver.run(start, tuple(bounds), problem).params, np.float64))
