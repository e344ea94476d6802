"""The tour's page as a test uses it."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hyjax.tour.tour import Tour

SIZE = {"width": 1000, "height": 640}
WAIT = 60.0


def until(condition: Callable[[], Any], seconds: float = WAIT) -> Any:
    """Wait for something to be true; what it was."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it has not come"
        time.sleep(0.05)
    return found


class Page:
    """The tour's page in a browser."""

    def __init__(self, browser: Any, tour: "Tour", size: dict[str, int] | None = None) -> None:
        self.tour, self.errors = tour, list[str]()
        self.page = browser.new_page(viewport=size or SIZE, accept_downloads=True)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(tour.url)
        self.page.wait_for_selector("body[data-state=ready], body[data-state=failed]", timeout=1e3 * WAIT)
        assert self.page.get_attribute("body", "data-state") == "ready", self.page.inner_text("#failure-text")

    def picture(self) -> np.ndarray:
        """Picture that is shown once it is fine, (h, w, 3) in [0, 1]."""
        until(lambda: not self.tour.queue.busy)
        pixels = self.page.evaluate("hyjax.pixels().then((pixels) => [...pixels])")
        height, width = self.tour.renderer.camera(0).intrinsics.shape
        return np.array(pixels).reshape(height, width, 3)

    def settled(self) -> np.ndarray:
        """The same when two that follow each other are equal."""
        before = self.picture()
        while True:
            time.sleep(0.4)
            if np.array_equal(after := self.picture(), before):
                return after
            before = after

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Place in the window of a place in the picture, in shares of its sides."""
        box = self.page.locator("#over").bounding_box()
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    def press(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def slide(self, panel: str, name: str, value: float) -> None:
        """Set a slider."""
        self.page.locator(panel).get_by_label(name, exact=True).fill(str(value))

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag on the picture, in shares of its sides."""
        mouse = self.page.mouse
        mouse.move(*self.place(*start))
        mouse.down()
        for share in np.linspace(0.2, 1.0, 5):
            mouse.move(*self.place(*(a + share * (b - a) for a, b in zip(start, end))))
            time.sleep(0.05)
        mouse.up()

    @property
    def plan(self) -> dict[str, Any]:
        """Plan that the page holds."""
        plan: dict[str, Any] = self.page.evaluate("hyjax.plan()")
        return plan
