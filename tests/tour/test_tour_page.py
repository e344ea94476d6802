"""The tour's page in a real browser, drawn by the server and by the visitor's own GPU."""

import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from extras import need
from msgspec.structs import replace

need("tour")

from browser import Page, until
from common import coarse_surface
from hands import Hand, check_keys
from legible import check_focus, check_legible
from visits import SCHEDULES

from experiments.browser import SOFTWARE_GPU, browser
from hyjax.data.builtin_room import UP, load_room
from hyjax.data.light_file import read_lights
from hyjax.scene.scene import Scene
from hyjax.tour import page_files, wire
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.tour import Tour
from hyjax.tour.viewpoint import Viewpoint

SCREEN, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
OTHER_LAMPS = """async () => {
  const { RemoteEngine } = await import("./remote_engine.js");
  const connection = Object.assign(new EventTarget(), { opened: Promise.resolve(), send: () => ++number });
  const canvas = document.createElement("div").appendChild(document.createElement("canvas"));
  let number = 0, state = { plan: "one lamp", view: { seconds: 0 } };
  const engine = new RemoteEngine(connection, () => state, canvas, { size: [1, 1] }, () => {}, () => {});
  const picture = new OffscreenCanvas(1, 1);
  picture.getContext("2d");
  const content = await (await picture.convertToBlob({ type: "image/jpeg" })).arrayBuffer();
  const found = [], note = () => found.push(engine.reach);
  const run = async (reach) => {
    const asked = engine.run();
    note();
    await new Promise(setTimeout);
    await engine.take({ head: { picture: number, reach }, content });
    await asked;
    note();
  };
  await run([1]);
  state = { ...state, view: { seconds: 1 } };
  note();
  state = { ...state, plan: "another lamp" };
  note();
  await run([2]);
  return found;
}"""


TOLD = """async ([told, name]) => {
  const { openDevice } = await import("./engine.js");
  const info = { description: name, ...told };
  const adapter = { features: new Set(), limits: {}, info, requestDevice: async () => ({}) };
  Object.defineProperty(navigator, "gpu", { value: { requestAdapter: async () => adapter }, configurable: true });
  const { isSoftware } = await openDevice();
  delete navigator.gpu;
  return isSoftware;
}"""
"""Whether an adapter of a name counts as made of software."""
FAST = "Object.defineProperty(GPUAdapterInfo.prototype, 'isFallbackAdapter', { get: () => false });"
"""A GPU that says it is none of software."""
BLACK = (
    "GPUBuffer.prototype.getMappedRange = function (offset, size) { return new ArrayBuffer(size ?? this.size); };"
)
"""A GPU all of whose pictures are black."""
ONCE = """
const { requestDevice } = GPUAdapter.prototype;
let opened = 0;
GPUAdapter.prototype.requestDevice = function (options) {
  if (opened++) throw new Error("no second device");
  return requestDevice.call(this, options);
};
"""
"""A GPU that is there but once."""
TURNED = """async () => {
  const { FlyingCamera } = await import("./camera.js");
  const axes = { right: [1, 0, 0], down: [0, 0, -1], forward: [0, 1, 0] };
  const camera = { ...axes, origin: [0, 0, 0], intrinsics: [9, 9, 5, 5] };
  const flying = new FlyingCamera(camera, [0, 0, 1], [[-5, -5, -5], [5, 5, 5]]);
  const after = (...keys) => flying.step(new Set(keys), 0.5) && [flying.camera.forward, flying.origin];
  return [after("ShiftLeft", "ArrowRight"), after("ShiftRight", "ArrowUp"), after("ShiftLeft"), after("ArrowUp")];
}"""
"""Where a camera looks and is after keys."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    room = load_room(n_frames=3, width=96, height=72, quality=0.25, progress=False)
    return Scene(room, coarse_surface(room))


def opened(scene: Scene, out: Path, engine: Any) -> Tour:
    return Tour(Renderer(scene, folder=out), SCHEDULES, out, port=0, engine=engine)


@pytest.fixture(scope="module")
def tour(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    tour = opened(scene, tmp_path_factory.mktemp("tour"), "auto")
    yield tour
    tour.stop()


@pytest.fixture(scope="module")
def chromium(browser_wanted: None) -> Iterator[Any]:
    """With a GPU made of software, which the page takes for none unless it must."""
    with browser(["--headless=new", *SOFTWARE_GPU]) as launched:
        yield launched


@pytest.fixture(scope="module")
def page(chromium: Any, tour: Tour) -> Iterator[Page]:
    page = Page(chromium, tour)
    yield page
    assert not page.errors


def apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(255 * np.abs(a - b).mean())


@pytest.mark.slow
def test_lamps_and_daylight_and_undo(page: Page) -> None:
    """Without a GPU the server draws; lamps are put and dragged, and every step is taken back."""
    assert "the server" in page.page.evaluate("hyjax.stats().adapter")
    afternoon = page.settled()
    page.slide("#daylight", "Hour", 22)
    night = page.settled()
    assert apart(night, afternoon) > 10
    assert "22:00 solar time: moonlight" in page.page.inner_text(".said")
    page.page.get_by_label("Open sky").check()
    assert apart(page.settled(), night) > 1 and page.plan["open_sky"]
    assert "open sky" in page.page.inner_text(".said")
    page.page.get_by_label("Open sky").uncheck()
    np.testing.assert_array_equal(page.settled(), night)
    page.page.get_by_label("Kind").select_option("candle")
    page.press("Add a lamp")
    page.page.mouse.click(*page.place(0.5, 0.75))
    until(lambda: page.plan["lamps"])
    page.slide("#lights", "Brightness", 0.7)
    assert page.plan["lamps"][0]["kind"] == "candle" and page.plan["lamps"][0]["lumen"] > 800
    page.page.emulate_media(reduced_motion="reduce")  # else it flickers
    lit = page.settled()
    assert apart(lit, night) > 5
    marker = page.page.locator(".marker:not(.handle)")
    before = page.plan["lamps"][0]["position"]
    marker.press("ArrowLeft")
    assert page.plan["lamps"][0]["position"] != before
    page.page.wait_for_timeout(500)
    page.page.keyboard.press("Control+z")
    assert page.plan["lamps"][0]["position"] == before
    np.testing.assert_array_equal(page.settled(), lit)
    for _ in range(8):
        if page.page.get_by_role("button", name="Undo").is_enabled():
            page.press("Undo")
    assert not page.plan["lamps"] and page.plan["hour"] == 16
    np.testing.assert_array_equal(page.settled(), afternoon)
    page.page.keyboard.press("Control+Shift+z")
    assert page.plan["hour"] == 22
    page.press("Undo")


@pytest.mark.slow
def test_windows_furniture_stages_and_flight(page: Page) -> None:
    first = page.settled()
    page.press("Draw a window")
    page.drag((0.5, 0.1), (0.72, 0.4))
    until(lambda: len(page.plan["windows"]) == 2)
    drawn = page.plan["windows"][1]
    opacity = "getComputedStyle(document.querySelector('#outline polygon:not(.selected)')).opacity"
    assert page.page.evaluate(opacity) == "1", "the mouse is on the picture"
    page.page.locator("#title").hover()
    assert page.page.evaluate(opacity) == "0"
    assert apart(page.settled(), first) > 0.5
    page.page.get_by_label("Upper right corner of window 2").press("ArrowRight")
    assert page.plan["windows"][1]["width"] == pytest.approx(drawn["width"] + 0.05, abs=1e-3)
    page.press("Remove")
    page.press("Pick a piece")
    page.page.mouse.click(*page.place(0.9, 0.8))
    until(lambda: page.plan["pieces"])
    before = page.settled()
    page.page.get_by_label("Piece 1").press("ArrowUp")
    page.slide("#furniture", "Turned", 30)
    pose = np.array(page.plan["pieces"][0]["pose"]).reshape(4, 4)
    np.testing.assert_allclose(pose[:2, :2], [[0.866, -0.5], [0.5, 0.866]], atol=1e-3)
    page.page.locator("#stages").select_option("normals")
    assert apart(page.settled(), before) > 10
    page.page.locator("#stages").select_option("result")
    page.press("Put back")
    assert not page.plan["pieces"]
    np.testing.assert_array_equal(page.settled(), first)
    page.press("Look around")
    page.drag((0.4, 0.2), (0.3, 0.3))
    assert apart(page.settled(), first) > 5
    page.press("Back to the photos")
    np.testing.assert_array_equal(page.settled(), first)


@pytest.mark.slow
def test_a_lamp_that_changes_nothing_says_why_and_grey_is_told(page: Page) -> None:
    page.page.get_by_label("Kind").select_option("candle")
    page.press("Add a lamp")
    page.page.mouse.click(*page.place(0.5, 0.75))
    page.page.locator("#notice", has_text="Candle changes nothing here: it adds less than 1 %").wait_for()
    assert "less than 1 %" in page.page.inner_text(".why")
    # Nothing is known of other lamps, neither before they are asked for nor until their picture has come.
    assert page.page.evaluate(OTHER_LAMPS) == [None, [1], [1], None, None, [2]]
    page.page.get_by_label("Candle is on").uncheck()
    page.page.locator(".why", has_text="it is switched off").wait_for()
    page.press("Start over")
    page.press("Pick a piece")
    page.page.mouse.click(*page.place(0.9, 0.8))
    until(lambda: page.plan["pieces"])
    page.page.get_by_label("Taken away").check()
    # Attached: on a busy machine the notice may be gone again when the box's click has been confirmed.
    page.page.locator("#notice", has_text="No photo shows what is grey here").wait_for(state="attached")
    page.press("Put back")


@pytest.mark.slow
def test_downloads_of_the_page(page: Page, tmp_path: Path) -> None:
    with page.page.expect_download() as download:
        page.press("Lights file")
    download.value.save_as(tmp_path / "lights.json")
    assert read_lights(tmp_path / "lights.json", page.tour.renderer.up).lights
    assert "the server has it" in page.page.inner_text("#notice")


@pytest.mark.slow
def test_lamps_and_meshes_without_a_pointer(page: Page, tmp_path: Path) -> None:
    """Buttons that are pressed by keys work in the middle of the picture."""
    trimesh.creation.box((0.4, 0.4, 0.4)).export(tmp_path / "box.ply")
    page.page.get_by_role("button", name="Add a lamp").press("Enter")
    until(lambda: page.plan["lamps"])
    page.page.set_input_files("input[type=file]", tmp_path / "box.ply")
    until(lambda: page.plan["pieces"])
    page.press("Start over")
    assert not page.plan["lamps"] and not page.plan["pieces"]


@pytest.mark.slow
def test_a_phone_has_the_picture_above_the_panel(chromium: Any, tour: Tour) -> None:
    page = Page(chromium, tour, PHONE)
    picture = page.page.locator("#picture").bounding_box()
    assert picture["width"] == PHONE["width"] and picture["y"] == 0
    assert page.page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    page.page.locator("#downloads").scroll_into_view_if_needed()
    assert page.page.locator("#picture").bounding_box()["y"] == 0, "it stays"
    assert not page.errors
    page.page.close()


def visitor(browser: Any, prepare: Callable[[Any], object] = lambda page: None, **more: Any) -> Any:
    """A browser whose pages are prepared before they are opened."""

    def new_page(**options: Any) -> Any:
        page = browser.new_page(**options, **more)
        prepare(page)
        return page

    return SimpleNamespace(new_page=new_page)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "touch"), [(SCREEN, False), (PHONE, True)], ids=["mouse", "touch"])
def test_everything_by_mouse_and_by_touch(
    chromium: Any, tour: Tour, size: dict[str, int], touch: bool, tmp_path: Path
) -> None:
    page = Page(visitor(chromium, has_touch=touch), tour, size)
    hand, button = Hand(page.page, touch=touch), functools.partial(page.page.get_by_role, "button", exact=True)
    hand.press_on(button(name="Start over"))
    first = page.settled()
    hand.slide(page.page.locator("#daylight").get_by_label("Hour", exact=True), 0.95)
    hand.slide(page.page.locator("#exposure"), 0.6)
    page.page.get_by_label("Weather").select_option("cloudy")
    plan = page.plan
    assert plan["hour"] > 22 and 0 < plan["exposure"] < 2 and plan["weather"] == "cloudy"
    night = page.settled()
    assert apart(night, first) > 5
    hand.press_on(button(name="Add a lamp"))
    hand.press(page.place(0.5, 0.75))
    until(lambda: page.plan["lamps"])
    hung = page.plan["lamps"]
    hand.drag(page.page.locator(".marker:not(.handle)"), -0.2 * size["width"] / 2)
    until(lambda: page.plan["lamps"] != hung)
    moved = page.plan["lamps"]
    assert np.linalg.norm(np.subtract(moved[0]["position"], hung[0]["position"])) > 0.2
    assert apart(page.settled(), night) > 1
    for name, lamps in (("Undo", hung), ("Undo", []), ("Redo", hung), ("Redo", moved)):
        hand.press_on(button(name=name))
        assert page.plan["lamps"] == lamps
    hand.press_on(button(name="Pick a piece"))
    hand.press(page.place(0.9, 0.8))
    until(lambda: page.plan["pieces"])
    pose = page.plan["pieces"][0]["pose"]
    hand.drag(page.page.locator(".marker.piece"), -40, 10)
    assert page.plan["pieces"][0]["pose"] != pose
    hand.press_on(button(name="Undo"))
    assert page.plan["pieces"][0]["pose"] == pose
    with page.page.expect_download() as download:
        hand.press_on(button(name="Video"))
    download.value.save_as(tmp_path / "relit.mp4")
    assert (tmp_path / "relit.mp4").read_bytes()[4:8] == b"ftyp"
    hand.press_on(button(name="Start over"))
    assert page.settled().std() > 0.05 and not page.errors
    page.page.close()


@pytest.mark.slow
def test_keys_turn_the_view_and_move_lamps_nearer(page: Page) -> None:
    """A lamp that was pressed takes them."""
    (right, there), (up, still), idle, (_, moved) = page.page.evaluate(TURNED)
    assert right[0] > 0.3 and up[2] > 0.3 and there == still == [0, 0, 0] and not idle and moved[1] > 0.3
    first = page.settled()
    page.press("Look around")
    for keys in (("Shift", "ArrowRight"), ("ArrowLeft",)):
        before = page.settled()
        for key in keys:
            page.page.keyboard.down(key)
        page.page.wait_for_timeout(300)
        for key in keys:
            page.page.keyboard.up(key)
        assert apart(page.settled(), before) > 1, keys
    assert "Shift and arrows" in page.page.inner_text("#hint")
    page.press("Back to the photos")
    np.testing.assert_array_equal(page.settled(), first)
    page.press("Add a lamp")
    page.page.mouse.click(*page.place(0.5, 0.75))
    until(lambda: page.plan["lamps"])
    marker = page.page.locator(".marker:not(.handle)")
    page.page.evaluate("document.activeElement.blur()")
    marker.click()

    def away() -> float:
        return float(np.linalg.norm(page.plan["lamps"][0]["position"] - page.tour.renderer.camera(0).origin))

    far = [away()]
    for key in ("PageDown", "PageUp", "PageUp"):
        page.page.keyboard.press(key)
        far.append(away())
    assert far[1] < far[0] - 0.05 and far[2] == pytest.approx(far[0], abs=1e-3) and far[3] > far[2] + 0.05
    assert "Page Up and Page Down" in marker.get_attribute("title")
    page.press("Start over")


@pytest.mark.slow
def test_everything_can_be_read_has_a_name_shows_the_focus_and_follows_keys(page: Page) -> None:
    page.press("Start over")
    page.press("Add a lamp")
    page.page.mouse.click(*page.place(0.5, 0.75))
    until(lambda: page.plan["lamps"])
    page.press("Pick a piece")
    page.page.mouse.click(*page.place(0.9, 0.8))
    until(lambda: page.plan["pieces"])
    page.page.locator("#lights .name").click()
    for panel in ("#diffusion", "#speed"):
        page.page.locator(panel).evaluate("(panel) => { panel.open = true; }")
    for opened in ("Raised", "Width"):
        page.page.get_by_label(opened, exact=True).wait_for()
        page.settled()
        check_legible(page.page)
        assert check_focus(page.page) > 40
        assert check_keys(page.page) > 18
        page.page.locator("#windows .name").first.click()
    assert page.page.locator("[role=img]:visible").evaluate_all("(all) => all.map(({ id }) => id)") == ["remote"]
    for panel in ("#diffusion", "#speed"):
        page.page.locator(panel).evaluate("(panel) => { panel.open = false; }")
    page.press("Start over")


@pytest.mark.slow
def test_a_server_that_refuses_is_told_and_asked_again(
    chromium: Any, tour: Tour, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire, "MOST_VISITORS", 0)
    page = chromium.new_page()
    page.goto(tour.url)
    page.locator("#loading-text", has_text="has too many visitors; trying again").wait_for()
    monkeypatch.undo()
    page.wait_for_selector("body[data-state=ready]")
    assert page.text_content("#loading-text") == "Preparing the picture …"
    page.close()


@pytest.mark.slow
def test_what_the_browser_says_of_a_gpu_goes_before_its_name(page: Page) -> None:
    def software(name: str, **told: bool) -> bool:
        return bool(page.page.evaluate(TOLD, [told, name]))

    assert software("SwiftShader") and software("llvmpipe") and not software("a card")
    assert software("a card", isFallbackAdapter=True) and not software("llvmpipe", isFallbackAdapter=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "said"),
    [(BLACK, "even a small picture wrong"), (ONCE, "no second device"), ("", "gpu.json came cut off or changed")],
    ids=["black", "once", "cut"],
)
def test_the_server_draws_where_a_gpu_fails(chromium: Any, tour: Tour, script: str, said: str) -> None:
    told: list[str] = []

    def prepare(page: Any) -> None:
        page.add_init_script(FAST + script)
        page.on("console", lambda message: told.append(message.text))
        if not script:
            page.route("**/gpu.json", lambda route: route.fulfill(body='{"programs": ['))

    page = Page(visitor(chromium, prepare), tour)
    assert any(said in text for text in told), told
    assert "the server" in page.page.evaluate("hyjax.stats().adapter")
    assert ("graphics failed" in page.page.text_content("#notice")) == bool(script)
    page.press("Start over")
    before = page.settled()
    page.slide("#daylight", "Hour", 22)
    assert apart(page.settled(), before) > 5 and not page.errors
    page.press("Start over")
    np.testing.assert_array_equal(page.settled(), before)
    page.page.close()


@pytest.mark.slow
def test_news_bring_the_rooms_bounds(chromium: Any, tour: Tour) -> None:
    """Frames that arrive make it grow; where news in between was overtaken, page.json has them."""
    tops, sockets = [3.0], list[Any]()

    def describe(route: Any) -> None:
        described = route.fetch().json()
        described["server"]["live"] = True
        described["scene"]["bounds"] = [[0, 0, 0], [4, 4, tops[0]]]
        route.fulfill(body=json.dumps(described) if tops[0] else "{")

    def listen(socket: Any) -> None:
        sockets.append(socket)
        socket.connect_to_server()

    def prepare(page: Any) -> None:
        page.route("**/page.json", describe)
        page.route_web_socket("**/socket", listen)

    page = Page(visitor(chromium, prepare), tour)
    top = page.page.locator("#height")
    news: dict[str, Any] = {"frames": 3, "numbering": tour.renderer.numbering}
    news["entries"] = page.page.evaluate("fetch('page.json').then((r) => r.json())")["frames"]
    assert top.get_attribute("max") == "3.00"
    sockets[0].send(json.dumps({**news, "bounds": [[0, 0, 0], [4, 4, 5]]}))
    until(lambda: top.get_attribute("max") == "5.00")
    tops[0], news["entries"] = 6.0, news["entries"][-1:]
    overtaken = json.dumps({**news, "numbering": -1, "bounds": [[0, 0, 0], [4, 4, 4]]})
    sockets[0].send(overtaken)
    until(lambda: top.get_attribute("max") == "6.00")
    tops[0] = 0.0
    sockets[0].send(overtaken)
    page.page.locator("#notice", has_text="page.json came cut off or changed").wait_for(state="attached")
    assert not page.errors
    page.page.close()


@pytest.mark.slow
def test_the_visitors_gpu_draws_what_the_server_draws(
    chromium: Any, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One lamp at night, with small shadow maps: there is no GPU here but one made of software."""
    monkeypatch.setattr(page_files, "RESOLUTIONS", (128, 64))
    tour = opened(scene, tmp_path, "visitor")
    candle = replace(place_lamp("candle", scene.mesh.bounds.mean(axis=0), UP), lumen=800.0)
    tour.kept.keep(TourPlan(hour=0.0, lamps=(candle,)))
    try:
        page = Page(chromium, tour)
        flames = [page.picture() for _ in range(4)]
        assert any(0 < apart(flame, flames[0]) < 10 for flame in flames[1:]), "it flickers"
        page.page.emulate_media(reduced_motion="reduce")
        assert "swiftshader" in page.page.evaluate("hyjax.stats().adapter").lower()
        wanted = tour.renderer.render(tour.kept.plan, Viewpoint(0, "relit", SCHEDULES["hyjax"])).linear
        assert apart(np.minimum(page.settled(), 1), np.minimum(wanted, 1)) < 5
        assert check_keys(page.page) > 12
        page.page.locator("#diffusion summary").click()
        page.slide("#diffusion", "Steps ×", 2)  # which only the server can
        assert "the server" in page.page.evaluate("hyjax.stats().adapter")
        assert page.settled().std() > 0.05
    finally:
        tour.stop()
