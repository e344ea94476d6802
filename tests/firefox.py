"""Debian's Firefox, driven by WebDriver BiDi, which it speaks as it comes."""

import contextlib
import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import until
from extras import need


def firefox() -> str:
    """Path of the browser."""
    path = shutil.which("firefox-esr") or shutil.which("firefox")
    assert path, "needs Firefox; apt install firefox-esr"
    return path


@contextlib.contextmanager
def launched_firefox(driver: Any, **preferences: Any) -> Iterator[Any]:
    """Browser of a driver of playwright's, without a screen.

    Args:
        preferences: by names with `_` in the place of dots.
    """
    need("playwright")
    from playwright.sync_api import Error

    path = firefox()
    values = {name.replace("_", "."): value for name, value in preferences.items()}
    launched = driver.firefox.launch(channel="moz-firefox", executable_path=path, firefox_user_prefs=values)
    try:
        try:
            launched.new_page().close()
        except Error as error:
            if "unknown command" not in str(error):
                raise
            pytest.skip(f"this playwright and this Firefox do not know each other's commands: {error.message}")
        yield launched
    finally:
        launched.close()


class TouchScreen:
    """Page in a Firefox with a touch screen, which playwright has not: spoken to by BiDi directly."""

    def __init__(self, wire: Any) -> None:
        self._wire, self._number = wire, 0
        self.ask("session.new", capabilities={})
        self._context = self.ask("browsingContext.getTree")["contexts"][0]["context"]

    def ask(self, method: str, **parameters: Any) -> Any:
        """Answer to a command."""
        self._number += 1
        self._wire.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (answer := json.loads(self._wire.recv(timeout=60.0))).get("id") != self._number:
            pass
        assert answer["type"] == "success", answer
        return answer["result"]

    def open(self, url: str, width: int, height: int) -> None:
        """Open a page in a window of a size."""
        size = {"width": width, "height": height}
        self.ask("browsingContext.setViewport", context=self._context, viewport=size)
        self.ask("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def evaluate(self, expression: str) -> Any:
        """Value of an expression, by way of JSON."""
        found = self.ask(
            "script.evaluate",
            expression=f"Promise.resolve({expression}).then(JSON.stringify)",
            target={"context": self._context},
            awaitPromise=True,
        )
        assert found["type"] == "success", found
        return json.loads(found["result"].get("value", "null"))

    def drag(self, selector: str, across: float, down: float) -> None:
        """Drag an element by a finger, by CSS pixels."""
        box = self.evaluate(f"document.querySelector('{selector}').getBoundingClientRect()")
        start = {
            "type": "pointerMove",
            "x": round(box["x"] + box["width"] / 2),
            "y": round(box["y"] + box["height"] / 2),
        }
        end = start | {"x": round(start["x"] + across), "y": round(start["y"] + down), "duration": 300}
        steps = [start, {"type": "pointerDown", "button": 0}, end, {"type": "pointerUp", "button": 0}]
        finger = {"type": "pointer", "id": "finger", "parameters": {"pointerType": "touch"}, "actions": steps}
        self.ask("input.performActions", context=self._context, actions=[finger])


@contextlib.contextmanager
def touch_screen() -> Iterator[TouchScreen]:
    """A Firefox with a touch screen."""
    need("tour")
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        Path(profile, "user.js").write_text('user_pref("dom.w3c_touch_events.enabled", 1);\n')
        told = Path(profile, "WebDriverBiDiServer.json")  # its own
        command = [firefox(), "--headless", "--no-remote", "--profile", profile, "--remote-debugging-port", "0"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            until(lambda: told.is_file() and told.read_text().rstrip().endswith("}"))
            port = json.loads(told.read_text())["ws_port"]
            with connect(f"ws://127.0.0.1:{port}/session", max_size=None) as wire:
                screen = TouchScreen(wire)
                yield screen
                screen.ask("browser.close")
            process.wait(30.0)
        finally:
            process.kill()
            process.wait()
