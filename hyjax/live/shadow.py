"""Shadow maps on a changing surface, drawn again when it has changed."""

import dataclasses
import threading
from collections.abc import Hashable

import cachetools
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout
from hyjax.light.kinds import Light
from hyjax.light.setup import geometry_key
from hyjax.light.shadow_map import ShadowMap
from hyjax.scene.surfaces import SURFACE_ERROR

MOST_MAPS = 24
"""Lights, at each resolution, whose maps are kept."""


@dataclasses.dataclass(frozen=True, eq=False)
class LiveSurface:
    """Surface at one moment.

    Attributes:
        bounds: least and largest coordinates, rounded outwards so that they seldom change.
    """

    caster: RayCaster
    revision: int
    bounds: Float[np.ndarray, "2 3"]


class LiveShadowMaps:
    """Shadow maps of lights on the surface as it is when they are asked for."""

    def __init__(self) -> None:
        self._kept = cachetools.LRUCache[Hashable, tuple[int, ShadowMap]](MOST_MAPS)
        self._lock = threading.Lock()

    def __call__(
        self, light: Light, surface: LiveSurface, scale: float, most_views: int | None = None
    ) -> ShadowMap | None:
        """Shadow map of a light on a surface; None if it casts no shadow.

        Args:
            surface: as it is now, or was when the picture was begun that the map is for.
        """
        views = light.shadow_views()
        if views is None:
            return None
        if most_views is not None:
            views = views.thinned(most_views)
        key = geometry_key(light), scale, most_views
        with self._lock:
            kept = self._kept.get(key)
            if kept is None or kept[0] < surface.revision:
                made = MapLayout.of(views, scale, surface.bounds).cast(surface.caster)
                kept = surface.revision, dataclasses.replace(made, slack=jnp.float32(SURFACE_ERROR))
                self._kept[key] = kept
        return kept[1]
