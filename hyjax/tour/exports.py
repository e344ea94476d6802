"""What one takes home from a tour: the picture, the set-up, a video. Files appear whole or not at all."""

from collections.abc import Callable, Generator
from pathlib import Path

import av
import numpy as np

from hyjax.data.light_file import write_lights
from hyjax.files import whole
from hyjax.images import write_exr, write_png
from hyjax.scene.mesh import save_mesh
from hyjax.tour.lighting import setup_of
from hyjax.tour.painting import Painting, View
from hyjax.tour.plan import Plan
from hyjax.tour.studio import Studio

FRAME_RATE = 12


def export_view(painting: Painting, out: Path) -> list[Path]:
    """Write what is shown as a PNG and the relit picture's linear values as an EXR; returns the files."""
    png, exr = (out / f"{painting.frame.name}.relit.{suffix}" for suffix in ("png", "exr"))
    write_png(png, painting.picture.astype(np.float32) / 255.0)
    write_exr(exr, painting.linear)
    return [png, exr]


def export_setup(studio: Studio, plan: Plan, out: Path) -> list[Path]:
    """Write the lights file, and the mesh if any furniture is not where it was scanned; returns the files."""
    _, setup = setup_of(plan, studio.up, studio.surface)
    files = [out / "lights.json"]
    write_lights(files[0], setup)
    if plan.pieces:
        files.append(out / "mesh.ply")
        save_mesh(files[1], studio.house.arranged_mesh(plan))
    return files


def video_job(studio: Studio, plan: Plan, view: View, out: Path, done: Callable[[Path], None]) -> Generator[None]:
    """Relight the whole capture into an MP4 file, one frame a step.

    Args:
        studio, plan, view: as for `Studio.paint`; of the view, all but its frame.
        out: folder.
        done: called with the file.
    """
    file = out / "relit.mp4"
    with whole(file) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        height, width = studio.frame(0).camera.intrinsics.shape
        stream = container.add_stream("libx264", rate=FRAME_RATE)
        stream.width, stream.height = width - width % 2, height - height % 2  # as the colour format wants
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "18"}
        for index in range(len(studio.capture)):
            painting = studio.paint(plan, View(index, view.shown, view.schedule), seconds=index / FRAME_RATE)
            picture = np.ascontiguousarray(painting.picture[: stream.height, : stream.width])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            yield
        container.mux(stream.encode())
    done(file)
