"""An exported page: its files, and what it shows in a real browser."""

import base64
import contextlib
import dataclasses
import functools
import gzip
import http.server
import io
import json
import re
import runpy
import shutil
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from common import coarse_surface
from extras import need
from firefox import launched_firefox
from hands import Hand, check_keys
from legible import check_focus, check_legible
from PIL import Image

from experiments.browser import NAMES, SOFTWARE_GPU
from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import load_room
from hyjax.data.light_file import read_lights
from hyjax.device.page_scene import pack_arrays
from hyjax.export.page_sun import sun_table
from hyjax.export.single_page import single_page
from hyjax.export.web import THUMBNAIL, check_page_folder, write_page
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.color import to_display
from hyjax.light.kinds.point import PointLight
from hyjax.light.setup import LightSetup
from hyjax.pipeline import relight
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError

SCHEDULE = Schedule.preset("hyjax")
PRESET = dataclasses.replace(
    Configuration().with_choices({"photo_exponent": 1.4, "sampling": 1}), schedule=Schedule.preset("paper-50")
)
RESOLUTIONS = 128, 64
WAIT = 60.0
NO_ANSWERS: Mapping[str, bytes] = MappingProxyType({})
WEBGPU = [
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    *SOFTWARE_GPU,
]
FIREFOX_GPU = {"dom_webgpu_enabled": True, "gfx_webgpu_ignore-blocklist": True}

DEVICES = """
globalThis.devices = [];
if (globalThis.GPUAdapter) {
  const { requestDevice } = GPUAdapter.prototype;
  GPUAdapter.prototype.requestDevice = async function (...options) {
    devices.push(await requestDevice.apply(this, options));
    return devices.at(-1);
  };
}
"""


BARE = """
const { requestDevice: withLimits } = GPUAdapter.prototype;
GPUAdapter.prototype.requestDevice = function ({ requiredFeatures }) {
  return withLimits.call(this, { requiredFeatures });
};
"""
"""A device with nothing but the default limits."""
TAKING = """
const { createObjectURL } = URL;
URL.createObjectURL = (blob) => createObjectURL.call(URL, (globalThis.taken = blob));
"""
"""Keeps what is taken home: playwright is not told of this browser's downloads."""
MAPPED = """
globalThis.mapped = [];
const { mapAsync } = GPUBuffer.prototype;
GPUBuffer.prototype.mapAsync = function (...options) {
  mapped.push(this.size);
  return mapAsync.apply(this, options);
};
null;
"""


SHOWN_LIGHT = """async ([high, light]) => {
  const [{ Display }, { openDevice }] = await Promise.all([import("./display.js"), import("./engine.js")]);
  const page = await (await fetch("page.json")).json(), device = await openDevice();
  [page.display, page.program] = [page.displays[0], page.programs[0]];
  const [height, width] = page.size, { COPY_DST, MAP_READ, STORAGE } = GPUBufferUsage;
  const { COPY_SRC, RENDER_ATTACHMENT } = GPUTextureUsage;
  let texture, configured;
  const context = {
    getConfiguration: () => configured,
    configure(options) {
      configured = options;
      const { format } = options;
      texture = device.createTexture({ size: [width, height], format, usage: RENDER_ATTACHMENT | COPY_SRC });
    },
    getCurrentTexture: () => texture,
  };
  const media = globalThis.matchMedia;
  globalThis.matchMedia = (query) => (query === "(dynamic-range: high)" ? { matches: high } : media(query));
  const display = await Display.create(device, { getContext: () => context }, page);
  globalThis.matchMedia = media;
  const buffer = (size, usage) => device.createBuffer({ size, usage });
  const get = (all, name) => all[name] ??= buffer(16 * width * height, STORAGE | COPY_DST);
  const buffers = new Proxy({}, { get });
  device.queue.writeBuffer(buffers[page.program.names.image], 0, new Float32Array(4 * width * height).fill(light));
  await display.draw({ buffers }, { stage: "result", wipe: 0, stops: 0, lights: [] });
  const bytesPerRow = 256 * Math.ceil((8 * width) / 256);
  const copy = buffer(bytesPerRow * height, COPY_DST | MAP_READ);
  const encoder = device.createCommandEncoder();
  encoder.copyTextureToBuffer({ texture }, { buffer: copy, bytesPerRow }, [width, height]);
  device.queue.submit([encoder.finish()]);
  await copy.mapAsync(GPUMapMode.READ);
  const bytes = [...new Uint8Array(copy.getMappedRange(0, 8))];
  devices.splice(devices.indexOf(device), 1); // others are counted
  device.destroy();
  return [configured.format, configured.toneMapping.mode, bytes];
}"""


@pytest.fixture(scope="module")
def scene() -> Scene:
    room = load_room(n_frames=3, width=96, height=72, quality=0.25, progress=False)
    return Scene(room, coarse_surface(room))


@pytest.fixture(scope="module")
def setup(scene: Scene) -> LightSetup:
    return scene.lights("evening-lamps")


@pytest.fixture(scope="module")
def folder(scene: Scene, setup: LightSetup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("web") / "page"
    how = {"rays": 256, "resolutions": RESOLUTIONS, "lossless": True}
    write_page(scene, setup, SCHEDULE, [0, 2], out, presets=[PRESET], **how)
    return out


# ---- files ----


@pytest.mark.slow
def test_the_folder_is_complete(folder: Path) -> None:
    page = json.loads((folder / "page.json").read_text())
    assert page["size"] == [72, 96] and len(page["frames"]) == 2
    for name in ("index.html", "style.css", "main.js", "engine.js", "contact_sheet.png", "README.md", "icon.svg"):
        assert (folder / name).stat().st_size > 0, name
    for frame in page["frames"]:
        assert (folder / frame["file"]).is_file() and np.shape(frame["pose"]) == (4, 4)
    buffers, arrays = page["programs"][0]["buffers"], {entry["name"]: entry for entry in page["arrays"]}
    assert set(arrays) == {"vertices", "occluders", "faces", "fields", "hits", "sources"} <= set(buffers)
    assert len(page["setup"]["lights"]) == 4 and page["setup"]["reference_lux"] > 0
    assert set(page["light_keys"]) == {"ambient", "point", "spot", "rect", "directional", "sky"}
    with Image.open(folder / THUMBNAIL) as thumbnail:
        assert thumbnail.size == (96, 72) and thumbnail.convert("L").getextrema()[1] > 60
    assert not list(folder.parent.glob(".*")), "nothing temporary is left"
    assert bool(page["sun"]) == (find_spec("astral") is not None)
    if page["sun"]:
        assert [row["hour"] for row in page["sun"]["rows"]] == [0.5 * k for k in range(48)]
        by_day = [row for row in page["sun"]["rows"] if row["lux"] > 300]
        suns = [(row, light) for row in by_day for light in row["lights"] if light["kind"] == "directional"]
        assert suns and all(sun["illuminance"] < 4 * row["lux"] for row, sun in suns), "none burns out"


@pytest.mark.slow
def test_the_page_asks_nobody_else(folder: Path) -> None:
    for file in folder.iterdir():
        if file.suffix in (".js", ".css", ".html"):
            text = file.read_text().replace("http://localhost", "")
            assert not re.search(r"https?://|@import|eval\(", text), file.name
    assert "default-src 'self'" in (folder / "index.html").read_text()


def test_without_the_extra_a_page_has_no_sun_by_the_hour(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "astral", None)
    assert sun_table(Scene.__new__(Scene)) is None
    (line,) = caplog.messages
    assert line.startswith("web: the page has no sun by the hour: needs the package astral; install it with")


def test_scripts_are_short_modules() -> None:
    scripts = Path(__file__).parents[2] / "hyjax" / "device" / "page"
    for file in scripts.glob("*.js"):
        assert len(file.read_text().splitlines()) <= 300, file.name


def test_arrays_come_back_from_the_packed_file() -> None:
    arrays = {"a": np.arange(5, dtype=np.uint16), "b": np.array([[7, 3], [9, 1]], np.uint32)}
    packed = pack_arrays(arrays, ("b",))
    content = gzip.decompress(packed.content)
    assert len(content) == packed.bytes
    for entry in packed.entries:
        values = np.frombuffer(content, entry["dtype"], np.prod(entry["shape"]), entry["offset"])
        if entry["differences"]:
            values = np.cumsum(values, dtype=values.dtype)
        np.testing.assert_array_equal(values.reshape(entry["shape"]), arrays[entry["name"]])


def test_a_folder_with_something_else_in_it_is_refused(tmp_path: Path) -> None:
    check_page_folder(tmp_path / "new")
    check_page_folder(tmp_path)
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="is not empty and holds no page"):
        check_page_folder(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        check_page_folder(tmp_path / "letter.txt")
    (tmp_path / "page.json").write_text('{"made_by": "hyjax"}')
    check_page_folder(tmp_path)


# ---- in a browser ----


def fulfil(body: bytes, route: Any) -> None:
    """Answer a request."""
    route.fulfill(body=body)


class Visit:
    """The page in a browser."""

    def __init__(
        self,
        browser: Any,
        url: str,
        size: tuple[int, int] = (1000, 700),
        *,
        script: str = "",
        answers: Mapping[str, bytes] = NO_ANSWERS,
    ) -> None:
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.set_default_timeout(1e3 * WAIT)
        self.asked: list[str] = []
        self.page.add_init_script(DEVICES + script)
        self.page.on("request", lambda request: self.asked.append(request.url))
        for name, body in answers.items():
            self.page.route(f"**/{name}", functools.partial(fulfil, body))
        self.page.goto(url)

    def state(self) -> str:
        """Wait until the page is ready or says why not."""
        end = time.monotonic() + WAIT
        while (state := self.page.evaluate("document.body.dataset.state")) not in ("ready", "failed"):
            assert time.monotonic() < end, "the page does not start"
            self.page.wait_for_timeout(100)
        return str(state)

    def close_wipe(self) -> None:
        """Show nothing of the photo."""
        self.page.focus("#wipe")
        self.page.keyboard.press("Home")

    @property
    def failure(self) -> str:
        """Why the page does not start."""
        assert self.state() == "failed"
        return str(self.page.inner_text("#failure-text"))

    def pixels(self) -> np.ndarray:
        values = self.page.evaluate("hyjax.pixels().then((p) => [...p])")
        return np.array(values, np.float32).reshape(72, 96, 3)


@contextlib.contextmanager
def served(folder: Path) -> Iterator[str]:
    """Address of a folder."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@pytest.fixture(scope="module")
def driver(browser_wanted: None) -> Iterator[Any]:
    need("playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        yield driver


@contextlib.contextmanager
def launched(driver: Any, arguments: list[str]) -> Iterator[Any]:
    chromium = next((path for name in NAMES if (path := shutil.which(name))), None)
    assert chromium, "needs chromium; apt install chromium"
    browser = driver.chromium.launch(executable_path=chromium, args=arguments)
    try:
        yield browser
    finally:
        browser.close()


@pytest.fixture(scope="module")
def browser(driver: Any) -> Iterator[Any]:
    with launched(driver, WEBGPU) as browser:
        yield browser


@pytest.fixture(scope="module")
def url(folder: Path) -> Iterator[str]:
    with served(folder) as url:
        yield url


@pytest.fixture(scope="module")
def visit(browser: Any, url: str) -> Iterator[Visit]:
    """The page, opened once: its shaders take a while to compile without a GPU."""
    visit = Visit(browser, url)
    assert visit.state() == "ready", visit.page.inner_text("#failure-text")
    assert not any("contact_sheet" in asked for asked in visit.asked), "it is for browsers without WebGPU"
    assert visit.page.get_attribute("#wipe", "aria-valuenow") == "50", "it opens with half of the photo"
    visit.close_wipe()
    yield visit
    assert all(asked.startswith((url, "blob:")) for asked in visit.asked), visit.asked


def reference(
    scene: Scene, lights: LightSetup, frame: int, configuration: Configuration | None = None
) -> np.ndarray:
    """What `relight` makes of a frame with the page's shadow maps, by the page's schedule or a configuration."""
    maps = cast_shadow_maps(scene.occluders, lights.lights, scale=RESOLUTIONS[0] / 1024, slack=scene.slack)
    view = scene.view(frame)
    light = scene.photo_light.surface_light(lights, maps)
    schedule = shadow_schedule = None
    if configuration:
        light = light.raised(configuration.light.photo_exponent)
        schedule, shadow_schedule = configuration.schedule, configuration.shadow_schedule
    shaded = view.shade(lights, shadow_maps=maps, surface_light=light)
    made = relight(view, shaded, view.display, schedule or SCHEDULE, shadow_schedule=shadow_schedule)
    return np.asarray(made.image)


def difference(visit: Visit, wanted: np.ndarray) -> float:
    mean = float(np.abs(visit.pixels() - wanted).mean())
    print(f"mean difference {mean:.1e} of {wanted.mean():.2f}")
    return mean


@pytest.mark.slow
def test_the_picture_is_that_of_relight(visit: Visit, scene: Scene, setup: LightSetup) -> None:
    assert difference(visit, reference(scene, setup, 0)) < 2e-3
    visit.page.evaluate("hyjax.goto(1)")
    assert difference(visit, reference(scene, setup, 2)) < 2e-3
    visit.page.evaluate("hyjax.goto(0)")
    stats = visit.page.evaluate("hyjax.stats()")
    assert stats["lights"] == 4 and stats["milliseconds"] > 0 and "cascade" in stats["passes"]


@pytest.mark.slow
def test_a_single_file_opens_by_itself(browser: Any, visit: Visit, folder: Path, tmp_path: Path) -> None:
    """The same picture as its folder's, without a server."""
    file = tmp_path / "room.html"
    file.write_text(single_page(folder))
    alone = Visit(browser, file.as_uri())
    assert alone.state() == "ready", alone.page.inner_text("#failure-text")
    assert np.abs(alone.pixels() - visit.pixels()).max() < 1e-6
    assert all(asked.startswith(("file:", "data:", "blob:")) for asked in alone.asked)
    alone.page.close()


@pytest.mark.slow
def test_firefox_draws_the_same_picture_in_half_precision(
    driver: Any, url: str, scene: Scene, setup: LightSetup
) -> None:
    """With WebGPU of its own on Mesa's driver, which gets half precision right; default limits will do."""
    with launched_firefox(driver, **FIREFOX_GPU) as firefox:
        visit = Visit(firefox, url, script=BARE + TAKING)
        assert visit.state() == "ready", visit.page.inner_text("#failure-text")
        assert visit.page.evaluate("hyjax.stats().precision") == "f16"
        limits = visit.page.evaluate(
            "['maxBufferSize', 'maxStorageBufferBindingSize'].map((k) => devices[0].limits[k])"
        )
        assert limits == [1 << 28, 1 << 27]
        assert difference(visit, reference(scene, setup, 0)) < 2e-3
        visit.page.get_by_role("button", name="Record a video").click()
        visit.page.wait_for_function("globalThis.taken")
        content = visit.page.evaluate("taken.arrayBuffer().then((bytes) => [...new Uint8Array(bytes)])")
        assert firefox.new_page().evaluate(PLAYED, content)[:2] == [96, 72]


@pytest.mark.slow
def test_a_display_of_high_dynamic_range_shows_what_is_beyond_white(visit: Visit) -> None:
    """Sunlit spots and lamps, up to four times white; others show white."""
    for light, shown in ((0.5, 0.5), (3.0, 2.8), (9.0, 4.0)):
        *how, values = visit.page.evaluate(SHOWN_LIGHT, [True, light])
        assert how == ["rgba16float", "extended"]
        encoded = np.frombuffer(bytes(values), np.float16)[:3].astype(float)
        np.testing.assert_allclose(encoded, 1.055 * shown ** (1 / 2.4) - 0.055, atol=4e-3)
    *how, values = visit.page.evaluate(SHOWN_LIGHT, [False, 9.0])
    assert how[0].endswith("8unorm") and how[1] == "standard" and values[:3] == [255, 255, 255]


@pytest.mark.slow
def test_a_lights_file_gives_the_same_picture(
    visit: Visit, scene: Scene, setup: LightSetup, tmp_path: Path
) -> None:
    from hyjax.data.light_file import parse_lights

    kinds: list[dict[str, Any]] = [
        {"kind": "point", "position": [2.2, 2.5, 1.8], "luminous_flux": 1200, "temperature": 3000},
        {"kind": "spot", "position": [2.5, 2, 2.2], "target": [2, 3.5, 0], "luminous_flux": 900, "radius": 0.05},
        {"kind": "sky", "illuminance": 40, "color": [0.8, 0.9, 1.2]},
        {"kind": "directional", "direction": [1, 0.2, -0.8], "illuminance": 300},
        {"kind": "rect", "center": [2, 2, 2.4], "normal": [0, 0, -1], "width": 1, "height": 0.5},
    ]
    kinds[-1]["luminous_flux"] = 2000
    content = {
        "reference_lux": 250,
        "lights": kinds,
        "existing": {scene.photo_light.estimate.names[0]: 0.3},
    }
    visit.page.evaluate("(content) => hyjax.setLights(content)", content)
    wanted = reference(scene, parse_lights(content, scene.capture.up), 0)
    assert difference(visit, wanted) < 2e-3
    before = visit.pixels()
    for wrong, message in (
        ({"lights": [{"kind": "bulb"}]}, "unknown kind 'bulb'"),
        ({"lights": [{"kind": "point", "position": [0, 0], "luminous_flux": 1}]}, "three finite numbers"),
        ({"lights": [{"kind": "point", "position": [0, 0, 1]}]}, "'luminous_flux' is missing"),
        ({"lights": [], "existing": {"sun": 1}}, "no source 'sun'"),
        ("no json", "not JSON"),
    ):
        said = visit.page.evaluate("(c) => hyjax.setLights(c).then(() => '', (error) => error.message)", wrong)
        assert message in said
    np.testing.assert_array_equal(visit.pixels(), before)


@pytest.mark.slow
def test_a_preset_is_chosen_on_the_page(visit: Visit, scene: Scene, setup: LightSetup) -> None:
    """Frame, lights and the page's own configuration stay."""
    visit.page.get_by_role("button", name="Start over").click()
    before = visit.pixels()
    wanted = reference(scene, setup, 0, PRESET)
    assert np.abs(wanted - reference(scene, setup, 0)).mean() > 5e-3
    visit.page.get_by_label("Preset").select_option(PRESET.name)
    visit.page.locator("#preset:enabled").wait_for()
    assert difference(visit, wanted) < 2e-3
    visit.page.get_by_label("Preset").select_option("default")
    visit.page.locator("#preset:enabled").wait_for()
    np.testing.assert_array_equal(visit.pixels(), before)
    assert visit.page.evaluate("devices.splice(0, 2).length") == 2, (
        "each preset has its own device, and one is left"
    )
    assert visit.page.evaluate("devices.length") == 1 and visit.page.locator("#notice").is_hidden()


def wait_for_move(marker: Any, before: dict[str, float]) -> None:
    """Wait until a marker is elsewhere: the surface under the pointer is asked for first."""
    end = time.monotonic() + WAIT
    while marker.bounding_box() == before:
        assert time.monotonic() < end, "it does not move"
        time.sleep(0.1)


@pytest.mark.slow
def test_a_lamp_is_added_by_a_click_and_dragged(visit: Visit) -> None:
    visit.page.get_by_role("button", name="Start over").click()
    before = visit.pixels()
    box = visit.page.locator("#over").bounding_box()
    count = visit.page.locator(".marker").count()
    visit.page.get_by_role("button", name="Add a lamp").click()
    x, y = box["x"] + 0.45 * box["width"], box["y"] + 0.3 * box["height"]
    visit.page.mouse.click(x, y)
    visit.page.get_by_role("button", name="Remove").wait_for()
    lit = visit.pixels()
    assert visit.page.locator(".marker").count() == count + 1
    assert (lit - before).mean() > 0.01, "it is brighter"
    marker = visit.page.locator(".marker.selected").bounding_box()
    place = marker["x"] + marker["width"] / 2, marker["y"] + marker["height"] / 2
    visit.page.mouse.move(*place)
    visit.page.mouse.down()
    visit.page.wait_for_timeout(1000)
    visit.page.mouse.move(place[0] - 0.25 * box["width"], place[1], steps=3)
    visit.page.mouse.up()
    wait_for_move(visit.page.locator(".marker.selected"), marker)
    assert np.abs(visit.pixels() - lit).mean() > 5e-3, "it is elsewhere"
    visit.page.get_by_role("button", name="Remove").click()
    np.testing.assert_allclose(visit.pixels(), before, atol=1e-5)


@pytest.mark.slow
def test_dragging_stays_on_the_photos_and_buttons_leave_and_go_back(visit: Visit) -> None:
    before = visit.pixels()
    box = visit.page.locator("#over").bounding_box()
    middle = box["x"] + 0.5 * box["width"], box["y"] + 0.7 * box["height"]

    def drag(across: float) -> None:
        visit.page.mouse.move(*middle)
        visit.page.mouse.down()
        visit.page.mouse.move(middle[0] + across, middle[1], steps=4)
        visit.page.mouse.up()

    drag(150)
    visit.page.mouse.wheel(0, 200)
    np.testing.assert_allclose(visit.pixels(), before, atol=1e-5)
    drag(-150)
    assert visit.page.inner_text("#frame-label") == "2 / 2" and visit.page.locator("#land").is_hidden()
    drag(150)
    assert visit.page.inner_text("#frame-label") == "1 / 2"
    visit.page.get_by_role("button", name="Look around").click()
    drag(150)
    away = visit.pixels()
    assert np.abs(away - before).mean() > 5e-3 and away.std() > 0.01
    visit.page.get_by_role("button", name="Back to the photos").click()
    np.testing.assert_allclose(visit.pixels(), before, atol=1e-5)


@pytest.mark.slow
def test_on_a_phone_nothing_is_wider_than_the_screen(visit: Visit, tmp_path: Path) -> None:
    visit.page.set_viewport_size({"width": 360, "height": 740})
    visit.page.wait_for_timeout(200)
    assert visit.page.evaluate("document.documentElement.scrollWidth") <= 360
    visit.page.screenshot(path=tmp_path / "phone.png")
    visit.page.set_viewport_size({"width": 1000, "height": 700})


def canvas(visit: Visit) -> np.ndarray:
    """Pixels of the canvas, 0 to 255."""
    visit.pixels()
    url = visit.page.evaluate("document.getElementById('canvas').toDataURL()")
    picture = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1])))
    return np.asarray(picture.convert("RGB"), np.float32)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference, of 255."""
    return float(np.abs(a - b).mean())


@pytest.mark.slow
def test_frames_stages_and_the_wipe(visit: Visit, folder: Path) -> None:
    page = visit.page
    photo = np.asarray(Image.open(folder / json.loads((folder / "page.json").read_text())["frames"][0]["file"]))
    page.evaluate("hyjax.goto(0)")
    result = canvas(visit)
    page.locator("#scrub").fill("1")
    assert apart(canvas(visit), result) > 5 and page.inner_text("#frame-label") == "2 / 2"
    page.get_by_role("button", name="Play the frames").click()
    seen = set()
    for _ in range(20):
        seen.add(page.inner_text("#frame-label"))
        page.wait_for_timeout(100)
    page.get_by_role("button", name="Pause").click()
    assert seen == {"1 / 2", "2 / 2"}
    page.locator("#scrub").fill("0")
    shown = {}
    for stage in ("photo", "normals", "depth", "raw filter", "refined filter", "visibility"):
        page.select_option("#stages", stage)
        shown[stage] = canvas(visit)
        assert shown[stage].std() > 5, stage
        assert all(apart(shown[stage], other) > 3 for name, other in shown.items() if name != stage), stage
    np.testing.assert_array_equal(shown["photo"], photo)
    page.select_option("#stages", "result")
    np.testing.assert_array_equal(canvas(visit), result)
    picture, handle = page.locator("#picture").bounding_box(), page.locator("#wipe span").bounding_box()
    assert handle["x"] >= picture["x"], "the handle is inside"
    x, y = handle["x"] + 5, handle["y"] + 5
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 0.5 * picture["width"], y, steps=3)
    page.mouse.up()
    wiped = canvas(visit)
    np.testing.assert_array_equal(wiped[:, :47], photo[:, :47])
    np.testing.assert_array_equal(wiped[:, 49:], result[:, 49:])
    page.focus("#wipe")
    for _ in range(11):
        page.keyboard.press("ArrowLeft")
    np.testing.assert_array_equal(canvas(visit), result)


@pytest.mark.slow
def test_lamps_change_by_the_panel_and_are_saved(visit: Visit, scene: Scene, tmp_path: Path) -> None:
    page = visit.page
    page.get_by_role("button", name="Start over").click()
    before = canvas(visit)
    page.locator("#exposure").fill("1")
    assert canvas(visit).mean() > before.mean() + 10
    page.locator("#exposure").fill("0")
    page.select_option("#put-mode", "height")
    page.locator("#height").fill("1.2")
    page.get_by_role("button", name="Add a lamp").click()
    box = page.locator("#over").bounding_box()
    page.mouse.click(box["x"] + 0.45 * box["width"], box["y"] + 0.8 * box["height"])
    page.get_by_role("button", name="Remove").wait_for()
    warm = canvas(visit)
    assert warm.mean() > before.mean() + 5
    page.get_by_label("Temperature").fill("9000")
    cold = (canvas(visit) - warm).mean((0, 1))
    assert cold[2] > 5 > -5 > cold[0]
    page.get_by_label("Colour").fill("#ff2020")
    red = canvas(visit)
    page.get_by_label("Brightness").fill("0.3")
    dim = canvas(visit)
    assert dim[..., 0].mean() < red[..., 0].mean() - 10
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the lights").click()
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    lamp = read_lights(file, scene.capture.up).lights[-1]
    assert isinstance(lamp, PointLight)
    floor = page.evaluate("fetch('page.json').then((r) => r.json()).then((p) => p.scene.bounds[0][2])")
    assert abs(lamp.position[2] - floor - 1.2) < 1e-3
    page.get_by_role("button", name="Start over").click()
    np.testing.assert_array_equal(canvas(visit), before)
    page.evaluate("(content) => hyjax.setLights(content)", file.read_text())
    np.testing.assert_array_equal(canvas(visit), dim)
    page.select_option("#put-mode", "off")
    page.get_by_role("button", name="Start over").click()


PLAYED = """async (bytes) => {
  const url = URL.createObjectURL(new Blob([new Uint8Array(bytes)]));
  const video = Object.assign(document.createElement("video"), { src: url, muted: true });
  await video.play();
  await new Promise((done) => { video.addEventListener("ended", done); });
  return [video.videoWidth, video.videoHeight, video.currentTime];
}"""


@pytest.mark.slow
def test_a_picture_and_a_video_are_taken_home(browser: Any, visit: Visit, tmp_path: Path) -> None:
    """Without a server, and without the photo that is wiped over the picture."""
    page, shown = visit.page, canvas(visit)
    page.focus("#wipe")
    page.keyboard.press("End")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the picture").click()
    download.value.save_as(tmp_path / "picture.png")
    assert download.value.suggested_filename == "relit-1.png"
    with Image.open(tmp_path / "picture.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture.convert("RGB")), shown)
    with page.expect_download() as download:
        page.get_by_role("button", name="Record a video").click()
    download.value.save_as(tmp_path / "video")
    assert download.value.suggested_filename in ("relit.mp4", "relit.webm")
    player = browser.new_page()
    width, height, seconds = player.evaluate(PLAYED, list((tmp_path / "video").read_bytes()))
    player.close()
    assert (width, height) == (96, 72) and 0.05 < seconds < 1.0, "two frames"
    visit.close_wipe()
    np.testing.assert_array_equal(canvas(visit), shown)


@pytest.mark.slow
def test_fingers_drag_lamps_and_fly(visit: Visit) -> None:
    page = visit.page
    page.set_viewport_size({"width": 360, "height": 740})
    touch = page.context.new_cdp_session(page)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    before = canvas(visit)
    marker = page.locator(".marker:visible").first.bounding_box()
    x, y = marker["x"] + marker["width"] / 2, marker["y"] + marker["height"] / 2
    fingers("Start", (x, y))
    page.wait_for_timeout(1000)
    fingers("Move", (x - 40, y))
    fingers("Move", (x - 80, y))
    fingers("End")
    wait_for_move(page.locator(".marker:visible").first, marker)
    moved = canvas(visit)
    assert apart(moved, before) > 1 and page.locator("#land").is_hidden()
    box = page.locator("#over").bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.7 * box["height"]
    page.get_by_role("button", name="Look around").click()
    fingers("Start", (x, y))
    fingers("Move", (x + 30, y))
    fingers("End")
    flown = canvas(visit)
    assert apart(flown, moved) > 3
    fingers("Start", (x - 30, y), (x + 30, y))
    fingers("Move", (x - 40, y), (x + 40, y))
    fingers("End")
    assert apart(canvas(visit), flown) > 1, "it is nearer"
    page.get_by_role("button", name="Back to the photos").click()
    page.get_by_role("button", name="Start over").click()
    np.testing.assert_array_equal(canvas(visit), before)
    page.set_viewport_size({"width": 1000, "height": 700})


@pytest.mark.slow
@pytest.mark.parametrize(("size", "touch"), [((1280, 800), False), ((390, 844), True)], ids=["mouse", "touch"])
def test_undo_redo_and_the_sun_by_the_hour(visit: Visit, size: tuple[int, int], touch: bool) -> None:
    need("tour")
    page = visit.page
    page.get_by_role("button", name="Start over").click()
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.wait_for_timeout(500)
    hand, before, shown = Hand(page, touch=touch), canvas(visit), list[np.ndarray]()
    page.locator("#hour").evaluate("(hour) => { hour.value = 16; }")  # as the page is opened
    for share in (0.5, 0.97):
        hand.slide(page.locator("#hour"), share)
        shown.append(canvas(visit))
        page.wait_for_timeout(500)
    assert page.locator("#sun-on").is_checked() and page.inner_text("#hour-label") >= "22:00"
    assert min(apart(shown[0], before), apart(shown[1], shown[0])) > 5
    undo, redo = (page.get_by_role("button", name=name) for name in ("Undo", "Redo"))
    for button, picture in ((undo, shown[0]), (undo, before), (redo, shown[0]), (undo, before)):
        hand.press_on(button)
        np.testing.assert_array_equal(canvas(visit), picture)
    assert not page.locator("#sun-on").is_checked()
    hand.leave()
    page.set_viewport_size({"width": 1000, "height": 700})


@pytest.mark.slow
def test_a_hidden_page_draws_nothing(visit: Visit) -> None:
    before = canvas(visit)
    visit.page.evaluate("Object.defineProperty(document, 'hidden', { value: true, configurable: true })")
    visit.page.locator("#scrub").fill("1")
    visit.page.wait_for_timeout(500)
    url = visit.page.evaluate("document.getElementById('canvas').toDataURL()")
    visit.page.evaluate("delete document.hidden")
    assert apart(canvas(visit), before) > 5
    assert visit.page.evaluate("document.getElementById('canvas').toDataURL()") != url
    visit.page.locator("#scrub").fill("0")
    np.testing.assert_array_equal(canvas(visit), before)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ({"scene.bin": gzip.compress(bytes(10_000))}, "scene.bin came cut off or changed"),
        ({"scene.bin": gzip.compress(np.random.default_rng(0).bytes(10_000))[:5000]}, "scene.bin came cut off"),
        ({"scene.bin": b"<!doctype html>"}, "scene.bin came cut off or changed"),
        ({"page.json": b"<!doctype html><title>Home</title>"}, "answers with a web page where it was asked for"),
        ({"page.json": b'{"format": 1, "name'}, "page.json came cut off or changed"),
    ],
)
def test_files_that_a_host_sends_otherwise_are_one_clear_line(
    browser: Any, url: str, answers: dict[str, bytes], said: str
) -> None:
    visit = Visit(browser, url, answers=answers)
    assert said in visit.failure
    visit.page.close()


CHOOSE = """
async ([page, query]) => {
  const device = devices.at(-1);
  const { choosePrecision } = await import("./precision.js");
  Object.defineProperty(device, "features", { value: new Set(["shader-f16"]), configurable: true });
  history.replaceState(null, "", query);
  try {
    await choosePrecision(page, device);
    return page.program.precision;
  } catch (error) {
    return error.message;
  } finally {
    history.replaceState(null, "", location.pathname);
    delete device.features;
  }
}
"""


def with_half(folder: Path) -> Any:
    """Content of a page whose programs of half precision are those of single."""
    page = json.loads((folder / "page.json").read_text())
    page["programs"][1] = page["programs"][0] | {"precision": "f16"}
    page["displays"][1] = page["displays"][0]
    page["checks"][1] = json.loads(json.dumps(page["checks"][0] | {"precision": "f16"}))
    return page


@pytest.mark.slow
def test_a_device_that_gets_half_precision_wrong_takes_single(visit: Visit, folder: Path) -> None:
    assert visit.page.evaluate("hyjax.stats().precision") == "f32", "it has no other"
    page = with_half(folder)
    assert visit.page.evaluate(CHOOSE, [page, "?precision=f32"]) == "f32"
    shaders = page["checks"][1]["shaders"]
    shaders.update({name: text.replace("store(y[q])", "store(0.9 * y[q])") for name, text in shaders.items()})
    assert visit.page.evaluate(CHOOSE, [page, "?"]) == "f32"
    assert visit.page.evaluate(CHOOSE, [page, "?precision=f16"]) == "f16"
    page = with_half(folder)
    for check in page["checks"]:
        shaders = check["shaders"]
        shaders.update({name: text.replace("store(y[q])", "store(0.0 * y[q])") for name, text in shaders.items()})
    assert "even a small picture wrong" in visit.page.evaluate(CHOOSE, [page, "?"])
    page["checks"] = page["checks"][:1]  # as where the device has no half precision
    assert "even a small picture wrong" in visit.page.evaluate(CHOOSE, [page, "?"])


@pytest.mark.slow
def test_a_look_at_the_surface_takes_sixteen_bytes(visit: Visit) -> None:
    visit.page.evaluate(MAPPED)
    visit.page.get_by_role("button", name="Add a lamp").click()
    box = visit.page.locator("#over").bounding_box()
    visit.page.mouse.click(box["x"] + 0.45 * box["width"], box["y"] + 0.3 * box["height"])
    visit.page.get_by_role("button", name="Remove").click()
    assert 16 in visit.page.evaluate("mapped")
    assert max(visit.page.evaluate("mapped.filter((bytes) => bytes !== 256 * 2 * 72)")) <= 8192, "times, if any"


@pytest.mark.slow
def test_everything_can_be_read_has_a_name_and_follows_keys(visit: Visit) -> None:
    page = visit.page
    page.locator(".light-head input").first.uncheck()
    page.locator(".light-head .name").first.click()
    page.evaluate("document.getElementById('speed').open = true")
    visit.pixels()
    check_legible(page)
    assert check_focus(page) > 20
    assert check_keys(page) > 10
    page.evaluate("document.getElementById('speed').open = false")
    page.get_by_role("button", name="Start over").click()


@pytest.mark.slow
def test_a_lamp_that_changes_nothing_visible_says_why(visit: Visit) -> None:
    page = visit.page
    page.locator(".light-head .name").first.click()
    visit.pixels()
    page.wait_for_timeout(500)
    assert page.locator(".why").is_hidden(), page.inner_text(".why")
    page.get_by_label("Brightness").fill("0.02")
    page.locator(".why", has_text="less than 1 %").wait_for()
    page.get_by_label("Brightness").fill("0")
    page.locator(".why", has_text="brightness is zero").wait_for()
    page.get_by_role("button", name="Start over").click()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (390, 844), (844, 390)])
def test_notices_lie_beside_the_picture_which_stays(visit: Visit, size: tuple[int, int]) -> None:
    page = visit.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.locator(".light-head input").first.uncheck()
    for light in page.locator(".light-head input").all():
        light.uncheck()
    page.get_by_role("button", name="Save the lights").click()
    notice, picture = page.locator("#notice").bounding_box(), page.locator("#picture").bounding_box()
    apart = notice["y"] >= picture["y"] + picture["height"] or notice["x"] >= picture["x"] + picture["width"]
    assert apart, (notice, picture)
    page.get_by_role("button", name="Start over").click()
    page.locator("#save").scroll_into_view_if_needed()
    assert page.locator("#picture").bounding_box()["y"] >= 0
    if size[0] < size[1]:
        scrolled = page.evaluate("scrollTo(0, 1e4), scrollY")
        assert scrolled > 100 and page.locator("#picture").bounding_box()["y"] == 0, "the panel scrolls below it"
        page.evaluate("scrollTo(0, 0)")
    page.set_viewport_size({"width": 1000, "height": 700})


@pytest.mark.slow
def test_dark_gradients_have_no_bands(visit: Visit) -> None:
    """What is shown differs from what was computed by rounding and noise, half a step each."""
    linear = visit.pixels()
    exact = 255 * np.asarray(to_display(linear))
    error = (canvas(visit) - exact)[exact.min(-1) > 2]
    assert np.abs(error).max() < 1.05 and 0.35 < error.std() < 0.5


@pytest.mark.slow
def test_keys_press_what_has_the_focus(visit: Visit) -> None:
    """Space on a heading unfolds it and does not play; Enter chooses a lamp, arrows move it."""
    page = visit.page
    page.locator("#speed summary").focus()
    page.keyboard.press("Space")
    assert page.evaluate("document.getElementById('speed').open")
    assert page.get_by_role("button", name="Play the frames").count() == 1, "it is not playing"
    page.keyboard.press("Space")
    before = canvas(visit)
    marker = page.locator(".marker:visible").first
    marker.focus()
    page.keyboard.press("Enter")
    assert page.locator(".marker.selected").count() == 1
    assert page.get_by_role("button", name="Remove").is_visible()
    for _ in range(6):
        page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(600)
    assert apart(canvas(visit), before) > 0.5 and page.locator("#land").is_hidden()
    page.get_by_role("button", name="Start over").click()
    np.testing.assert_array_equal(canvas(visit), before)


@pytest.mark.slow
def test_a_lost_device_is_opened_again_twice(visit: Visit) -> None:
    """The last test that has the page, and lost while it draws."""
    before, opened = canvas(visit), visit.page.evaluate("devices.length")
    visit.page.get_by_role("button", name="Play the frames").click()
    visit.page.wait_for_timeout(300)
    visit.page.evaluate("devices.at(-1).destroy()")
    visit.page.wait_for_timeout(100)
    assert "is being opened again" in visit.page.inner_text("#notice")
    visit.page.evaluate("hyjax.goto(0)")
    visit.page.get_by_role("button", name="Pause").click()
    visit.page.evaluate("hyjax.goto(0)")
    assert visit.page.evaluate("devices.length") == opened + 1
    np.testing.assert_array_equal(canvas(visit), before)
    visit.page.evaluate("devices.at(-1).destroy()")
    visit.page.wait_for_timeout(300)
    visit.page.evaluate("hyjax.goto(0)")
    np.testing.assert_array_equal(canvas(visit), before)
    visit.page.evaluate("devices.at(-1).destroy()")
    visit.page.wait_for_timeout(300)
    assert "lost three times" in visit.failure
    visit.page.evaluate("navigator.gpu.requestAdapter = async () => null")
    for name in (PRESET.name, "default"):  # the second where there is no device
        menu = visit.page.locator("#preset")
        menu.evaluate("(menu, name) => { menu.value = name; menu.dispatchEvent(new Event('change')); }", name)
        visit.page.locator("#preset:enabled").wait_for(state="attached", timeout=10_000)


@pytest.mark.slow
def test_without_webgpu_the_page_says_so_and_shows_its_frames(folder: Path, driver: Any) -> None:
    with launched(driver, ["--headless=new", "--no-sandbox"]) as browser, served(folder) as url:
        visit = Visit(browser, url)
        assert visit.state() == "failed"
        assert "WebGPU" in visit.page.inner_text("#failure-text")
        visit.page.wait_for_timeout(500)
        assert visit.page.evaluate("document.getElementById('sheet').naturalWidth") > 0


# ---- in the documentation ----


@pytest.fixture(scope="module")
def site(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site's page to try, with the exported page."""
    need("docs")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    root = Path(__file__).parents[2]
    docs, site = tmp_path_factory.mktemp("docs"), tmp_path_factory.mktemp("site")
    for name in ("try.md", "try.js", "style.css"):
        shutil.copy(root / "docs" / name, docs)
    shutil.copytree(root / "docs" / "examples", docs / "examples")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of mkdocs' own packages
        settings = {"docs_dir": str(docs), "site_dir": str(site), "plugins": [], "nav": [{"Try": "try.md"}]}
        build(load_config(str(root / "mkdocs.yml"), extra={"demo": str(folder)}, **settings))
    return site


@pytest.mark.slow
def test_the_documentation_shows_the_exported_page(site: Path, browser: Any) -> None:
    with served(site) as url:
        page = browser.new_page()
        page.goto(f"{url}try.html")
        frame = page.frame_locator("iframe")
        frame.locator("body[data-state=ready]").wait_for(timeout=1e3 * WAIT)
        assert frame.get_by_label("Preset").locator("option").all_inner_texts() == ["default", PRESET.name]
        assert page.locator(".wipe").count() == 0 and "by your own GPU" in page.locator("#stills").inner_text()
        page.close()


@pytest.mark.slow
def test_the_documentation_wipes_stills_without_webgpu(site: Path, driver: Any) -> None:
    with launched(driver, ["--headless=new", "--no-sandbox"]) as plain, served(site) as url:
        page, asked = plain.new_page(viewport={"width": 390, "height": 844}), list[str]()
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"{url}try.html")

        def photo(at: int) -> np.ndarray:
            page.get_by_label("Photo wiped").fill(str(at))
            shot = page.locator(".wipe").screenshot()
            return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), float)[:200]

        whole, half, none = photo(100), photo(50), photo(0)
        middle = whole.shape[1] // 2
        assert np.abs(whole - none).mean() > 5
        assert np.abs(half - whole)[:, : middle - 5].max() == 0 == np.abs(half - none)[:, middle + 5 :].max()
        assert not any("demo/" in address for address in asked), "it is for browsers with WebGPU"


def test_an_exported_page_that_is_too_large_stops_the_build(tmp_path: Path) -> None:
    need("docs")
    from mkdocs.exceptions import PluginError

    hooks = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "hooks.py"))
    (tmp_path / "scene.bin").write_bytes(bytes(hooks["MOST_BYTES"] + 1))
    with pytest.raises(PluginError, match="export fewer frames"):
        hooks["on_files"](None, {"extra": {"demo": str(tmp_path)}})
