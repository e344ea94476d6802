"""The room tour as a web page: one plan that all viewers share, served by viser.

Controls of the plan belong to the server, so that every viewer sees and moves the same; those of a view to each
viewer. Handlers only change the plan and tell the easel who is out of date.
"""

import contextlib
import dataclasses
import functools
import logging
import threading
import time
from collections.abc import Generator, Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import viser
from jaxtyping import Float

from hyjax.errors import InputError
from hyjax.files import make_writable, whole, write_text
from hyjax.schedule import Schedule
from hyjax.tour.controls import Controls
from hyjax.tour.door import LOCAL, address, open_door
from hyjax.tour.easel import Easel
from hyjax.tour.exports import export_setup, export_view, video_job
from hyjax.tour.handles import Handles
from hyjax.tour.painting import View
from hyjax.tour.place import check_rays, draw_window, place_lamp, place_window
from hyjax.tour.plan import Piece, Plan
from hyjax.tour.studio import Studio, Unwanted
from hyjax.tour.viewer import Viewer

SAVED = "tour.json"
SAVE_AFTER = 0.5
"""Seconds after a change until the plan is kept."""
MOST_UPLOADED = 64 * 2**20
UPLOADS = (".ply", ".obj", ".glb")
_log = logging.getLogger(__name__)


class Tour:
    """A tour of a capture, served until it is stopped.

    Attributes:
        plan: what is set up just now; replaced, never changed.
        viewers: by the number of their browser.
        url: where the page is.
        lock: held while what is set up, or what is chosen, changes.

    Args:
        studio: paints.
        schedules: to choose from, by name; the first is taken.
        out: folder that exports and the plan are written to, and nothing else is.
        host, port: where to listen.

    Raises:
        InputError: the port is in use, the folder cannot be written, or a plan in it makes no sense.
    """

    def __init__(
        self,
        studio: Studio,
        schedules: Mapping[str, Schedule],
        out: Path,
        *,
        host: str = LOCAL,
        port: int = 8080,
    ) -> None:
        make_writable(out)
        self.studio, self.schedules, self.out = studio, dict(schedules), out
        self.plan = self._kept_plan()
        self.viewers: dict[int, Viewer] = {}
        self.easel = Easel(self._paint)
        self.lock = threading.RLock()
        self._unused: set[str] = set()
        self._saving: threading.Timer | None = None
        self._begun = time.monotonic()
        self.server = open_door(host, port)
        self.url = address(host, self.server)
        self.server.scene.set_up_direction(tuple(studio.up))
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self.handles = Handles(self)
        self.controls = Controls(self)
        self.handles.draw()
        self.easel.start()
        self.server.on_client_connect(self._come)
        self.server.on_client_disconnect(self._go)

    def warm_up(self) -> None:
        """Compile what the first visitors may ask for, while nobody asks for anything."""
        view = View(0, "relit", next(iter(self.schedules.values())))
        self.easel.work_on(self.studio.warm_up(self.plan, view))

    def stop(self) -> None:
        """Keep the plan and end the server."""
        self._save()
        self.easel.stop()
        for viewer in list(self.viewers.values()):
            viewer.leave()
        self.server.stop()

    # ---- the plan ----

    def change(self, *, redraw: bool = False, **changes: Any) -> None:
        """Replace parts of the plan, for all viewers.

        Args:
            redraw: whether things have come, gone or been moved by something else than their handles.
            changes: fields of `Plan`.

        Raises:
            InputError: the plan would make no sense; it stays as it was.
        """
        with self.lock:
            before = self.plan
            self.plan = dataclasses.replace(before, **changes).check()
            self._unused |= before.files - self.plan.files
        if redraw:
            self.handles.draw()
        self.controls.follow()
        self.easel.want(*self.viewers)
        self._save_soon()

    def replace(self, kind: str, index: int, *, redraw: bool = False, **changes: Any) -> None:
        """Change one of the plan's `windows`, `lamps` or `pieces`."""
        with self.lock:
            things = list(getattr(self.plan, kind))
            if index < len(things):
                things[index] = dataclasses.replace(things[index], **changes)
                self.change(redraw=redraw, **{kind: tuple(things)})

    def remove(self, kind: str, index: int) -> None:
        """Take one of them out of the plan."""
        with self.lock:
            things = list(getattr(self.plan, kind))
            if index < len(things):
                del things[index]
                self.handles.select(None)
                self.change(redraw=True, **{kind: tuple(things)})

    def click(self, viewer: Viewer, tool: str, origin: Any, direction: Any) -> None:
        """A viewer has clicked into the scene with a tool."""
        with viewer.answering():
            start, ray = check_rays(origin, direction)
            touch = self.studio.house.touch(self.plan, start, ray)
            if touch is None:
                raise InputError("there is no surface here; click on a wall, the floor or a thing")
            if tool == "window":
                self._add("windows", place_window(touch.point, touch.normal, self.studio.up))
            elif tool == "furniture":
                self._pick(touch.piece, touch.origin)
            else:
                self._add("lamps", place_lamp(tool, touch.point, touch.normal))  # type: ignore[arg-type]

    def draw(self, viewer: Viewer, origin: Any, rays: Float[np.ndarray, "n n 3"]) -> None:
        """A viewer has drawn a window: rays through a rectangle, row by row."""
        with viewer.answering():
            start, rays = check_rays(origin, rays)
            points, normals = self.studio.house.seen(self.plan, start, rays.reshape(-1, 3))
            corners = rays[[0, 0, -1, -1], [0, -1, -1, 0]]
            self._add("windows", draw_window(start, corners, points, normals, self.studio.up))

    def _add(self, kind: str, thing: Any) -> None:
        """Add to the plan's `windows`, `lamps` or `pieces`, and choose it."""
        with self.lock:
            things = (*getattr(self.plan, kind), thing)
            self.change(redraw=True, **{kind: things})
            self.handles.select((kind, len(things) - 1))

    def _pick(self, number: int | None, point: np.ndarray) -> None:
        if number is None:
            x, y, z = (round(float(v), 4) for v in point)
            piece = Piece((x, y, z))
            self.studio.house.check_piece(piece)
            number = self.studio.house.same_piece(self.plan, piece)
            if number is None:
                self._add("pieces", piece)
                return
        self.handles.select(("pieces", number))

    def bring(self, viewer: Viewer, name: str, content: bytes) -> None:
        """Put a mesh file into the room, on the floor in front of the viewer."""
        with viewer.answering():
            suffix = Path(name).suffix.lower()
            if suffix not in UPLOADS:
                raise InputError(f"{Path(name).name}: give a mesh as {', '.join(UPLOADS)}, in metres")
            if not 0 < len(content) <= MOST_UPLOADED:
                raise InputError(f"{Path(name).name}: {len(content)} bytes; give a mesh of at most 64 MiB")
            file = f"mesh-{int(time.time() * 1e3):x}{suffix}"
            with whole(self.out / file) as temporary:
                temporary.write_bytes(content)
            try:
                self._add("pieces", self._brought(viewer, file))
            except Exception as error:
                (self.out / file).unlink(missing_ok=True)
                if isinstance(error, InputError):
                    raise InputError(str(error).replace(str(self.out / file), Path(name).name)) from None
                raise

    def _brought(self, viewer: Viewer, file: str) -> Piece:
        piece = Piece((0.0, 0.0, 0.0), file=file)
        mesh = self.studio.house.piece_mesh(piece)
        assert mesh is not None
        if not 0.02 < max(mesh.extents) < 10:
            raise InputError(f"{file}: spans {max(mesh.extents):.3g} m; furniture must be in metres")
        camera = self.studio.camera(viewer.view().frame)
        height, width = camera.intrinsics.shape
        ahead = camera.rays()[height * 2 // 3, width // 2]
        touch = self.studio.house.touch(self.plan, camera.origin, ahead)
        place = camera.origin + camera.pose[:3, 2] if touch is None else touch.point
        pose = np.eye(4)
        lowest = float((mesh.vertices @ self.studio.up).min())
        centre = mesh.bounds.mean(axis=0)
        foot = centre + (lowest - centre @ self.studio.up) * self.studio.up
        pose[:3, 3] = place - foot
        return dataclasses.replace(piece, pose=tuple(pose.reshape(-1).tolist()))

    def warn_if_hidden(self, viewer: Viewer, index: int) -> None:
        """Tell whoever has put a lamp where its light cannot get out."""
        lamps = self.plan.lamps
        if index < len(lamps) and self.studio.house.hidden(self.plan, lamps[index].position):
            where = "This lamp is inside a wall or a thing, or outside the room: its light hardly gets out."
            viewer.say("Is it meant there?", where, color="yellow")

    def flickers(self) -> bool:
        """Whether the picture changes by itself."""
        return any(lamp.kind == "candle" and lamp.on for lamp in self.plan.lamps)

    # ---- painting ----

    def _paint(self, number: Hashable, draft: bool) -> bool:
        viewer = self.viewers.get(number)  # type: ignore[call-overload]
        if viewer is None:
            return False
        begun = time.perf_counter()
        view, plan = viewer.view(), self.plan
        try:
            with viewer.patience() if draft else contextlib.nullcontext():
                painting = self.studio.paint(
                    plan,
                    view,
                    draft=draft,
                    seconds=time.monotonic() - self._begun,
                    unwanted=lambda: not draft and self.easel.pressing,
                )
        except Unwanted:  # somebody waits for a draft; then again
            return True
        except InputError as error:
            viewer.refuse(error)
            return False
        except Exception:
            viewer.fail()
            raise
        viewer.show(painting, time.perf_counter() - begun, latest=draft)
        return painting.draft

    # ---- exports ----

    def save_view(self, viewer: Viewer) -> None:
        """Write the viewer's picture as PNG and EXR, and let the browser download both."""
        painting = viewer.painting
        if painting is None or painting.draft:
            painting = self.studio.paint(self.plan, viewer.view())
        for file in export_view(painting, self.out):
            viewer.client.send_file_download(file.name, file.read_bytes())
        viewer.say("Saved", f"Also in {self.out}", color="green")

    def save_setup(self, viewer: Viewer) -> None:
        """Write the lights file, and the mesh if furniture was moved."""
        files = export_setup(self.studio, self.plan, self.out)
        for file in files:
            viewer.client.send_file_download(file.name, file.read_bytes())
        names = " --mesh ".join(str(file) for file in files)
        height, width = self.studio.camera(viewer.frame).intrinsics.shape
        command = f"hyjax relight --lights {names} --size {width}x{height} --out relit"
        viewer.say(
            "Saved", f"All frames in this light (add your --capture): {command}", color="green", seconds=None
        )

    def save_video(self, viewer: Viewer) -> None:
        """Relight the whole capture as a video, while nobody needs the machine for anything else."""
        viewer.say("Video", f"{len(self.studio.capture)} frames are being relit; you can go on meanwhile")
        self.easel.work_on(self._film(viewer))

    def _film(self, viewer: Viewer) -> Generator[None]:
        done = functools.partial(self._filmed, viewer)
        try:
            yield from video_job(self.studio, self.plan, viewer.view(), self.out, done)
        except Exception as error:
            viewer.say("The video was not made", str(error), color="red", seconds=None)
            raise

    def _filmed(self, viewer: Viewer, file: Path) -> None:
        viewer.client.send_file_download(file.name, file.read_bytes())
        viewer.say("Video", f"Saved as {file}", color="green")

    # ---- coming and going ----

    def _come(self, client: viser.ClientHandle) -> None:
        viewer = Viewer(self, client)
        self.viewers[client.client_id] = viewer
        if client.client_id not in self.server.get_clients():  # gone meanwhile
            self._go(client)
            return
        self.easel.want(client.client_id)
        viewer.say(
            "Room tour", "Drag the hour, or put a lamp somewhere. Drag the picture to look around.", seconds=10
        )

    def _go(self, client: viser.ClientHandle) -> None:
        self.easel.forget(client.client_id)
        viewer = self.viewers.pop(client.client_id, None)
        if viewer is not None:
            viewer.leave()

    # ---- keeping the plan ----

    def _kept_plan(self) -> Plan:
        file = self.out / SAVED
        if not file.is_file():
            return self.studio.first_plan()
        try:
            return Plan.from_json(file.read_text(encoding="utf-8"))
        except (InputError, UnicodeDecodeError) as error:
            raise InputError(f"{file}: {error}; remove it to begin anew, or choose another --out") from None

    def _save_soon(self) -> None:
        with self.lock:
            if self._saving is None:
                self._saving = threading.Timer(SAVE_AFTER, self._save)
                self._saving.daemon = True
                self._saving.start()

    def _save(self) -> None:
        with self.lock:
            if self._saving is not None:
                self._saving.cancel()
                self._saving = None
            try:
                write_text(self.out / SAVED, self.plan.to_json() + "\n")
                for file in self._unused - self.plan.files:  # not before the kept plan does without
                    (self.out / file).unlink(missing_ok=True)
                self._unused.clear()
            except InputError as error:
                _log.warning("%s", error)
