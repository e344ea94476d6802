"""Exposure of named set-ups, by the illuminance of their lights on the visible surface."""

import dataclasses
import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.light.color import WHITE
from hyjax.light.kinds import Light
from hyjax.light.setup import LightSetup
from hyjax.scene.light_response import Response, kinds_of, paleness
from hyjax.scene.seen_surface import SeenSurface

LARGEST_FILTER, LARGEST_FILTER_IN_SUN = 1.6, 3.5
"""Largest filter on all but a twentieth of the surface, without the sun and with it."""
MOST_BURNT, MOST_BURNT_UNSEEN = 0.1, 0.03
"""Largest share of the surface in a picture that burns out, but for what the photo itself has that bright; the one
under the paper's lights, which no picture shows."""
MOST_OVER_SHARE = 2.0
"""Largest brightness of a picture, beside the sun, over that which the median one should have."""
DIMMINGS = 8
"""Most times that sun, least bounces and exposure are brought in line with each other."""
MOST_FILLED, FILL_STEPS = 0.85, 16
"""Most light that bounces are filled up to, over that of the median picture; number of steps that are tried."""
ROUNDING = 1e-4
"""Share of its brightness that the median picture may lack before bounces are filled: it mostly has just that."""
DAY_BRIGHTNESS, LARGEST_LIFT = 0.12, 1.8
"""Median linear value of photos below which they are lifted by day, and the largest lift."""
LEAST_KEPT, KEPT_WHERE_DARK, MOST_KEPT = 0.2, 0.4, 1.0
"""Shares of its brightness that the median picture keeps under a set-up of a fixed exposure: the least, that of a
longer exposure, and the largest."""
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Exposure:
    """Exposure of a set-up.

    Attributes:
        share: of its brightness that the median picture keeps, in linear light.
        ambient: illuminance of ambient lights over the reference; bounces are filled up to a share of it.
        sun: most of parallel light over the reference, where it falls on a surface that is seen.
        day: whether dark photos are lifted.
    """

    share: float
    ambient: float
    sun: float
    day: bool = False

    def lifted(self, brightness: float) -> "Exposure":
        """Exposure of photos of a median brightness: by day, dark ones come out brighter than they were."""
        lift = np.clip(np.sqrt(DAY_BRIGHTNESS / max(brightness, 1e-6)), 1.0, LARGEST_LIFT) if self.day else 1.0
        return dataclasses.replace(self, share=float(lift) * self.share)


def exposed(
    setup: LightSetup, lux: Float[np.ndarray, "n l"], seen: SeenSurface, exposure: Exposure, response: Response
) -> LightSetup:
    """Set-up with the reference illuminance, and the ambient light, of an exposure.

    Dimmer where lights would burn the pictures out.
    """
    near, parallel = kinds_of(setup.lights)
    usual, exposure = exposure.share, exposure.lifted(response.brightness)
    lift = exposure.share / usual
    sun, reference = np.ones(len(setup.lights)), 0.0
    strengths = [float(getattr(light, light.STRENGTH)) for light in setup.lights]
    pale = paleness(setup.lights)
    brightest = np.array(
        [np.quantile(column[column > 0], 0.9) if (column > 0).any() else np.inf for column in lux.T]
    )
    near_white = (lux * pale)[:, near].sum(axis=1)
    for _ in range(DIMMINGS):
        dimming = float(sun[parallel].min(initial=1.0))
        filled = exposure.ambient * response.filled_share * reference
        indirect = np.maximum(response.near + dimming * response.parallel, filled)
        shade = lux[:, near].sum(axis=1) + np.maximum(response.near, filled)
        light = (lux * sun)[:, near | parallel].sum(axis=1) + indirect
        bright = (lux * sun * pale)[:, near | parallel].sum(axis=1) + indirect
        bounds = [(shade, lift * LARGEST_FILTER), (light, lift * LARGEST_FILTER_IN_SUN)]
        least = max(float(np.quantile(values / response.photo_light, 0.95)) / most for values, most in bounds)
        least = max(least, _least_unburnt(shade, seen, response))
        median = float(np.median(seen.of_cameras(bright / response.photo_light)))
        beside_sun = near_white + np.maximum(response.near, filled)
        brightest_picture = float(seen.of_cameras(beside_sun / response.photo_light).max())
        least = max(least, brightest_picture / (MOST_OVER_SHARE * exposure.share))
        before, reference = (reference, *sun), max(median / exposure.share, least, 1e-3)
        sun = np.where(parallel, np.minimum(1.0, lift * exposure.sun * reference / brightest), 1.0)
        if (reference, *sun) == before:
            break

    ambient, burning = exposure.ambient, 1.0
    if response.measured:
        direct = (lux * sun * pale)[:, near | parallel].sum(axis=1) / reference
        bounced = (response.near + float(sun[parallel].min(initial=1.0)) * response.parallel) / reference
        ambient = _least_ambient(setup, direct, bounced, seen, exposure, response)
        # Ambient light lifts what was just not burnt out; with it, everything is exposed for less. Channels count
        # in the mean, as white walls are meant: of a warm light red may burn out.
        white = near_white / reference + np.maximum(bounced, ambient * response.filled_share)
        burning = max(_least_unburnt(white, seen, response), 1.0)
    lights: list[Any] = list(setup.lights)
    for number, light in enumerate(lights):
        strength = ambient * reference if light.UNIFORM else sun[number] * strengths[number]
        lights[number] = dataclasses.replace(light, **{light.STRENGTH: float(strength)})
    return LightSetup(tuple(lights), burning * reference)


def bounded(setup: LightSetup, lux: Float[np.ndarray, "n l"], seen: SeenSurface, response: Response) -> LightSetup:
    """Set-up of a fixed exposure, which is left only where pictures would end dark or burnt out."""
    pale, strongest = (light.sum(axis=1) + response.near for light in (lux * paleness(setup.lights), lux))
    filtered = pale / response.photo_light
    median, reference = float(np.median(seen.of_cameras(filtered))), float(setup.reference_lux)
    if 0 < median < LEAST_KEPT * reference:
        unburnt = float(np.quantile(filtered, 0.95)) / LARGEST_FILTER
        reference = min(reference, max(median / KEPT_WHERE_DARK, unburnt))
    least = max(median / MOST_KEPT, _least_unburnt(strongest, seen, response, MOST_BURNT_UNSEEN))
    return LightSetup(setup.lights, max(reference, least))


def _least_unburnt(
    light: Float[np.ndarray, "n"], seen: SeenSurface, response: Response, most_burnt: float = MOST_BURNT
) -> float:
    """Least reference by which nothing burns out beside the sun: white walls take less light than dark floors."""
    if response.photo_value is None:
        return 0.0
    photo = seen.of_cameras(response.photo_value, 1.0 - most_burnt)
    relit = seen.of_cameras(response.photo_value * light / response.photo_light, 1.0 - most_burnt)
    return float((relit / np.maximum(photo, WHITE)).max())


def _least_ambient(
    setup: LightSetup,
    direct: Float[np.ndarray, "n"],
    bounced: Float[np.ndarray, "n"],
    seen: SeenSurface,
    exposure: Exposure,
    response: Response,
) -> float:
    """Ambient light over the reference: that of the exposure, or more, so that the median picture keeps its share.

    Lights leave it darker than told where they light a small part of what is seen and would burn that out, and
    where bounces give little, as in a room that was scanned in small part.
    """
    color = float(np.mean([light.color for light in setup.lights if light.UNIFORM] or 1.0))
    least = exposure.ambient * response.filled_share
    for filled in np.linspace(least, max(least, MOST_FILLED * exposure.share), FILL_STEPS):
        light = (direct + np.maximum(bounced, filled * color)) / response.photo_light
        if np.median(seen.of_cameras(light)) >= (1.0 - ROUNDING) * exposure.share:
            break
    return float(filled) / response.filled_share


def warn_of_far(lights: Sequence[Light], bounds: Float[np.ndarray, "2 3"], where: str) -> None:
    """Warn of lights that stand farther from a scan than it is wide."""
    low, high = np.asarray(bounds)
    for number, light in enumerate(lights):
        place = getattr(light, "position", getattr(light, "center", None))
        if place is None:
            continue
        away = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - np.asarray(place), np.asarray(place) - high))))
        if away > np.linalg.norm(high - low):
            kind = type(light).__name__
            _log.warning("%s: light %d (%s) stands %.3g m outside the scan", where, number, kind, away)


def warn_of_missing(setup: LightSetup, lux: Float[np.ndarray, "n l"], name: str) -> None:
    """Warn of lights of a set-up that reach no visible surface."""
    for number, light in enumerate(setup.lights):
        if not light.UNIFORM and float(lux[:, number].max()) <= 0:
            kind = type(light).__name__
            _log.warning("%s: light %d (%s) reaches no surface that the cameras see", name, number, kind)
