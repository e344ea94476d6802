"""Records of lights for shaders: the twin of `struct Light` in `wgsl/lights.wgsl`, and of `page/lights.js`."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float

from hyjax.device.frame_program import MOST_LIGHTS, RECORD_BYTES
from hyjax.geometry.shadow_caster import RESOLUTION, VIEW_RESOLUTION, MapLayout
from hyjax.light.kinds import AmbientLight, DirectionalLight, Light, PointLight, RectLight, SkyLight, SpotLight
from hyjax.util import vectors
from hyjax.util.errors import InputError

KIND_NUMBERS: dict[type[Light], int] = {
    AmbientLight: 0,
    PointLight: 1,
    SpotLight: 2,
    RectLight: 3,
    DirectionalLight: 4,
    SkyLight: 5,
}
RECORD = np.dtype(
    [
        ("kind", "<u4"),
        ("views", "<u4"),
        ("size", "<u4"),
        ("start", "<u4"),
        *((name, "<f4", 4) for name in ("position", "direction", "right", "up", "color", "bounds", "shadow")),
    ]
)
assert RECORD.itemsize == RECORD_BYTES


@dataclasses.dataclass(frozen=True)
class LightRecords:
    """Lights for a shader.

    Attributes:
        views: origin and axes of each view of a shadow map.
        jobs: (light, view, 0, 0) of each.
        texels: of all shadow maps together.
    """

    records: np.ndarray
    views: Float[np.ndarray, "v 4 4"]
    jobs: np.ndarray
    texels: int


def light_records(
    lights: Sequence[Light],
    occluders: trimesh.Trimesh,
    *,
    shadows: bool = True,
    slack: float | None = None,
    resolutions: tuple[int, int] = (1024, 512),
    uniform: bool = True,
) -> LightRecords:
    """Records of lights.

    Args:
        resolutions: texels a side of a map with one view, and of each of several.
        uniform: whether ambient light is kept; bounces stand in its place.
    """
    if len(lights) > MOST_LIGHTS:
        raise InputError(f"webgpu: {len(lights)} lights; the shaders take at most {MOST_LIGHTS}")
    records, jobs, start = np.zeros(len(lights), RECORD), [], 0
    vectors4 = np.zeros((0, 4, 4), np.float32)
    bounds = np.append(occluders.bounds.mean(axis=0), 0.5 * np.linalg.norm(occluders.extents) * 1.01)
    for number, (light, record) in enumerate(zip(lights, records)):
        if type(light) not in KIND_NUMBERS:
            names = ", ".join(kind.__name__ for kind in KIND_NUMBERS)
            raise InputError(f"webgpu: no shader for a {type(light).__name__}; there are {names}")
        _fill(record, light)
        record["bounds"] = bounds
        record["shadow"][0] = -1.0 if slack is None else slack
        if light.UNIFORM and not uniform:
            record["color"][3] = 0.0
        views = light.shadow_views() if shadows else None
        if views is None:
            continue
        record["views"], record["size"] = views.count, resolutions[views.count > 1]
        scale = record["size"] / (VIEW_RESOLUTION if views.count > 1 else RESOLUTION)
        layout = MapLayout.of(views, scale, occluders.bounds)
        record["start"] = start
        record["shadow"][2:] = layout.texel, len(vectors4)
        vectors4 = np.concatenate([vectors4, _views(layout)])
        jobs += [(number, view, 0, 0) for view in range(views.count)]
        start += views.count * (int(record["size"]) + 2) ** 2
    return LightRecords(records, vectors4, np.array(jobs, np.uint32).reshape(-1, 4), start)


def _views(layout: MapLayout) -> Float[np.ndarray, "v 4 4"]:
    """Origin and unit axes of each view."""
    result = np.zeros((layout.count, 4, 4), np.float32)
    result[:, 0, :3] = layout.origins
    result[:, 1:, :3] = layout.axes / np.linalg.norm(layout.axes, axis=-1, keepdims=True)
    return result


def _fill(record: np.void, light: Light) -> None:
    record["kind"] = KIND_NUMBERS[type(light)]
    record["color"][:3], record["color"][3] = light.color, getattr(light, light.STRENGTH)
    if isinstance(light, PointLight | SpotLight):
        record["position"] = (*np.asarray(light.position), light.radius)
        record["direction"][3] = light.clearance
    if isinstance(light, SpotLight):
        record["direction"][:3] = vectors.unit(light.direction)
        record["right"][3], record["up"][3] = np.cos(light.inner_angle), np.cos(light.outer_angle)
    if isinstance(light, RectLight):
        _rectangle(record, light.center, light.right, light.up)
    if isinstance(light, DirectionalLight):
        record["direction"][:3] = vectors.unit(light.direction)
        record["position"][3] = light.angular_radius
        if light.aperture is not None:
            _rectangle(record, light.aperture.center, light.aperture.right, light.aperture.up)
            record["shadow"][1] = 1.0
    if isinstance(light, SkyLight):
        record["direction"][:3] = vectors.unit(light.up)


def _rectangle(record: np.void, *vectors3: Float[np.ndarray, "3"]) -> None:
    for name, vector in zip(("position", "right", "up"), vectors3, strict=True):
        record[name][:3] = vector
