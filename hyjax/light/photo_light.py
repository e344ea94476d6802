"""Photo's own light: the illumination of a scan when its frames were taken, and its interreflections.

A frame is albedo times the light it was taken under. Dividing by that light leaves what any new light multiplies:

    S = C · (E_direct + E_bounced) / E_old · K

with K the geometric mean of E_old over what is visible: light of the reference illuminance leaves the frame's
brightness, and its white balance, as they are. All fields live on the scan's vertices: numerator and denominator
share the mesh's errors, which a sharper denominator would show.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from hyjax.light.emission import Emitters
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.shaded import Shaded
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import ShadowMap, visibilities
from hyjax.light.surface_outliers import without_outliers
from hyjax.light.transport import Transport, bounce
from hyjax.util.errors import InputError
from hyjax.util.tracing import Run, call, concrete

LEAST_PHOTO_LIGHT = 0.05
"""Least share of the photo's mean light; below it noise would be amplified more than twentyfold."""

EVEN_RANGE = 1e-3
"""Range of the photo's own light below which it is even."""
FILLED_SHARE = 0.25
"""Share of ambient light that is left where bounces give less: about the mean reflectance of a room."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class PhotoLight:
    """Illumination of a scan's frames, and the scan's own light transport.

    Attributes:
        illuminance: E_old / K at the vertices.
        sources: share of each source in it, with its bounces; the sources' shares add up to it.
        mean: K, the linear value that a white surface in the mean light would have in the frames.
        albedo: of the transport's points.
        transport: between them.
        filled_share: of ambient light, that bounces are filled up to.
    """

    illuminance: Float[Array, "v 3"]
    sources: Float[Array, "s v 3"]
    mean: Float[Array, "3"]
    albedo: Float[Array, "p 3"]
    transport: Transport
    filled_share: float = dataclasses.field(default=FILLED_SHARE, metadata={"static": True})


@jax.jit
def interpolate(
    values: Float[Array, "v c"],
    faces: Int[Array, "f 3"],
    face: Int[Array, "h w"],
    barycentric: Float[Array, "h w 3"],
) -> Float[Array, "h w c"]:
    """Interpolate vertex values at pixels; 0 in holes, whose `face` is -1."""
    corners = faces[jnp.maximum(face, 0)]
    parts = [barycentric[..., k, None] * values[corners[..., k]] for k in range(3)]
    return jnp.where((face >= 0)[..., None], parts[0] + parts[1] + parts[2], 0.0)


def bounced_light(
    photo: PhotoLight,
    lights: Sequence[Light],
    shadow_maps: Sequence[ShadowMap | None] | None = None,
    *,
    run: Run = call,
) -> Float[Array, "v 3"]:
    """Indirect illuminance (lux) of the vertices by way of other surfaces, with the lights' colours.

    Args:
        lights: bounces stand in the place of ambient ones, which fill them up where they give much less.
        run: runs the function of each light, whose program serves other set-ups with a light of its kind.
    """
    maps = (None,) * len(lights) if shadow_maps is None else tuple(shadow_maps)
    pairs = [pair for pair in zip(lights, maps, strict=True) if not pair[0].UNIFORM]
    parts = [bounced_by(photo, *pair, run=run) for pair in pairs] or [jnp.zeros(photo.illuminance.shape)]
    return run(filled_up, parts, _filling(lights), np.float32(photo.filled_share))


def bounced_by(
    photo: PhotoLight, light: Light, shadow_map: ShadowMap | None, *, run: Run = call
) -> Float[Array, "v 3"]:
    """Indirect illuminance of the vertices by one light.

    Outliers are held back for each light alone, so that lights add up. Arguments: see `bounced_light`.
    """
    return run(
        interreflection, photo.transport, photo.albedo, run(direct_light, photo.transport, light, shadow_map)
    )


@jax.jit
def direct_light(transport: Transport, light: Light, shadow_map: ShadowMap | None) -> Float[Array, "p 3"]:
    """Illuminance of the points straight from a light."""
    everywhere = jnp.ones((1, len(transport.position)))
    points = GBuffer(transport.position[None], transport.normal[None], everywhere, everywhere > 0)
    return (shade_each(points, [light]) * visibilities(points, [light], [shadow_map]))[0] * light.color


@jax.jit
def interreflection(
    transport: Transport, albedo: Float[Array, "p 3"], direct: Float[Array, "p 3"]
) -> Float[Array, "v 3"]:
    """Indirect illuminance of the vertices by that of the points, without outliers."""
    return without_outliers(bounce(transport, albedo, direct)[: transport.vertices], transport.faces)


@jax.jit
def filled_up(
    parts: Sequence[Float[Array, "v 3"]], filling: Sequence[Light], filled_share: Float[ArrayLike, ""]
) -> Float[Array, "v 3"]:
    """Sum of the lights' bounces, no less than a share of the ambient lights that fill them up."""
    return jnp.maximum(sum(parts[1:], parts[0]), _filled(filling, filled_share))


def least_bounced(lights: Sequence[Light], filled_share: float = FILLED_SHARE) -> Float[Array, "3"]:
    """Illuminance that bounces are filled up to, a share of ambient lights'; 0 where there are no other lights.

    >>> from hyjax import AmbientLight, PointLight
    >>> lights = [AmbientLight(jnp.float32(100.0), jnp.ones(3)), PointLight(jnp.zeros(3), 900.0, jnp.ones(3))]
    >>> least_bounced(lights).tolist(), least_bounced(lights[:1]).tolist()
    ([25.0, 25.0, 25.0], [0.0, 0.0, 0.0])
    """
    return _filled(_filling(lights), filled_share)


def _filling(lights: Sequence[Light]) -> tuple[Light, ...]:
    """Ambient lights that fill up the bounces of others; none where there are no others."""
    ambient = tuple(light for light in lights if light.UNIFORM)
    return ambient if len(ambient) < len(lights) else ()


def _filled(filling: Sequence[Light], filled_share: Float[ArrayLike, ""]) -> Float[Array, "3"]:
    parts = [jnp.asarray(getattr(light, light.STRENGTH)) * jnp.asarray(light.color) for light in filling]
    return jnp.asarray(filled_share) * sum(parts, jnp.zeros(3))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class SurfaceLight:
    """Light on the vertices of a scan other than the direct light of new lights.

    Attributes:
        photo_light: E_old / K, that the frames were taken under.
        bounced: lux of new lights by way of other surfaces; None to leave it out.
        faces: of the scan.
        emitters: panes and lamps that shine by themselves.
        kept: lux of the photo's own sources that stay on; None where all are off.
    """

    photo_light: Float[Array, "v 3"]
    bounced: Float[Array, "v 3"] | None
    faces: Int[Array, "f 3"]
    emitters: Emitters | None = None
    kept: Float[Array, "v 3"] | None = None

    @functools.cached_property
    def is_even(self) -> bool:
        """Whether the photo's own light is the same everywhere, as where its estimate is not believed."""
        known = concrete(self.photo_light)
        return known is not None and bool(np.ptp(known) < EVEN_RANGE)

    def raised(self, exponent: float) -> "SurfaceLight":
        """Light with the photo's own to a power, and the kept part in proportion: all of it is still the photo."""
        kept = self.kept
        if kept is not None:
            after = jnp.maximum(self.photo_light**exponent, LEAST_PHOTO_LIGHT)  # both as they are divided by
            kept = kept * after / jnp.maximum(self.photo_light, LEAST_PHOTO_LIGHT)
        return dataclasses.replace(self, photo_light=self.photo_light**exponent, kept=kept)


def add_surface_light(shaded: Shaded, light: SurfaceLight, gbuffer: GBuffer, lights: Sequence[Light]) -> Shaded:
    """Add the photo's own light and bounces to a shaded surface.

    Args:
        gbuffer: of the view, with triangles; see `on_pixels` for surfaces outside the scan.
        lights: of the shading; ambient ones are in the bounces, see `bounced_light`, and give no direct light.
    """
    if gbuffer.face is None or gbuffer.barycentric is None:
        raise InputError("surface light: the G-buffer must have the triangle of each pixel, as a mesh's does")
    direct = np.isin(np.arange(len(lights)), direct_channels(lights, light.bounced is not None))
    return _add(shaded, light, gbuffer, jax.device_put(direct))


def direct_channels(lights: Sequence[Light], bounces: bool) -> tuple[int, ...]:
    """Places of the lights that give direct light: bounces stand in for ambient ones beside others."""
    direct = tuple(k for k, light in enumerate(lights) if not (light.UNIFORM and bounces))
    return direct or tuple(range(len(lights)))


@jax.jit
def _add(shaded: Shaded, light: SurfaceLight, gbuffer: GBuffer, direct: Bool[Array, "l"]) -> Shaded:
    illuminance = jnp.where(direct, shaded.illuminance, 0.0)
    photo_light = on_pixels(light.photo_light, light.faces, gbuffer)
    indirect = indirect_on_pixels(light, gbuffer)
    return dataclasses.replace(shaded, illuminance=illuminance, bounced=indirect, photo_light=photo_light)


def indirect_on_pixels(light: SurfaceLight, gbuffer: GBuffer) -> Float[Array, "h w 3"] | None:
    """Bounces and the kept part of the photo's own light at the pixels; None if there is neither."""
    fields = [field for field in (light.bounced, light.kept) if field is not None]
    return on_pixels(sum(fields[1:], fields[0]), light.faces, gbuffer) if fields else None


@jax.jit
def on_pixels(values: Float[Array, "v 3"], faces: Int[Array, "f 3"], gbuffer: GBuffer) -> Float[Array, "h w 3"]:
    """Interpolate light on vertices at the pixels of a view: 0 in holes; its mean on surfaces outside the scan.

    Args:
        gbuffer: with triangles of the scan, -1 where the surface is another's.
    """
    assert gbuffer.face is not None and gbuffer.barycentric is not None
    inside = interpolate(values, faces, gbuffer.face, gbuffer.barycentric)
    foreign = gbuffer.hit & (gbuffer.face < 0)
    return jnp.where(foreign[..., None], jnp.mean(values, axis=0), inside)
