"""The tour's page in Firefox, drawn by the server, on a screen and at a phone's size."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from extras import need

need("tour")

from browser import Page, until
from common import coarse_surface
from firefox import launched_firefox, touch_screen
from visits import SCHEDULES

from hyjax.data.builtin_room import load_room
from hyjax.scene.scene import Scene
from hyjax.tour.renderer import Renderer
from hyjax.tour.tour import Tour

PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def tour(browser_wanted: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    room, out = (
        load_room(n_frames=3, width=96, height=72, quality=0.25, progress=False),
        tmp_path_factory.mktemp("tour"),
    )
    tour = Tour(Renderer(Scene(room, coarse_surface(room)), folder=out), SCHEDULES, out, port=0, engine="server")
    yield tour
    tour.stop()


@pytest.fixture(scope="module")
def firefox(browser_wanted: None) -> Iterator[Any]:
    need("playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, launched_firefox(driver) as launched:
        yield launched


@pytest.mark.slow
def test_a_lamp_is_hung_moved_and_taken_back(firefox: Any, tour: Tour) -> None:
    page = Page(firefox, tour)
    assert "the server" in page.page.evaluate("hyjax.stats().adapter")
    page.slide("#daylight", "Hour", 22)
    night = page.settled()
    page.press("Add a lamp")
    page.page.mouse.click(*page.place(0.5, 0.75))
    until(lambda: page.plan["lamps"])
    before = page.plan["lamps"][0]["position"]
    lit = page.settled()
    assert np.abs(lit - night).mean() > 0.02
    page.page.locator(".marker:not(.handle)").press("ArrowLeft")
    assert page.plan["lamps"][0]["position"] != before
    page.page.wait_for_timeout(500)
    page.page.keyboard.press("Control+z")
    assert page.plan["lamps"][0]["position"] == before
    np.testing.assert_array_equal(page.settled(), lit)
    page.page.set_viewport_size(PHONE)
    width = page.page.evaluate("document.documentElement.clientWidth")
    assert page.page.evaluate("document.documentElement.scrollWidth") == width
    picture = page.page.locator("#picture").bounding_box()
    assert picture["width"] == width and picture["y"] == 0
    page.press("Start over")
    assert not page.plan["lamps"] and not page.errors
    page.page.close()


@pytest.mark.slow
def test_a_finger_drags_a_lamp(browser_wanted: None, tour: Tour) -> None:
    with touch_screen() as page:
        page.open(tour.url, **PHONE)
        until(lambda: page.evaluate("document.body.dataset.state") == "ready")
        page.evaluate("document.getElementById('reset').click()")
        page.evaluate("document.getElementById('add').click()")
        (lamp,) = until(lambda: page.evaluate("hyjax.plan()")["lamps"])
        page.evaluate("addEventListener('pointerdown', ({ pointerType }) => { globalThis.pressed = pointerType; })")
        until(lambda: page.evaluate("Boolean(document.querySelector('.marker:not(.handle):not([hidden])'))"))
        page.drag(".marker:not(.handle)", -60, 20)
        until(lambda: page.evaluate("hyjax.plan()")["lamps"][0]["position"] != lamp["position"])
        assert page.evaluate("pressed") == "touch"
        page.evaluate("document.getElementById('reset').click()")
