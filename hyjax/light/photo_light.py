"""The photo's own light: what lit a scan when its frames were taken, and light that it sends on.

A frame is albedo times the light it was taken under. Dividing by that light leaves what any new light multiplies:

    S = C · (E_direct + E_bounced) / E_old · K

with K the geometric mean of E_old over what is visible, so that light of the reference illuminance leaves the frame's
brightness, and its white balance, as they are. All fields live on the scan's vertices: numerator and denominator share
the mesh's errors, which a sharper denominator would show.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels, shade_each
from hyjax.light.shadow_map import ShadowMap, visibilities
from hyjax.light.transport import Transport, bounce


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class PhotoLight:
    """Light that a scan's frames were taken under.

    Attributes:
        illuminance: E_old / K at the vertices.
        albedo: of the transport's points.
        transport: between them.
    """

    illuminance: Float[Array, "v 3"]
    albedo: Float[Array, "p 3"]
    transport: Transport


@jax.jit
def interpolate(
    values: Float[Array, "v c"], faces: Int[Array, "f 3"], gbuffer: GBuffer
) -> Float[Array, "h w c"]:
    """Values of vertices at the pixels of a G-buffer; 0 in holes."""
    face = jnp.maximum(gbuffer.face, 0)
    corners = faces[face]
    total = sum(gbuffer.barycentric[..., k, None] * values[corners[..., k]] for k in range(3))
    return jnp.where(gbuffer.hit[..., None], total, 0.0)


def bounced_light(
    photo: PhotoLight, lights: Sequence[Light], shadow_maps: Sequence[ShadowMap | None] | None = None
) -> Float[Array, "v 3"]:
    """Lux, with the lights' colours, that reaches the vertices by way of other surfaces.

    Args:
        photo: transport and albedo.
        lights: those that fall on any surface alike are left out: bounces stand in their place.
        shadow_maps: one for each light; None for no shadows.
    """
    maps = (None,) * len(lights) if shadow_maps is None else tuple(shadow_maps)
    chosen = [(light, shadow_map) for light, shadow_map in zip(lights, maps, strict=True) if not light.UNIFORM]
    if not chosen:
        return jnp.zeros_like(photo.illuminance)
    own, maps = zip(*chosen, strict=True)
    return _bounced(photo, own, maps)


@jax.jit
def _bounced(
    photo: PhotoLight, lights: Sequence[Light], shadow_maps: Sequence[ShadowMap | None]
) -> Float[Array, "v 3"]:
    transport = photo.transport
    points = GBuffer(
        transport.position[None],
        transport.normal[None],
        jnp.ones((1, transport.position.shape[0])),
        jnp.ones((1, transport.position.shape[0]), bool),
    )
    each = shade_each(points, lights) * visibilities(points, lights, shadow_maps)
    direct = mix_channels(each, [light.color for light in lights])[0]
    return bounce(transport, photo.albedo, direct)[: transport.vertices]


@jax.jit
def divide_photo_light(
    shaded: Shaded, photo: PhotoLight, bounced: Float[Array, "v 3"], gbuffer: GBuffer, uniform: Bool[Array, "l"]
) -> Shaded:
    """Shaded surface with the light that it was photographed under, and with bounces.

    Args:
        shaded: direct light.
        photo: the photo's own light.
        bounced: see `bounced_light`.
        gbuffer: of the view, with triangles.
        uniform: lights that the bounces stand in for.
    """
    fields = interpolate(jnp.concatenate([bounced, photo.illuminance], axis=-1), photo.transport.faces, gbuffer)
    illuminance = jnp.where(uniform, 0.0, shaded.illuminance)
    return dataclasses.replace(
        shaded, illuminance=illuminance, bounced=fields[..., :3], photo_light=fields[..., 3:]
    )
