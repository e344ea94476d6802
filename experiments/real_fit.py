"""Fit of new lights' strengths to a picture: the same for every method, on one half of its blocks.

A linear method makes the picture Σ θ_k X_k of the columns X_k, what each light of the family makes of the photo.
Strengths θ ≥ 0, by red, green and blue: first by non-negative least squares, where errors of linear light weigh as
they show, then by L-BFGS-B in display values.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, optimize

from hyjax.light.color import SHOULDER, WHITE, WIDTH, held, unclipped
from hyjax.photo_light.radiance import linear

BLOCK_SIDE = 32
"""Side, in pixels, of the blocks of the checkerboard: half are fitted on, half scored."""
ITERATIONS = 150
SMALLEST_DIVISOR = 1e-6
LEAST_OLD_LIGHT = 0.05
"""Least old light that the oracle divides by, where each light of the family has a root mean square of 1."""
Columns = Float[np.ndarray, "h w k 3"]
Picture = Float[np.ndarray, "h w 3"]


def shown(light: np.ndarray) -> np.ndarray:
    """Display values of light, going on beyond white."""
    return unclipped(held(light))


def slope(light: np.ndarray) -> np.ndarray:
    """Derivative of `shown`."""
    t = np.maximum(light - SHOULDER, 0.0) / (1.0 - SHOULDER)
    of_shoulder = np.where(light <= WHITE, (1.0 + (2.0 * t + t**2) / WIDTH**2) / (1.0 + t) ** 2, 1.0)
    own = held(light)
    power = 1.055 / 2.4 * np.maximum(own, 0.0031308) ** (1 / 2.4 - 1)
    return np.where(own <= 0.0031308, 12.92, power * of_shoulder)


def checkerboard(shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Pixels to fit on; the others are scored."""
    rows, columns = np.indices(shape) // BLOCK_SIDE
    return (rows + columns) % 2 == 0


@dataclasses.dataclass(frozen=True)
class Target:
    """Picture to come near to.

    Attributes:
        display: its values.
        fitted: pixels to fit on.
    """

    display: Picture
    fitted: Bool[np.ndarray, "h w"]

    @property
    def linear(self) -> Picture:
        """Linear light."""
        return linear(self.display)

    def at(self, values: np.ndarray) -> np.ndarray:
        """Values of the fitted pixels."""
        return values[self.fitted]


def fit_strengths(columns: Columns, target: Target, *, encoded: bool = False) -> Float[np.ndarray, "k 3"]:
    """Strengths of a linear method's lights.

    Args:
        columns: picture by each light.
        target: to come near to.
        encoded: whether columns are display values and add up as such, as in the paper's form.
    """
    strengths = np.zeros(columns.shape[2:])
    for channel in range(3):
        matrix = target.at(columns[..., channel]).astype(np.float64)
        wanted = target.at(target.display)[:, channel].astype(np.float64)
        light = wanted if encoded else linear(wanted)
        weight = np.ones_like(light) if encoded else slope(np.maximum(light, 2e-3))
        normal, side, scale = _normal_equations(matrix, light, weight)
        strengths[:, channel] = _refined(matrix, wanted, _non_negative(normal, side) / scale, encoded)
    return strengths


def _normal_equations(
    matrix: np.ndarray, light: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrix and right-hand side of weighted least squares, and the scales of the columns."""
    weighted = matrix * weight[:, None]
    scale = np.maximum(np.sqrt((weighted**2).mean(axis=0)), SMALLEST_DIVISOR)
    weighted = weighted / scale
    return weighted.T @ weighted / len(light), weighted.T @ (light * weight) / len(light), scale


def _non_negative(normal: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Non-negative least squares, from the normal equations."""
    root = np.linalg.cholesky(normal + 1e-7 * np.eye(len(normal)))
    return optimize.nnls(root.T, np.linalg.solve(root, side), maxiter=50 * len(normal))[0]


def _refined(matrix: np.ndarray, wanted: np.ndarray, start: np.ndarray, encoded: bool) -> np.ndarray:
    """Strengths that bring display values nearest to those wanted."""
    scale = 1 / np.maximum(np.sqrt((matrix**2).mean(axis=0)), SMALLEST_DIVISOR)
    own = matrix * scale

    def loss(theta: np.ndarray) -> tuple[float, np.ndarray]:
        light = own @ theta
        off = (light if encoded else shown(light)) - wanted
        off = np.where((off > 0) & (wanted >= 1), 0.0, off)
        pull = off if encoded else off * slope(light)
        return float((off**2).mean()), 2 * own.T @ pull / len(wanted)

    found = optimize.minimize(
        loss,
        start / scale,
        jac=True,
        method="L-BFGS-B",
        bounds=[(0, None)] * len(start),
        options={"maxiter": ITERATIONS},
    )
    return found.x * scale


def chosen_lights(
    columns: Columns, candidates: Sequence[int], fixed: Sequence[int], target: Target, count: int
) -> list[int]:
    """Columns of the lights that help most, chosen one by one in addition to the fixed ones."""
    equations = []
    for channel in range(3):
        light = linear(target.at(target.display)[:, channel].astype(np.float64))
        matrix = target.at(columns[..., channel]).astype(np.float64)
        equations.append(_normal_equations(matrix, light, slope(np.maximum(light, 2e-3)))[:2])

    def error(chosen: list[int]) -> float:
        total = 0.0
        for normal, side in equations:
            part = normal[np.ix_(chosen, chosen)]
            theta = _non_negative(part, side[chosen])
            total += theta @ part @ theta - 2 * theta @ side[chosen]
        return total

    return _one_after_another(error, candidates, fixed, count)


def _one_after_another(
    error: Callable[[list[int]], float], candidates: Sequence[int], fixed: Sequence[int], count: int
) -> list[int]:
    """Candidates that lower an error most, each in addition to the fixed ones and those taken before."""
    taken: list[int] = []
    for _ in range(min(count, len(candidates))):
        left = [number for number in candidates if number not in taken]
        taken.append(min(left, key=lambda number: error([*fixed, *taken, number])))
    return taken


def polynomial(shape: tuple[int, int], order: int) -> Float[np.ndarray, "h w k"]:
    """Monomials of the pixels' places up to an order."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)], axis=-1)


def smooth_picture(photo: Picture, order: int, target: Target, count: int | None = None) -> Picture:
    """Photo times exp(polynomial), fitted in display values; order 0 is three gains. Linear light.

    Args:
        photo: linear.
        order: of the polynomial.
        target: to come near to.
        count: of its terms to use, those that help most; None for all.
    """
    terms, light = polynomial(photo.shape[:2], order), np.empty_like(photo, np.float64)
    if count is not None:
        terms = terms[..., _chosen_terms(photo, terms, target, count)]
    for channel in range(3):
        own, wanted = target.at(terms), target.at(target.display)[:, channel].astype(np.float64)
        before, weight, log = _log_ratio(photo, target, channel)
        start = np.linalg.lstsq(own * weight[:, None], log * weight, rcond=None)[0]

        def loss(c: np.ndarray, own: np.ndarray = own, before: np.ndarray = before, wanted: np.ndarray = wanted):  # type: ignore[no-untyped-def]
            made = before * np.exp(np.clip(own @ c, -8, 8))
            off = shown(made) - wanted
            return float((off**2).mean()), 2 * own.T @ (off * slope(made) * made) / len(wanted)

        found = optimize.minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
        light[..., channel] = photo[..., channel] * np.exp(np.clip(terms @ found.x, -8, 8))
    return light


def _log_ratio(photo: Picture, target: Target, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photo's light at the fitted pixels, weight of errors of its logarithm, log ratio of the target to it."""
    before = np.maximum(target.at(photo)[:, channel].astype(np.float64), SMALLEST_DIVISOR)
    wanted = linear(target.at(target.display)[:, channel].astype(np.float64))
    log = np.log(np.maximum(wanted, 2e-3) / np.maximum(before, 2e-3))
    return before, np.sqrt(before) * slope(before), log


def _chosen_terms(photo: Picture, terms: Float[np.ndarray, "h w k"], target: Target, count: int) -> list[int]:
    """Terms that help most, the constant one among them."""
    own, equations = target.at(terms), []
    for channel in range(3):
        _, weight, log = _log_ratio(photo, target, channel)
        weighted = own * weight[:, None]
        equations.append((weighted.T @ weighted, weighted.T @ (log * weight)))

    def error(chosen: list[int]) -> float:
        parts = ((normal[np.ix_(chosen, chosen)], side[chosen]) for normal, side in equations)
        return -sum(float(side @ np.linalg.lstsq(normal, side, rcond=None)[0]) for normal, side in parts)

    return [0, *_one_after_another(error, range(1, terms.shape[-1]), [0], count - 1)]


def fit_both(
    photo: Picture, light: Float[np.ndarray, "h w k 3"], target: Target, old: Sequence[Float[np.ndarray, "h w 3"]]
) -> Picture:
    """Photo times one combination of lights over another, both fitted to the target: an oracle.

    Args:
        photo: linear.
        light: of the family, as each falls on the surface.
        target: to come near to.
        old: guesses of the old light to begin with; the one that ends best is taken, for each channel.
    """
    made, count = np.empty_like(photo, np.float64), light.shape[2]
    scale = 1 / np.maximum(np.sqrt((light**2).mean(axis=(0, 1))), SMALLEST_DIVISOR)
    whole = light * scale
    begins = []
    for guess in old:
        under = np.stack([optimize.nnls(target.at(whole[..., c]), target.at(guess)[:, c])[0] for c in range(3)], 1)
        divided = photo / (np.einsum("hwkc,kc->hwc", whole, under) + LEAST_OLD_LIGHT)
        begins.append((fit_strengths(divided[:, :, None] * whole, target), under))
    for channel in range(3):
        own, before = target.at(whole[..., channel]), target.at(photo)[:, channel].astype(np.float64)
        wanted = target.at(target.display)[:, channel].astype(np.float64)

        def relit(x: np.ndarray, own: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            under = own @ x[count:] + LEAST_OLD_LIGHT
            return before * (own @ x[:count]) / under, under

        def loss(x: np.ndarray, own: np.ndarray = own, before: np.ndarray = before, wanted: np.ndarray = wanted):  # type: ignore[no-untyped-def]
            image, under = relit(x, own, before)
            off = shown(image) - wanted
            pull = 2 * off * slope(image) * before / under / len(wanted)
            change = np.concatenate([own.T @ pull, -own.T @ (pull * image / np.maximum(before, SMALLEST_DIVISOR))])
            return 1e3 * float((off**2).mean()), 1e3 * change

        bounds, options = [(0, None)] * (2 * count), {"maxiter": 2 * ITERATIONS}
        tries = (
            optimize.minimize(
                loss,
                np.concatenate([over[:, channel], under[:, channel]]),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options=options,
            )
            for over, under in begins
        )
        best = min(tries, key=lambda one: one.fun)
        made[..., channel] = relit(best.x, whole[..., channel], photo[..., channel].astype(np.float64))[0]
    return made


def blurred_ratio(photo: Picture, wanted: Picture, valid: Bool[np.ndarray, "h w"], sigma: float) -> Picture:
    """Photo times the true ratio of light, its logarithm blurred within `valid`."""
    log = np.log(np.maximum(wanted, 2e-3) / np.maximum(photo, 2e-3)) * valid[..., None]
    weight = ndimage.gaussian_filter(valid.astype(np.float64), sigma)
    smooth = np.stack([ndimage.gaussian_filter(log[..., c], sigma) for c in range(3)], axis=-1)
    return photo * np.exp(smooth / np.maximum(weight, 1e-6)[..., None])
