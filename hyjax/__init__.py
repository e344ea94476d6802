"""Relight camera frames of real rooms: the Hybrelighter pipeline as pure JAX functions.

The functions here take and return arrays and work under jit, grad and vmap (checks of values, such as κ > 0, happen
only where the values are known). Cameras, meshes and ray casting are in
`hyjax.geometry`, captures in `hyjax.data`, scenes in `hyjax.scene`.
"""

import importlib

from hyjax.core.cascade import cascade, level_edges
from hyjax.core.cycles import step_cycle
from hyjax.core.diffusion import conductance, diffuse, diffuse_step
from hyjax.core.pyramid import downsample, min_pool, upsample
from hyjax.core.refine import cascade_known, fill_visibility, shadow_pass
from hyjax.core.schedule import Level, Schedule
from hyjax.core.solver import solve
from hyjax.core.superresolution import super_resolve
from hyjax.core.upsampling import guided_upsample
from hyjax.light.color import blackbody, luminance, to_display, to_linear
from hyjax.light.compositing import composite
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
)
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.shading import colored, shade, shade_each
from hyjax.light.shadow_map import ShadowMap, visibilities, visibility
from hyjax.light.view import View
from hyjax.pipeline import Relit, relight, relight_stages
from hyjax.util.errors import InputError

__version__ = "0.1.0"

LAZY = {
    "RelightSettings": "hyjax.relighting.settings",
    "Scene": "hyjax.scene.scene",
    "SceneSettings": "hyjax.scene.settings",
    "relight_capture": "hyjax.relighting.run",
    "TuneSettings": "hyjax.tuning.settings",
    "tune": "hyjax.tuning.tune",
    "write_png": "hyjax.util.images",
}
"""Names that need files, geometry or the tuner, and where they are."""


def __getattr__(name: str) -> object:
    """Names of `LAZY` and modules, loaded when they are first asked for."""
    if name in LAZY:
        return getattr(importlib.import_module(LAZY[name]), name)
    if name in ("metrics", "video"):
        return importlib.import_module(f"hyjax.{name}")
    if name == "losses":
        return importlib.import_module("hyjax.metrics.losses")
    raise AttributeError(f"module 'hyjax' has no attribute {name!r}")


__all__ = [
    "AmbientLight",
    "Aperture",
    "DirectionalLight",
    "GBuffer",
    "InputError",
    "Level",
    "Light",
    "LightSetup",
    "PointLight",
    "RectLight",
    "RelightSettings",
    "Relit",
    "Scene",
    "SceneSettings",
    "Schedule",
    "Shaded",
    "ShadowMap",
    "SkyLight",
    "SpotLight",
    "TuneSettings",
    "View",
    "blackbody",
    "cascade",
    "cascade_known",
    "colored",
    "composite",
    "conductance",
    "diffuse",
    "diffuse_step",
    "downsample",
    "fill_visibility",
    "guided_upsample",
    "level_edges",
    "luminance",
    "min_pool",
    "relight",
    "relight_capture",
    "relight_stages",
    "shade",
    "shade_each",
    "shadow_pass",
    "solve",
    "step_cycle",
    "super_resolve",
    "to_display",
    "to_linear",
    "tune",
    "upsample",
    "visibilities",
    "visibility",
    "write_png",
]
