"""Sun by the hour: lights through a room's windows for every half hour of a day, as entries of a lights file."""

import logging
from typing import Any

import numpy as np

from hyjax.data.frames import spread
from hyjax.device.page_scene import setup_content
from hyjax.scene.scene import Scene

BEARING = 240.0
"""Bearing of the first window, degrees from north: an afternoon sun comes in."""
STEP_HOURS = 0.5
"""Hours."""
CAMERAS = 8
"""That see the surface for which the sun is exposed."""
_log = logging.getLogger(__name__)


def sun_table(scene: Scene) -> dict[str, Any] | None:
    """Lights of each half hour of a day; None without the extra `tour`, or for a room without windows."""
    windows = scene.photo_light.sources.windows
    if not windows:
        _log.info("web: no sun by the hour: this room has no windows")
        return None
    try:
        from hyjax.tour.lighting import ADAPTATION, LEAST_AMBIENT, WALL_REFLECTANCE, Lighting
        from hyjax.tour.placement import as_window, north_for_bearing
        from hyjax.tour.plan import MOST_WINDOWS, TourPlan
    except ImportError:
        _log.warning("web: the page has no sun by the hour, which needs the extra 'tour': pip install '.[tour]'")
        return None
    up = np.asarray(scene.capture.up, float)
    openings = tuple(
        as_window(w.center, w.normal, *(2.0 * float(np.linalg.norm(side)) for side in (w.right, w.up)))
        for w in windows[:MOST_WINDOWS]
    )
    plan = TourPlan(windows=openings, north=north_for_bearing(openings[0], BEARING, up))
    cameras = [scene.capture.camera(index) for index in spread(range(len(scene.capture)), CAMERAS)]
    photo = scene.photo_light.estimate.light if scene.knows_photo_light else None
    lighting, rows = Lighting(scene.caster, cameras, up, photo), []
    for hour in np.arange(0.0, 24.0, STEP_HOURS):
        at = _at(plan, float(hour))
        rows.append(
            {
                "hour": float(hour),
                "lux": lighting.outside(at).lux,
                "lights": setup_content(lighting.setup(at))["lights"],
            }
        )
    return {
        "day": plan.day,
        "latitude": plan.latitude,
        "rows": rows,
        "adaptation": ADAPTATION,
        "walls": WALL_REFLECTANCE,
        "least_ambient": LEAST_AMBIENT,
        "surface_area": lighting.surface_area,
    }


def _at(plan: Any, hour: float) -> Any:
    from msgspec.structs import replace

    return replace(plan, hour=hour).check()
