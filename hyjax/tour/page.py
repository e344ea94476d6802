"""The room tour as a web page, served by viser.

Controls of the plan belong to the server, so that all viewers share them; those of a view to its
viewer. Handlers only change the plan and tell the render queue whose picture is out of date.
"""

import contextlib
import time
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import viser

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.guide.choose import configured_guide
from hyjax.scene.scene import Scene
from hyjax.scene.settings import parse_size
from hyjax.tour.controls import Controls
from hyjax.tour.gizmos import Gizmos
from hyjax.tour.layers import RenderCancelled
from hyjax.tour.render_queue import RenderQueue
from hyjax.tour.renderer import Renderer
from hyjax.tour.server import address, check_port, open_server
from hyjax.tour.session import Session
from hyjax.tour.settings import TourSettings
from hyjax.tour.viewer import Viewer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.hosts import LOCAL

if TYPE_CHECKING:
    from hyjax.tour.arriving import Arriving

WIDEST = 640
"""Pixels of the pictures, unless another size is given."""


class Tour:
    """A tour of a capture, served until it is stopped.

    Attributes:
        session: plan and selection, shared by all viewers.
        viewers: by the number of their browser.
        url: address of the page.
        arriving: frames that arrive; None unless the tour is live.

    Args:
        renderer: renders the pictures.
        schedules: to choose from, by name; the first is the default.
        out: folder that exports and the plan are written to, and nothing else is.
        host, port: where to listen.
    """

    def __init__(
        self,
        renderer: Renderer,
        schedules: Mapping[str, Schedule],
        out: Path,
        *,
        host: str = LOCAL,
        port: int = 8080,
    ) -> None:
        self.queue = RenderQueue(self._render)
        self.session = Session(renderer, schedules, out, self.queue)
        self.viewers: dict[int, Viewer] = {}
        self.arriving: Arriving | None = None
        self._started = time.monotonic()
        self.server = open_server(host, port)
        self.url = address(host, self.server)
        self.server.scene.set_up_direction(tuple(renderer.up))
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self.gizmos = Gizmos(self.session, self.server.scene, self.viewers)
        self.controls = Controls(self.session, self.server.gui, self.viewers)
        self.session.on_change, self.session.on_select = self._plan_changed, self._selection_changed
        self.gizmos.draw()
        self.queue.start()
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._disconnected)

    @classmethod
    def open(cls, settings: TourSettings) -> "Tour":
        """Open a scene and serve its tour.

        Raises:
            InputError: the scene cannot be opened, or anything that the class refuses.
        """
        # All that can be checked is checked before the first slow step.
        settings.check()
        check_port(settings.host, settings.port)
        configuration, schedules = settings.open_configuration(), settings.open_schedules()
        configuration = configuration.followed_by(settings.renderer)
        configured_guide(configuration.guide)
        if settings.live is not None:
            make_writable(settings.out)
            return cls._open_live(settings, schedules, configuration)
        named = settings.scene.capture
        capture = None if named is None else settings.scene.open_capture()
        make_writable(settings.out)
        scene = Scene.open(settings.scene, capture=capture, progress=not settings.quiet)
        height, width = scene.capture.camera(0).intrinsics.shape
        if scene.size is None and width > WIDEST:
            scene.size = round(height * WIDEST / width), WIDEST
        # Estimates the photo's own light, if it was not before: some ten seconds, with a bar.
        renderer = Renderer(
            scene,
            folder=settings.out,
            keep_photo_light=settings.keep_photo_light,
            configuration=configuration,
        )
        return cls(renderer, schedules, settings.out, host=settings.host, port=settings.port)

    @classmethod
    def _open_live(
        cls, settings: TourSettings, schedules: Mapping[str, Schedule], configuration: Configuration
    ) -> "Tour":
        """Wait for the first frames, and serve a tour that follows them."""
        from hyjax.live.scene import LiveScene
        from hyjax.tour.arriving import Arriving

        scene = LiveScene()
        arriving = Arriving(scene, settings.live or "", size=parse_size(settings.scene.size), widest=WIDEST)
        renderer = arriving.first_renderer(settings.out, configuration)
        tour = cls(renderer, schedules, settings.out, host=settings.host, port=settings.port)
        arriving.on_frame = tour._frame_arrived
        tour.arriving = arriving
        return tour

    def warm_up(self) -> None:
        """Compile the first viewers' likely requests, while the queue is empty."""
        viewpoint = Viewpoint(0, "relit", next(iter(self.session.schedules.values())))
        self.queue.add_job(self.session.renderer.warm_up(self.session.plan, viewpoint))

    def stop(self) -> None:
        """Save the plan and end the server."""
        self.session.save()
        if self.arriving is not None:
            self.arriving.stop()
        self.queue.stop()
        for viewer in list(self.viewers.values()):
            viewer.close()
        self.server.stop()

    def _frame_arrived(self) -> None:
        for viewer in list(self.viewers.values()):
            viewer.frame_arrived()

    def _plan_changed(self, redraw: bool) -> None:
        if redraw:
            self.gizmos.draw()
        self.controls.show_plan()
        self.queue.request(*self.viewers)

    def _selection_changed(self) -> None:
        self.controls.show_selected()
        self.gizmos.draw()

    def _render(self, number: Hashable, draft: bool) -> bool:
        """Render for one viewer; returns whether a finer picture is still to come."""
        viewer = self.viewers.get(number)  # type: ignore[call-overload]
        if viewer is None:
            return False
        begun = time.perf_counter()
        try:
            with viewer.notices.show_wait() if draft else contextlib.nullcontext():
                rendered = self.session.renderer.render(
                    self.session.plan,
                    viewer.controls.viewpoint(),
                    draft=draft,
                    seconds=time.monotonic() - self._started,
                    cancelled=lambda: not draft and self.queue.has_interactive,
                )
        except RenderCancelled:  # a draft is more urgent; then again
            return True
        except InputError as error:
            viewer.notices.refuse(error)
            return False
        except Exception:
            viewer.notices.fail()
            raise
        viewer.show(rendered, time.perf_counter() - begun, latest=draft)
        return rendered.draft

    def _connected(self, client: viser.ClientHandle) -> None:
        viewer = Viewer(self.session, client, self.controls.show_plan)
        self.viewers[client.client_id] = viewer
        if client.client_id not in self.server.get_clients():  # disconnected meanwhile
            self._disconnected(client)
            return
        self.queue.request(client.client_id)
        viewer.notices.notify(
            "Room tour", "Drag the hour, or put a lamp somewhere. Drag the picture to look around.", seconds=10
        )
        for title, text in self.session.notices:
            viewer.notices.notify(title, text, color="yellow", seconds=20)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        self.queue.remove(client.client_id)
        viewer = self.viewers.pop(client.client_id, None)
        if viewer is not None:
            viewer.close()
