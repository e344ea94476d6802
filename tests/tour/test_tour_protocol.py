"""The tour's server, visited without a browser: pictures, what pages ask for, downloads, the set-up kept."""

import base64
import io
import json
import queue
import re
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

import av
import msgspec
import trimesh
from box_room import CUBE, TOP, BoxCapture, box_room, moved
from visits import SCHEDULES, WAIT, box_tour, visiting

from hyjax.data.builtin_room import UP
from hyjax.data.light_file import read_lights
from hyjax.export.web import write_page
from hyjax.light.kinds import PointLight
from hyjax.light.setup import LightSetup
from hyjax.scene.scene import Scene
from hyjax.tour.messages import Message
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import Piece, TourPlan, Window
from hyjax.tour.renderer import Renderer
from hyjax.tour.tour import Tour
from hyjax.tour.viewpoint import Viewpoint
from hyjax.tour.visitor import Answer
from hyjax.tour.wire import listen
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

LAMP = place_lamp("bulb", np.array([0.9, -0.6, 1.0]), UP)
PLAN = TourPlan(hour=0.0, windows=(Window((1.98, 0.0, 1.3), (-1.0, 0.0, 0.0)),), lamps=(LAMP,)).check()
DIM = replace(PLAN, lamps=(replace(LAMP, lumen=100.0),))
AWAY = replace(PLAN, pieces=(Piece(tuple(TOP.tolist()), removed=True),))


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    tour = box_tour(tmp_path_factory.mktemp("tour"))
    yield tour
    tour.stop()


def got(url: str, **headers: str) -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=60) as answer:
        content: bytes = answer.read()
        return content


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference of means of 4x4 pixels: the pictures are noise, which JPEG files keep badly."""
    means = np.asarray(a, float) - b
    rows, columns = means.shape[0] // 4, means.shape[1] // 4
    return float(np.abs(means.reshape(rows, 4, columns, 4, 3).mean(axis=(1, 3))).mean())


# ---- pictures ----


def test_the_picture_is_that_of_the_renderer(tour: Tour) -> None:
    with visiting(tour) as visit:
        for shown in ("relit", "photo", "normals", "visibility", "conductances"):
            wanted = tour.renderer.render(PLAN, Viewpoint(1, shown, tour.schedules["hyjax"])).picture
            assert apart(visit.picture(PLAN, frame=1, shown=shown), wanted) < 3, shown


def test_a_change_of_a_lamp_arrives_and_visitors_have_lights_of_their_own(tour: Tour) -> None:
    with visiting(tour) as one, visiting(tour) as other:
        bright, dim = one.picture(PLAN), other.picture(DIM)
        assert apart(bright, dim) > 5
        assert apart(one.picture(PLAN), bright) == 0
        assert apart(one.picture(replace(PLAN, lamps=())), bright) > 5


def test_coarse_shadows_first_and_fine_ones_when_it_rests(tour: Tour) -> None:
    lamp = replace(LAMP, position=(-0.4, -0.9, 1.7))
    with visiting(tour) as visit:
        coarse = visit.picture(replace(PLAN, lamps=(lamp,)), draft=True)
        head, _ = visit.receive()
        assert head["picture"] == 1 and not head["draft"]
        assert apart(visit.picture(replace(PLAN, lamps=(lamp,))), coarse) > 0


def test_the_newest_change_comes_first_and_stale_ones_are_dropped(tour: Tour) -> None:
    with visiting(tour) as visit:
        for step in range(12):
            lamp = replace(LAMP, position=(0.9, -1.5 + 0.1 * step, 1.4))
            last = visit.send("picture", replace(PLAN, lamps=(lamp,)), view={"shown": "raw filter"})
        numbers = []
        while not numbers or numbers[-1] != last:
            numbers.append(visit.receive()[0]["picture"])
        assert numbers == sorted(numbers) and len(set(numbers)) < 12


def test_a_camera_leaves_the_photo(tour: Tour) -> None:
    """The mesh is lit where there is no photo; beside the frame's own camera it looks alike."""
    pose = tour.renderer.camera(0).pose
    camera = [pose[:3, k].tolist() for k in range(4)]
    with visiting(tour) as visit:
        there = visit.picture(PLAN, camera=camera)
        elsewhere = visit.picture(PLAN, camera=[*camera[:3], [0, 0, 1.2]])
        assert there.std() > 5 and apart(there, elsewhere) > 5
        skewed = visit.ask(
            "surface", PLAN, view={"camera": [[1, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 0]]}, places=[[1, 1]]
        )
        assert "unit vectors" in skewed["refused"]


# ---- what pages ask for ----


def test_the_page_and_its_frames_are_served(tour: Tour) -> None:
    page = json.loads(got(f"{tour.url}/page.json"))
    assert page["size"] == [48, 64] and len(page["frames"]) == 2
    assert page["server"]["schedules"] == ["hyjax", "paper-50"] and page["server"]["engine"] == "auto"
    assert b"<canvas" in got(tour.url) and b"import" in got(f"{tour.url}/main.js")
    photo = read_image_of(got(f"{tour.url}/{page['frames'][1]['file']}"))
    assert apart(photo, 255 * tour.renderer.frame(1).image) < 3
    gpu = json.loads(got(f"{tour.url}/gpu.json"))
    assert gpu["programs"] and len(got(f"{tour.url}/{gpu['file']['name']}")) > 1000
    for name in ("no.js", "frames/2.jpg", "frames/99999999.jpg", "..%2f..%2fsetup.py", "tour.json", "%00"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            got(f"{tour.url}/{name}")


def read_image_of(content: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(content)))


def test_daylight_in_words_and_lights(tour: Tour) -> None:
    with visiting(tour) as visit:
        noon, night = (visit.ask("daylight", replace(PLAN, hour=hour)) for hour in (15.0, 0.0))
    assert "21 June, 15:00 solar time: sun" in noon["said"]
    assert "moonlight" in night["said"] or "dark" in night["said"]
    assert {light["kind"] for light in noon["lights"]} <= {"rect", "directional"}
    assert noon["lumen"] > 100 * night["lumen"] and 2000 < noon["kelvin"] < 12000


def pixel(tour: Tour, point: Any) -> list[float]:
    camera = tour.renderer.camera(0)
    x, y, z = camera.pose[:3, :3].T @ (np.asarray(point) - camera.origin)
    k = camera.intrinsics
    return [float(k.fx * x / z + k.cx), float(k.fy * y / z + k.cy)]


def test_the_surface_at_a_pixel(tour: Tour) -> None:
    raised = replace(PLAN, pieces=(Piece(tuple(TOP.tolist()), pose=moved((0.0, 0.0, 0.5))),))
    above = pixel(tour, TOP + np.array((0.0, 0.0, 0.5)))
    with visiting(tour) as visit:
        top = visit.ask("surface", PLAN, places=[pixel(tour, TOP)])
        np.testing.assert_allclose(top["point"], TOP, atol=1e-3)
        np.testing.assert_allclose(top["normal"], UP, atol=1e-6)
        there = visit.ask("surface", raised, places=[above])
        np.testing.assert_allclose(there["point"], TOP + np.array((0.0, 0.0, 0.5)), atol=1e-3)
        assert "needs a place" in visit.ask("surface", PLAN)["refused"]


def test_furniture_is_picked_by_a_pixel(tour: Tour) -> None:
    with visiting(tour) as visit:
        new = visit.ask("furniture", PLAN, places=[pixel(tour, TOP)])["new"]
        np.testing.assert_allclose(new["centre"], CUBE, atol=0.1)
        known = replace(PLAN, pieces=(Piece(tuple(new["seed"])),))
        again = visit.ask("furniture", known, places=[pixel(tour, TOP)])
        assert again["piece"] == 0
        floor = visit.ask("furniture", PLAN, places=[pixel(tour, (-0.6, -0.6, 0.0))])
        assert "no piece of its own" in floor["refused"]
        before, after = visit.picture(PLAN, shown="raw filter"), visit.picture(AWAY, shown="raw filter")
        assert apart(before, after) > 1


def test_windows_are_drawn_and_clicked(tour: Tour) -> None:
    wall = np.array([0.4, 2.5, 1.6])
    with visiting(tour) as visit:
        click = visit.ask("window", PLAN, places=[pixel(tour, wall)])["window"]
        np.testing.assert_allclose(click["center"], wall, atol=0.15)
        np.testing.assert_allclose(click["normal"], (0, -1, 0), atol=1e-6)
        x, y = pixel(tour, wall)
        drawn = visit.ask("window", PLAN, places=[[x - 4, y - 3], [x + 4, y + 3]])["window"]
        np.testing.assert_allclose(drawn["center"], wall, atol=0.2)
        assert 0.3 < drawn["width"] < 2 and 0.3 < drawn["height"] < 2
        assert "too small" in visit.ask("window", PLAN, places=[[x, y], [x + 0.2, y + 0.2]])["refused"]
        assert "one place or two" in visit.ask("window", PLAN)["refused"]
        full = replace(PLAN, windows=PLAN.windows * 8)
        assert "at most 8" in visit.ask("window", full, places=[pixel(tour, wall)])["refused"]


def test_a_mesh_is_brought_in_parts(tour: Tour) -> None:
    out = tour.kept._file.parent
    content = trimesh.creation.box((0.4, 0.4, 0.4)).export(file_type="ply")
    half = len(content) // 2
    with visiting(tour) as visit:
        told: dict[str, Any] = {"name": "box.ply", "rest": len(content) - half}
        assert visit.ask("bring", PLAN, part=content[:half], **told)["got"] == half
        piece = visit.ask("bring", PLAN, part=content[half:], name="box.ply")["new"]
        assert (out / piece["file"]).read_bytes() == content
        brought = replace(PLAN, pieces=(msgspec.convert(piece, Piece),))
        assert apart(visit.picture(PLAN, shown="normals"), visit.picture(brought, shown="normals")) > 1
        assert "at most 64 MiB" in visit.ask("bring", PLAN, name="box.ply", part=b"a", rest=1 << 40)["refused"]
        assert "give a mesh as" in visit.ask("bring", PLAN, name="box.exe", part=b"a")["refused"]
        assert visit.ask("bring", PLAN, name="box.ply", part=b"no mesh")["refused"].startswith("box.ply: ")
        assert len(list(out.glob("mesh-*"))) == 1
        visit.ask("bring", PLAN, part=b"a", **told)
        assert tour._uploads._parts
    end = time.monotonic() + 20
    while tour._uploads._parts and time.monotonic() < end:
        time.sleep(0.05)
    assert not tour._uploads._parts, "it broke off"


# ---- downloads ----


def test_downloads(tour: Tour, tmp_path: Path) -> None:
    out = tour.kept._file.parent
    with visiting(tour) as visit:
        files = {task: visit.ask(task, AWAY) for task in ("png", "exr", "lights", "mesh", "page", "video")}
    for task, answer in files.items():
        assert (out / answer["file"]).read_bytes() == answer["content"], task
        (tmp_path / answer["file"]).write_bytes(answer["content"])
    picture = tour.renderer.render(AWAY, Viewpoint(0, "relit", tour.schedules["hyjax"]))
    assert apart(255 * read_image(tmp_path / "0.relit.png"), picture.picture) < 1e-3
    np.testing.assert_allclose(read_image(tmp_path / "0.relit.exr"), picture.linear, rtol=1e-2, atol=1e-3)
    setup = read_lights(tmp_path / "lights.json", UP)
    assert [light.position.tolist() for light in setup.lights if isinstance(light, PointLight)] == [
        pytest.approx(LAMP.position)
    ]
    assert len(trimesh.load(tmp_path / "mesh.ply").faces) < len(tour.renderer.scene.mesh.faces)
    (held,) = re.findall(r'id="files">(.*?)</script>', (tmp_path / "room.html").read_text())
    page = json.loads(base64.b64decode(json.loads(held)["page.json"]))
    assert [light["position"] for light in page["setup"]["lights"] if "position" in light] == [
        pytest.approx(LAMP.position)
    ]
    with av.open(str(tmp_path / "relit.mp4")) as video:
        assert sum(1 for _ in video.decode(video=0)) == 2


def test_while_a_page_is_made_everything_else_goes_on(tmp_path: Path) -> None:
    asked, go_on = threading.Event(), threading.Event()

    def write_page(scene: Scene, setup: LightSetup, *_: Any) -> None:
        asked.set()
        assert go_on.wait(WAIT)
        raise InputError("page: the disk is full")

    tour = box_tour(tmp_path, write_page=write_page)
    try:
        with visiting(tour) as visit, visiting(tour) as other:
            assert json.loads(got(f"{tour.url}/page.json"))["server"]["page"]
            number = visit.send("page", PLAN)
            assert asked.wait(WAIT)
            assert "a page is being made" in other.ask("page", PLAN)["refused"]
            assert "content" in other.ask("lights", PLAN)
            assert visit.picture(PLAN).any()
            go_on.set()
            assert visit.answer(number)["refused"] == "page: the disk is full"
            assert "is being made" not in other.ask("page", PLAN)["refused"]
    finally:
        go_on.set()
        tour.stop()


def test_who_is_sent_a_page_may_ask_for_the_next_at_once(tmp_path: Path) -> None:
    def write_page(*_: Any) -> None:
        raise InputError("page: the disk is full")

    tour = box_tour(tmp_path, write_page=write_page)
    sent, message = queue.Queue[Answer](), Message("page", 1, PLAN)
    viewpoint = Viewpoint(0, "relit", SCHEDULES["hyjax"])

    def ask_again(answer: Answer) -> None:
        tour._downloads.answer(message, viewpoint, sent.put)
        sent.put(answer)

    try:
        tour._downloads.answer(message, viewpoint, ask_again)
        assert all(b"the disk is full" in msgspec.json.encode(sent.get(timeout=WAIT)) for _ in range(2))
    finally:
        tour.stop()


def test_a_tour_that_keeps_the_photos_light_has_a_page_of_its_own_and_makes_none(tmp_path: Path) -> None:
    renderer = Renderer(Scene(BoxCapture(), box_room()), folder=tmp_path, keep_photo_light=True)
    tour = Tour(renderer, SCHEDULES, tmp_path, port=0, write_page=write_page)
    try:
        server = json.loads(got(f"{tour.url}/page.json"))["server"]
        assert server["engine"] == "server" and not server["page"]
    finally:
        tour.stop()


# ---- the set-up that is kept ----


def test_what_was_set_up_last_is_what_the_next_visitor_begins_with(tmp_path: Path) -> None:
    tour = box_tour(tmp_path)
    try:
        with visiting(tour) as visit:
            visit.send("keep", DIM)
            visit.ask("daylight", DIM)
            assert json.loads(got(f"{tour.url}/page.json"))["server"]["plan"]["lamps"][0]["lumen"] == 100
            with pytest.raises(InputError, match="already in use"):
                listen("127.0.0.1", int(tour.url.rpartition(":")[2]))
            end = time.monotonic() + 20
            while not (tmp_path / "tour.json").is_file() and time.monotonic() < end:
                time.sleep(0.05)
        assert TourPlan.from_json((tmp_path / "tour.json").read_text()) == DIM
    finally:
        tour.stop()
    (tmp_path / "tour.json").write_text('{"hour": 99}')
    with pytest.raises(InputError, match="remove it to begin anew"):
        box_tour(tmp_path)


def test_a_page_that_only_ticks_overwrites_nothing_that_others_set_up(tour: Tour) -> None:
    with visiting(tour) as idle, visiting(tour) as other:
        idle.picture(PLAN)
        other.picture(DIM)
        idle.picture(PLAN, seconds=1.0)
        idle.picture(PLAN, seconds=1.0, frame=1)
        assert tour.kept.plan == DIM
        idle.picture(replace(PLAN, hour=15.0))
        assert tour.kept.plan == replace(PLAN, hour=15.0)
