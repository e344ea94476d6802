"""Sun by the hour: light from outside for every half hour of a day, as entries of a lights file."""

import logging
from typing import Any

import numpy as np
from msgspec.structs import replace

from hyjax.data.frames import spread
from hyjax.device.page_scene import setup_content
from hyjax.scene.light_setups import tell_made_up
from hyjax.scene.scene import Scene
from hyjax.tour.lighting import ADAPTATION, LEAST_AMBIENT, WALL_REFLECTANCE, Lighting, lights_from_outside
from hyjax.tour.placement import sunny_plan
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

STEP_HOURS = 0.5
"""Hours."""
CAMERAS = 8
"""That see the surface for which the sun is exposed."""
_log = logging.getLogger(__name__)


def sun_table(scene: Scene) -> dict[str, Any] | None:
    """Lights of each half hour of a day; None without the extra `tour`."""
    try:
        optional_module("astral", "tour", "web: the page has no sun by the hour")
    except InputError as error:
        _log.warning("%s", error)
        return None
    anchors = scene.anchors(at_photo_sources=scene.knows_photo_light)
    plan = sunny_plan(anchors)
    cameras = [scene.capture.camera(index) for index in spread(range(len(scene.capture)), CAMERAS)]
    tell_made_up("sun by the hour", anchors, lights_from_outside(plan, anchors.up)[0])
    photo = scene.photo_light.estimate.light if scene.knows_photo_light else None
    lighting, rows = Lighting(scene.caster, cameras, anchors.up, photo), []
    for hour in np.arange(0.0, 24.0, STEP_HOURS).tolist():
        at = replace(plan, hour=hour)
        lights = setup_content(lighting.setup(at))["lights"]
        rows.append({"hour": hour, "lux": lighting.outside(at).lux, "lights": lights})
    return {
        "day": plan.day,
        "latitude": plan.latitude,
        "rows": rows,
        "adaptation": ADAPTATION,
        "walls": WALL_REFLECTANCE,
        "least_ambient": LEAST_AMBIENT,
        "surface_area": lighting.surface_area,
    }
