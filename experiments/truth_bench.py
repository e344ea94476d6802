"""A room of known truth with its scan, and the photo's own light: estimated in several ways, and true."""

import copy
import dataclasses
import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.data.truth_room import TruthCapture, load_truth_room
from hyjax.light.photo_light import LEAST_PHOTO_LIGHT, SurfaceLight, bounced_light
from hyjax.light.setup import LightSetup
from hyjax.photo_light.estimate import Estimate, estimate_arrays, read_estimate
from hyjax.scene.photo_light import VERSION
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.synthetic.truth.source import direct, unshadowed
from hyjax.util.cache import cache_folder, cached_arrays
from hyjax.util.files import digest

DARKEST_SHARE = 1e-3
"""Share of the mean light that no place is darker than in the truth that is divided by."""

SHADOW_RAYS = 8
"""Rays to each light from each pixel."""


class TruthBench:
    """A room of known truth and its scan.

    Args:
        name: of the room.
        photos: along the walk.
        size: width and height of the pictures.
        quality: of the room's light and textures.
    """

    def __init__(self, name: str, photos: int, size: tuple[int, int], quality: float) -> None:
        self.capture: TruthCapture = load_truth_room(name, photos, *size, quality=quality)
        self.scene = Scene.open(SceneSettings(), capture=self.capture)

    @functools.cached_property
    def unnamed(self) -> Scene:
        """The scene without the windows and lamps that the capture knows: they are searched for."""
        capture = copy.copy(self.capture)
        capture.anchors = {}
        return Scene(capture, self.scene.mesh)

    @functools.cached_property
    def unclosed(self) -> Estimate:
        """Estimate where nothing comes from beyond the scan but by the named sources."""
        scene, sources = self.scene, self.scene.photo_light.sources
        key = digest([self.capture.fingerprint, repr(sources), str(len(scene.mesh.vertices))])
        return cached_arrays(
            cache_folder() / f"unclosed-photo-light-v{VERSION}-{key}.npz",
            lambda arrays: read_estimate(scene.caster, arrays),
            lambda: estimate_arrays(
                scene.caster,
                (scene.frame(i) for i in range(len(scene))),
                np.asarray(self.capture.up, np.float64),
                sources,
                closed=False,
            ),
        )

    def unclosed_light(self, setup: LightSetup) -> SurfaceLight:
        """Light on the vertices by `unclosed`, panes and lamps as usual."""
        light, maps = self.unclosed.light, self.scene.shadow_maps(setup)
        bounced = bounced_light(light, setup.lights, maps)
        return dataclasses.replace(self.scene.surface_light(setup), photo_light=light.illuminance, bounced=bounced)

    @functools.cached_property
    def true_light(self) -> Float[np.ndarray, "v 3"]:
        """E_old / K at the vertices of the scan."""
        light = np.add(*self.at_vertices(None))
        return (np.maximum(light, DARKEST_SHARE * light.mean()) / self.capture.mean_light).astype(np.float32)

    def at_vertices(self, setup: LightSetup | None) -> tuple[np.ndarray, np.ndarray]:
        """True (direct, bounced) irradiance / π on the scan, of a set-up or of the photo's light."""
        mesh = self.scene.mesh
        return self.irradiance(setup, np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals))

    def irradiance(
        self, setup: LightSetup | None, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """True (direct, bounced) irradiance / π of a set-up, or of the photo's light."""
        light = self.capture.photo_light() if setup is None else self.capture.light(setup)
        return self.capture.room.irradiance(light, points, normals)

    def visibility(
        self, setup: LightSetup, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n l"]:
        """Share of each light that reaches the true mesh, by shadow rays; none where that is turned away."""
        turn = np.random.default_rng(0).random((len(points), 2))
        shares = np.ones((len(points), len(setup.lights)), np.float32)
        for k, light in enumerate(setup.lights):
            emitter, strongest = light.emitter(), int(np.argmax(light.color))
            if emitter is None or emitter.kind == "sky":
                continue
            lux = unshadowed(light, points, normals) * float(light.color[strongest])
            left = np.pi * direct(light, self.capture.room.caster, points, normals, SHADOW_RAYS, turn)[:, strongest]
            shares[:, k] = np.where(lux > 0, left / np.where(lux > 0, lux, 1.0), 0.0)
        return np.clip(shares, 0.0, 1.0)

    def again(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """A frame rendered again under the photo's own light; its noise is another frame's."""
        camera, noise = self.capture.camera(index), index + len(self.capture)
        return self.capture.room.photograph(self.capture.photo_light(), camera, noise, self.capture.exposure)

    def row(self) -> dict[str, Any]:
        """Row of the estimates, and of their errors.

        Returns:
            Of the scene's: exponent, flatness, origin and names of the sources; and median and 90 % quantile of
            |log E_old / true E_old| at the vertices for each estimate.
        """
        light = self.scene.photo_light
        found = {
            "even light": jnp.ones((1, 3)),
            "as estimated": light.estimate.light.illuminance,
            "scan not closed": self.unclosed.light.illuminance,
            "sources not told": self.unnamed.photo_light.estimate.light.illuminance,
        }
        true, errors = np.log(np.maximum(self.true_light, LEAST_PHOTO_LIGHT)), {}
        for name, field in found.items():
            off = np.abs(np.log(np.maximum(np.asarray(field), LEAST_PHOTO_LIGHT)) - true)
            errors[name] = np.quantile(off, [0.5, 0.9])
        return {"light_errors": errors, "searched": self.unnamed.photo_light.estimate.names, **light.record()}
