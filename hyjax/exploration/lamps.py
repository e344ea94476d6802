"""Lamps as the page shows them, and their changes by hand."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from hyjax.geometry.camera import Camera
from hyjax.light.color import encoded
from hyjax.light.kinds import Light, kind_name
from hyjax.light.setup import LightSetup
from hyjax.util.errors import InputError, shown


def lamp_rows(setup: LightSetup | None, camera: Camera | None) -> list[dict[str, Any]]:
    """Kind, strength, colour and place in the picture of each light."""
    found = []
    for light in () if setup is None else setup.lights:
        place = None
        if camera is not None and (key := _place_key(light)) is not None:
            k = camera.intrinsics
            xy, depth = camera.project(np.asarray(getattr(light, key), np.float64))
            place = [float(xy[0]) / k.width, float(xy[1]) / k.height] if depth > 0 else None
        color = np.asarray(encoded(jnp.asarray(light.color) / max(float(np.max(light.color)), 1e-6)))
        row = {"kind": kind_name(light), "strength": float(np.asarray(getattr(light, light.STRENGTH)))}
        row |= {"unit": "lx" if light.STRENGTH == "illuminance" else "lm", "place": place}
        found.append(row | {"color": [round(255 * float(c)) for c in color]})
    return found


def changed_lamp(setup: LightSetup, camera: Camera, index: Any, kind: str, value: Any) -> LightSetup:
    """Set-up with another strength of a light, or another place, at its distance from the camera.

    Args:
        value: the strength, or the place in the picture as shares of its width and height.
    """
    if not 0 <= index < len(setup.lights):
        raise InputError(f"lights: there is no light {shown(index)}")
    if not np.all(np.isfinite(np.asarray(value, np.float64))):
        raise InputError(f"lights[{index}]: must be numbers, got {shown(value)}")
    light: Any = setup.lights[index]
    if kind == "strength":
        light = dataclasses.replace(light, **{light.STRENGTH: np.float32(value)})
    else:
        key = _place_key(light)
        if key is None:
            raise InputError(f"lights[{index}]: {kind_name(light)} has no place")
        k, own = camera.intrinsics, np.asarray(getattr(light, key), np.float64)
        depth = float(camera.project(own)[1])
        x, y = value[0] * k.width, value[1] * k.height
        ray = np.array([(x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0]) * depth
        light = dataclasses.replace(light, **{key: (camera.origin + camera.pose[:3, :3] @ ray).astype(np.float32)})
    lights = (*setup.lights[:index], light, *setup.lights[index + 1 :])
    return LightSetup.of(dataclasses.replace(setup, lights=lights))


def _place_key(light: Light) -> str | None:
    return next((key for key in ("position", "center") if hasattr(light, key)), None)
