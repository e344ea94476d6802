"""Estimate of the photo's own light of a scan."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import enclose, trace
from hyjax.light.kinds import Aperture
from hyjax.light.photo_light import PhotoLight
from hyjax.light.transport import Transport, bounce, gather, send
from hyjax.photo_light.basis import Basis, make_basis
from hyjax.photo_light.fit import FLOOR, HIGHEST_ALBEDO, FitProblem, fit_sources
from hyjax.photo_light.pairs import coplanar_pairs, held_out
from hyjax.photo_light.radiance import vertex_radiance

PAIRS = 20000
EXPONENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
LEAST_GAIN = 0.04
"""Share by which planes must become flatter on pairs that were not fitted to; below it nothing is divided out."""
LOWEST_ALBEDO = 0.02
VIEW = (48, 64)
VIEWS = 12


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Photo's light of a scan, and what it was found from.

    Attributes:
        light: to relight with.
        exponent: that E_old is raised to: 0 where dividing would do harm, 1 where it is believed.
        flatness: spread of log radiance on planes after the division over that before it, on pairs held out, for
            each of `EXPONENTS`.
        names: of the sources.
        strength: θ of all unknowns.
        source: which source each unknown belongs to.
        seconds: of each step.
    """

    light: PhotoLight
    exponent: float
    flatness: tuple[float, ...]
    names: tuple[str, ...]
    strength: Float[np.ndarray, "k 3"]
    source: Int[np.ndarray, "k"]


def estimate(
    caster: RayCaster,
    frames: Sequence[Frame],
    up: Float[np.ndarray, "3"],
    windows: Sequence[tuple[str, Aperture]] = (),
    lamps: Sequence[tuple[str, Float[np.ndarray, "3"]]] = (),
    progress: bool = False,
) -> Estimate:
    """Photo's light by the frames and the scan alone, see `hyjax.photo_light.fit`.

    Args:
        caster: the scan.
        frames: of the capture, spread over it.
        up: against gravity.
        windows: that the photo's light came through.
        lamps: that were lit.
        progress: show a bar on stderr.
    """
    mesh = caster.mesh
    count = len(mesh.vertices)
    seen = vertex_radiance(caster, frames)
    hits, position, normal = trace(caster, enclose(caster, up), [w for _, w in windows], progress=progress)
    transport = Transport(
        jnp.asarray(hits), jnp.asarray(mesh.faces, jnp.int32), *(jnp.asarray(a, jnp.float32) for a in (position, normal)),
        vertices=count,
    )
    basis = make_basis(caster, hits, position, normal, windows, lamps)
    visible = seen.weight > 0
    scale = np.exp(np.log(np.maximum(seen.radiance[visible], FLOOR)).mean())
    radiance = np.maximum(seen.radiance / scale, FLOOR)
    radiance[~visible] = np.exp(np.log(radiance[visible]).mean(axis=0))
    sent = jnp.asarray(np.concatenate([radiance, np.zeros((len(position) - count, 3))]), jnp.float32)
    gathered = np.asarray(gather(transport.hits, send(transport, sent)))
    pairs = coplanar_pairs(np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals), visible, PAIRS)
    test = held_out(np.asarray(mesh.vertices)[pairs[:, 0]])
    floats = (gathered[:count], basis.light[:count], radiance)
    problem = FitProblem(
        *(jnp.asarray(a, jnp.float32) for a in floats),
        jnp.asarray(visible), jnp.asarray(pairs[~test], jnp.int32), jnp.asarray(basis.neighbours, jnp.int32),
    )
    theta = fit_sources(problem)
    light = gathered + basis.light @ theta
    flatness = _flatness(np.log(radiance), np.log(light[:count] + FLOOR), pairs[test])
    best = int(np.argmin(flatness))
    exponent = EXPONENTS[best] if flatness[best] < 1 - LEAST_GAIN else 0.0
    albedo = np.clip(radiance / np.maximum(light[:count], FLOOR), LOWEST_ALBEDO, HIGHEST_ALBEDO)
    mean = np.exp(np.log(albedo[visible]).mean(axis=0))
    albedo = np.concatenate([albedo, np.broadcast_to(mean, (len(position) - count, 3))])
    divisor = light[:count] ** exponent
    divisor = divisor / _visible_mean(caster, [f.camera for f in frames], divisor)
    return Estimate(
        PhotoLight(jnp.asarray(divisor, jnp.float32), jnp.asarray(albedo, jnp.float32), transport),
        exponent, flatness, basis.names, theta, basis.source,
    )


def _flatness(
    log_radiance: Float[np.ndarray, "v 3"], log_light: Float[np.ndarray, "v 3"], pairs: Int[np.ndarray, "n 2"]
) -> tuple[float, ...]:
    """Mean absolute difference across pairs after dividing by E to each exponent, relative to that before."""
    if not len(pairs):
        return (1.0,) * len(EXPONENTS)
    c, e = (v[pairs[:, 0]] - v[pairs[:, 1]] for v in (log_radiance, log_light))
    spread = [np.abs(c - k * e).mean() for k in EXPONENTS]
    return tuple(float(s / spread[0]) for s in spread)


def _visible_mean(
    caster: RayCaster, cameras: Sequence[Camera], values: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "3"]:
    """Geometric mean of vertex values over what cameras see."""
    total, count = np.zeros(3), 0
    for camera in cameras[:: max(1, len(cameras) // VIEWS)]:
        rays = Camera(camera.intrinsics.resize(*VIEW), camera.pose).rays().reshape(-1, 3)
        hits = caster.cast(camera.origin, rays)
        corners = caster.mesh.faces[hits.face[hits.hit]]
        seen = np.einsum("nk,nkc->nc", hits.barycentric[hits.hit], values[corners])
        total, count = total + np.log(np.maximum(seen, 1e-6)).sum(axis=0), count + len(seen)
    return np.exp(total / max(count, 1))
