"""Shadow maps on a changing surface, drawn again when it has changed."""

import dataclasses
import threading
from collections.abc import Hashable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import MapLayout
from hyjax.light.kinds import Light
from hyjax.light.shadow_map import ShadowMap

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

    def __init__(self, slack: float | None = None) -> None:
        self._slack = slack
        self._kept: dict[Hashable, tuple[int, ShadowMap]] = {}
        self._lock = threading.Lock()

    def __call__(
        self, key: Hashable, light: Light, surface: LiveSurface, scale: float = 1.0, most_views: int | None = None
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
        key = key, scale, most_views
        with self._lock:
            kept = self._kept.pop(key, None)
            if kept is None or kept[0] < surface.revision:
                made = MapLayout.of(views, scale, surface.bounds).cast(surface.caster)
                if self._slack is not None:
                    made = dataclasses.replace(made, slack=jnp.float32(self._slack))
                kept = surface.revision, made
            self._kept[key] = kept  # the latest last
            while len(self._kept) > MOST_MAPS:
                self._kept.pop(next(iter(self._kept)))
        return kept[1]
