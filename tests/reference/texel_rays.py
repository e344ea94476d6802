"""Distances of a shadow map's texels by rays, one through each: what the rasteriser must draw."""

import numpy as np

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout, _texel_rays
from hyjax.light.kinds.shadow_views import RadialViews
from hyjax.util.vectors import orthonormal_frame


def texel_distances(layout: MapLayout, view: int, caster: RayCaster) -> np.ndarray:
    """Distances in a view, gutter included, row by row; −∞ where no light starts."""
    local_starts, local = _texel_rays(layout.size, layout.projection)
    views, origin = layout.views, layout.origins[view]
    if isinstance(views, RadialViews):
        # Rays that start in one point. The rows of `axes` are orthogonal: its inverse is its transpose over their
        # squared lengths.
        directions = local @ (views.axes * np.sum(views.axes**2, axis=1, keepdims=True) ** -1)
        return np.asarray(views.near + caster.cast(origin + views.near * directions, directions).distance)
    frame = orthonormal_frame(views.directions)[view]
    starts = layout.half * (local_starts @ frame)
    directions = np.broadcast_to(frame[2], starts.shape)
    if views.aperture is None:
        return np.asarray(caster.cast(origin + starts, directions).distance)
    # Rays that start in an opening. Beside the opening no light starts: all is dark.
    right, up = (np.asarray(side, np.float64) for side in (views.aperture.right, views.aperture.up))
    normal = np.cross(right, up)
    lead = -(starts @ normal) / (frame[2] @ normal)
    starts = starts + lead[:, None] * frame[2]
    inside = (np.abs(starts @ right) <= right @ right) & (np.abs(starts @ up) <= up @ up)
    return np.where(inside, lead + caster.cast(origin + starts, directions).distance, -np.inf)
