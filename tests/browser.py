"""The tour's page as a test uses it."""

import io
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image

from hyjax.tour.page import Tour

SIZE = {"width": 1000, "height": 600}
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

    def __init__(self, browser: Any, tour: Tour) -> None:
        self.tour = tour
        self.page = browser.new_page(viewport=SIZE)
        self.page.goto(tour.url)
        self.shown()

    def shown(self) -> None:
        """Wait for the first picture."""
        self.page.get_by_text("ms for this picture").wait_for(timeout=1e3 * WAIT)
        # They would be in the pictures, and in the way of clicks.
        self.page.add_style_tag(content=".mantine-Notifications-root { opacity: 0; pointer-events: none }")

    def picture(self) -> np.ndarray:
        """What the scene shows once it is still, (h, w, 3) in [0, 255]."""

        def shot() -> np.ndarray:
            content = self.page.locator("canvas").first.screenshot()
            return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), np.float32)

        until(lambda: not self.tour.queue.busy)
        before, end = shot(), time.monotonic() + WAIT
        still = 0
        while still < 3:
            assert time.monotonic() < end, "the picture never comes to rest"
            time.sleep(0.25)
            after = shot()
            still = still + 1 if before.shape == after.shape and np.abs(before - after).mean() < 0.2 else 0
            before = after
        return before

    def box(self) -> dict[str, float]:
        """Where the scene is on the page, in pixels."""
        box: dict[str, float] = self.page.locator("canvas").first.bounding_box()
        return box

    def slide(self, number: int, share: float) -> None:
        """Drag a slider, counted from the top, to a share of its length."""
        self.page.locator(".mantine-Slider-thumb").nth(number).scroll_into_view_if_needed()
        track = (
            self.page.locator(".mantine-Slider-root").nth(number).locator(".mantine-Slider-track").bounding_box()
        )
        thumb = self.page.locator(".mantine-Slider-thumb").nth(number).bounding_box()
        y = thumb["y"] + 0.5 * thumb["height"]
        self.page.mouse.move(thumb["x"] + 0.5 * thumb["width"], y)
        self.page.mouse.down()
        self.page.mouse.move(track["x"] + share * track["width"], y, steps=8)
        self.page.mouse.up()

    def press(self, name: str) -> None:
        """Click a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def unfold(self, name: str) -> None:
        """Click a folder's heading."""
        self.page.get_by_text(name, exact=True).first.click()

    def click(self, x: float, y: float) -> None:
        """Click into the scene, at pixels of it."""
        box = self.box()
        self.page.mouse.click(box["x"] + x, box["y"] + y)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag in the scene, from pixels to pixels of it."""
        box = self.box()
        mouse = self.page.mouse
        mouse.move(box["x"] + start[0], box["y"] + start[1])
        mouse.down()
        for share in np.linspace(0.0, 1.0, 12):
            x, y = (a + share * (b - a) for a, b in zip(start, end))
            mouse.move(box["x"] + x, box["y"] + y)
            time.sleep(0.03)
        mouse.up()
