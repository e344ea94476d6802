"""The widget's page in a browser, on a model that only notes what it is sent."""

import base64
import io
import json
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import hyjax
from experiments.browser import browser
from hyjax.exploration.controls import controls, ladders, values
from hyjax.exploration.pictures import slider_ends

FOLDER = Path(hyjax.__file__).parent / "exploration"
MODEL = """
const bytes = (text) => new DataView(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
for (const name of ["photo", "picture"]) traits[name] = bytes(traits[name]);
traits.sheet = new DataView(new ArrayBuffer(0));
const listeners = {};
window.sent = [];
window.model = {
  get: (name) => traits[name],
  set: (name, value) => { traits[name] = value; (listeners[`change:${name}`] || []).forEach((call) => call()); },
  on: (name, call) => (listeners[name] ||= []).push(call),
  off: (name, call) => { listeners[name] = (listeners[name] || []).filter((each) => each !== call); },
  send: (content) => window.sent.push(content),
};
const { default: widget } = await import(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
window.close_ = widget.render({ model: window.model, el: document.querySelector("#widget") });
"""


def traits() -> dict[str, Any]:
    file = io.BytesIO()
    Image.new("RGB", (320, 240), (90, 120, 150)).save(file, "JPEG")
    picture = base64.b64encode(file.getvalue()).decode()
    default = hyjax.Configuration()
    lamp = {"kind": "point", "strength": 900.0, "unit": "lm", "place": [0.5, 0.25], "color": [255, 200, 150]}
    state = {"frame": 0, "frames": 8, "lights": "evening-lamps", "setups": ["noon-window", "evening-lamps"]}
    state |= {"values": values(default), "ladders": ladders(default, slider_ends(default)), "told": 0}
    state |= {
        "views": {"wipe": "photo | relit", "stages": "stages"},
        "preset": "default",
        "view": "wipe",
        "other": "",
    }
    state |= {"presets": ["default", "fast"], "lamps": [lamp, lamp | {"place": None}]}
    found = {"controls": controls(), "state": state, "photo": picture, "picture": picture, "message": ""}
    found |= {"judged": ["default: loss 0.01000"], "times": [["cascade", 3.2], ["composite", 1.0]]}
    return found | {"code": "import hyjax\n"}


@pytest.mark.slow
def test_controls(browser_wanted: None) -> None:
    source = (FOLDER / "widget.js").read_text(encoding="utf-8")
    style = (FOLDER / "widget.css").read_text(encoding="utf-8")
    with browser() as launched:
        page = launched.new_page(viewport={"width": 1000, "height": 800})
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.set_content(f"<style>{style}</style><div id=widget></div>")
        page.evaluate(
            f"async () => {{ const traits = {json.dumps(traits())}; const source = {json.dumps(source)}; {MODEL} }}"
        )
        assert page.locator("input, select").count() > 30
        assert page.locator(".hyjax-judged").inner_text().strip() == "default: loss 0.01000"
        assert page.locator(".hyjax-times").inner_text() == "4 ms: cascade 3, composite 1"

        def sent() -> list[dict[str, Any]]:
            found: list[dict[str, Any]] = page.evaluate("() => window.sent.splice(0)")
            return found

        assert sent() == [{"kind": "ready"}]
        page.get_by_label("1/8 steps").fill("9")
        assert sent() == [
            {"kind": "level", "cascade": "schedule", "index": 1, "key": "steps", "value": 9, "draft": draft}
            for draft in (True, False)
        ]
        page.get_by_label("norm").fill("mean_abs")
        page.get_by_label("norm").blur()
        page.get_by_label("lights", exact=True).select_option("noon-window")
        assert [message["value"] for message in sent()] == ["mean_abs", "noon-window"]
        norm = page.get_by_label("norm")
        norm.fill("l7")
        page.evaluate("() => model.set('state', { ...model.get('state') })")  # of another change
        assert norm.input_value() == "l7"
        norm.press("Enter")
        assert [message["value"] for message in sent()] == ["l7"]
        page.evaluate("() => model.set('state', { ...model.get('state'), told: 1 })")
        assert norm.input_value() == "l2"  # what is refused goes back, though it has the focus
        page.get_by_text("Light of the photo, bounces").click()
        page.get_by_label("bounces", exact=True).uncheck()
        assert sent() == [{"kind": "choice", "name": "bounces", "value": False, "draft": False}]

        box = page.locator(".hyjax-stage").bounding_box()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"])
        page.mouse.down()
        page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
        page.mouse.up()
        moves = sent()
        assert [message["draft"] for message in moves] == [True] * 4 + [False]
        assert moves[-1]["value"] == pytest.approx([0.75, 0.5], abs=0.01)
        assert page.locator(".hyjax-lamp:visible").count() == 1

        page.get_by_label("photo | relit").fill("250")
        assert "25%" in page.locator(".hyjax-relit").evaluate("image => image.style.clipPath")
        page.evaluate("() => model.set('message', 'lam: too large')")
        assert page.get_by_role("alert").inner_text() == "lam: too large"
        page.evaluate(
            "() => { const state = structuredClone(model.get('state')); state.ladders.schedule[0].kappa = 0.25;"
            " state.ladders.schedule.pop(); state.view = 'stages'; model.set('state', state); }"
        )
        assert page.get_by_label("1/16 κ").evaluate("input => input.nextSibling.textContent") == "0.25"
        page.evaluate(
            "() => { const state = structuredClone(model.get('state')); state.ladders.schedule[0].most_steps = 50;"
            " model.set('state', state); }"
        )
        assert page.get_by_label("1/16 steps").get_attribute("max") == "50"
        assert page.get_by_label("1/4 steps").count() == 1  # the shadow pass has one, too
        assert not page.locator(".hyjax-stage").is_visible()
        page.evaluate(
            "() => { const state = structuredClone(model.get('state')); state.lights = '';"
            " state.lamps[0].kind = 'spot'; model.set('state', state); }"
        )
        assert page.get_by_label("0 Spot, lm").count() == 1
        page.evaluate("() => window.close_()")
        assert not errors
