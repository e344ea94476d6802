"""Methods that `experiments.real` compares: each one's picture of a place under another light, by fitted lights."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from experiments.real_bench import DIRECTIONS, RealPlace
from experiments.real_fit import (
    Columns,
    Picture,
    Target,
    blurred_ratio,
    checkerboard,
    chosen_lights,
    fit_both,
    fit_strengths,
    smooth_picture,
)
from hyjax.metrics.exposure import displayed
from hyjax.photo_light.radiance import linear

PHOTO, GAINS, SMOOTH, SMOOTHER = "untouched photo", "three gains", "exp(polynomial 4)", "exp(polynomial 7)"
SMOOTH_BEST = "exp(polynomial 7), best 15 terms"
PAPER, KEPT, NEW = "paper's method", "hyjax 0.1", "default"
BLURRED = "default without light edges"
KEPT_BEST, BEST = "hyjax 0.1, best 15 lights", "default, best 15 lights"
KEPT_GLOW, GLOW = "hyjax 0.1 + glow", "default + glow"
ORACLE, BLUR_8, BLUR_4 = "oracle: both lights fitted", "true ratio, blurred 8 px", "true ratio, blurred 4 px"
METHODS = (
    *(PHOTO, GAINS, SMOOTH, SMOOTH_BEST, SMOOTHER, PAPER),
    *(KEPT, BLURRED, NEW, KEPT_BEST, BEST, KEPT_GLOW, GLOW, ORACLE, BLUR_8, BLUR_4),
)
LAMPS = 2
"""Lamps of the grid that a method may choose."""
FEW_UNKNOWNS = 15
"""Unknowns of each channel of a method that chooses of all lights or terms: as many as exp(polynomial 4) has."""


@dataclasses.dataclass(frozen=True)
class Made:
    """Picture of a method.

    Attributes:
        display: its values, in [0, 1].
        unknowns: fitted numbers of each channel; 0 where nothing was.
    """

    display: Picture
    unknowns: int


def pictures(place: RealPlace) -> Iterator[tuple[str, Made]]:
    """Name and picture of each method."""
    photo = linear(place.photo)
    target = Target(place.target, checkerboard(place.photo.shape[:2]) & place.valid)
    yield PHOTO, Made(place.photo, 0)
    for name, order, unknowns in ((GAINS, 0, 1), (SMOOTH, 4, 15), (SMOOTHER, 7, 36)):
        yield name, _shown(smooth_picture(photo, order, target), unknowns)
    yield SMOOTH_BEST, _shown(smooth_picture(photo, 7, target, FEW_UNKNOWNS), FEW_UNKNOWNS)
    filters = place.paper
    yield PAPER, Made(*_encoded(place.photo[:, :, None] * filters[..., None], place, target))
    glow = np.repeat(place.glow[..., None], 3, axis=-1)
    kept = np.repeat(place.before[..., None], 3, axis=-1)
    divided, light = photo / place.own, place.direct[..., None] + place.bounced
    plain = ((KEPT, photo, kept), (BLURRED, photo / place.estimated, light), (NEW, divided, light))
    for name, image, family in plain:
        yield name, _fitted(image[:, :, None] * family, place, target)
    kept_shaded = np.repeat(place.shaded_lamps(place.before)[..., None], 3, axis=-1)
    shaded = place.shaded_lamps(place.direct)[..., None] + place.bounced_shaded
    for name, image, parts in ((KEPT_BEST, photo, (kept, kept_shaded)), (BEST, divided, (light, shaded))):
        columns = image[:, :, None] * np.concatenate([*parts, glow], axis=2)
        few = [0, *chosen_lights(columns, range(1, columns.shape[2]), [0], target, FEW_UNKNOWNS - 1)]
        yield name, _with_strengths(columns[:, :, few], target)
    for name, image, family in ((KEPT_GLOW, photo, kept), (GLOW, divided, light)):
        columns = image[:, :, None] * np.concatenate([family, glow], axis=2)
        yield name, _fitted(columns, place, target, len(place.lights))
    own = np.repeat(place.direct[..., None], 3, axis=-1)
    # Two lamps for the new light, and two for the old, as far as the way back tells it.
    there, back = Target(place.photo, target.fitted), linear(place.target)[:, :, None] * own
    chosen = sorted({*_chosen(photo[:, :, None] * own, place, target), *_chosen(back, place, there)})
    guesses = np.ones_like(photo), place.own
    yield ORACLE, _shown(fit_both(photo, own[:, :, chosen], target, guesses), 2 * len(chosen))
    for name, sigma in ((BLUR_8, 8.0), (BLUR_4, 4.0)):
        yield name, _shown(blurred_ratio(photo, linear(place.target), place.valid, sigma), 0)


def default_picture(place: RealPlace) -> Made:
    """The default's picture alone, as `pictures` makes it."""
    target = Target(place.target, checkerboard(place.photo.shape[:2]) & place.valid)
    light = place.direct[..., None] + place.bounced
    return _fitted((linear(place.photo) / place.own)[:, :, None] * light, place, target)


def _shown(light: Picture, unknowns: int) -> Made:
    return Made(displayed(light), unknowns)


def _chosen(columns: Columns, place: RealPlace, target: Target, more: int | None = None) -> list[int]:
    """Columns of the family: all but the lamps that help least; and those from `more` on."""
    fixed = [*range(1 + DIRECTIONS), *(range(more, columns.shape[2]) if more is not None else ())]
    return [*fixed, *chosen_lights(columns, place.lamps, fixed, target, LAMPS)]


def _fitted(columns: Columns, place: RealPlace, target: Target, more: int | None = None) -> Made:
    return _with_strengths(columns[:, :, _chosen(columns, place, target, more)], target)


def _with_strengths(columns: Columns, target: Target) -> Made:
    strengths = fit_strengths(columns, target)
    return _shown(np.einsum("hwkc,kc->hwc", columns, strengths), columns.shape[2])


def _encoded(columns: Columns, place: RealPlace, target: Target) -> tuple[Picture, int]:
    """The same in display values, which the paper multiplies."""
    chosen = _chosen(columns, place, target)
    strengths = fit_strengths(columns[:, :, chosen], target, encoded=True)
    return np.clip(np.einsum("hwkc,kc->hwc", columns[:, :, chosen], strengths), 0, 1), len(chosen)
