"""Light set-up: virtual lights, and the light that the frames were taken under."""

import dataclasses
from collections.abc import Hashable, Iterable, Mapping, Sequence

import jax
import numpy as np

from hyjax.light.kinds import Light
from hyjax.util.array_arguments import is_numeric
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

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
    def of(cls, lights: "LightSetup | Sequence[Light] | Light") -> "LightSetup":
        """A set-up as it is, or a set-up of these lights, or of a single one, under the usual reference.

        Raises:
            InputError: none of these, or a light whose values make no sense.
        """
        if isinstance(lights, LightSetup):
            setup = lights
        elif isinstance(lights, Light):
            setup = cls((lights,))
        elif isinstance(lights, Iterable) and not isinstance(lights, str | bytes | Mapping):
            setup = cls(tuple(lights))
        else:
            raise InputError(f"lights: must be a LightSetup or several lights, got {shown(lights)}")
        setup.check_values("lights")
        return setup

    def check_values(self, name: str) -> None:
        """Raise `InputError` for what is no light, or one whose values make no sense.

        Args:
            name: what messages call the set-up.
        """
        for number, light in enumerate(self.lights):
            if not isinstance(light, Light):
                raise InputError(f"{name}[{number}]: must be a Light, got {shown(light)}")
            light.check_values(f"{name}[{number}]")
        lux = concrete(self.reference_lux)
        if lux is not None and not (is_numeric(lux) and lux.ndim == 0 and 0 < lux < np.inf):
            raise InputError(f"{name}.reference_lux: must be finite and > 0, got {shown(self.reference_lux)}")

    def check_existing(self, *, divided: bool) -> None:
        """Raise `InputError` if sources of the photo are to be kept while its light is not divided out."""
        if self.existing and not divided:
            raise InputError(
                "lights: 'existing' keeps some of the photo's own light; leave keep_photo_light and paper_mode out"
            )


def check_lights(lights: Sequence[Light]) -> None:
    """Raise `InputError` if there are no lights."""
    if not lights:
        raise InputError("lights: none given; give at least one")


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
