"""Free view of one browser: the room's mesh, the sources of the photos' light, and the cameras to click on."""

import functools
import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
import viser
from jaxtyping import UInt8

from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.tour.plan import TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.screen import quaternion

CAMERAS = 24
"""Most cameras that are drawn."""
FRAME_COLOR, CAMERA_COLOR, SOURCE_COLOR = (255, 140, 0), (70, 70, 70), (255, 220, 120)


class FreeView:
    """Mesh and cameras that a browser shows while its camera is not in a picture.

    Args:
        scene: of the browser.
        renderer: lights the mesh.
        thumbnail: returns the picture to show in the current camera; None if there is none.
        go_to: called with the number of the frame whose camera was clicked on.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        renderer: Renderer,
        thumbnail: Callable[[], UInt8[np.ndarray, "h w 3"] | None],
        go_to: Callable[[int], None],
    ) -> None:
        self._scene, self._renderer, self._thumbnail, self._go_to = scene, renderer, thumbnail, go_to
        self._lock = threading.Lock()
        self._nodes: list[Any] = []
        self._plan: TourPlan | None = None
        self._frame = -1

    def is_current(self, plan: TourPlan, frame: int) -> bool:
        """Whether this plan has been drawn, with this frame's camera marked."""
        return self._plan is plan and self._frame == frame

    def outdate(self) -> None:
        """Mark the drawn surface as out of date."""
        self._plan = None

    def show(self, visible: bool) -> None:
        """Show or hide the drawn surface."""
        for node in list(self._nodes):
            node.visible = visible

    def draw(self, state: Callable[[], tuple[TourPlan, int] | None]) -> None:
        """Draw the mesh and the cameras anew.

        Args:
            state: returns plan and frame, or None once the free view has been left; asked again at the end.
        """
        with self._lock:
            if (now := state()) is None:
                return
            plan, frame = now
            mesh = self._renderer.lit_mesh(plan)  # until it is there the old one stays
            numbers = spread(range(len(self._renderer.capture)), CAMERAS)
            cameras = {number: self._renderer.captured_camera(number) for number in numbers}
            for node in self._nodes:
                node.remove()
            self._nodes = self._draw_nodes(mesh, cameras, frame)
            self._plan, self._frame = plan, frame
            if state() is None:
                self.show(False)

    def _draw_nodes(self, mesh: trimesh.Trimesh, cameras: dict[int, Camera], frame: int) -> list[Any]:
        # The light is in the mesh's colours: a light of the scene would shade it twice.
        nodes: list[Any] = [
            self._scene.add_light_ambient("/ambient", intensity=math.pi),
            self._scene.add_mesh_trimesh("/room", mesh),
        ]
        if (light := self._renderer.photo_light) is not None:
            places = [(window.name, window.center) for window in light.sources.windows]
            places += [(lamp.name, lamp.position) for lamp in light.sources.lamps]
            for name, place in places:
                nodes.append(self._scene.add_label(f"/photo/{name}", name, position=tuple(place)))
            for window in light.sources.windows:
                outline = np.stack([window.corners, np.roll(window.corners, -1, axis=0)], axis=1)
                nodes.append(self._scene.add_line_segments(f"/photo/{window.name}/frame", outline, SOURCE_COLOR))
        for number, camera in cameras.items():
            k, current = camera.intrinsics, number == frame
            picture = self._thumbnail() if current else None
            frustum = self._scene.add_camera_frustum(
                f"/cameras/{number}",
                2 * float(np.arctan(0.5 * k.height / k.fy)),
                k.width / k.height,
                scale=0.12,
                color=FRAME_COLOR if current else CAMERA_COLOR,
                wxyz=quaternion(camera.pose),
                position=camera.origin,
                image=None if picture is None else picture[::4, ::4],
            )
            frustum.on_click(functools.partial(self._clicked, number))
            nodes.append(frustum)
        return nodes

    def _clicked(self, number: int, _: Any) -> None:
        self._go_to(number)
