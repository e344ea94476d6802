"""The tour in a real browser: what a visitor does, and what the page then shows."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from browser import Page, until

from experiments.browser import browser
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.data.light_file import read_lights
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tour.editable_scene import SurfaceHit
from hyjax.tour.page import Tour
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import MOST_LAMPS, Piece
from hyjax.tour.renderer import Renderer
from hyjax.tour.screen import background_size
from hyjax.tour.server import check_port
from hyjax.tour.tools import add_mesh
from hyjax.tour.viewer import Viewer
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

SCHEDULES = {name: Schedule.preset(name) for name in ("hyjax", "paper-50")}
UP = np.array([0.0, 0.0, 1.0])
FRAME, WIPE, HOUR = 0, 1, 2  # sliders, from the top


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture
def chromium(browser_wanted: None) -> Iterator[Any]:
    """A browser for one test: without a GPU it takes both cores as long as it is open."""
    with browser() as launched:  # asked for: one that is missing fails
        yield launched


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def scanned(room: RoomCapture) -> Scene:
    """The room as a phone scans it: its photo light is estimated faster than on the true mesh."""
    return Scene.open(SceneSettings(), capture=room)


@pytest.fixture
def tour(room: RoomCapture, tmp_path: Path) -> Iterator[Tour]:
    tour = Tour(Renderer(scanned(room), folder=tmp_path), SCHEDULES, tmp_path, port=free_port())
    yield tour
    tour.stop()


def on_screen(tour: Tour, page: Page, point: Any, frame: int = 0) -> tuple[float, float]:
    """Pixels of the scene where a point of the room is."""
    camera, box = tour.session.renderer.camera(frame), page.box()
    _, _, angle = background_size(camera, box["width"] / box["height"])
    x, y, z = camera.pose[:3, :3].T @ (np.asarray(point, float) - camera.origin)
    scale = 0.5 * box["height"] / np.tan(0.5 * angle)
    return 0.5 * box["width"] + scale * x / z, 0.5 * box["height"] + scale * y / z


def wall(tour: Tour) -> SurfaceHit:
    """A place on a bare wall, in view of the first frame."""
    scene, camera = tour.session.renderer.scene, tour.session.renderer.camera(0)
    for ray in camera.rays()[10:-40:4, 20:-20:4].reshape(-1, 3):
        touch = scene.pick(tour.session.plan, camera.origin.tolist(), ray.tolist())
        if touch is None or abs(touch.normal @ UP) > 0.05:
            continue
        across = np.cross(UP, touch.normal)
        around = [
            touch.point + 0.45 * (a * across + b * UP) - camera.origin for a in (-1, 0, 1) for b in (-1, 0, 1)
        ]
        points, _ = scene.visible_surface(tour.session.plan, camera.origin, np.stack(around))
        flat = len(points) == 9 and np.abs((points - touch.point) @ touch.normal).max() < 0.03
        facing = -touch.normal @ ray / np.linalg.norm(ray) > 0.7
        if flat and facing:
            return touch
    raise AssertionError("no bare wall in view")


def table(tour: Tour) -> np.ndarray:
    """A point on top of something that stands in the room, in view of the first frame."""
    scene, camera = tour.session.renderer.scene, tour.session.renderer.camera(0)
    rays = camera.rays()
    for row in range(camera.intrinsics.height - 8, camera.intrinsics.height // 2, -2):
        for column in range(20, camera.intrinsics.width - 20, 4):
            touch = scene.pick(tour.session.plan, camera.origin.tolist(), rays[row, column].tolist())
            if touch is not None and touch.normal[2] > 0.99 and 0.3 < touch.point[2] < 0.9:
                return touch.point
    raise AssertionError("no table in view")


@pytest.mark.slow
def test_a_visit(tour: Tour, room: RoomCapture, chromium: Any, tmp_path: Path) -> None:
    """Evening comes, a lamp is put somewhere, the photo is wipe_photo over, all is taken home."""
    page = Page(chromium, tour)
    afternoon = page.picture()
    assert afternoon.std() > 10, "there is a picture"

    page.slide(HOUR, 0.96)
    until(lambda: tour.session.plan.hour > 22)
    evening = page.picture()
    assert np.abs(evening - afternoon).mean() > 5

    page.press("Bulb")
    page.click(*on_screen(tour, page, table(tour)))
    until(lambda: tour.session.plan.lamps)
    (lamp,) = tour.session.plan.lamps
    np.testing.assert_allclose(lamp.position[:2], table(tour)[:2], atol=0.05)
    page.press("Done")
    lit = page.picture()
    assert np.abs(lit - evening).mean() > 2

    page.slide(WIPE, 0.5)
    half = page.picture()
    middle = half.shape[1] // 2
    changed = np.abs(half - lit).mean(axis=(0, 2))
    assert changed[middle - 200 : middle - 80].mean() > 5 and changed[middle + 80 : middle + 200].mean() < 1
    page.slide(WIPE, 0.0)

    page.unfold("Take home")
    for name, files in (("The lights", ["lights.json"]), ("This picture", ["000.relit.png", "000.relit.exr"])):
        page.press(name)
        for file in files:
            until((tmp_path / file).is_file)
    setup = read_lights(tmp_path / "lights.json", room.up)
    again = tmp_path / "again"
    settings = RelightSettings(frames="0", exr=True, out=again, quiet=True)
    relight_capture(settings, scene=scanned(room), lights=setup, schedule=SCHEDULES["hyjax"])
    ours, theirs = (read_image(folder / "000.relit.exr") for folder in (tmp_path, again))
    np.testing.assert_allclose(ours, theirs, rtol=0.02, atol=2e-3)

    page.page.reload()
    page.shown()
    back = page.picture()
    assert np.abs(back - lit).mean() < 2, "reloaded, it is as it was"


@pytest.mark.slow
def test_a_piece_of_furniture_is_moved(tour: Tour, chromium: Any) -> None:
    page = Page(chromium, tour)
    before = page.picture()
    page.unfold("Furniture")
    page.press("Pick up")
    page.click(*on_screen(tour, page, table(tour)))
    until(lambda: tour.session.plan.pieces)
    (piece,) = tour.session.plan.pieces
    mesh = tour.session.renderer.scene.piece_mesh(piece)
    assert mesh is not None
    pivot = mesh.bounds.mean(axis=0)
    up = np.array([0.0, 0.0, 1.0])
    tip = pivot + 0.3 * up  # the gizmo's upright arrow
    page.picture()
    page.drag(on_screen(tour, page, tip), on_screen(tour, page, tip + 0.4 * up))
    until(lambda: tour.session.plan.pieces[0].matrix[2, 3] > 0.2)
    assert abs(tour.session.plan.pieces[0].matrix[0, 3]) < 0.05, "up only"
    page.press("Done")
    assert np.abs(page.picture() - before).mean() > 0.3, "its shadow is another"


@pytest.mark.slow
def test_a_window_is_drawn_on_a_wall(tour: Tour, chromium: Any) -> None:
    page = Page(chromium, tour)
    before = page.picture()
    place = wall(tour)
    across, high = np.cross(UP, place.normal), UP
    page.press("Add a window")
    page.page.get_by_text("draw a rectangle on a wall").wait_for()
    page.page.wait_for_timeout(500)
    corners = (place.point + 0.3 * (high - across), place.point + 0.3 * (across - high))
    page.drag(*(on_screen(tour, page, corner) for corner in corners))
    until(lambda: len(tour.session.plan.windows) == 2)
    window = tour.session.plan.windows[-1]
    assert window.normal == pytest.approx(place.normal, abs=0.1)
    assert window.center == pytest.approx(place.point, abs=0.15)
    assert 0.4 < window.width < 0.8 and 0.4 < window.height < 0.8
    page.press("Done")
    assert np.abs(page.picture() - before).mean() > 1
    page.drag((300.0, 300.0), (340.0, 300.0))
    page.page.get_by_role("button", name="Back into the picture").wait_for()  # dragging turns the camera again


@pytest.mark.slow
def test_two_visitors_share_the_room_but_not_the_view(tour: Tour, chromium: Any) -> None:
    first, second = Page(chromium, tour), Page(chromium, tour)
    until(lambda: len(tour.viewers) == 2)
    second.slide(FRAME, 1.0)
    until(lambda: sorted(viewer.frame for viewer in tour.viewers.values()) == [0, 5])
    before = first.picture(), second.picture()
    assert np.abs(before[0] - before[1]).mean() > 5
    first.slide(HOUR, 0.9)
    until(lambda: tour.session.plan.hour > 20)
    after = first.picture(), second.picture()
    assert all(np.abs(a - b).mean() > 3 for a, b in zip(before, after)), "evening for both"
    second.page.close()
    until(lambda: len(tour.viewers) == 1)


@pytest.mark.slow
def test_dragging_the_scene_leaves_the_picture_and_the_button_goes_back(tour: Tour, chromium: Any) -> None:
    page = Page(chromium, tour)
    before = page.picture()
    box = page.box()
    page.page.wait_for_timeout(1500)
    page.drag((0.5 * box["width"], 0.5 * box["height"]), (0.7 * box["width"], 0.5 * box["height"]))
    page.page.get_by_role("button", name="Back into the picture").wait_for()
    assert np.abs(page.picture() - before).mean() > 10
    page.press("Back into the picture")
    back = page.picture()
    assert np.abs(back - before).mean() < 2


@pytest.mark.slow
def test_a_server_that_was_stopped_goes_on(tour: Tour, chromium: Any, tmp_path: Path) -> None:
    page = Page(chromium, tour)
    page.slide(HOUR, 0.2)
    until(lambda: tour.session.plan.hour < 6)
    plan, port = tour.session.plan, tour.server.get_port()
    dark = page.picture()
    tour.stop()
    again = Tour(tour.session.renderer, SCHEDULES, tmp_path, port=port)
    try:
        assert again.session.plan == plan
        page.tour = again
        until(lambda: again.viewers)  # the page comes back by itself
        until(lambda: next(iter(again.viewers.values())).rendered)
        assert np.abs(page.picture() - dark).mean() < 2
    finally:
        again.stop()


@pytest.mark.slow
def test_nonsense_gets_a_notice_and_the_server_goes_on(tour: Tour, chromium: Any) -> None:
    page = Page(chromium, tour)
    (viewer,) = tour.viewers.values()
    lamp = place_lamp("bulb", np.zeros(3), np.array([0.0, 0.0, 1.0]))
    tour.session.change(lamps=(lamp,) * MOST_LAMPS)
    viewer.click("bulb", tour.session.renderer.camera(0).origin, tour.session.renderer.camera(0).pose[:3, 2])
    page.page.get_by_text(f"at most {MOST_LAMPS} on a tour").wait_for()
    plan = tour.session.plan
    viewer.click("bulb", tour.session.renderer.camera(0).origin, (0.0, float("nan"), "up"))
    page.page.get_by_text("a ray must be").wait_for()
    upload(tour, viewer, "../../x.txt", b"hello")
    page.page.get_by_text("give a mesh as").wait_for()
    upload(tour, viewer, "x.ply", b"not a mesh")
    until(lambda: page.page.get_by_text("x.ply").count())
    send_nonsense(tour)
    assert tour.session.plan == plan, "numbers that are none change nothing"
    assert not list(tour.session.out.glob("mesh-*"))
    page.slide(HOUR, 0.2)
    until(lambda: tour.session.plan.hour < 6)


def upload(tour: Tour, viewer: Viewer, name: str, content: bytes) -> None:
    """What the button "Bring a mesh" does."""
    with viewer.show_errors():
        add_mesh(tour.session, viewer.frame, name, content)


def send_nonsense(tour: Tour) -> None:
    """Messages that no page sends: noise, and numbers that are none for every shared slider."""
    import msgspec
    import viser
    from websockets.sync.client import connect

    url = tour.url.replace("http", "ws")
    for noise in (b"", b"\x00\xff", msgspec.msgpack.encode({"type": "NoSuchMessage"}), b"[" * 1000):
        with connect(url, subprotocols=[f"viser-v{viser.__version__}"]) as wire:  # type: ignore[list-item]
            wire.send(noise)
    camera = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 0), "look_at": (0, 0, 1), "up_direction": (0, 1, 0)}
    camera |= {"fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 1, "image_width": 10**7}
    with connect(url, subprotocols=[f"viser-v{viser.__version__}"]) as wire:  # type: ignore[list-item]
        wire.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage"} | camera))
        until(lambda: len(tour.viewers) == 2)  # a visitor now, with a scene as wide as a city
        for control in tour.controls._fields.values():
            for value in (float("nan"), 1e300, -1e6, "text", None, [1, 2]):
                message = {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": {"value": value}}
                wire.send(msgspec.msgpack.encode(message))
        time.sleep(2.0)
    until(lambda: len(tour.viewers) == 1)


def test_pages_of_other_sites_are_hung_up_on(tour: Tour) -> None:
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    url, wanted = tour.url.replace("http", "ws"), [f"viser-v{viser.__version__}"]
    foreign = connect(url, subprotocols=wanted, origin="http://elsewhere.example")  # type: ignore[arg-type]
    with foreign as wire, pytest.raises(ConnectionClosed, match="1008"):
        while True:
            wire.recv(timeout=10)
    with connect(url, subprotocols=wanted, origin=tour.url) as wire:  # type: ignore[arg-type]
        assert wire.recv(timeout=10)


@pytest.mark.slow
def test_a_mesh_is_brought_and_a_video_taken_home(tour: Tour, chromium: Any, tmp_path: Path) -> None:
    import trimesh

    page = Page(chromium, tour)
    (viewer,) = tour.viewers.values()
    content = trimesh.creation.box((0.4, 0.4, 1.2)).export(file_type="ply")
    upload(tour, viewer, "stool.ply", content)
    (piece,) = tour.session.plan.pieces
    assert (tmp_path / piece.file).is_file()
    mesh = tour.session.renderer.scene.piece_mesh(piece)
    assert mesh is not None
    lowest = (mesh.vertices @ piece.matrix[:3, :3].T + piece.matrix[:3, 3])[:, 2].min()
    assert -0.05 < lowest < 1.0, "it stands on something"
    page.unfold("Take home")
    page.press("A video")
    until((tmp_path / "relit.mp4").is_file)
    import av

    with av.open(str(tmp_path / "relit.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == len(tour.session.renderer.capture) and frames[0].shape == (120, 160, 3)
    assert np.abs(frames[0].astype(float) - frames[-1]).mean() > 5


# ---- without a browser ----


def test_a_port_in_use_is_one_clear_line(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port}"):
            check_port("127.0.0.1", port)
        command = [
            str(Path(sys.executable).with_name("hyjax")),
            "tour",
            "--port",
            str(port),
            "--out",
            str(tmp_path / "o"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and done.stderr.startswith(f"hyjax: port {port}") and done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_a_damaged_set_up_is_told_by_name(room: RoomCapture, tmp_path: Path) -> None:
    (tmp_path / "tour.json").write_text(json.dumps({"hour": 99}))
    with pytest.raises(InputError, match=r"tour\.json.*hour"):
        Tour(Renderer(scanned(room)), SCHEDULES, tmp_path, port=free_port())


def test_nothing_is_shared_with_the_world(tour: Tour) -> None:
    assert tour.server.get_host() == "127.0.0.1" and tour.server.request_share_url() is None
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.2", tour.server.get_port())) != 0


def test_what_is_not_there_any_more_cannot_be_chosen(tour: Tour) -> None:
    lamp = place_lamp("bulb", np.zeros(3), UP)
    tour.session.change(redraw=True, lamps=(lamp, lamp))
    tour.session.select(("lamps", 1))
    tour.session.change(redraw=True, lamps=(lamp,))  # by somebody else
    tour.session.select(("lamps", 1))
    assert tour.session.selected is None
    tour.session.remove("lamps", 0)
    tour.gizmos.draw()


def test_a_mesh_file_goes_with_the_plan_that_named_it(tour: Tour, tmp_path: Path) -> None:
    file = tmp_path / "mesh-1.ply"
    file.write_bytes(b"")
    piece = Piece((0.0, 0.0, 0.0), file=file.name)
    with tour.session.lock:
        tour.session.plan = replace(tour.session.plan, pieces=(piece,))
    tour.session.reset()
    assert file.is_file(), "the kept plan may still name it"
    tour.session.save()
    assert not file.exists() and (tmp_path / "tour.json").is_file()
