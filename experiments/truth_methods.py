"""Methods that `experiments.truth` compares, from the untouched photo to what nobody can know."""

import copy
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments import peers
from experiments.paper_bench import with_kappa
from experiments.peers_report import SMOOTHER
from experiments.truth_camera import Exposed, camera_response, exposed_light
from hyjax.core.refine import cascade_known
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.data.truth_room import TruthCapture, load_truth_room
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.photo_light import PhotoLight, SurfaceLight, bounced_light
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.photo_light.estimate import estimate_arrays, read_estimate
from hyjax.photo_light.sources import named_sources
from hyjax.pipeline import LEAST_PHOTO_LIGHT, Relit, composite_linear, refine_visibility, relight
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.cache import cache_folder, cached_arrays
from hyjax.util.files import digest

PHOTO, BARE, MEAN, PAPER = "untouched photo", "bare mesh", "mean colour", "paper's method"
TODAY, OPENCV = "photo's light kept", "OpenCV's global smoother"
BOUNCES, DIVIDED, NEW = "+ bounces", "/ E_old", "/ E_old + bounces"
OPEN, BLIND = "scan not closed by a box", "sources not named"
TRUE_BOUNCES, TRUE_LIGHT, TRUE_BOTH = "true bounces", "true E_old", "true E_old and bounces"
TRUE_SHADOWS, RESPONSE, TRUE_MESH = "true visibility", "true response", f"{TODAY}, true mesh"
TRUE_ALL, TRUE_ALL_RESPONSE = "true mesh, E_old and new light", "… and true response"
METHODS = (
    PHOTO, BARE, MEAN, PAPER, OPENCV, TODAY, BOUNCES, DIVIDED, NEW, OPEN, BLIND, TRUE_BOUNCES, TRUE_LIGHT,
    TRUE_BOTH, TRUE_SHADOWS, RESPONSE, TRUE_MESH, TRUE_ALL, TRUE_ALL_RESPONSE,
)  # fmt: skip
ORACLES = METHODS[METHODS.index(TRUE_BOUNCES) :]
"""Methods that are told something; those in its middle are `NEW` but for what they are told."""
OURS, THEIRS = Schedule.preset("hyjax"), with_kappa(Schedule.preset("paper-80"), PAPER_KAPPA)
SMOOTHER_OPTION = (0.05, 100.0)
"""Strength and reach of OpenCV's smoother, the best of `peers.opencv_filters` in the room builtin-0."""
DARKEST = 1e-3
"""Share of the mean light that no place is darker than in the truth that is divided by."""


class TruthBench:
    """A room of known truth, its scan, and all methods on it.

    Args:
        name: of the room.
        photos: along the walk.
        size: width and height of the pictures.
        quality: of the room's light and textures.
    """

    def __init__(self, name: str, photos: int, size: tuple[int, int], quality: float) -> None:
        self.capture: TruthCapture = load_truth_room(name, photos, *size, quality=quality)
        self.scene = Scene.open(SceneSettings(), capture=self.capture)

    # ---- the photo's own light ----

    @property
    def light(self) -> PhotoLight:
        """Estimate that `Scene.shade` uses."""
        return self.scene.photo_light.light

    @functools.cached_property
    def blind_light(self) -> PhotoLight:
        """Estimate without the windows and lamps that the capture knows."""
        unnamed = copy.copy(self.capture)
        unnamed.anchors = {}
        return Scene(unnamed, self.scene.mesh).photo_light.light

    @functools.cached_property
    def open_light(self) -> PhotoLight:
        """Estimate where nothing comes from beyond the scan but by the named sources."""
        scene, (windows, lamps) = self.scene, named_sources(self.capture)
        key = digest([self.capture.fingerprint, f"{windows} {lamps}", str(len(scene.mesh.vertices))])
        estimate = cached_arrays(
            cache_folder() / f"open-photo-light-{key}.npz",
            lambda arrays: read_estimate(scene.caster, arrays),
            lambda: estimate_arrays(
                scene.caster,
                (scene.frame(i) for i in range(len(scene))),
                np.asarray(self.capture.up, np.float64),
                windows,
                lamps,
                closed=False,
            ),
        )
        return estimate.light

    @functools.cached_property
    def true_light(self) -> Float[np.ndarray, "v 3"]:
        """E_old / K at the vertices of the scan."""
        direct, bounce = self._at_vertices(None)
        return (_lifted(direct + bounce) / self.capture.mean_light).astype(np.float32)

    def light_errors(self) -> dict[str, list[float]]:
        """Median and 90 % quantile of |log E_old / true E_old| at the vertices, of each estimate."""
        true = np.log(np.maximum(self.true_light, LEAST_PHOTO_LIGHT))
        found = {"even light": jnp.ones(3), NEW: self.light.illuminance, OPEN: self.open_light.illuminance}
        found[BLIND] = self.blind_light.illuminance
        return {
            name: np.quantile(np.abs(np.log(np.maximum(light, LEAST_PHOTO_LIGHT)) - true), [0.5, 0.9]).tolist()
            for name, light in found.items()
        }

    def estimate_row(self) -> dict[str, Any]:
        """What the estimate says of itself, for the record."""
        estimate = self.scene.photo_light
        return {"exponent": estimate.exponent, "flatness": estimate.flatness, "sources": estimate.names}

    def _at_vertices(self, setup: LightSetup | None) -> tuple[np.ndarray, np.ndarray]:
        """True (direct, bounced) irradiance / π, of a set-up or of the photo's light."""
        mesh = self.scene.mesh
        return self._true(setup, np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals))

    def _true(self, setup: LightSetup | None, points: np.ndarray, normals: np.ndarray) -> tuple:
        light = self.capture.photo_light() if setup is None else self.capture.light(setup)
        return self.capture.room.irradiance(light, points, normals)

    def check(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """A frame rendered again under the photo's own light; its noise is another frame's."""
        camera, noise = self.capture[index].camera, index + len(self.capture)
        return self.capture.room.photograph(self.capture.photo_light(), camera, noise, self.capture.exposure)[0]


class LitBench:
    """A room's scan under one set-up: `pictures` of each frame.

    Args:
        bench: of the room.
        name: of the set-up.
    """

    def __init__(self, bench: TruthBench, name: str) -> None:
        self.bench, self.scene = bench, bench.scene
        self.setup = bench.scene.lights(name)
        self.true_maps = cast_shadow_maps(bench.capture.room.caster, self.setup.lights)
        self.true_bounces = np.pi * bench._at_vertices(self.setup)[1].astype(np.float32)

    def truth(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """What the camera would see, display values."""
        return self.bench.capture.truth(self.setup, [index])[0]

    def bounce_ratio(self) -> float:
        """Median of estimated over true light of bounces where it is not dim, geometric mean of its channels."""
        own, true = np.asarray(self._surface_light().bounced), self.true_bounces
        bright = true.mean(axis=1) > 0.2 * true.mean()
        ratio = np.median(np.log(np.maximum(own[bright], 1e-6) / np.maximum(true[bright], 1e-6)), axis=0)
        return float(np.exp(ratio.mean()))

    def pictures(self, index: int) -> dict[str, Exposed]:
        """Method → picture of a frame."""
        view, bench = self.scene.view(index), self.bench
        today = self.scene.shade(view, self.setup, keep_photo_light=True)
        new = self.scene.shade(view, self.setup)
        kept, full = _relight(view, today), _relight(view, new)
        shaded = {
            BOUNCES: dataclasses.replace(new, photo_light=None),
            DIVIDED: dataclasses.replace(today, photo_light=new.photo_light),
            OPEN: self._shade(view, self._estimated(bench.open_light)),
            BLIND: self._shade(view, self._estimated(bench.blind_light)),
            TRUE_BOUNCES: self._shade(view, self._surface_light(bounced=self.true_bounces)),
            TRUE_LIGHT: self._shade(view, self._surface_light(bench.true_light)),
            TRUE_BOTH: self._shade(view, self._surface_light(bench.true_light, self.true_bounces)),
            TRUE_SHADOWS: self._shade(view, self._surface_light(), self.true_maps),
        }
        photo, filters = np.asarray(view.frame), self._true_filters(view, index)
        made = {
            PHOTO: photo,
            BARE: kept.unrefined,
            MEAN: photo * _mean_filter(today, view),
            PAPER: relight(view, today, view.display, THEIRS, mode="paper").image,
            TODAY: kept.image,
            NEW: full.image,
            TRUE_MESH: _relight(filters.view, filters.shaded).image,
            TRUE_ALL: photo * filters.everything,
        } | {name: _relight(view, own).image for name, own in shaded.items()}
        if (smoothed := _smoothed(view, today)) is not None:
            made[OPENCV] = smoothed.image
        light = exposed_light(np.asarray(view.display))
        told = {RESPONSE: full.relight_filter, TRUE_ALL_RESPONSE: filters.everything}
        exposed = {name: Exposed(np.asarray(image)) for name, image in made.items()}
        exposed |= {name: Exposed(light * np.asarray(f), camera_response) for name, f in told.items()}
        return {name: exposed[name] for name in METHODS if name in exposed}

    def _shade(self, view: View, light: SurfaceLight, maps: Sequence[ShadowMap | None] | None = None) -> Shaded:
        maps = self.scene.shadow_maps(self.setup) if maps is None else maps
        return view.shade(self.setup, shadow_maps=maps, surface_light=light)

    def _surface_light(
        self, photo_light: np.ndarray | None = None, bounced: np.ndarray | None = None
    ) -> SurfaceLight:
        """That of `Scene.shade`, but for what is told."""
        own = self.scene.surface_light(self.setup)
        told = {"photo_light": photo_light, "bounced": bounced}
        return dataclasses.replace(own, **{k: jnp.asarray(v) for k, v in told.items() if v is not None})

    def _estimated(self, light: PhotoLight) -> SurfaceLight:
        bounced = bounced_light(light, self.setup.lights, self.scene.shadow_maps(self.setup))
        return SurfaceLight(light.illuminance, bounced, light.transport.faces)

    def _true_filters(self, view: View, index: int) -> "TrueFilters":
        """What a perfect mesh tells, and perfect light on it, pixel by pixel."""
        room, camera = self.bench.capture.room, self.scene.frame(index).camera
        seen = room.caster.gbuffer(camera)
        own = View.of(view.display, seen)
        hit = np.asarray(seen.hit)
        places = (np.asarray(x, np.float64)[hit] for x in (seen.position, seen.normal))
        points, normals = places
        old, new = (sum(self.bench._true(setup, points, normals)) for setup in (None, self.setup))
        relative = np.maximum(old / self.bench.capture.mean_light, LEAST_PHOTO_LIGHT)
        raw = np.zeros((*hit.shape, 3), np.float32)
        raw[hit] = np.pi * new / self.setup.reference_lux / relative
        filled = cascade_known(jnp.asarray(raw), seen.hit[..., None], view.display, OURS)
        everything = np.where(hit[..., None], raw, np.asarray(filled))
        return TrueFilters(own, own.shade(self.setup, shadow_maps=self.true_maps), everything)


@dataclasses.dataclass(frozen=True)
class TrueFilters:
    """The true mesh in a frame.

    Attributes:
        view: with it.
        shaded: by the set-up.
        everything: relight filter of the true light, old and new.
    """

    view: View
    shaded: Shaded
    everything: Float[np.ndarray, "h w 3"]


def _relight(view: View, shaded: Shaded) -> Relit:
    return relight(view, shaded, view.display, OURS)


def _mean_filter(shaded: Shaded, view: View) -> Float[np.ndarray, "3"]:
    """Mean of the raw filter with its shadows, where the mesh has a surface."""
    each = shaded.illuminance * shaded.visibility
    raw = np.asarray(mix_channels(each, shaded.colors)) / float(shaded.reference_lux)
    hit = np.asarray(view.gbuffer.hit)
    return raw[hit].mean(axis=0) if hit.any() else np.ones(3, np.float32)


def _smoothed(view: View, shaded: Shaded) -> Relit | None:
    """OpenCV's global smoother in the cascade's place; None without it."""
    filters = peers.opencv_filters(np.asarray(view.display))
    if SMOOTHER not in filters:
        return None
    smooth, known = filters[SMOOTHER][0], np.asarray(shaded.confidence)
    weighted = np.concatenate([np.asarray(shaded.illuminance) * known, known], axis=-1).astype(np.float32)
    channels = [smooth(np.ascontiguousarray(weighted[..., k]), *SMOOTHER_OPTION) for k in range(weighted.shape[-1])]
    illuminance = np.stack(channels[:-1], axis=-1) / np.maximum(channels[-1], 1e-3)[..., None]
    visibility = refine_visibility(shaded, view.display, Schedule.preset("hyjax-shadow"))
    return composite_linear(view.frame, shaded, jnp.asarray(illuminance), visibility)


def _lifted(light: np.ndarray) -> np.ndarray:
    return np.maximum(light, DARKEST * light.mean())
