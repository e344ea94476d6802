"""Light set-up: virtual lights, and the light that the frames were taken under."""

import dataclasses
from collections.abc import Hashable, Mapping, Sequence

import jax
import numpy as np

from hyjax.light.kinds import Light
from hyjax.util.errors import InputError

REFERENCE_LUX = 300.0
"""Illuminance under which a frame is taken to have been photographed: an ordinary room in daylight or lamplight."""


@dataclasses.dataclass(frozen=True)
class LightSetup:
    """Virtual lights, with the illuminance that the frames are taken to have been photographed under.

    Attributes:
        lights: in the mesh's world coordinates.
        reference_lux: illuminance that leaves a frame as it is.
        existing: what is left of the sources that lit the photos, by name: a factor for red, green and blue. Those
            that are not named are off.
    """

    lights: tuple[Light, ...]
    reference_lux: float = REFERENCE_LUX
    existing: Mapping[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, lights: "LightSetup | Sequence[Light]") -> "LightSetup":
        """A set-up as it is, or a set-up of these lights under the usual reference."""
        return lights if isinstance(lights, LightSetup) else cls(tuple(lights))

    def check_existing(self, *, divided: bool) -> None:
        """Raise `InputError` if sources of the photo are to be kept while its light is not divided out."""
        if self.existing and not divided:
            raise InputError(
                "lights: 'existing' keeps some of the photo's own light; leave keep_photo_light and paper_mode out"
            )


def same_lights(a: Sequence[Light], b: Sequence[Light]) -> bool:
    """Whether two sequences have lights of the same kinds and values."""
    own, other = tuple(a), tuple(b)
    same: bool = jax.tree.structure(own) == jax.tree.structure(other)  # type: ignore[operator]
    return same and all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(own), jax.tree.leaves(other)))


def same_setup(a: LightSetup, b: LightSetup) -> bool:
    """Whether two set-ups have the same lights and reference, and keep the same of the photo's light."""
    same = a.reference_lux == b.reference_lux and dict(a.existing) == dict(b.existing)
    return same and same_lights(a.lights, b.lights)


def geometry_key(light: Light) -> Hashable:
    """Key of a light's kind and geometry: equal for lights that differ in strength and colour alone."""
    geometry = [value for name, value in vars(light).items() if name not in ("color", light.STRENGTH)]
    return type(light), *(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(geometry))
