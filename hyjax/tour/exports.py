"""Exports of a tour: picture, lights and video, written to its folder and sent to the browser that asks.

Files appear whole or not at all.
"""

from collections.abc import Generator
from pathlib import Path

import av
import numpy as np

from hyjax.data.light_file import write_lights
from hyjax.data.video_frames import new_video
from hyjax.geometry.mesh import save_mesh
from hyjax.tour.lighting import setup_of
from hyjax.tour.picture import RenderedFrame
from hyjax.tour.plan import TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.viewer import Viewer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.files import atomic_write
from hyjax.util.images import write_exr, write_png

FRAME_RATE = 12


def save_view(viewer: Viewer) -> None:
    """Save the viewer's picture as PNG and EXR."""
    session, rendered = viewer.session, viewer.rendered
    if rendered is None or rendered.draft:
        rendered = session.renderer.render(session.plan, viewer.controls.viewpoint())
    for file in write_view(rendered, session.out):
        _send(viewer, file)
    viewer.notices.notify("Saved", f"Also in {session.out}", color="green")


def save_setup(viewer: Viewer) -> None:
    """Save the lights file, and the mesh if furniture was moved."""
    session = viewer.session
    files = write_setup(session.renderer, session.plan, session.out)
    for file in files:
        _send(viewer, file)
    names = " --mesh ".join(str(file) for file in files)
    height, width = session.renderer.camera(viewer.frame).intrinsics.shape
    kept = " --keep-photo-light" if session.renderer.photo_light is None else ""
    command = f"hyjax relight --lights {names} --size {width}x{height}{kept} --out relit"
    viewer.notices.notify(
        "Saved", f"All frames in this light (add your --capture): {command}", color="green", seconds=None
    )


def save_video(viewer: Viewer) -> None:
    """Save a video of the whole capture, rendered while nothing else needs the machine."""
    count = len(viewer.session.renderer.capture)
    viewer.notices.notify("Video", f"{count} frames are being relit; you can go on meanwhile")
    viewer.session.queue.add_job(_video_job(viewer))


def write_view(rendered: RenderedFrame, out: Path) -> list[Path]:
    """Write the picture shown as a PNG and the relit frame's linear values as an EXR; returns the files."""
    png, exr = (out / f"{rendered.frame.name}.relit.{suffix}" for suffix in ("png", "exr"))
    write_png(png, rendered.picture.astype(np.float32) / 255.0)
    write_exr(exr, rendered.linear)
    return [png, exr]


def write_setup(renderer: Renderer, plan: TourPlan, out: Path) -> list[Path]:
    """Write the lights file, and the mesh if any furniture is not where it was scanned; returns the files."""
    files = [out / "lights.json"]
    write_lights(files[0], setup_of(plan, renderer.up, renderer.surface_area))
    if plan.pieces:
        files.append(out / "mesh.ply")
        save_mesh(files[1], renderer.scene.apply_to_mesh(plan))
    return files


def write_video(renderer: Renderer, plan: TourPlan, viewpoint: Viewpoint, file: Path) -> Generator[None]:
    """Relight the whole capture into an MP4 file, one frame a step.

    Args:
        renderer, plan, viewpoint: as for `Renderer.render`; of the viewpoint, all but its frame.
        file: to write.
    """
    with atomic_write(file) as temporary, new_video(temporary) as container:
        height, width = renderer.frame(0).camera.intrinsics.shape
        stream = container.add_stream("libx264", rate=FRAME_RATE)
        stream.width, stream.height = width - width % 2, height - height % 2  # as the colour format wants
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "18"}
        for index in range(len(renderer.capture)):
            each = Viewpoint(index, viewpoint.shown, viewpoint.schedule)
            rendered = renderer.render(plan, each, seconds=index / FRAME_RATE)
            picture = np.ascontiguousarray(rendered.picture[: stream.height, : stream.width])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            yield
        container.mux(stream.encode())


def _video_job(viewer: Viewer) -> Generator[None]:
    session = viewer.session
    file = session.out / "relit.mp4"
    try:
        yield from write_video(session.renderer, session.plan, viewer.controls.viewpoint(), file)
        _send(viewer, file)
        viewer.notices.notify("Video", f"Saved as {file}", color="green")
    except Exception as error:
        viewer.notices.notify("The video was not made", str(error), color="red", seconds=None)
        raise


def _send(viewer: Viewer, file: Path) -> None:
    viewer.client.send_file_download(file.name, file.read_bytes())
