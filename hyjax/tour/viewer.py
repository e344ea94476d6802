"""One browser: what it looks at, its own controls, and how a painting gets onto its screen.

A viewer is in the picture (the camera stands where the frame's camera stood, the painting fills the background and
the handles of lamps and windows lie over it where they belong) or flies around the mesh. Dragging the scene leaves
the picture, a button or a click on a camera goes back into one.
"""

import contextlib
import functools
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import trimesh
import viser
import viser.transforms
from jaxtyping import Float, UInt8

from hyjax.data.frames import spread
from hyjax.errors import InputError
from hyjax.scene.camera import Camera
from hyjax.tour.canvas import canvas_of, framed_picture, rays_through, sensible_aspect, wiped
from hyjax.tour.painting import Painting, Shown, View, adjusted, bytes_of
from hyjax.tour.plan import Plan

if TYPE_CHECKING:
    from hyjax.tour.page import Tour

WAIT = ("One moment", "Compiling what this picture needs; it is kept for the next time.")
PATIENCE = 0.6  # seconds
HOW_TO = {
    "window": "Now draw a rectangle on a wall, or click there for one of the usual size.",
    "furniture": "Now click on a piece of furniture.",
}
_log = logging.getLogger(__name__)
TURNS_ABOUT = 1.0  # metres ahead: whoever drags looks around, and does not fly through the floor
AWAY, TURNED = 0.02, 0.01  # metres and radians that mean leaving the picture
SETTLING = 1.0  # seconds that a browser may take to put its camera where it was told to
TYPING = 0.6  # seconds after a key
REDRAW_AFTER = 0.5  # seconds after the last change
CAMERAS = 24
HOW_TO_SECONDS = 8.0
GRID = 7  # rays a side through a rectangle that is drawn
KAPPA_RANGE, MOST_STEPS = 1.5, 4.0
PLAYING_HZ, FLICKER_HZ = 12.0, 6.0
JPEG_QUALITY = 88
STAGES = {
    "guide": "guide",
    "surface": "surface seen by the camera",
    "light": "light and shadow maps",
    "cascade": "diffusion of the light",
    "shadow pass": "diffusion of the shadows",
    "composite": "times the photo",
    "show": "to the screen's bytes",
}


class Viewer:
    """See the module's docstring. All methods may be called from any thread."""

    def __init__(self, tour: "Tour", client: viser.ClientHandle) -> None:
        self.tour, self.client = tour, client
        self.tool: str | None = None
        """What the next click on a surface puts there or picks up."""
        self.painting: Painting | None = None
        self._in_picture, self._moved_at = True, 0.0
        self._aspect = sensible_aspect(client.camera)
        self._drawing = threading.Lock()
        self._nodes: list[Any] = []
        self._drawn: Plan | None = None
        self._drawn_frame = -1
        client.scene.configure_default_lights(enabled=False)
        self._timer: threading.Timer | None = None
        self._gone = False
        self.touched = 0.0
        """When this browser last used a control. Arrow keys on a slider move its camera too, which nobody means."""
        self._busy: Any = None
        self._told: Any = None
        self._build()
        self._enter()
        self.show_photo()
        client.camera.on_update(self._camera_moved)
        client.scene.on_click()(asked_by(tour, Viewer._clicked))

    # ---- what it looks at ----

    def view(self) -> View:
        """As its controls say."""
        shown: Any = self._shown.value if self._shown.value in get_args(Shown) else "relit"
        schedules = self.tour.schedules
        schedule = schedules.get(self._named.value, next(iter(schedules.values())))
        kappa = 10.0 ** within(self._kappa.value, -KAPPA_RANGE, KAPPA_RANGE)
        return View(self.frame, shown, adjusted(schedule, within(self._steps.value, 0.0, MOST_STEPS), kappa))

    @property
    def frame(self) -> int:
        """Number of the frame, whatever the browser says."""
        return round(within(self._frame.value, 0, len(self.tour.studio.capture) - 1))

    def _build(self) -> None:
        gui, last = self.client.gui, len(self.tour.studio.capture) - 1
        with gui.add_folder("View", order=-2):
            self._frame: Any = gui.add_slider("Frame", 0, max(last, 1), 1, 0, hint="Where the photo was taken from")
            self._wipe = gui.add_slider(
                "Photo over it", 0.0, 1.0, 0.01, 0.0, hint="Wipe the photo over the relit one, from the left"
            )
            self._play = gui.add_checkbox("Play the capture", False)
            self._back = gui.add_button("Back into the picture", visible=False, color="orange")
            self._stats = gui.add_markdown("Compiling the first picture …")
        self._frame.on_update(self._go)
        self._wipe.on_update(self._rewipe)
        self._play.on_update(self._repaint)
        self._back.on_click(self._enter_again)
        with gui.add_folder("How it works", expand_by_default=False, order=2):
            self._shown = gui.add_dropdown("Show", get_args(Shown), hint="A stage of the picture")
            self._named = gui.add_dropdown(
                "Schedule", tuple(self.tour.schedules), hint="Steps of diffusion by size"
            )
            less = "Less: fainter edges stop the light"
            self._kappa = gui.add_slider("κ × 10^", -KAPPA_RANGE, KAPPA_RANGE, 0.05, 0.0, hint=less)
            self._steps = gui.add_slider("Steps ×", 0.0, MOST_STEPS, 0.5, 1.0, hint="0: nothing is repaired")
            self._times = gui.add_markdown("")
            self._photo = gui.add_image(np.zeros((3, 4, 3), np.uint8), label="The photo", format="jpeg")
        for control in (self._shown, self._named, self._kappa, self._steps):
            control.on_update(self._repaint)

    async def _repaint(self, _: Any) -> None:
        self.touched = time.monotonic()
        self.tour.easel.want(self.client.client_id)

    async def _rewipe(self, _: Any) -> None:
        self.touched = time.monotonic()
        if self.painting is not None:  # nothing new to compute
            self._put()

    async def _go(self, event: Any) -> None:
        if event.client is not None:
            self.touched = time.monotonic()
            self.go(self.frame)

    def go(self, frame: int, *, moved: bool = True) -> None:
        """Go into the picture of a frame; `moved`, see `Easel.want`."""
        self._frame.value = round(within(frame, 0, len(self.tour.studio.capture) - 1))
        self._enter()
        self.tour.easel.want(self.client.client_id, moved=moved)

    # ---- showing ----

    def show(self, painting: Painting, seconds: float, *, latest: bool = True) -> None:
        """Put a painting on the screen.

        Args:
            painting: of this viewer's view.
            seconds: that it took.
            latest: whether something has changed, or the last picture was only painted more finely.
        """
        if self._gone:
            return
        if self.painting is None or self.painting.frame.name != painting.frame.name:
            self._photo.image = painting.photo
        self.painting = painting
        self._put()
        times = painting.milliseconds
        if latest:
            rate = f"**{1 / seconds:.0f} fps** · " if seconds < 1 else ""
            self._stats.content = f"{rate}{1e3 * seconds:.0f} ms for this picture"
        rows = "\n".join(f"| {told} | {times[key]:.1f} |" for key, told in STAGES.items() if key in times)
        self._times.content = f"| stage | ms |\n|---|---|\n{rows}"
        if not self._in_picture:
            self.redraw_soon()
        elif self._play.value:
            self._later(max(0.0, 1 / PLAYING_HZ - seconds), self._advance)
        elif self.tour.flickers():
            self._later(
                max(0.0, 1 / FLICKER_HZ - seconds),
                functools.partial(self.tour.easel.want, self.client.client_id, moved=False),
            )

    def say(self, title: str, body: str, *, color: Any = "blue", seconds: float | None = 6.0) -> None:
        """A notice in the page."""
        if not self._gone:
            self.client.add_notification(title, body, color=color, auto_close_seconds=seconds)

    def refuse(self, error: InputError) -> None:
        """What was asked for cannot be."""
        self.say("That does not work", str(error), color="red")

    def fail(self) -> None:
        """Something that nobody thought of; the log has it."""
        self.say("Something went wrong", "See the terminal for what it was.", color="red")

    @contextlib.contextmanager
    def answering(self) -> Iterator[None]:
        """What this browser must not ask for becomes a notice in its page."""
        self.touched = time.monotonic()
        try:
            yield
        except InputError as error:
            self.tour.controls.follow()
            self.refuse(error)
        except Exception:
            _log.exception("a control of the tour failed")
            self.fail()

    @contextlib.contextmanager
    def patience(self) -> Iterator[None]:
        """Say so if what is done in the block takes its time."""
        done, lock = threading.Event(), threading.Lock()

        def wait() -> None:
            with lock:
                if not done.is_set() and not self._gone:
                    self._busy = self.client.add_notification(*WAIT, loading=True, with_close_button=False)

        timer = threading.Timer(PATIENCE, wait)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            with lock:
                done.set()
                if self._busy is not None:
                    self._busy.remove()
                    self._busy = None

    def show_photo(self) -> None:
        """Show the frame as it was taken, until there is a painting of it."""
        frame = self.tour.studio.frame(self.frame)
        self._fill(bytes_of(frame.image), frame.camera)

    def leave(self) -> None:
        """The browser has gone."""
        self._gone = True
        if self._timer is not None:
            self._timer.cancel()

    def _later(self, seconds: float, task: Callable[[], None]) -> None:
        def run() -> None:
            try:
                task()
            except Exception:
                if not self._gone:  # else nobody is there to draw for
                    _log.exception("a browser of the tour could not be drawn for")

        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(seconds, run)
        self._timer.daemon = True
        self._timer.start()

    def _advance(self) -> None:
        if not self._gone and self._play.value:
            self.go((self.frame + 1) % len(self.tour.studio.capture), moved=False)

    def _put(self) -> None:
        shown = None
        while self._in_picture and self.painting is not None and shown is not self.painting:
            shown = self.painting
            picture = wiped(shown.photo, shown.picture, within(self._wipe.value, 0.0, 1.0))
            self._fill(picture, shown.frame.camera)
        if not self._in_picture:  # left while it was encoded
            self.client.scene.set_background_image(None)
        self.client.flush()

    def _fill(self, picture: UInt8[np.ndarray, "h w 3"], camera: Camera) -> None:
        framed = framed_picture(picture, camera, self._aspect)
        self.client.scene.set_background_image(framed, "jpeg", jpeg_quality=JPEG_QUALITY)

    # ---- in the picture or around the mesh ----

    async def _enter_again(self, _: Any) -> None:
        self.go(self.frame)

    def _enter(self) -> None:
        camera = self.tour.studio.camera(self.frame)
        _, _, angle = canvas_of(camera, self._aspect)
        self._moved_at = time.monotonic()
        self._in_picture = True
        with self.client.atomic():
            self.client.camera.wxyz = quaternion(camera.pose)
            self.client.camera.position = camera.origin
            self.client.camera.look_at = camera.origin + TURNS_ABOUT * camera.pose[:3, 2]
            self.client.camera.fov = angle
            self._back.visible = False
            self._hide_room()

    async def _camera_moved(self, camera: viser.CameraHandle) -> None:
        if not self._in_picture:
            return
        if abs(sensible_aspect(camera) - self._aspect) > 1e-3:
            self._aspect = sensible_aspect(camera)
            self.go(self.frame)
            return
        pose = self.tour.studio.camera(self.frame).pose
        facing = viser.transforms.SO3(camera.wxyz).as_matrix()[:, 2]
        near = np.linalg.norm(camera.position - pose[:3, 3]) < AWAY and facing @ pose[:3, 2] > np.cos(TURNED)
        if near:
            self._moved_at = 0.0
        elif time.monotonic() - self.touched < TYPING:
            self._enter()
        elif time.monotonic() - self._moved_at > SETTLING:
            self.fly()

    def fly(self) -> None:
        """Leave the picture: show the mesh and the cameras."""
        self._in_picture = False
        self.client.scene.set_background_image(None)
        self._back.visible = True
        self.say("Flying", "Press “Back into the picture”, or click on a camera, to see the relit photo again.")
        for node in list(self._nodes):
            node.visible = True
        self.redraw_soon()

    def redraw_soon(self) -> None:
        """Draw the room anew, if it has changed, for whoever flies; not on the thread that serves all browsers."""
        if not self._in_picture and (self._drawn is not self.tour.plan or self._drawn_frame != self.frame):
            self._later(REDRAW_AFTER, self._draw_room)

    def _draw_room(self) -> None:
        """The mesh and the camera path, as they are now."""
        with self._drawing:
            if self._in_picture or self._gone:
                return
            plan, frame, studio = self.tour.plan, self.frame, self.tour.studio
            mesh = studio.lit_mesh(plan)  # until it is there the old one stays
            cameras = {
                index: studio.captured_camera(index) for index in spread(range(len(studio.capture)), CAMERAS)
            }
            for node in self._nodes:
                node.remove()
            self._nodes = self._room_nodes(mesh, cameras, frame)
            self._drawn, self._drawn_frame = plan, frame
            if self._in_picture:  # again, meanwhile
                self._hide_room()

    def _room_nodes(self, mesh: trimesh.Trimesh, cameras: dict[int, Camera], frame: int) -> list[Any]:
        scene = self.client.scene
        nodes: list[Any] = [
            # Light is painted on: one that the scene added would shade it twice.
            scene.add_light_ambient("/ambient", intensity=math.pi),
            scene.add_mesh_trimesh("/room", mesh),
        ]
        for index, camera in cameras.items():
            k = camera.intrinsics
            here = index == frame
            frustum = scene.add_camera_frustum(
                f"/cameras/{index}",
                2 * float(np.arctan(0.5 * k.height / k.fy)),
                k.width / k.height,
                scale=0.12,
                color=(255, 140, 0) if here else (70, 70, 70),
                wxyz=quaternion(camera.pose),
                position=camera.origin,
                image=self.painting.picture[::4, ::4] if here and self.painting is not None else None,
            )
            frustum.on_click(functools.partial(self._go_to, index))
            nodes.append(frustum)
        return nodes

    def _hide_room(self) -> None:
        for node in list(self._nodes):
            node.visible = False

    def _go_to(self, index: int, _: Any) -> None:
        self.go(index)

    # ---- tools ----

    def take(self, tool: str | None) -> None:
        """Take a tool into the hand that points at the scene, instead of whatever is in it."""
        self._put_down()
        self.tool = tool
        if tool is None:
            return
        how_to = HOW_TO.get(tool, "Now click where the lamp goes.")
        self._told = self.client.add_notification(tool.capitalize(), how_to, auto_close_seconds=HOW_TO_SECONDS)
        if tool == "window":  # until it is drawn, dragging does not turn the camera
            self.client.scene.on_rect_select()(asked_by(self.tour, Viewer._drew))

    def _put_down(self) -> str | None:
        tool, self.tool = self.tool, None
        self.client.scene.remove_rect_select_callback()
        if self._told is not None:  # it is in the way of what comes next
            self._told.remove()
            self._told = None
        return tool

    def _clicked(self, event: Any) -> None:
        if (tool := self._put_down()) is not None:
            self.tour.click(self, tool, event.ray_origin, event.ray_direction)

    def _drew(self, event: Any) -> None:
        if self._put_down() is None:
            return
        (left, top), (right, bottom) = event.screen_min, event.screen_max
        across, down = np.linspace(left, right, GRID), np.linspace(top, bottom, GRID)
        grid = np.stack(np.meshgrid(across, down), axis=-1)
        camera = self.client.camera
        rays = rays_through(grid.reshape(-1, 2), camera.wxyz, camera.fov, sensible_aspect(camera))
        self.tour.draw(self, camera.position, rays.reshape(GRID, GRID, 3))


def guarded(tour: "Tour", handler: Callable[[Any], None]) -> Callable[[Any], Any]:
    """A handler of what a browser sends, in the order in which it is sent; see `Viewer.answering`.

    Changes that the server makes to its own controls are not passed on.
    """

    async def handle(event: Any) -> None:
        viewer = tour.viewers.get(event.client_id)
        if event.client is not None and viewer is not None:
            with viewer.answering():
                handler(event)

    return handle


def asked_by(tour: "Tour", handler: Callable[[Viewer, Any], None]) -> Callable[[Any], None]:
    """A handler of what may take its time, on a thread of its own; it is given who asks."""

    def handle(event: Any) -> None:
        viewer = tour.viewers.get(event.client_id)
        if viewer is not None:
            with viewer.answering():
                handler(viewer, event)

    return handle


def within(value: Any, low: float, high: float) -> float:
    """A number that a browser sent, brought into its range; the nearest to 0 that is there, if it is none."""
    number = float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
    return min(max(number, low), high)


def quaternion(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4"]:
    """Rotation of a pose as w, x, y, z."""
    wxyz: np.ndarray = viser.transforms.SO3.from_matrix(np.asarray(pose)[:3, :3]).wxyz
    return wxyz
