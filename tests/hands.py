"""A visitor's hand on a page in chromium: with a mouse, or a finger on a touch screen."""

from typing import Any

Place = tuple[float, float]
"""In the window, in CSS pixels."""
SHARE = "({ value, min, max }) => (value - min) / (max - min)"
"""Where the thumb of a slider is."""
THUMB = 14
"""Its width, as style.css has it."""


class Hand:
    """Hand that presses and drags."""

    def __init__(self, page: Any, *, touch: bool) -> None:
        self.page = page
        self._screen: Any = page.context.new_cdp_session(page) if touch else None
        if self._screen is not None:
            self._screen.send("Emulation.setTouchEmulationEnabled", {"enabled": True})

    def _finger(self, kind: str, *places: Place) -> None:
        points = [{"x": x, "y": y} for x, y in places]
        self._screen.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    def press(self, *places: Place) -> None:
        """Press a place, and drag over any others."""
        mouse, (first, *others) = self.page.mouse, places
        if self._screen is None:
            mouse.move(*first)
            mouse.down()
        else:
            self._finger("Start", first)
        for place in others:
            self.page.wait_for_timeout(500)  # a drag that rests is one step to undo
            if self._screen is None:
                mouse.move(*place)
            else:
                self._finger("Move", place)
        self.page.wait_for_timeout(500 if others else 0)  # the surface under the pointer is asked for
        if self._screen is None:
            mouse.up()
        else:
            self._finger("End")
            self.page.wait_for_timeout(200)  # it counts as a click a little later

    def press_on(self, element: Any) -> None:
        """Press an element."""
        box = self._shown(element)
        self.press((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))

    def slide(self, element: Any, share: float) -> None:
        """Drag the thumb of a slider to a share of its way."""
        box, now = self._shown(element), element.evaluate(SHARE)
        x, y = box["x"] + THUMB / 2, box["y"] + box["height"] / 2
        self.press(*((x + at * (box["width"] - THUMB), y) for at in (now, share)))

    def _shown(self, element: Any) -> Any:
        """Where an element is, once it is scrolled into view."""
        element.evaluate("(element) => element.scrollIntoView({ block: 'center' })")
        self.page.wait_for_timeout(200)
        return element.bounding_box()

    def drag(self, element: Any, across: float, down: float = 0.0) -> None:
        """Drag an element by CSS pixels."""
        box = element.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.press((x, y), *((x + share * across, y + share * down) for share in (0.5, 1.0)))

    def leave(self) -> None:
        """Go, with the touch screen."""
        if self._screen is not None:
            self._screen.detach()


CONTROLS = ":is(#panel, #transport) :is(input, select):visible:enabled, #wipe"
KINDS = "(control) => control.type ?? control.getAttribute('role')"
VALUE = "(control) => (control.type === 'checkbox' ? control.checked : control.value ?? control.ariaValueNow)"
KEYS = {
    "range": ("ArrowRight", "ArrowLeft"),
    "slider": ("ArrowRight", "ArrowLeft"),
    "checkbox": ("Space", "Space"),
    "select-one": ("ArrowDown", "ArrowUp"),
    "date": ("ArrowUp", "ArrowDown"),
}
"""Keys that change a control of a kind, one of them at the end of its range. A colour has a window of its own."""


def check_keys(page: Any) -> int:
    """Check that keys change every control that is shown, and change it back; their number."""
    count, number, controls = 0, -1, page.locator(CONTROLS)
    while (number := number + 1) < controls.count():  # of what the last one has left
        control = controls.nth(number).element_handle()
        kind, before = control.evaluate(KINDS), control.evaluate(VALUE)
        if kind not in KEYS:
            assert kind in ("color", "file"), kind
            continue
        there, back = KEYS[kind]
        control.focus()
        page.keyboard.press(there)
        if control.evaluate(VALUE) == before:
            there, back = back, there
            page.keyboard.press(there)
        assert control.evaluate(VALUE) != before, control.evaluate("(control) => control.outerHTML")
        page.keyboard.press(back)
        count += 1
    return count
