"""Estimate of the photo's own light on a scan."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import enclose, trace
from hyjax.light.photo_light import FILLED_SHARE, LEAST_PHOTO_LIGHT, PhotoLight
from hyjax.light.surface_outliers import without_outliers
from hyjax.light.transport import Transport, bounce, gather, send
from hyjax.photo_light.basis import Basis, make_basis
from hyjax.photo_light.belief import LEAST_GAIN, NO_BELIEF, Belief, fit_and_judge, split
from hyjax.photo_light.fit import HIGHEST_ALBEDO, RADIANCE_FLOOR, FitProblem
from hyjax.photo_light.local_belief import Evidence, local_divisor
from hyjax.photo_light.pairs import coplanar_pairs
from hyjax.photo_light.radiance import VertexRadiance, vertex_radiance
from hyjax.photo_light.rim import held_at_rim
from hyjax.photo_light.sources import PhotoSources, PhotoWindow
from hyjax.util.cache import Arrays

PAIR_COUNT = 20000
"""Number of pairs of vertices to draw."""
HUE_TOLERANCE = 0.2
"""Difference of log colour within which two places share one hue."""
LEAST_CONTRAST = 0.05
"""Least range of log radiance; below it the frames are all black, or all white."""
LOWEST_ALBEDO = 0.02
SHARED_LIGHT = 1e-6
"""Light of each source that reaches all vertices."""
WHITE_WALL = 0.75
"""Albedo of painted walls and ceilings."""
PLAIN_ALBEDO = 0.5
"""Albedo of all surfaces where the photo's light is unknown."""
VIEW_SHAPE = (48, 64)
"""Rows and columns of rays of a view for the visible mean."""
VIEW_COUNT = 12
"""Number of views for the visible mean."""


Rays = tuple[Int[np.ndarray, "r p"], Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]
"""Ends of the rays of all points, with positions and normals of these."""


@dataclasses.dataclass(frozen=True)
class Estimate(Belief):
    """Photo's light on a scan, with the belief in it.

    Attributes:
        transport: of the scan, also where nothing is believed and `light` has no bounces.
    """

    light: PhotoLight
    names: tuple[str, ...]
    transport: Transport

    @property
    def reason(self) -> str:
        """Reason for dividing nothing out, in words for the log and the tour; meaningful where `exponent` is 0."""
        if all(f == 1 for f in self.flatness):
            return "frames and scan tell too little of it"
        change = 100 * (1 - min(self.flatness))
        least = 100 * LEAST_GAIN
        doubt = (
            f"less than {least:.0f} %" if change < least else "which may be chance with so few places to compare"
        )
        return f"divided by it, planes come out {change:.0f} % flatter, {doubt}"


def estimate_arrays(
    caster: RayCaster,
    frames: Iterable[Frame],
    up: Float[np.ndarray, "3"],
    sources: PhotoSources,
    progress: bool = False,
    closed: bool = True,
    rays: Rays | None = None,
    expect: Callable[[PhotoLight], None] | None = None,
) -> Arrays:
    """Estimate the photo's light from the frames and the scan alone, as arrays for `read_estimate`.

    The fit is in `hyjax.photo_light.fit`.

    Args:
        sources: windows that the photo's light may have come through, and lamps that may have been lit.
        closed: whether the box round the scan stands for the walls that were not scanned.
        rays: of these windows and this box, where `trace_scan` cast them before.
        expect: takes the shapes of the light that will come of it if it is believed, before the fit.
    """
    cameras: list[Camera] = []

    def read() -> Iterator[Frame]:
        for frame in frames:
            cameras.append(frame.camera)
            yield frame

    # All that needs no frame comes first: they may still be rendered.
    hits, position, normal = rays or trace_scan(caster, up, sources.windows, progress, closed)
    transport, count = _transport(caster, hits, position, normal), len(caster.arrays.vertices)
    basis = make_basis(caster, hits, position, normal, sources, up)
    if expect is not None:
        expect(_shapes(transport, len(basis.names)))
    shown = _shown(vertex_radiance(caster, read()))
    sent = np.concatenate([shown.radiance, np.zeros((len(position) - count, 3))])
    gathered = np.asarray(gather(transport.hits, send(transport, jnp.asarray(sent, jnp.float32))))
    theta, belief, evidence = _fitted(caster, normal[:count], shown, gathered[:count], basis)
    light = np.maximum(gathered + basis.light @ theta, RADIANCE_FLOOR)
    even = without_outliers(jnp.asarray(light[:count], jnp.float32), transport.faces)
    light[:count] = held_at_rim(np.asarray(even, np.float64), position[:count], normal[:count], caster.arrays.faces)
    exponent, log_light = belief.exponent, split(np.log(light[:count]))
    albedo, unscanned = _albedo(shown, light, believed=exponent > 0)
    divisor = local_divisor(caster.arrays, normal[:count], log_light, belief, evidence)
    illuminance = np.maximum(divisor / _visible_mean(caster, cameras, divisor), LEAST_PHOTO_LIGHT)
    direct = _direct_by_source(basis, theta, light, unscanned, count)
    shares = _shares(transport, *(jnp.asarray(a, jnp.float32) for a in (albedo, direct, illuminance)))
    arrays = {
        "illuminance": illuminance,
        "mean": shown.scale * _visible_mean(caster, cameras, light[:count]),
        "albedo": albedo,
        "sources": np.asarray(shares),
        "position": position,
        "normal": normal,
    }
    return {name: value.astype(np.float32) for name, value in arrays.items()} | {
        "hits": hits,
        "names": np.array(basis.names),
        "exponent": np.array(exponent),
        "hue_exponent": np.array(belief.hue_exponent),
        "flatness": np.array(belief.flatness),
    }


def read_estimate(caster: RayCaster, arrays: Arrays) -> Estimate:
    """Estimate from the arrays of `estimate_arrays`.

    Where nothing is believed no light bounces and all ambient light is left, as where the photo's light is kept.
    """
    exponent, position = float(arrays["exponent"]), arrays["position"]
    transport = used = _transport(caster, arrays["hits"], position, arrays["normal"])
    if exponent == 0:  # every ray ends in an opening
        hits = np.full((1, len(position)), transport.opening, np.int32)
        used = dataclasses.replace(transport, hits=jax.device_put(hits))
    parts = ("illuminance", "sources", "mean", "albedo")
    illuminance, shares, mean, albedo = (jax.device_put(arrays[name]) for name in parts)
    names = tuple(str(name) for name in arrays["names"])
    flatness = tuple(float(x) for x in arrays["flatness"])
    light = PhotoLight(illuminance, shares, mean, albedo, used, filled_share(transport) if exponent else 1.0)
    return Estimate(exponent, float(arrays["hue_exponent"]), flatness, light, names, transport)


@dataclasses.dataclass(frozen=True)
class _Shown:
    """Radiance of the vertices in the frames.

    Attributes:
        visible: whether a frame shows it.
        radiance: relative to `scale`; the mean of the visible ones elsewhere.
        scale: linear value of the pictures.
    """

    visible: Bool[np.ndarray, "v"]
    radiance: Float[np.ndarray, "v 3"]
    scale: float


def _shown(seen: VertexRadiance) -> _Shown:
    visible = (seen.weight > 0) & np.isfinite(seen.radiance).all(axis=1)
    scale = float(_log_mean(seen.radiance[visible]).mean())
    radiance = np.where(visible[:, None], np.maximum(seen.radiance / scale, RADIANCE_FLOOR), 1.0)
    radiance[~visible] = _log_mean(radiance[visible])
    return _Shown(visible, radiance, scale)


def trace_scan(
    caster: RayCaster,
    up: Float[np.ndarray, "3"],
    windows: Sequence[PhotoWindow],
    progress: bool = False,
    closed: bool = True,
) -> Rays:
    """Ends of all rays, see `trace`; a ray that leaves a scan that is not `closed` has none."""
    apertures = [window.aperture for window in windows]
    hits, position, normal = trace(caster, enclose(caster, up), apertures, progress=progress)
    if not closed:
        nowhere = len(caster.mesh.faces) + len(position) - len(caster.mesh.vertices)
        hits = np.where(hits < len(caster.mesh.faces), hits, nowhere).astype(np.int32)
    return hits, position, normal


def _fitted(
    caster: RayCaster,
    normal: Float[np.ndarray, "v 3"],
    shown: _Shown,
    gathered: Float[np.ndarray, "v 3"],
    basis: Basis,
) -> tuple[Float[np.ndarray, "k 3"], Belief, Evidence]:
    """Fitted strength of each source of the basis, the belief in it, and the evidence for that.

    All are 1, and nothing is believed, where the scan and the frames tell too little.
    """
    vertices, count = np.asarray(caster.mesh.vertices), len(normal)
    nothing = np.full((basis.light.shape[1], 3), 1.0), NO_BELIEF, None
    log_radiance = np.log(shown.radiance)
    if not shown.visible.any() or np.ptp(log_radiance[shown.visible]) <= LEAST_CONTRAST:
        return nothing
    pairs, hue = coplanar_pairs(vertices, normal, shown.visible, PAIR_COUNT), split(log_radiance)[1]
    # Albedo changes with hue.
    pairs = pairs[np.abs(hue[pairs[:, 0]] - hue[pairs[:, 1]]).max(axis=1) < HUE_TOLERANCE]
    known = (gathered, basis.light[:count], log_radiance)
    gathered_here, light, radiance = (jax.device_put(np.ascontiguousarray(a.T, np.float32)) for a in known)
    seen, alike = jnp.asarray(shown.visible), jnp.asarray(basis.neighbours, jnp.int32)
    chosen = jnp.asarray(pairs, jnp.int32)

    def problem(fitted: Bool[np.ndarray, "n"]) -> FitProblem:
        return FitProblem(gathered_here, light, radiance, seen, chosen, jax.device_put(fitted), alike)

    judged = fit_and_judge(problem, pairs, vertices)
    return nothing if judged is None else (*judged[:2], (pairs, judged[2]))


def _albedo(
    shown: _Shown, light: Float[np.ndarray, "p 3"], believed: bool
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "3"]]:
    """Albedo of all points: plain where the light is not believed, a wall's where nothing was scanned."""
    count = len(shown.radiance)
    albedo = np.clip(shown.radiance / light[:count], LOWEST_ALBEDO, HIGHEST_ALBEDO)
    if not believed:
        albedo[:] = PLAIN_ALBEDO
    mean = _log_mean(albedo[shown.visible]) if shown.visible.any() else np.full(3, PLAIN_ALBEDO)
    # What was not scanned is often the ceiling and white walls: half way between them and what was.
    unscanned = np.sqrt(mean * WHITE_WALL)
    return np.concatenate([albedo, np.broadcast_to(unscanned, (len(light) - count, 3))]), unscanned


def _shapes(transport: Transport, sources: int) -> PhotoLight:
    """Shapes of a light in the place of its arrays."""
    shapes = (transport.vertices, 3), (sources, transport.vertices, 3), (3,), transport.position.shape
    light, shares, mean, albedo = (cast(Any, jax.ShapeDtypeStruct(shape, np.float32)) for shape in shapes)
    paths = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), transport)
    return PhotoLight(light, shares, mean, albedo, paths, filled_share(transport))


def filled_share(transport: Transport) -> float:
    """Share of ambient light that bounces are filled up to: at least that of the scan's rays that end on the box.

    The new light of the box is unknown. In whole hundredths.
    """
    hits = np.asarray(transport.hits)[:, : transport.vertices]
    unscanned = ((hits >= len(transport.faces)) & (hits < transport.opening)).mean()
    return max(FILLED_SHARE, round(float(unscanned), 2))


def _transport(caster: RayCaster, hits: np.ndarray, position: np.ndarray, normal: np.ndarray) -> Transport:
    # Converted by NumPy: every conversion of JAX's is a program of its own.
    parts = (np.asarray(a, np.float32) for a in (position, normal))
    faces, place, facing = map(jax.device_put, (np.asarray(caster.arrays.faces, np.int32), *parts))
    return Transport(jax.device_put(hits), faces, place, facing, len(caster.arrays.vertices))


def _direct_by_source(
    basis: Basis, theta: np.ndarray, light: np.ndarray, wall_albedo: np.ndarray, vertices: int
) -> Float[np.ndarray, "s p 3"]:
    """Direct light of each source; unscanned walls count by their light beyond reflections."""
    first = theta.shape[0] - (len(light) - vertices)
    emitted = theta.copy()
    emitted[first:] = np.maximum(theta[first:] - wall_albedo * light[vertices:], 0.0)
    numbers = range(len(basis.names))
    return np.stack([basis.light[:, basis.source == k] @ emitted[basis.source == k] for k in numbers])


@jax.jit
def _shares(
    transport: Transport, albedo: Float[Array, "p 3"], direct: Float[Array, "s p 3"], total: Float[Array, "v 3"]
) -> Float[Array, "s v 3"]:
    """Share of each source in the light of the photo, with its bounces."""
    count = direct.shape[0]
    channels = jnp.moveaxis(direct, 0, 1).reshape(direct.shape[1], -1)
    light = channels + bounce(transport, albedo, channels)
    by_source = jnp.moveaxis(light[: transport.vertices].reshape(-1, count, 3), 1, 0)
    by_source += SHARED_LIGHT  # evenly where none reaches
    return total * by_source / jnp.sum(by_source, axis=0)


def _log_mean(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Geometric mean; 1 without values."""
    return np.exp(np.log(np.maximum(values, RADIANCE_FLOOR)).mean(axis=0)) if len(values) else np.ones(3)


def _visible_mean(
    caster: RayCaster, cameras: Sequence[Camera], values: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "3"]:
    """Geometric mean of vertex values over the pixels of the cameras."""
    total, count = np.zeros(3), 0
    for camera in cameras[:: max(1, len(cameras) // VIEW_COUNT)]:
        rays = Camera(camera.intrinsics.resize(*VIEW_SHAPE), camera.pose).rays().reshape(-1, 3)
        hits = caster.cast(camera.origin, rays)
        corners = caster.mesh.faces[hits.face[hits.hit]]
        seen = np.einsum("nk,nkc->nc", hits.barycentric[hits.hit], values[corners])
        total, count = total + np.log(np.maximum(seen, 1e-6)).sum(axis=0), count + len(seen)
    return np.exp(total / max(count, 1))
