"""Lights of a plan: sky and sun, its lamps, bounces of the room; and the exposure for them."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import blackbody, luminance
from hyjax.light.kinds import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
)
from hyjax.light.kinds.directional import SUN_DEGREES
from hyjax.light.photo_light import PhotoLight
from hyjax.light.setup import REFERENCE_LUX, LightSetup, geometry_key
from hyjax.scene.exposure import exposed
from hyjax.scene.light_places import WindowPlace
from hyjax.scene.light_response import Response, assumed_response, measured_response
from hyjax.scene.light_setups import EXPOSURES
from hyjax.scene.seen_surface import SeenSurface
from hyjax.tour.placement import compass
from hyjax.tour.plan import KINDS, Lamp, TourPlan
from hyjax.util.lru_cache import LruCache
from hyjax.util.vectors import unit

GLASS_TRANSMITTANCE = 0.7
"""Share of the light that a window lets in."""
GROUND_REFLECTANCE = 0.2
"""Share of the daylight that the ground outside throws back."""
WALL_REFLECTANCE = 0.5
"""Share of the light that a room's surfaces throw back, on average."""
BALANCE_SHARE = 0.43
"""Share of a light's distance from neutral, in reciprocal kelvin, that a camera's white balance makes up for."""
NEUTRAL_KELVIN = 6500.0
ADAPTATION = 0.8
"""Exponent by which a camera makes up for the dark: 1 shows night as bright as day, 0 leaves it black."""
STRIP_SIZE = (1.0, 0.03)  # metres
SPOT_DEGREES = 20.0, 40.0
"""Half angles of a spot's cone: fully lit inside the first, dark outside the second."""
SUN_RADIUS = np.asarray(np.deg2rad(SUN_DEGREES), np.float32)
LEAST_COSINE = 0.02
"""Least cosine between the sun's direction and a window's normal for sun to come in."""
LEAST_AMBIENT = 1e-3
"""Lux: a picture is never entirely dark."""
KEPT_HOURS, KEPT_LIGHTS = 64, 64
"""Number of hours that are kept, and of lights with what each gives the seen surface."""


@dataclasses.dataclass(frozen=True)
class Outside:
    """Light through the windows or from an open sky, as a camera shows it that is exposed for the room.

    Attributes:
        lights: sky and sun, open or of each window; the sun dimmer than it is where it would burn out.
        lumen, kelvin: of all of it, as far as the room throws it back.
        lux: illuminance that the camera exposes for.
    """

    lights: tuple[Light, ...]
    lumen: float
    kelvin: float
    lux: float


class Lighting:
    """Lights of plans in a room, and the camera's exposure for them.

    What the room throws back is one ambient light, E = ρ Φ / (S (1 − ρ)) with all the light Φ of the lamps, the
    room's surface S and its mean reflectance ρ: the sphere that photometry integrates in.

    Attributes:
        up: against gravity, world axes.
        surface_area: of floor, walls and ceiling of a box around the room, square metres.

    Args:
        caster: surface of the room.
        cameras: of the capture, which see the surface that is exposed for.
        up: see above.
        photo: light of the photos where it is divided out; None where it is kept.
    """

    def __init__(
        self,
        caster: RayCaster,
        cameras: Sequence[Camera],
        up: Float[np.ndarray, "3"],
        photo: PhotoLight | None = None,
    ) -> None:
        a, b, c = caster.mesh.extents
        self.up, self.surface_area = up, 2.0 * float(a * b + b * c + c * a)
        self._seen, self._photo = SeenSurface.of(caster, cameras)[0], photo
        self._outside, self._responses = LruCache(KEPT_HOURS), LruCache(KEPT_LIGHTS)

    def setup(self, plan: TourPlan, flicker: Mapping[int, float] | None = None) -> LightSetup:
        """Lights of a plan and the illuminance that the camera exposes for.

        Sky and sun, then the lamps, then one ambient light. The camera does not follow a flicker: exposure is that
        of steady lamps.

        Args:
            plan: what is set up.
            flicker: factors on the light of some lamps, by their number.
        """
        outside = self.outside(plan)
        lights, flux, steady = [*outside.lights], [(outside.lumen, outside.kelvin)], 0.0
        for number, lamp in enumerate(plan.lamps):
            if lamp.on and lamp.lumen > 0:
                lumen = lamp.lumen * (flicker or {}).get(number, 1.0)
                lights.append(_lamp_light(lamp, lumen, self.up))
                flux.append((lumen, lamp.kelvin))
                steady += lamp.lumen
        total, kelvin = mixed(flux)
        ambient = max(self._thrown_back(total), LEAST_AMBIENT)
        lights.append(AmbientLight(_float32(ambient), _color(kelvin)))
        # Light that has bounced is what lamps give a room on average.
        reference = reference_lux(outside.lux + 2.0 * self._thrown_back(steady)) * 2.0**-plan.exposure
        existing = {name: (factor, factor, factor) for name, factor in plan.existing.items()}
        return LightSetup(tuple(lights), reference, existing)

    def outside(self, plan: TourPlan) -> Outside:
        """Light of a plan from outside, exposed as the named set-ups of `hyjax relight` are."""
        key = plan.hour, plan.day, plan.latitude, plan.north, plan.weather, plan.windows, plan.open_sky
        return self._outside(key, lambda: self._exposed(plan))

    def _exposed(self, plan: TourPlan) -> Outside:
        lights, flux = lights_from_outside(plan, self.up)
        if not lights:
            return Outside((), 0.0, NEUTRAL_KELVIN, 0.0)
        every = (*lights, AmbientLight(_float32(1.0), _color(mixed(flux)[1])))
        lux, response = self._response(every)
        setup = exposed(LightSetup(every), lux, self._seen, EXPOSURES["noon-window"], response)
        *shown, ambient = jax.tree.map(_float32, setup.lights)
        left = [_strength(new) / max(_strength(old), 1e-9) for new, old in zip(shown, lights, strict=True)]
        _, kelvin = mixed([(share * lumen, kelvin) for share, (lumen, kelvin) in zip(left, flux, strict=True)])
        lumen = _strength(ambient) / self._thrown_back(1.0)
        return Outside(tuple(shown), lumen, kelvin, setup.reference_lux)

    def _response(self, lights: Sequence[Light]) -> tuple[Float[np.ndarray, "n l"], Response]:
        """Illuminance of lights on the seen surface, and its response: sums over what is kept of each light.

        Both are linear in each light, and an hour leaves the windows' sky where it was.
        """
        seen, photo = self._seen, self._photo

        def made(light: Light) -> tuple[Float[np.ndarray, "n"], Response]:
            plain = [light.normalized()]
            lux = seen.lux(plain)
            own = assumed_response(plain, lux, seen) if photo is None else measured_response(plain, seen, photo)
            return lux[:, 0], own

        direct, own = zip(
            *(self._responses(geometry_key(light), functools.partial(made, light)) for light in lights), strict=True
        )
        strength = np.array([_strength(light) for light in lights])
        pale, strongest = (strength * [each(light.color) for light in lights] for each in (np.mean, np.max))
        near, parallel = pale @ [r.near for r in own], pale @ [r.parallel for r in own]
        return np.stack(direct, axis=-1) * strongest, dataclasses.replace(own[0], near=near, parallel=parallel)

    def _thrown_back(self, lumen: float) -> float:
        """Lux of the ambient light that lamps become."""
        return WALL_REFLECTANCE * lumen / (self.surface_area * (1.0 - WALL_REFLECTANCE))


def mixed(flux: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Lumens of several lights together, and their mean kelvin."""
    total = sum(lumen for lumen, _ in flux)
    return total, sum(lumen * kelvin for lumen, kelvin in flux) / total if total > 0 else 4000.0


def lights_from_outside(
    plan: TourPlan, up: Float[np.ndarray, "3"]
) -> tuple[list[Light], list[tuple[float, float]]]:
    """Sky and sun, open or of each window, and the lumens of each with their kelvin.

    Those of an open sky are on a square metre of level ground.
    """
    sky = plan.sky()
    toward = sky.toward @ compass(plan.north, up)
    lights: list[Light] = []
    flux: list[tuple[float, float]] = []
    if plan.open_sky:
        lights.append(SkyLight(_float32(up), _float32(sky.sky), _color(sky.sky_kelvin)))
        flux.append((sky.sky, sky.sky_kelvin))
        if sky.direct > 0 and sky.toward[2] > 0:
            sun = _float32(unit(-toward)), _float32(sky.direct), _color(sky.direct_kelvin), SUN_RADIUS
            lights.append(DirectionalLight(*sun))
            flux.append((sky.ground - sky.sky, sky.direct_kelvin))
        return lights, flux
    for window in plan.windows:
        inward, area = unit(np.asarray(window.normal)), window.width * window.height
        opening = WindowPlace(np.asarray(window.center), inward, window.width, window.height).opening(up)
        # A tilted surface sees a part of the sky and a part of the ground.
        tilt = float(-inward @ up)
        outside = 0.5 * (1.0 + tilt) * sky.sky + 0.5 * (1.0 - tilt) * GROUND_REFLECTANCE * sky.ground
        lumen = GLASS_TRANSMITTANCE * outside * area
        lights.append(RectLight.filling(opening, _float32(lumen), _color(sky.sky_kelvin)))
        flux.append((lumen, sky.sky_kelvin))
        cosine = float(-inward @ toward)
        if sky.direct > 0 and cosine > LEAST_COSINE:
            lux, direction = GLASS_TRANSMITTANCE * sky.direct, _float32(unit(-toward))
            color = _color(sky.direct_kelvin)
            lights.append(DirectionalLight(direction, _float32(lux), color, SUN_RADIUS, opening))
            flux.append((lux * cosine * area, sky.direct_kelvin))
    return lights, flux


def reference_lux(lux: float) -> float:
    """Illuminance that leaves the photos as they are, of a camera that is exposed for `lux`.

    By day it follows the light; where there is less than in the photos, not all the way, or night would look like
    day.
    """
    lux = max(lux, 2.0 * LEAST_AMBIENT)
    return float(max(lux, lux**ADAPTATION * REFERENCE_LUX ** (1.0 - ADAPTATION)))


def flicker(seconds: float, number: int) -> float:
    """Factor on a candle's light: a few waves of no common period; 1 on average."""
    t = seconds + 13.7 * number
    return 1.0 + 0.08 * math.sin(9.1 * t) + 0.06 * math.sin(14.3 * t + 1.0) + 0.05 * math.sin(3.7 * t + 2.0)


def _lamp_light(lamp: Lamp, lumen: float, up: Float[np.ndarray, "3"]) -> Light:
    flux, color = _float32(lumen), _color(lamp.kelvin)
    if lamp.color is not None and (brightness := float(luminance(jnp.asarray(lamp.color)))) > 0:
        color = _float32(np.asarray(lamp.color) / brightness)
    position, direction = _float32(np.asarray(lamp.position)), unit(np.asarray(lamp.direction))
    radius, none = _float32(KINDS[lamp.kind].radius), _float32(0.0)
    if lamp.kind in ("bulb", "candle"):
        return PointLight(position, flux, color, radius, none)
    if lamp.kind == "spot":
        inner, outer = (_float32(np.deg2rad(degrees)) for degrees in SPOT_DEGREES)
        return SpotLight(position, _float32(direction), flux, color, inner, outer, radius, none)
    return RectLight.filling(Aperture.facing(position, direction, up, *STRIP_SIZE), flux, color)


def _strength(light: Light) -> float:
    return float(getattr(light, light.STRENGTH))


@functools.lru_cache(maxsize=4096)
def _color(kelvin: float) -> Float[np.ndarray, "3"]:
    """Colour that light has in the picture."""
    neutral = 1.0 / NEUTRAL_KELVIN
    return _float32(blackbody(1.0 / (neutral + (1.0 - BALANCE_SHARE) * (1.0 / kelvin - neutral))))


def _float32(value: ArrayLike) -> Float[np.ndarray, "*s"]:
    return np.asarray(value, np.float32)
