"""Downloads of a tour: picture, lights, mesh, page and video, written to its folder and sent to the page that asks.

Files appear whole or not at all.
"""

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import numpy as np

from hyjax.configuration import Configuration
from hyjax.data.light_file import write_lights
from hyjax.data.video_frames import new_video
from hyjax.geometry.mesh import save_mesh
from hyjax.light.setup import LightSetup
from hyjax.scene.scene import Scene
from hyjax.tour.messages import Message, packed
from hyjax.tour.plan import TourPlan
from hyjax.tour.render_queue import RenderQueue
from hyjax.tour.renderer import Renderer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.tour.visitor import Answer, refusal
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write
from hyjax.util.images import write_exr, write_png

FRAME_RATE = 12
DOWNLOADS = ("png", "exr", "lights", "mesh", "page", "video")
"""Tasks whose answer is a file."""


PageWriter = Callable[[Scene, LightSetup, Configuration, None, Path], object]
"""Writer of a page with some frames of a scene, such as `hyjax.export.web.write_page`."""


class Downloads:
    """Files of a tour."""

    def __init__(
        self, renderer: Renderer, out: Path, queue: RenderQueue, write_page: PageWriter | None = None
    ) -> None:
        self._renderer, self._out, self._queue, self._write_page = renderer, out, queue, write_page
        self._lock, self._writing = threading.Lock(), threading.Lock()
        self._making = set[str]()

    def answer(self, message: Message, viewpoint: Viewpoint, send: Callable[[Answer], None]) -> Answer | None:
        """File that a message asks for; None for a video and a page, which are sent when they are made."""
        task, plan, renderer = message.task, message.plan, self._renderer
        if task in ("video", "page"):
            with self._lock:
                if task in self._making:
                    raise InputError(f"a {task} is being made; ask for the next one when it is there")
                self._making.add(task)
            if task == "video":
                self._queue.add_job(self._video(message, viewpoint, send))
            else:
                arguments = message, viewpoint, send
                threading.Thread(target=self._page, args=arguments, name="tour's page", daemon=True).start()
            return None
        if task in ("png", "exr"):
            rendered = renderer.render(plan, viewpoint)
            name = f"{rendered.frame.name}.relit.{task}"
            if task == "png":
                picture = rendered.picture.astype(np.float32) / 255.0
                return self._written(message, name, lambda file: write_png(file, picture))
            return self._written(message, name, lambda file: write_exr(file, rendered.linear))
        if task == "lights":
            setup = renderer.lighting.setup(plan)
            return self._written(message, "lights.json", lambda file: write_lights(file, setup))
        mesh = renderer.scene.apply_to_mesh(plan)
        return self._written(message, "mesh.ply", lambda file: save_mesh(file, mesh))

    def _written(self, message: Message, name: str, write: Callable[[Path], object]) -> bytes:
        """Write a file and read it back before another visitor's takes its place."""
        file = self._out / name
        with self._writing:
            write(file)
            return sent(message, file)

    def _video(self, message: Message, viewpoint: Viewpoint, send: Callable[[Answer], None]) -> Generator[None]:
        with self._sending(message, send, "relit.mp4") as file:
            yield from write_video(self._renderer, message.plan, viewpoint, file)

    def _page(self, message: Message, viewpoint: Viewpoint, send: Callable[[Answer], None]) -> None:
        """Make a page of the room and these lights, that needs no server; furniture is where it was scanned."""
        renderer = self._renderer
        with self._sending(message, send, "room.html") as file:
            if self._write_page is None or not isinstance(renderer.place, Scene):
                raise InputError("page: frames are still arriving; a page is made of a capture that is whole")
            configuration = dataclasses.replace(renderer.configuration, schedule=viewpoint.schedule)
            self._write_page(renderer.place, renderer.lighting.setup(message.plan), configuration, None, file)

    @contextlib.contextmanager
    def _sending(self, message: Message, send: Callable[[Answer], None], name: str) -> Iterator[Path]:
        """File that takes long to make: sent at the end, or the reason why it was not made."""
        file = self._out / name
        answer: Answer | None = None
        try:
            yield file
            answer = sent(message, file)
        except InputError as error:
            answer = refusal(error, message.number)
        except Exception:
            answer = refusal(InputError(f"the {message.task} was not made; see the terminal"), message.number)
            raise
        finally:  # who has the answer may ask for the next one at once
            self._making.discard(message.task)
            if answer is not None:
                send(answer)


def sent(message: Message, file: Path) -> bytes:
    """Answer with a file."""
    return packed({"number": message.number, "file": file.name, "written": str(file)}, file.read_bytes())


def write_video(renderer: Renderer, plan: TourPlan, viewpoint: Viewpoint, file: Path) -> Generator[None]:
    """Relight the whole capture into an MP4 file, one frame a step.

    Args:
        renderer, plan, viewpoint: as for `Renderer.render`; of the viewpoint, all but its frame and camera.
    """
    height, width = (side - side % 2 for side in renderer.frame(0).camera.intrinsics.shape)  # as videos want
    with atomic_write(file) as temporary, new_video(temporary, (height, width), FRAME_RATE, crf="18") as add:
        for index in range(len(renderer.capture)):
            each = Viewpoint(index, viewpoint.shown, viewpoint.schedule)
            add(renderer.render(plan, each, seconds=index / FRAME_RATE).picture[:height, :width])
            yield
