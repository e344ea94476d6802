"""Files of a tour's page: its scripts, page.json, the frames, and what a visitor's GPU takes."""

import dataclasses
import functools
import json
import mimetypes
import re
import threading
from collections.abc import Mapping
from typing import Any, get_args

import msgspec
import numpy as np

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.device.page_content import PAGE_FORMAT, frame_entry, frame_picture, page_programs, page_scripts
from hyjax.device.page_scene import describe_scene, light_keys, pack_scene, setup_content
from hyjax.device.scene_arrays import scene_arrays
from hyjax.geometry.shadow_caster import RESOLUTION, VIEW_RESOLUTION
from hyjax.light.setup import REFERENCE_LUX
from hyjax.scene.scene import Scene
from hyjax.tour.lighting import ADAPTATION, LEAST_AMBIENT, WALL_REFLECTANCE
from hyjax.tour.plan import KINDS, LARGEST_FACTOR, MOST_LAMPS, TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.sky import Weather
from hyjax.tour.viewpoint import Shown

RESOLUTIONS = RESOLUTION, VIEW_RESOLUTION
"""Texels a side of shadow maps with one view, and of each of several, on a visitor's GPU."""
RAYS = 128
"""Rays of each point of the light transport, there."""
JSON = "application/json"
mimetypes.add_type("text/javascript", ".js")
_FRAME = re.compile(r"frames/(\d{1,8})\.jpg")


class PageFiles:
    """Files of the page, made when they are first asked for.

    Args:
        schedules: to choose from, by name.
    """

    def __init__(
        self, renderer: Renderer, schedules: Mapping[str, Schedule], engine: str, notices: list[str]
    ) -> None:
        self._renderer, self._schedules, self._engine, self._notices = renderer, schedules, engine, notices
        self._scripts = dict(page_scripts())
        self._lock = threading.Lock()

    def get(self, path: str, plan: TourPlan) -> tuple[bytes, str] | None:
        """Content and media type of a file; None if there is none of that name."""
        name = path or "index.html"
        if name in self._scripts:
            return self._scripts[name], mimetypes.guess_type(name)[0] or "application/octet-stream"
        if name == "page.json":
            return msgspec.json.encode(self._page(plan)), JSON
        if name in ("gpu.json", "scene.bin") and self.for_gpus:
            with self._lock:
                described, packed = self._gpu
            return (json.dumps(described).encode(), JSON) if name == "gpu.json" else (packed, "application/gzip")
        if (found := _FRAME.fullmatch(name)) and int(found[1]) < len(self._renderer.capture):
            return frame_picture(self._renderer.frame(int(found[1])).image), "image/jpeg"
        return None

    @property
    def for_gpus(self) -> bool:
        """Whether visitors' GPUs may draw: no surface that changes, and nothing that they do not follow."""
        if self._engine == "server" or not isinstance(self._renderer.place, Scene):
            return False
        return self._engine == "visitor" or self._configuration == self._followed

    @property
    def _configuration(self) -> Configuration:
        own = self._renderer.configuration.followed_by("tour", say=False)
        return dataclasses.replace(own, schedule=next(iter(self._schedules.values())))

    @property
    def _followed(self) -> Configuration:
        """Configuration as a page follows it."""
        return self._configuration.followed_by("page", say=False)

    def entry(self, index: int) -> dict[str, Any]:
        """Entry of a frame in page.json."""
        return frame_entry(str(index), self._renderer.view_camera(index), f"frames/{index}.jpg")

    def _page(self, plan: TourPlan) -> dict[str, Any]:
        renderer = self._renderer
        photo, numbering = renderer.photo_light, renderer.numbering  # read before the frames that it numbers
        height, width = renderer.camera(0).intrinsics.shape
        return {
            "format": PAGE_FORMAT,
            "made_by": "hyjax",
            "name": renderer.capture.name,
            "size": [height, width],
            "frames": [self.entry(index) for index in range(len(renderer.capture))],
            "scene": {
                "up": renderer.up.tolist(),
                "bounds": np.asarray(renderer.scene.mesh.bounds).tolist(),
                "sources": [] if photo is None else list(photo.estimate.names),
            },
            "setup": setup_content(renderer.lighting.setup(plan)),
            "default_reference_lux": REFERENCE_LUX,
            "light_keys": light_keys(),
            "sun": {
                "rows": [],
                "adaptation": ADAPTATION,
                "walls": WALL_REFLECTANCE,
                "least_ambient": LEAST_AMBIENT,
                "surface_area": renderer.lighting.surface_area,
            },
            "server": {
                "engine": self._engine if self.for_gpus else "server",
                "plan": plan,
                "first": renderer.first_plan(),
                "lamps": KINDS,
                "most_lamps": MOST_LAMPS,
                "weather": get_args(Weather),
                "shown": get_args(Shown),
                "schedules": list(self._schedules),
                "largest_factor": LARGEST_FACTOR,
                "live": renderer.live,
                "numbering": numbering,
                "notices": self._notices,
            },
        }

    @functools.cached_property
    def _gpu(self) -> tuple[dict[str, Any], bytes]:
        """What a visitor's GPU takes: description and packed arrays."""
        renderer = self._renderer
        scene = renderer.place
        assert isinstance(scene, Scene)
        configuration, kept = self._followed, renderer.photo_light is None
        arrays = scene_arrays(
            scene, keep_photo_light=kept, rays=RAYS, photo_exponent=configuration.light.photo_exponent
        )
        packed = pack_scene(arrays)
        size = renderer.camera(0).intrinsics.shape
        setup = renderer.lighting.setup(renderer.first_plan())
        described = {
            **page_programs(arrays.counts, size, configuration, RESOLUTIONS),
            "scene": describe_scene(scene, setup, arrays),
            "file": {"name": "scene.bin", "bytes": packed.bytes, "compression": "gzip"},
            "arrays": packed.entries,
        }
        return described, packed.content
