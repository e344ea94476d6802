"""Shaded surface: the light on visible points, the input of the refinement."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.light.emission import Emission
from hyjax.light.kinds import Light
from hyjax.light.setup import LightSetup, check_lights
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import Run, call


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Shaded:
    """Light on the visible surface, a channel for each light.

    Shadow maps, Blender, a point cloud or moved furniture: whatever shades a frame delivers this.

    Attributes:
        illuminance: lux of each light on the surface without shadows, before its colour; zero in holes.
        visibility: unshadowed share of each light, in [0, 1].
        colors: linear RGB of each light.
        confidence: how far the shading of a pixel can be trusted, in [0, 1]; 0 in holes.
        reference_lux: assumed illuminance of the photographed frame.
        ambient: relight filter where nothing of the frame is known.
        bounced: lux of the lights by way of other surfaces, with their colours; None for none.
        photo_light: illuminance of the photographed frame, relative to its mean; None if assumed even.
        emission: emitting pixels, at the size of `View.source_frame`; None if there are none.
        refined_photo_light: `photo_light` refined before; None to refine it with the rest.
    """

    illuminance: Float[Array, "h w l"]
    visibility: Float[Array, "h w l"]
    colors: Float[Array, "l 3"]
    confidence: Float[Array, "h w 1"]
    reference_lux: Float[ArrayLike, ""]
    ambient: Float[Array, "3"]
    bounced: Float[Array, "h w 3"] | None = None
    photo_light: Float[Array, "h w 3"] | None = None
    emission: Emission | None = None
    refined_photo_light: Float[Array, "h w 3"] | None = None

    @property
    def surface_fields(self) -> tuple[Float[Array, "h w 3"], ...]:
        """Further fields of the surface to refine: bounced light and the photo's own."""
        return tuple(field for field in (self.bounced, self.photo_light) if field is not None)

    @classmethod
    @checked_arguments
    def of(
        cls,
        setup: LightSetup | Sequence[Light] | Light,
        illuminance: Float[Array, "h w l"],
        visibility: Float[Array, "h w l"],
        hit: Bool[Array, "h w"],
        *,
        confidence: Float[Array, "h w 1"] | None = None,
    ) -> "Shaded":
        """Shaded surface from the illuminance of a set-up, computed by any renderer.

        Args:
            setup: the lights, or a single one.
            illuminance: lux of each, without shadows.
            visibility: unshadowed share of it.
            hit: where the mesh has a surface.
            confidence: how far the shading can be trusted; 1 by default. In holes it is always 0.

        Raises:
            InputError: no lights, or shapes that do not fit.
        """
        setup = LightSetup.of(setup)
        check_lights(setup.lights)
        expected = (*hit.shape, len(setup.lights))
        for name, channels in (("illuminance", illuminance), ("visibility", visibility)):
            if channels.shape != expected:
                raise InputError(
                    f"shaded: {name} is {channels.shape}, must be {expected}: a channel for each light"
                )
        if confidence is not None and confidence.shape != (*hit.shape, 1):
            raise InputError(f"shaded: confidence is {confidence.shape}, must be {(*hit.shape, 1)}")
        known, colors, ambient = _complete(hit, confidence, setup.lights, setup.reference_lux)
        return cls(illuminance, visibility, colors, known, setup.reference_lux, ambient)


def with_dark_lights(shaded: Shaded, count: int, *, run: Run = call) -> Shaded:
    """Shaded surface with black lights after its own, which change no picture: programs of more lights take it."""
    illuminance, visibility, colors = run(
        _padded, shaded.illuminance, shaded.visibility, shaded.colors, count=count
    )
    return dataclasses.replace(shaded, illuminance=illuminance, visibility=visibility, colors=colors)


def _padded(
    illuminance: Float[Array, "h w l"],
    visibility: Float[Array, "h w l"],
    colors: Float[Array, "l 3"],
    *,
    count: int,
) -> tuple[Float[Array, "h w m"], Float[Array, "h w m"], Float[Array, "m 3"]]:
    channels, rows = ((0, 0), (0, 0), (0, count)), ((0, count), (0, 0))
    return jnp.pad(illuminance, channels), jnp.pad(visibility, channels), jnp.pad(colors, rows)


@jax.jit
def _complete(
    hit: Bool[Array, "h w"],
    confidence: Float[Array, "h w 1"] | None,
    lights: Sequence[Light],
    reference_lux: Float[ArrayLike, ""],
) -> tuple[Float[Array, "h w 1"], Float[Array, "l 3"], Float[Array, "3"]]:
    """Complete the defaults: confidence, colours and ambient filter."""
    known = jnp.where(hit[..., None], 1.0 if confidence is None else confidence, 0.0)
    return known, jnp.stack([light.color for light in lights]), ambient_filter(lights, reference_lux)


def ambient_filter(lights: Sequence[Light], reference_lux: Float[ArrayLike, ""]) -> Float[Array, "3"]:
    """Relight filter of the ambient lights; 1, which leaves the frame, if there are none."""
    anywhere, up = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])
    ambient = [light.illuminance_at(anywhere, up) * light.color for light in lights if light.UNIFORM]
    return sum(ambient[1:], ambient[0]) / reference_lux if ambient else jnp.ones(3)
