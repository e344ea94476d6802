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
    """Data of the fit, channel by channel. Radiances are relative to their geometric mean.

    Attributes:
        gathered: T c, light from what was scanned.
        basis: B, light of unit sources.
        log_radiance: log of c times π, which is at least `RADIANCE_FLOOR`.
        seen: vertices that any frame shows.
        pairs: of vertices on one plane.
        fitted: whether a pair takes part. A mask, so that fits to parts of the pairs share a program.
        neighbours: pairs of likely similar unknowns.
    """

    gathered: Float[Array, "3 v"]
    basis: Float[Array, "k v"]
    log_radiance: Float[Array, "3 v"]
    seen: Bool[Array, "v"]
    pairs: Int[Array, "n 2"]
    fitted: Bool[Array, "n"]
    neighbours: Int[Array, "e 2"]


def illuminance(problem: FitProblem, theta: Float[Array, "3 k"]) -> Float[Array, "3 v"]:
    """Illuminance E = T c + B θ of the points."""
    with jax.default_matmul_precision("highest"):  # a GPU would drop to 10 bits, and end the fit early
        # A product for each channel: one for all three reads B more slowly.
        return problem.gathered + jnp.stack([channel @ problem.basis for channel in theta])


def loss(log_theta: Float[Array, "3 k"], problem: FitProblem) -> Float[Array, ""]:
    """Objective of the fit; see the module's docstring."""
    log_light = jnp.log(illuminance(problem, jnp.exp(log_theta)) + RADIANCE_FLOOR)
    log_albedo = problem.log_radiance - log_light
    residual = _difference(log_albedo, problem.pairs)
    excess = jnp.maximum(log_albedo - math.log(HIGHEST_ALBEDO), 0.0)
    white = high_quantile(log_albedo, problem.seen, WHITE_QUANTILE)
    rough = _difference(log_theta, problem.neighbours)
    uneven = jnp.where(problem.fitted, jnp.sqrt(residual**2 + SMOOTH_L1**2), 0.0)
    return (
        _mean(uneven) * (len(problem.fitted) / problem.fitted.sum(dtype=float))
        + _mean(jnp.where(problem.seen, excess, 0.0) ** 2)
        + WHITENESS * _mean((white - math.log(WHITE_ALBEDO)) ** 2)
        + SMOOTHNESS * _mean(rough**2)
        + MEAN_WEIGHT * _mean(log_theta**2)
    )


def high_quantile(values: Float[Array, "c n"], chosen: Bool[Array, "n"], quantile: float) -> Float[Array, "c"]:
    """Quantile of the chosen columns as `numpy.quantile` has it, from the largest alone."""
    count = values.shape[1]
    most = min(int(np.ceil((1 - quantile) * (count - 1))) + 2, count)
    largest, _ = jax.lax.top_k(jnp.where(chosen, values, jnp.finfo(values.dtype).min), most)
    place = (1 - quantile) * (chosen.sum() - 1)
    above = jnp.floor(place).astype(int)
    low, high = largest[:, jnp.minimum(above + 1, most - 1)], largest[:, above]
    return high + (place - above) * (low - high)


def _mean(values: Float[Array, "c n"] | Float[Array, "c"]) -> Float[Array, ""]:
    """Mean with a sum in double precision, where there is any."""
    return jnp.mean(values, dtype=float)


def _difference(values: Float[Array, "c n"], pairs: Int[Array, "m 2"]) -> Float[Array, "c m"]:
    return values[:, pairs[:, 0]] - values[:, pairs[:, 1]]


_value_and_gradient = jax.jit(jax.value_and_grad(loss))


def fit_sources(problem: FitProblem, iterations: int = ITERATIONS) -> Float[np.ndarray, "3 k"]:
    """Strengths θ of the unknown sources, by L-BFGS-B within bounds (Byrd et al. 1995)."""
    import jaxopt

    # A solver that compiles would do so for every fit. It goes on while the loss falls, however little.
    options: Any = {"value_and_grad": True, "jit": False, "maxiter": iterations, "options": {"ftol": 0.0}}
    solver = jaxopt.ScipyBoundedMinimize(fun=_value_and_gradient, method="L-BFGS-B", tol=1e-7, **options)
    start, *bounds = (
        np.full((3, len(problem.basis)), log, np.float32) for log in (START_LOG, LOWEST_LOG, HIGHEST_LOG)
    )
    with jax.enable_x64(True):  # in single precision the loss would seem to stand still, at times early
        return np.exp(np.asarray(solver.run(start, tuple(bounds), problem).params, np.float64))
