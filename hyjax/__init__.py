"""Relight camera frames of real rooms: the Hybrelighter pipeline as pure JAX functions.

The functions here take and return arrays and work under jit, grad and vmap (checks of values, such as κ > 0, happen
only where the values are known). Cameras, meshes and ray casting are in
`hyjax.scene`, captures in `hyjax.data`.
"""

import importlib

from hyjax.cascade import cascade, level_edges
from hyjax.color import blackbody, luminance, to_display, to_linear
from hyjax.compositing import composite
from hyjax.cycles import step_cycle
from hyjax.diffusion import conductance, diffuse, diffuse_step
from hyjax.errors import InputError
from hyjax.gbuffer import GBuffer
from hyjax.lights import AmbientLight, Aperture, DirectionalLight, Light, PointLight, RectLight, SkyLight, SpotLight
from hyjax.pipeline import Relit, relight, relight_stages
from hyjax.pyramid import downsample, min_pool, upsample
from hyjax.refine import cascade_known, fill_visibility, shadow_pass
from hyjax.schedule import Level, Schedule
from hyjax.shading import colored, shade, shade_each
from hyjax.shadow import ShadowMap, visibilities, visibility
from hyjax.solver import solve
from hyjax.superresolution import super_resolve
from hyjax.upsampling import guided_upsample

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """`hyjax.tune`, which needs the whole upper half of the package, and modules: loaded when first asked for."""
    if name == "tune":
        return importlib.import_module("hyjax.tuning.tune").tune
    if name in ("losses", "metrics", "video"):
        return importlib.import_module(f"hyjax.{name}")
    raise AttributeError(f"module 'hyjax' has no attribute {name!r}")


__all__ = [
    "AmbientLight",
    "Aperture",
    "DirectionalLight",
    "GBuffer",
    "InputError",
    "Level",
    "Light",
    "PointLight",
    "RectLight",
    "Relit",
    "Schedule",
    "ShadowMap",
    "SkyLight",
    "SpotLight",
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
]
