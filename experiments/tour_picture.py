"""Screenshots of the room tour for the documentation: an afternoon, and the evening with a bulb on the table."""

import io
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from experiments.browser import browser
from experiments.tour_latency import served, wait_until_still

SIZE = {"width": 1200, "height": 673}
PIXELS = "640x480"
WAIT = 120_000.0  # milliseconds
AFTERNOON, EVENING = "16", "21.4"
TABLE = 0.5, 0.81
"""Place of the bulb, in shares of the scene."""
GAP = 8


def tour_picture() -> UInt8[np.ndarray, "h w 3"]:
    """Both, side by side.

    Raises:
        InputError: there is no browser, or the tour does not start.
    """
    with served(PIXELS) as (url, process), browser() as launched:
        page = launched.new_page(viewport=SIZE)
        page.goto(url)
        page.get_by_text("ms for this picture").wait_for(timeout=WAIT)
        page.add_style_tag(content=".mantine-Notifications-root { opacity: 0; pointer-events: none }")
        wait_until_still(process.pid)
        at_hour(page, AFTERNOON)
        wait_until_still(process.pid)
        afternoon = screenshot(page)
        at_hour(page, EVENING)
        page.get_by_role("button", name="Bulb", exact=True).click()
        box = page.locator("canvas").first.bounding_box()
        page.mouse.click(box["x"] + TABLE[0] * box["width"], box["y"] + TABLE[1] * box["height"])
        wait_until_still(process.pid)
        evening = screenshot(page)
    between = np.full((afternoon.shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([afternoon, between, evening], axis=1)


def at_hour(page: Any, hour: str) -> None:
    """Set the hour in its field."""
    field = page.locator("input.mantine-NumberInput-input").nth(2)
    field.fill(hour)
    field.press("Enter")


def screenshot(page: Any) -> UInt8[np.ndarray, "h w 3"]:
    """Picture that the page shows."""
    page.get_by_text("View", exact=True).first.scroll_into_view_if_needed()
    page.wait_for_timeout(2000)
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
