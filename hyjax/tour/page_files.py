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
from hyjax.device.page_content import (
    RAYS,
    RESOLUTIONS,
    SCENE_FILE,
    followed_programs,
    frame_entry,
    frame_picture,
    page_content,
    page_scripts,
    scene_content,
)
from hyjax.device.scene_arrays import scene_arrays
from hyjax.scene.scene import Scene
from hyjax.tour.lighting import ADAPTATION, LEAST_AMBIENT, WALL_REFLECTANCE
from hyjax.tour.plan import KINDS, LARGEST_FACTOR, MOST_LAMPS, TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.sky import Weather
from hyjax.tour.viewpoint import Shown

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
        if name in ("gpu.json", SCENE_FILE) and self.for_gpus:
            with self._lock:
                described, packed = self._gpu
            return (json.dumps(described).encode(), JSON) if name == "gpu.json" else (packed, "application/gzip")
        if (found := _FRAME.fullmatch(name)) and int(found[1]) < len(self._renderer.capture):
            return frame_picture(self._renderer.frame(int(found[1])).image), "image/jpeg"
        return None

    @property
    def for_gpus(self) -> bool:
        """Whether visitors' GPUs may draw: no surface that changes, and nothing that they do not follow."""
        if self._engine == "server":
            return False
        light = self._configuration.light.replace(sampling=1)  # pages work at full size, and show no less
        whole = dataclasses.replace(self._configuration, light=light)
        return self.as_pages and (self._engine == "visitor" or whole == self._followed)

    @property
    def as_pages(self) -> bool:
        """Whether a page can show the same: a whole capture, whose own light is divided out."""
        return isinstance(self._renderer.place, Scene) and self._renderer.photo_light is not None

    @property
    def _followed(self) -> Configuration:
        """Configuration as a page follows it."""
        return self._configuration.followed_by("page", say=False)

    @property
    def _configuration(self) -> Configuration:
        own = self._renderer.configuration.followed_by("tour", say=False)
        return dataclasses.replace(own, schedule=next(iter(self._schedules.values())))

    def entry(self, index: int) -> dict[str, Any]:
        """Entry of a frame in page.json."""
        return frame_entry(str(index), self._renderer.view_camera(index), f"frames/{index}.jpg")

    def _page(self, plan: TourPlan) -> dict[str, Any]:
        renderer = self._renderer
        photo, numbering = renderer.photo_light, renderer.numbering  # read before the frames that it numbers
        size, setup = renderer.camera(0).intrinsics.shape, renderer.lighting.setup(plan)
        entries = [self.entry(index) for index in range(len(renderer.capture))]
        return page_content(renderer.capture.name, size, setup, entries) | {
            "scene": {
                "up": renderer.up.tolist(),
                "bounds": np.asarray(renderer.scene.mesh.bounds).tolist(),
                "sources": [] if photo is None else list(photo.estimate.names),
            },
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
                "page": self.as_pages,
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
        arrays = scene_arrays(scene, rays=RAYS)
        setup = renderer.lighting.setup(renderer.first_plan())
        content, packed = scene_content(scene, setup, arrays)
        size = renderer.camera(0).intrinsics.shape
        return followed_programs(arrays.counts, size, self._configuration, RESOLUTIONS) | content, packed
