"""Light set-up: virtual lights, and the reference illuminance of the frames."""

import dataclasses
from collections.abc import Hashable, Mapping, Sequence

import jax
import numpy as np

from hyjax.light.kinds import Light
from hyjax.util.argument_kinds import is_numeric
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

REFERENCE_LUX = 300.0
"""Assumed illuminance of the photographed frame in lux: an ordinary room in daylight or lamplight."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LightSetup:
    """Virtual lights, with the assumed illuminance of the photographed frames.

    Attributes:
        lights: in the mesh's world coordinates.
        reference_lux: illuminance that leaves a frame as it is.
        existing: factor, for red, green and blue, of each source that lit the photos, by name. Sources without a
            name here are off.
    """

    lights: tuple[Light, ...]
    reference_lux: float = REFERENCE_LUX
    existing: Mapping[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)

    @classmethod
    @checked_arguments
    def of(cls, lights: "LightSetup | Sequence[Light] | Light") -> "LightSetup":
        """Return a set-up as it is, or make one of lights (or a single one) under the usual reference.

        Raises:
            InputError: none of these, or a light with invalid values.
        """
        if isinstance(lights, LightSetup):
            setup = lights
        else:
            setup = cls((lights,) if isinstance(lights, Light) else tuple(lights))
        setup.check_values("lights")
        return setup

    def check_values(self, name: str) -> None:
        """Raise `InputError` for an entry that is no light, or has invalid values.

        Args:
            name: of the set-up in messages.
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
    first, second = tuple(a), tuple(b)
    same: bool = jax.tree.structure(first) == jax.tree.structure(second)  # type: ignore[operator]
    return same and all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(first), jax.tree.leaves(second)))


def same_setup(a: LightSetup, b: LightSetup) -> bool:
    """Whether two set-ups have the same lights, reference and factors of the photo's sources."""
    same = a.reference_lux == b.reference_lux and dict(a.existing) == dict(b.existing)
    return same and same_lights(a.lights, b.lights)


def geometry_key(light: Light) -> Hashable:
    """Key of a light's kind and geometry, independent of strength and colour."""
    geometry = [value for name, value in vars(light).items() if name not in ("color", light.STRENGTH)]
    return type(light), *(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(geometry))
