"""Viewer: one browser, its camera, and how rendered frames get onto its screen.

A viewer is in the picture (its camera stands where the frame's camera stood, the rendered frame fills the
background, and lamps and windows lie over it where they belong) or in the free view around the mesh. Dragging the
scene leaves the picture; a button or a click on a camera goes back into one.
"""

import functools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import viser
import viser.transforms
from jaxtyping import Float, UInt8

from hyjax.geometry.camera import Camera
from hyjax.tour.free_view import FreeView
from hyjax.tour.notices import Notices
from hyjax.tour.picture import RenderedFrame, to_bytes
from hyjax.tour.plan import TourPlan
from hyjax.tour.screen import background_size, pad_to_aspect, quaternion, safe_aspect, screen_rays, wipe_photo
from hyjax.tour.session import Session
from hyjax.tour.tools import add_drawn_window, use_tool
from hyjax.tour.view_controls import ViewControls

INSTRUCTIONS = {
    "window": "Now draw a rectangle on a wall, or click there for one of the usual size.",
    "furniture": "Now click on a piece of furniture.",
}
INSTRUCTION_SECONDS = 8.0
ORBIT_DISTANCE = 1.0  # metres ahead: dragging looks around, and does not fly through the floor
LEAVE_DISTANCE, LEAVE_ANGLE = 0.02, 0.01  # metres and radians of camera motion that leave the picture
SETTLE_SECONDS = 20.0  # within which a browser has put its camera where it was told to, however slow it draws
RECENT_PICTURES = 32  # whose cameras a browser may still be on its way to
KEY_SECONDS = 0.6  # after a key
REDRAW_DELAY = 0.5  # seconds after the last change
DRAWN_RAYS = 7  # rays a side through a rectangle that is drawn
PLAYING_HZ, FLICKER_HZ = 12.0, 6.0
JPEG_QUALITY = 88
LIVE_REDRAW = 2.0
"""Seconds between two drawings of a mesh that changes: a browser gets all of it each time."""
_log = logging.getLogger(__name__)


class Viewer:
    """One browser. All methods may be called from any thread.

    Attributes:
        controls: its own control panel.
        notices: that it shows.
        tool: what the next click on a surface puts there or picks up; None for nothing.
        rendered: the frame on its screen; None before the first.

    Args:
        session: shared by all viewers.
        client: the browser.
        on_refusal: see `Notices`.
    """

    def __init__(self, session: Session, client: viser.ClientHandle, on_refusal: Callable[[], None]) -> None:
        self.session, self.client = session, client
        self.notices = Notices(client, on_refusal)
        self.tool: str | None = None
        self.rendered: RenderedFrame | None = None
        self._in_picture, self._arrived, self._moved_at = False, False, 0.0
        self._origins: deque[Float[np.ndarray, 3]] = deque(maxlen=RECENT_PICTURES)
        self._aspect = safe_aspect(client.camera)
        client.scene.configure_default_lights(enabled=False)
        self._timer: threading.Timer | None = None
        self._closed = False
        self._redrawn_at = 0.0
        self._used_at = 0.0  # when a control was last used: arrow keys on a slider move the camera too
        self._instruction: Any = None
        self._free_view = FreeView(client.scene, session.renderer, self._thumbnail, self.go)
        renderer = session.renderer
        self.controls = ViewControls(client.gui, session.schedules, len(renderer.capture), live=renderer.live)
        self.controls.frame_slider.on_update(self._frame_changed)
        self.controls.wipe_slider.on_update(self._wipe_changed)
        self.controls.back_button.on_click(self._back_clicked)
        for control in (self.controls.play_box, *self.controls.refinement):
            control.on_update(self._view_changed)
        self._enter()
        self._show_photo()
        client.camera.on_update(self._camera_moved)
        client.scene.on_click()(self._clicked)

    @property
    def frame(self) -> int:
        """Number of the frame that it looks at."""
        return self.controls.frame

    @contextmanager
    def show_errors(self) -> Iterator[None]:
        """`Notices.show_errors` for something that this viewer asks for."""
        self._used_at = time.monotonic()
        with self.notices.show_errors():
            yield

    def close(self) -> None:
        """Stop drawing: the browser has gone."""
        self._closed = True
        self.notices.close()
        if self._timer is not None:
            self._timer.cancel()

    # ---- showing ----

    def show(self, rendered: RenderedFrame, seconds: float, *, latest: bool = True) -> None:
        """Put a rendered frame on the screen.

        Args:
            rendered: from this viewer's viewpoint.
            seconds: that it took.
            latest: whether something has changed; false if the last picture was only rendered more finely.
        """
        if self._closed:
            return
        if self.rendered is None or self.rendered.frame.name != rendered.frame.name:
            self.controls.show_photo(rendered.photo)
        self.rendered = rendered
        self._update_background()
        if latest:
            self.controls.show_rate(seconds)
        self.controls.show_stages(rendered.milliseconds)
        if not self._in_picture:
            self.redraw_soon()
        elif self.controls.play_box.value:
            self._later(max(0.0, 1 / PLAYING_HZ - seconds), self._advance)
        elif self.session.plan.flickers:
            again = functools.partial(self.session.queue.request, self.client.client_id, interactive=False)
            self._later(max(0.0, 1 / FLICKER_HZ - seconds), again)

    def redraw_soon(self) -> None:
        """Draw the free view anew if it is shown and out of date; not on the thread that serves all browsers."""
        if not self._in_picture and not self._free_view.is_current(self.session.plan, self.frame):
            self._later(REDRAW_DELAY, functools.partial(self._free_view.draw, self._free_state))

    def frame_arrived(self) -> None:
        """Follow the newest frame, or at least the surface that it has renewed."""
        count = len(self.session.renderer.capture)
        self.controls.set_frames(count)
        if self._closed:
            return
        if self._in_picture and self.controls.follow:
            self.go(count - 1)
        elif self._in_picture:
            self.session.queue.request(self.client.client_id)
        elif time.monotonic() - self._redrawn_at > LIVE_REDRAW:
            self._redrawn_at = time.monotonic()
            self._free_view.outdate()
            self.redraw_soon()

    def _free_state(self) -> tuple[TourPlan, int] | None:
        return None if self._in_picture or self._closed else (self.session.plan, self.frame)

    def _thumbnail(self) -> UInt8[np.ndarray, "h w 3"] | None:
        return None if self.rendered is None else self.rendered.picture

    def _show_photo(self) -> None:
        frame = self.session.renderer.frame(self.frame)
        self._set_background(to_bytes(frame.image), frame.camera)

    def _update_background(self) -> None:
        shown = None
        while self._in_picture and self.rendered is not None and shown is not self.rendered:
            shown = self.rendered
            self._set_background(wipe_photo(shown.photo, shown.picture, self.controls.wipe), shown.frame.camera)
        if not self._in_picture:  # left while it was encoded
            self.client.scene.set_background_image(None)
        self.client.flush()

    def _set_background(self, picture: UInt8[np.ndarray, "h w 3"], camera: Camera) -> None:
        padded = pad_to_aspect(picture, camera, self._aspect)
        self.client.scene.set_background_image(padded, "jpeg", jpeg_quality=JPEG_QUALITY)

    def _later(self, seconds: float, task: Callable[[], None]) -> None:
        def run() -> None:
            try:
                task()
            except Exception:
                if not self._closed:  # else there is nothing to draw on
                    _log.exception("a browser of the tour could not be drawn for")

        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(seconds, run)
        self._timer.daemon = True
        self._timer.start()

    def _advance(self) -> None:
        if not self._closed and self.controls.play_box.value:
            self.go((self.frame + 1) % len(self.session.renderer.capture), interactive=False)

    # ---- its own controls ----

    async def _view_changed(self, _: Any) -> None:
        self._used_at = time.monotonic()
        self.session.queue.request(self.client.client_id)

    async def _wipe_changed(self, _: Any) -> None:
        self._used_at = time.monotonic()
        if self.rendered is not None:  # nothing new to compute
            self._update_background()

    async def _frame_changed(self, event: Any) -> None:
        if event.client is not None:
            self._used_at = time.monotonic()
            self.go(self.frame)

    async def _back_clicked(self, _: Any) -> None:
        self.go(self.frame)

    # ---- in the picture or in the free view ----

    def go(self, frame: int, *, interactive: bool = True) -> None:
        """Go into the picture of a frame; `interactive`, see `RenderQueue.request`."""
        self.controls.frame = frame
        self._enter()
        self.session.queue.request(self.client.client_id, interactive=interactive)

    def _enter(self) -> None:
        camera = self.session.renderer.camera(self.frame)
        _, _, angle = background_size(camera, self._aspect)
        self._moved_at = time.monotonic()
        if not self._in_picture:
            self._in_picture, self._arrived = True, False
            self._origins.clear()
        self._origins.append(camera.origin)
        with self.client.atomic():
            self.client.camera.wxyz = quaternion(camera.pose)
            self.client.camera.position = camera.origin
            self.client.camera.look_at = camera.origin + ORBIT_DISTANCE * camera.pose[:3, 2]
            self.client.camera.fov = angle
            self.controls.back_button.visible = False
            self._free_view.show(False)

    async def _camera_moved(self, camera: viser.CameraHandle) -> None:
        if not self._in_picture:
            return
        if abs(safe_aspect(camera) - self._aspect) > 1e-3:
            self._aspect = safe_aspect(camera)
            self.go(self.frame)
            return
        pose = self.session.renderer.camera(self.frame).pose
        forward = viser.transforms.SO3(camera.wxyz).as_matrix()[:, 2]
        near = np.linalg.norm(camera.position - pose[:3, 3]) < LEAVE_DISTANCE
        # While pictures follow each other fast it never settles, but only a visitor takes it elsewhere.
        elsewhere = np.linalg.norm(camera.position - np.array(self._origins), axis=1).min() > LEAVE_DISTANCE
        self._arrived |= not elsewhere
        if near and forward @ pose[:3, 2] > np.cos(LEAVE_ANGLE):
            self._moved_at = 0.0
        elif time.monotonic() - self._used_at < KEY_SECONDS:
            self._enter()
        elif (elsewhere and self._arrived) or time.monotonic() - self._moved_at > SETTLE_SECONDS:
            self._leave_picture()

    def _leave_picture(self) -> None:
        self._in_picture = False
        self.client.scene.set_background_image(None)
        self.controls.back_button.visible = True
        self.notices.notify(
            "Flying", "Press “Back into the picture”, or click on a camera, to see the relit photo again."
        )
        self._free_view.show(True)
        self.redraw_soon()

    # ---- tools ----

    def select_tool(self, tool: str | None) -> None:
        """Use this tool with the next click on the scene; None for no tool."""
        self._take_tool()
        self.tool = tool
        if tool is None:
            return
        instruction = INSTRUCTIONS.get(tool, "Now click where the lamp goes.")
        self._instruction = self.client.add_notification(
            tool.capitalize(), instruction, auto_close_seconds=INSTRUCTION_SECONDS
        )
        if tool == "window":  # until it is drawn, dragging does not turn the camera
            self.client.scene.on_rect_select()(self._rectangle_drawn)

    def click(self, tool: str, origin: Any, direction: Any) -> None:
        """Use a tool where a ray meets the scene; errors become notices."""
        with self.show_errors():
            use_tool(self.session, tool, origin, direction)

    def _take_tool(self) -> str | None:
        tool, self.tool = self.tool, None
        self.client.scene.remove_rect_select_callback()
        if self._instruction is not None:  # it is in the way of what comes next
            self._instruction.remove()
            self._instruction = None
        return tool

    def _clicked(self, event: Any) -> None:
        with self.show_errors():
            if (tool := self._take_tool()) is not None:
                use_tool(self.session, tool, event.ray_origin, event.ray_direction)

    def _rectangle_drawn(self, event: Any) -> None:
        with self.show_errors():
            if self._take_tool() is None:
                return
            (left, top), (right, bottom) = event.screen_min, event.screen_max
            across, down = np.linspace(left, right, DRAWN_RAYS), np.linspace(top, bottom, DRAWN_RAYS)
            grid = np.stack(np.meshgrid(across, down), axis=-1)
            camera = self.client.camera
            rays = screen_rays(grid.reshape(-1, 2), camera.wxyz, camera.fov, safe_aspect(camera))
            add_drawn_window(self.session, camera.position, rays.reshape(DRAWN_RAYS, DRAWN_RAYS, 3))
