"""The room tour: its page, the pictures of its visitors, and the set-up that is kept."""

import time
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.guide.choose import configured_guide
from hyjax.scene.scene import Scene
from hyjax.scene.settings import parse_size
from hyjax.tour import tasks
from hyjax.tour.downloads import DOWNLOADS, Downloads, PageWriter
from hyjax.tour.kept_plan import KeptPlan
from hyjax.tour.layers import RenderCancelled
from hyjax.tour.messages import Message, packed
from hyjax.tour.page_files import PageFiles
from hyjax.tour.render_queue import RenderQueue
from hyjax.tour.renderer import Renderer
from hyjax.tour.settings import Engine, TourSettings
from hyjax.tour.uploads import Uploads
from hyjax.tour.viewpoint import Viewpoint, scale_schedule
from hyjax.tour.visitor import Visitor, refusal
from hyjax.tour.wire import Wire, listen
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.hosts import LOCAL
from hyjax.util.images import picture_file

if TYPE_CHECKING:
    from hyjax.tour.arriving import Arriving

JPEG_QUALITY = 90
WIDEST = 640
"""Pixels of the pictures, unless another size is given."""


class Tour:
    """A tour of a capture, served until it is stopped.

    Each message of a page holds all that its visitor has set up, so that every visitor has lights and furniture of
    their own. What was set up last is kept, and new visitors begin with it.

    Attributes:
        kept: what was set up last.
        arriving: frames that arrive; None unless the tour is live.

    Args:
        schedules: to choose from, by name; the first is the default.
        out: folder that exports and the plan are written to, and nothing else is.
        write_page: writer of pages that visitors take home; None for a live tour, which makes none.
    """

    def __init__(
        self,
        renderer: Renderer,
        schedules: Mapping[str, Schedule],
        out: Path,
        *,
        engine: Engine = "auto",
        host: str = LOCAL,
        port: int = 8080,
        write_page: PageWriter | None = None,
    ) -> None:
        self.renderer, self.schedules, self.kept = renderer, dict(schedules), KeptPlan(renderer, out)
        self.visitors: dict[int, Visitor] = {}
        self.arriving: Arriving | None = None
        notices, light = self.kept.notices, renderer.photo_light
        if light is not None and light.estimate.exponent == 0:
            notices.append(f"The photos keep their own light: it could not be estimated, {light.estimate.reason}.")
        self.queue = RenderQueue(self._render)
        self._downloads = Downloads(renderer, out, self.queue, write_page)
        self._uploads = Uploads(renderer, out)
        self._files = PageFiles(renderer, self.schedules, engine, notices)
        self._wire = Wire(host, port, lambda path: self._files.get(path, self.kept.plan), self._visit)
        self.url = self._wire.url
        self.queue.start()

    @classmethod
    def open(cls, settings: TourSettings, write_page: PageWriter) -> "Tour":
        """Open a scene and serve its tour."""
        # All that can be checked is checked before the first slow step.
        settings.check()
        listen(settings.host, settings.port).close()
        configuration, schedules = settings.open_configuration(), settings.open_schedules()
        configuration = configuration.followed_by(settings.renderer)
        configured_guide(configuration.guide)
        options: dict[str, Any] = {"engine": settings.engine, "host": settings.host, "port": settings.port}
        if settings.live is not None:
            make_writable(settings.out)
            return cls._open_live(settings, schedules, configuration, options)
        named = settings.scene.capture
        capture = None if named is None else settings.scene.open_capture()
        make_writable(settings.out)
        scene = Scene.open(settings.scene, capture=capture, progress=not settings.quiet)
        height, width = scene.capture.camera(0).intrinsics.shape
        if scene.size is None and width > WIDEST:
            scene.size = round(height * WIDEST / width), WIDEST
        # Estimates the photo's own light, if it was not before: some ten seconds, with a bar.
        renderer = Renderer(
            scene, folder=settings.out, keep_photo_light=settings.keep_photo_light, configuration=configuration
        )
        return cls(renderer, schedules, settings.out, write_page=write_page, **options)

    @classmethod
    def _open_live(
        cls,
        settings: TourSettings,
        schedules: Mapping[str, Schedule],
        configuration: Configuration,
        options: Mapping[str, Any],
    ) -> "Tour":
        """Wait for the first frames, and serve a tour that follows them."""
        from hyjax.live.scene import LiveScene
        from hyjax.tour.arriving import Arriving

        arriving = Arriving(LiveScene(), settings.live or "", size=parse_size(settings.scene.size), widest=WIDEST)
        tour = cls(arriving.first_renderer(settings.out, configuration), schedules, settings.out, **options)
        arriving.on_frame = tour._frame_arrived
        tour.arriving = arriving
        return tour

    def warm_up(self) -> None:
        """Compile the first visitors' likely requests, while the queue is empty."""
        viewpoint = Viewpoint(0, "relit", next(iter(self.schedules.values())))
        self.queue.add_job(self.renderer.warm_up(self.kept.plan, viewpoint))

    def stop(self) -> None:
        """Save the plan and end the server."""
        self.kept.save()
        if self.arriving is not None:
            self.arriving.stop()
        self.queue.stop()
        self._wire.stop()

    # ---- visitors ----

    async def _visit(self, connection: ServerConnection) -> None:
        visitor = Visitor(connection, self._requested, self._answer)
        self.visitors[id(visitor)] = visitor
        try:
            await visitor.run()
        finally:
            del self.visitors[id(visitor)]
            self.queue.remove(id(visitor))
            self._uploads.drop(id(visitor))

    def _requested(self, visitor: Visitor, last: Message | None) -> None:
        message = visitor.message
        assert message is not None
        if last is None or message.plan != last.plan:  # candles and frames alone set nothing up
            self.kept.keep(message.plan)
        pieces = message.plan.pieces
        if any(piece.as_scanned for piece in pieces) and (last is None or last.plan.pieces != pieces):
            self.queue.add_job(self.renderer.lift(message.plan, self._viewpoint(message)))
        changed = last is None or not message.differs_in_time_only(last)
        self.queue.request(id(visitor), interactive=changed)

    def _answer(self, visitor: Visitor, message: Message) -> str | bytes | None:
        if message.task == "keep":
            self.kept.keep(message.plan)
            return None
        if message.task in DOWNLOADS:
            viewpoint = self._viewpoint(message)
            return self._downloads.answer(message, viewpoint, visitor.send)
        if message.task == "bring":
            return tasks.reply(message, self._uploads.take(id(visitor), message))
        return tasks.answer(self.renderer, message)

    def _viewpoint(self, message: Message) -> Viewpoint:
        view = message.view
        last = len(self.renderer.capture) - 1
        schedule = self.schedules.get(view.schedule, next(iter(self.schedules.values())))
        camera = None if view.camera is None else tasks.camera_of(self.renderer, message)
        scaled = scale_schedule(schedule, view.steps, 10.0**view.kappa)
        return Viewpoint(min(view.frame, last), view.shown, scaled, camera)

    def _render(self, number: Hashable, draft: bool) -> bool:
        """Render for one visitor; returns whether a finer picture is still to come."""
        visitor = self.visitors.get(number)  # type: ignore[call-overload]
        if visitor is None or (message := visitor.message) is None:
            return False
        begun = time.perf_counter()
        try:
            rendered = self.renderer.render(
                message.plan,
                self._viewpoint(message),
                draft=draft,
                seconds=message.view.seconds,
                cancelled=lambda: not draft and self.queue.has_interactive,
            )
        except RenderCancelled:  # a draft is more urgent; then again
            return True
        except InputError as error:
            visitor.send(refusal(error, message.number))
            return False
        except Exception:
            visitor.send(refusal(InputError("something went wrong; see the terminal"), message.number))
            raise
        head = {
            "picture": message.number,
            "draft": rendered.draft,
            "unseen": rendered.unseen,
            "reach": [lamp and lamp._asdict() for lamp in rendered.reach],
            "milliseconds": rendered.milliseconds | {"whole picture": 1e3 * (time.perf_counter() - begun)},
        }
        visitor.show(packed(head, picture_file(rendered.picture, quality=JPEG_QUALITY, subsampling=0)))
        return rendered.draft

    def _frame_arrived(self, forgotten: bool) -> None:
        """Tell all visitors of a new frame; all frames have other numbers if some were forgotten."""
        count = len(self.renderer.capture)
        first = 0 if forgotten else count - 1
        entries = [self._files.entry(index) for index in range(first, count)]
        bounds = self.renderer.scene.mesh.bounds.tolist()
        for visitor in list(self.visitors.values()):
            visitor.tell(frames=count, entries=entries, numbering=self.renderer.numbering, bounds=bounds)
