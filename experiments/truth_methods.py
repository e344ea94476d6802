"""Methods that `experiments.truth` compares, from the untouched photo to oracles."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments import peers
from experiments.paper_view import with_kappa
from experiments.peers_report import SMOOTHER
from experiments.truth_bench import TruthBench
from experiments.truth_camera import Exposed, camera_response, exposed_light
from hyjax.core.refine import cascade_known
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.guide.edge_weights import edge_weights
from hyjax.light.photo_light import EVEN_RANGE, LEAST_PHOTO_LIGHT, SurfaceLight
from hyjax.light.relit import Relit, compared, filter_and_light, relit_picture
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.light.view import View
from hyjax.pipeline import refine_visibility, relight

PHOTO, BARE, MEAN, PAPER = "untouched photo", "bare mesh", "mean colour", "paper's method"
OPENCV, TODAY = "OpenCV's global smoother", "hyjax 0.1"
SHADOWS, SHINING, BOUNCES, DIVIDED = "0.1 + completed shadows", "0.1 + what shines", "0.1 + bounces", "0.1 / E_old"
BOTH, NEW = "0.1 / E_old + bounces", "hyjax, all together"
UNCLOSED, UNNAMED = "all, scan not closed by a box", "all, sources not told"
BLURRED = "all but light edges"
TRUE_LIGHT, TRUE_BOUNCES = "all, true E_old", "all, true bounces"
TRUE_BOTH, TRUE_SHADOWS, RESPONSE = "all, true E_old and bounces", "all, true visibility", "all, true response"
TRUE_MESH = "0.1, true mesh"
TRUE_ALL, TRUE_ALL_RESPONSE = "true mesh, E_old and light", "true mesh, E_old, light and response"
METHODS = (
    PHOTO, BARE, MEAN, PAPER, OPENCV, TODAY, SHADOWS, SHINING, BOUNCES, DIVIDED, BOTH, BLURRED, NEW, UNCLOSED,
    UNNAMED, TRUE_LIGHT, TRUE_BOUNCES, TRUE_BOTH, TRUE_SHADOWS, RESPONSE, TRUE_MESH, TRUE_ALL,
    TRUE_ALL_RESPONSE,
)  # fmt: skip
ORACLES = METHODS[METHODS.index(TRUE_LIGHT) :]
"""Oracles: methods that are given a part of the truth."""
COMPLETED = {SHADOWS, BLURRED, NEW, UNCLOSED, UNNAMED, TRUE_LIGHT, TRUE_BOUNCES, TRUE_BOTH, RESPONSE}
"""Methods whose shadows the completed scan throws, and that soften them as `Scene` does; others keep them sharp."""
EDGED = {NEW, UNCLOSED, UNNAMED, TRUE_BOUNCES, TRUE_SHADOWS, RESPONSE}
"""Methods whose estimate of E_old follows the light edges of the photo."""
OURS, THEIRS = Schedule.preset("hyjax"), with_kappa(Schedule.preset("paper-80"), PAPER_KAPPA)
SHARP = Schedule.preset("hyjax-shadow")
SMOOTHER_OPTION = (0.2, 1000.0)
"""Strength and reach of OpenCV's smoother, see `peers.opencv_filters`; chosen in the room builtin-0."""


class LitBench:
    """A room's scan under one set-up: `pictures` of each frame.

    Args:
        bench: of the room.
        name: of the set-up.
    """

    def __init__(self, bench: TruthBench, name: str) -> None:
        self.bench, self.scene, scene = bench, bench.scene, bench.scene
        self.setup = scene.lights(name)
        bare = scene.surface_light(self.setup, occluders="surface")
        self.bare_light = dataclasses.replace(bare, emitters=None)
        self.unclosed = bench.unclosed_light(self.setup)
        self.unnamed = bench.unnamed.photo_light.surface_light(self.setup, scene.shadow_maps(self.setup))
        self.light = scene.surface_light(self.setup)  # the last asked for, so that the scene keeps it
        self.true_bounces = (np.pi * bench.at_vertices(self.setup)[1]).astype(np.float32)

    def truth(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """Picture that the camera would see, display values."""
        return self.bench.capture.truth(self.setup, [index])[0]

    def bounce_ratio(self) -> float:
        """Median of estimated over true light of bounces where it is not dim, geometric mean of its channels."""
        own, true = np.asarray(self.light.bounced), self.true_bounces
        bright = true.mean(axis=1) > 0.2 * true.mean()
        ratio = np.median(np.log(np.maximum(own[bright], 1e-6) / np.maximum(true[bright], 1e-6)), axis=0)
        return float(np.exp(ratio.mean()))

    def pictures(self, index: int) -> dict[str, Exposed]:
        """Method → picture of a frame."""
        view, scene, setup = self.scene.view(index), self.scene, self.setup
        exposed = dataclasses.replace(view, frame=jnp.asarray(exposed_light(np.asarray(view.display))))
        today = scene.shade(view, setup, keep_photo_light=True, occluders="surface")
        both = view.shade(
            setup, shadow_maps=scene.shadow_maps(setup, occluders="surface"), surface_light=self.bare_light
        )
        new, true = scene.shade(view, setup), self._true(view, index)
        shaded = {
            TODAY: today,
            SHADOWS: dataclasses.replace(today, visibility=new.visibility),
            SHINING: dataclasses.replace(today, emission=new.emission),
            BOUNCES: dataclasses.replace(both, photo_light=None),
            DIVIDED: dataclasses.replace(today, photo_light=both.photo_light),
            BOTH: both,
            BLURRED: new,
            NEW: new,
            UNCLOSED: self._shade(view, self.unclosed),
            UNNAMED: self._shade(view, self.unnamed),
            TRUE_LIGHT: self._shade(view, self._light_with(photo_light=self.bench.true_light)),
            TRUE_BOUNCES: self._shade(view, self._light_with(bounced=self.true_bounces)),
            TRUE_BOTH: self._shade(view, self._light_with(self.bench.true_light, self.true_bounces)),
            TRUE_SHADOWS: dataclasses.replace(new, visibility=true.shaded.visibility),
        }
        relit = {name: _relight(view, own, name) for name, own in shaded.items()}
        paper = relight(view, today, view.display, THEIRS, mode="paper").image
        made = {name: own.image for name, own in relit.items()} | {
            PHOTO: view.frame,
            BARE: relit[TODAY].unrefined,
            MEAN: view.frame * _mean_filter(today, view),
            PAPER: paper,
            TRUE_MESH: _relight(true.view, true.shaded, TRUE_MESH).image,
            TRUE_ALL: true.relit(view, new),
        }
        if (smoothed := _smoothed(view, today)) is not None:
            made[OPENCV] = smoothed.image
        responding = scene.shade(exposed, setup)
        responded = {
            RESPONSE: _relight(exposed, responding, RESPONSE).image,
            TRUE_ALL_RESPONSE: true.relit(exposed, responding),
        }
        pictures = {name: Exposed(np.asarray(image)) for name, image in made.items()}
        pictures |= {name: Exposed(np.asarray(image), camera_response) for name, image in responded.items()}
        return {name: pictures[name] for name in METHODS if name in pictures}

    def _shade(self, view: View, light: SurfaceLight) -> Shaded:
        return view.shade(self.setup, shadow_maps=self.scene.shadow_maps(self.setup), surface_light=light)

    def _light_with(self, photo_light: np.ndarray | None = None, bounced: np.ndarray | None = None) -> SurfaceLight:
        """Light on the vertices, with some of its fields replaced."""
        light = self.light
        fields = {"photo_light": photo_light, "bounced": bounced}
        for name, value in fields.items():
            if value is not None:
                light = dataclasses.replace(light, **{name: jnp.asarray(value)})  # type: ignore[arg-type]
        return light

    def _true(self, view: View, index: int) -> "TrueView":
        """G-buffer of the true mesh in a frame, and the true light on it, pixel by pixel."""
        seen = self.bench.capture.room.caster.gbuffer(self.scene.frame(index).camera)
        own, hit = View.of(view.display, seen), np.asarray(seen.hit)
        points, normals = (np.asarray(x, np.float64)[hit] for x in (seen.position, seen.normal))
        old, new = (sum(self.bench.irradiance(setup, points, normals)) for setup in (None, self.setup))
        relative = np.maximum(old / self.bench.capture.mean_light, LEAST_PHOTO_LIGHT)
        light = np.zeros((*hit.shape, 6), np.float32)
        light[hit, :3] = np.pi * new / float(self.setup.reference_lux)
        light[hit, 3:] = light[hit, :3] / relative
        filled = cascade_known(jnp.asarray(light), seen.hit[..., None], view.display, OURS)
        light = np.where(hit[..., None], light, np.asarray(filled))
        visibility = np.ones((*hit.shape, len(self.setup.lights)), np.float32)
        visibility[hit] = self.bench.visibility(self.setup, points, normals)
        shaded = dataclasses.replace(own.shade(self.setup), visibility=jnp.asarray(visibility))
        return TrueView(own, shaded, light[..., :3], light[..., 3:])


@dataclasses.dataclass(frozen=True)
class TrueView:
    """The true mesh in a frame.

    Attributes:
        view: with it.
        shaded: by the set-up.
        light: true new light over the reference illuminance.
        relight_filter: that over the photo's true light.
    """

    view: View
    shaded: Shaded
    light: Float[np.ndarray, "h w 3"]
    relight_filter: Float[np.ndarray, "h w 3"]

    def relit(self, view: View, shaded: Shaded) -> Float[np.ndarray, "h w 3"]:
        """The frame times the true filter, with the light sources in view as in `shaded`."""
        image, source = np.asarray(view.frame) * self.relight_filter, shaded.emission
        if source is None:
            return image
        shining = np.asarray(source.sent) + np.asarray(source.reflectance) * self.light
        return image + np.asarray(source.weight) * (shining - image)


def _relight(view: View, shaded: Shaded, method: str) -> Relit:
    shadows = None if method in COMPLETED else SHARP
    even = shaded.photo_light is None or float(jnp.ptp(shaded.photo_light)) < EVEN_RANGE
    edges = edge_weights() if method in EDGED and not even else None
    return relight(view, shaded, view.display, OURS, shadow_schedule=shadows, light_edges=edges)


def _mean_filter(shaded: Shaded, view: View) -> Float[np.ndarray, "3"]:
    """Mean of the raw filter with its shadows, where the mesh has a surface."""
    each = shaded.illuminance * shaded.visibility
    raw = np.asarray(mix_channels(each, shaded.colors) / shaded.reference_lux)
    hit = np.asarray(view.gbuffer.hit)
    return raw[hit].mean(axis=0) if hit.any() else np.ones(3, np.float32)


def _smoothed(view: View, shaded: Shaded) -> Relit | None:
    """OpenCV's global smoother in the cascade's place; None without it."""
    filters = peers.opencv_filters(np.asarray(view.display))
    if SMOOTHER not in filters:
        return None
    smooth, known = filters[SMOOTHER][0], np.asarray(shaded.confidence)
    weighted = np.concatenate([np.asarray(shaded.illuminance) * known, known], axis=-1).astype(np.float32)
    channels = [smooth(np.ascontiguousarray(each), *SMOOTHER_OPTION) for each in np.moveaxis(weighted, -1, 0)]
    illuminance = np.stack(channels[:-1], axis=-1) / np.maximum(channels[-1], 1e-3)[..., None]
    visibility = refine_visibility(shaded, view.display, SHARP)
    refined, kappa = (shaded, jnp.asarray(illuminance), visibility), OURS.levels[-1].kappa
    picture = relit_picture(view, *filter_and_light(*refined), shaded.emission, kappa)
    return compared(view, *refined, picture, kappa)
