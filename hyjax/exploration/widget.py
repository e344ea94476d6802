"""Widget that shows frames relit and changes how; its page is `widget.js`."""

import base64
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anywidget
import traitlets

from hyjax.configuration import PRESETS, Configuration
from hyjax.exploration.controls import controls, ladders, script, values, with_choice, with_level
from hyjax.exploration.lamps import changed_lamp, lamp_rows
from hyjax.exploration.newest import Newest
from hyjax.exploration.pictures import Pictures, Superseded
from hyjax.exploration.sheets import compared_sheet, jpeg, levels_sheet, stages_sheet
from hyjax.exploration.truth import KnownTruth, Truth, lines, scores
from hyjax.geometry.camera import Camera
from hyjax.light.color import to_display
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.scene.light_setups import SETUPS
from hyjax.scene.scene import AnyConfiguration, AnyLights, Scene
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError, one_line, shown

DRAFT_MS = 15.0
"""Milliseconds of a picture beyond which a draft is made of it while a control is moved."""
LARGEST_DRAFT_SCALE = 4
"""Largest scale of a configuration that is halved."""
VIEWS = {"wipe": "photo | relit", "stages": "stages", "levels": "levels of the cascade", "compare": "A | B"}
"""What can be shown."""
TRUTH_VIEW = {"truth": "relit | truth"}
"""What can be shown where the truth is known."""
UNKNOWN_TRUTH = "of this frame under these lights no truth is known; of a generated room it is under named lights"
FOLDER = Path(__file__).parent
_log = logging.getLogger(__name__)


class Checked(traitlets.TraitType):
    """Trait whose values are checked, and brought into one form."""

    def __init__(self, check: Callable[[Any, Any], Any], default: Any = None) -> None:
        super().__init__(default)
        self._check = check

    def validate(self, obj: Any, value: Any) -> Any:
        return self._check(obj, value)


class Explorer(anywidget.AnyWidget):
    """Widget of a scene's frames, relit while choices and lights are changed by hand, or from Python.

    What is set here moves the controls, and they set it: `configuration`, `lights` (a set-up, lights, or a name),
    `frame`, `view` (a key of `VIEWS`) and `other`, the configuration that it is compared with. `relit` follows, and
    where the truth is known `scores`: of the configuration, and of `other` where they are compared.

    Args:
        scene: whose frames they are.
        frame, lights, configuration: what is shown first.
        truth: what they should look like; None for the true pictures of a generated room.
    """

    _esm = (FOLDER / "widget.js").read_text(encoding="utf-8")
    _css = (FOLDER / "widget.css").read_text(encoding="utf-8")
    configuration = Checked(lambda _, value: Configuration.of(value), Configuration())
    other = Checked(lambda _, value: None if value is None else Configuration.of(value))
    lights = Checked(lambda self, value: self._checked_lights(value), "evening-lamps")
    frame = Checked(lambda self, value: self._checked_frame(value), 0)
    view = Checked(lambda self, value: self._checked_view(value), "wipe")
    relit = traitlets.Any(None, allow_none=True, read_only=True)
    scores: Any = traitlets.List(read_only=True)
    controls: Any = traitlets.List().tag(sync=True)
    state = traitlets.Dict().tag(sync=True)
    photo = traitlets.Bytes().tag(sync=True)
    picture = traitlets.Bytes().tag(sync=True)
    sheet = traitlets.Bytes().tag(sync=True)
    message = traitlets.Unicode().tag(sync=True)
    times: Any = traitlets.List().tag(sync=True)
    judged: Any = traitlets.List().tag(sync=True)
    code = traitlets.Unicode().tag(sync=True)

    def __init__(
        self,
        scene: Scene,
        *,
        frame: int = 0,
        lights: AnyLights = "evening-lamps",
        configuration: AnyConfiguration = None,
        truth: Truth | None = None,
    ) -> None:
        self._scene, self._draft, self._ready, self._warms, self._failed = scene, False, False, False, False
        self._newest, self._judging = Newest(self._work), Newest(self._judge)
        self._truth = KnownTruth(scene, truth)
        self._to_judge: Any = ()  # see `_judge_later`
        self._pictures = Pictures(scene, lambda: self._newest.superseded)
        self._last_ms: dict[bool, float] = {}  # of a whole, by whether its frame was kept
        self._made: tuple[LightSetup | str, str, LightSetup] | None = None
        self._camera: Camera | None = None
        self._changing = threading.RLock()
        self._photo: tuple[int, bytes] = (-1, b"")
        super().__init__()
        self.controls = controls()
        self.configuration, self.lights, self.frame = Configuration.of(configuration), lights, frame
        self._make(draft=False)
        self._ready = True
        self.on_msg(self._received)

    def __repr__(self) -> str:
        lights = self.lights if isinstance(self.lights, str) else "own lights"
        return f"Explorer: frame {self.frame}, {lights}, configuration {self.configuration.name}"

    def _repr_mimebundle_(self, **kwargs: Any) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Widget, and its last picture for where no kernel runs."""
        self.wait()
        found = super()._repr_mimebundle_(**kwargs)
        if found is None:
            return None
        data, metadata = found if isinstance(found, tuple) else (found, {})
        picture = self.sheet if self.view != "wipe" and self.sheet else self.picture
        return {**data, "image/jpeg": base64.b64encode(picture).decode()}, metadata

    def _checked_lights(self, value: Any) -> LightSetup | str:
        return value if isinstance(value, str) and value in SETUPS else self._scene.lights(value)

    def _checked_view(self, value: Any) -> str:
        if value not in self._views():
            raise InputError(f"view: must be one of {', '.join(self._views())}, got {shown(value)}")
        return str(value)

    def _views(self) -> dict[str, str]:
        return VIEWS | TRUTH_VIEW if self._truth.known else VIEWS

    def _checked_frame(self, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < len(self._scene):
            raise InputError(f"frame {shown(value)}: the capture has frames 0 to {len(self._scene) - 1}")
        return value

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until picture and scores are those of what is set; whether they were in time and could be made.

        False, too, where a picture's own thread asks, as in an observer of `relit`.
        """
        return self._newest.wait(seconds) and self._judging.wait(seconds) and not self._failed

    @traitlets.observe("configuration", "other", "lights", "frame", "view")
    def _follow(self, _: Any) -> None:
        if self._ready:
            self.message = ""
            self._show_state()
            self._newest.request(draft=self._draft)

    def _received(self, _: Any, content: Any, buffers: Any = None) -> None:
        """Change what a control of the page says; what it cannot be is said on the page."""
        with self._changing:
            try:
                self._draft = bool(content.get("draft"))
                self._change(content)
                self.message = ""
            except (InputError, traitlets.TraitError) as error:
                self._tell(str(error))
            except Exception as error:  # of a message that is none of ours
                _log.debug("a message of the page could not be used", exc_info=True)
                self._tell(f"{type(error).__name__}: {error}")
            finally:
                self._draft = False

    def _tell(self, text: str) -> None:
        """Show a line, and the controls as they are."""
        self.message = one_line(text)
        self._show_state(force=True)

    def _change(self, content: dict[str, Any]) -> None:
        kind, value = content.get("kind"), content.get("value")
        if kind == "choice":
            self.configuration = with_choice(self.configuration, str(content["name"]), value)
        elif kind == "level":
            place = content["cascade"], content["index"], content["key"]
            self.configuration = with_level(self.configuration, *place, value)
        elif kind == "preset":
            self.configuration = Configuration.preset(str(value))
        elif kind == "keep":
            self.other = self.configuration
            self.view = "compare"
        elif kind == "swap":
            self.configuration, self.other = self.other, self.configuration
        elif kind in ("frame", "lights", "view"):
            setattr(self, kind, value)
        elif kind in ("strength", "place"):
            self._change_lamp(content["index"], kind, value)
        elif kind == "ready":  # a page is there: what its controls need is compiled before it is wanted
            self._pictures.fills = self._warms = True
        else:
            raise InputError(f"explore: no control {shown(kind)}")
        if not content.get("draft"):
            self._newest.request()  # the whole, also where the last draft had this value

    def _change_lamp(self, index: int, kind: str, value: Any) -> None:
        """Set a lamp's strength, or its place in the picture as shares of its width and height."""
        setup, camera = self._setup(), self._camera
        if setup is None:
            raise InputError("lights: they are not there yet; wait for their picture")
        if camera is None:
            raise InputError("lights: there is no picture yet to place them in")
        self.lights = changed_lamp(setup, camera, index, kind, value)

    def _setup(self) -> LightSetup | None:
        """Lights that are set; None for those of a name until a picture of it is made."""
        lights, made = self.lights, self._made
        if isinstance(lights, LightSetup):
            return lights
        key = lights, self.configuration.light.photo_light
        return made[2] if made is not None and made[:2] == key else None

    def _work(self, draft: bool) -> bool:
        """Make the picture of what is set now; whether it is a draft."""
        self._failed = False
        try:
            return self._make(draft=draft)
        except Superseded:
            return False
        except Exception as error:
            self._fail(error)
            return False

    def _fail(self, error: Exception) -> None:
        """Say on the page why what is set could not be made."""
        self._failed = True
        if not isinstance(error, InputError):
            _log.exception("a picture could not be made")
        self._tell(str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}")

    def _make(self, *, draft: bool) -> bool:
        frame, lights, configuration, view = self.frame, self.lights, self.configuration, self.view
        clock, kept = StageClock(), self._pictures.knows(frame, lights, configuration)
        draft = draft and self._has_drafts(configuration) and self._last_ms.get(kept, 0.0) > DRAFT_MS
        if draft:
            image = self._pictures.draft(frame, lights, configuration, clock)
        else:
            relit = self._pictures.relit(frame, lights, configuration, clock)
            image = relit.image
            self._last_ms[kept] = 1e3 * sum(map(sum, clock.seconds.values()))
        opened = self._scene.frame(frame)
        self._camera = opened.camera
        key = lights, configuration.light.photo_light
        if isinstance(lights, LightSetup):
            self._made = *key, lights
        elif self._made is None or self._made[:2] != key:
            self._made = *key, self._pictures.relighter(lights, configuration).setup
        setup = self._made[2]
        with clock("JPEG"):
            picture = jpeg(to_display(image))
            if self._photo[0] != frame:
                self._photo = frame, jpeg(opened.image)
        with self.hold_sync():
            self.picture, self.photo = picture, self._photo[1]
            self.times = [[stage, round(1e3 * sum(taken), 1)] for stage, taken in clock.seconds.items()]
            if not draft:
                self.code = script(self._scene.settings, frame, lights, configuration)
            self._show_state()
        if not draft:
            self.set_trait("relit", relit)
            self._judge_later(frame, lights, setup, {configuration.name: relit.image})
            self._show_sheet(view, frame, lights, setup, configuration, relit)
        if self._warms and not draft and self._has_drafts(configuration):
            self._warms = False
            self._pictures.draft(frame, lights, configuration, StageClock())
        return draft

    def _has_drafts(self, configuration: Configuration) -> bool:
        return configuration.mode != "paper" and configuration.sampled().scale <= LARGEST_DRAFT_SCALE

    def _show_sheet(self, view: str, *made: Any) -> None:
        """Show the sheet of a view; one that cannot be made leaves the picture as it is."""
        try:
            self.sheet = b"" if view == "wipe" else jpeg(self._sheet(view, *made))
        except Superseded:
            raise
        except Exception as error:
            self.sheet = b""
            self._fail(error)

    def _sheet(
        self, view: str, frame: int, lights: Any, setup: LightSetup, configuration: Configuration, relit: Relit
    ) -> Any:
        if view == "stages":
            return stages_sheet(self._scene.frame(frame).image, relit)
        if view == "truth":
            known = self._truth.picture(frame, lights, setup, relit.image.shape)
            if known is None:
                raise InputError(f"truth: {UNKNOWN_TRUTH}")
            return compared_sheet(("relit", to_display(relit.image)), ("truth", known))
        if view == "levels":
            return levels_sheet(self._pictures.levels(frame, lights, configuration, StageClock()))
        other = self.other or Configuration()
        second = self._pictures.relit(frame, lights, other, StageClock(), beside=True)
        named = {f"A: {configuration.name}": relit.image, f"B: {other.name}": second.image}
        self._judge_later(frame, lights, setup, named)
        return compared_sheet(*((name, to_display(image)) for name, image in named.items()))

    def _judge_later(self, frame: int, lights: Any, setup: LightSetup, pictures: dict[str, Any]) -> None:
        """Judge pictures by name of a frame under lights, as given and placed."""
        if self._truth.known:
            self._to_judge, self._failed = (frame, lights, setup, pictures), False  # whatever an older one came to
            self._judging.request()

    def _judge(self, _: bool) -> bool:
        """Judge the last pictures."""
        asked = self._to_judge
        frame, lights, setup, pictures = asked
        try:
            known = self._truth.picture(frame, lights, setup, next(iter(pictures.values())).shape)
            found = [] if known is None else scores(pictures, known)
        except Exception as error:
            if asked is self._to_judge:
                self._fail(error)
            return False
        if asked is self._to_judge:
            self.set_trait("scores", found)
            self.judged = lines(found) or [UNKNOWN_TRUTH]
        return False

    def _show_state(self, *, force: bool = False) -> None:
        """Tell the page what its controls are to show."""
        configuration = self.configuration
        name = self.lights if isinstance(self.lights, str) else ""
        state = {"frame": self.frame, "frames": len(self._scene), "lights": name, "setups": list(SETUPS)}
        rows = ladders(configuration, self._pictures.ends(configuration))
        state |= {"values": values(configuration), "ladders": rows, "view": self.view}
        presets = ["default", "paper", *PRESETS]
        state |= {"views": self._views(), "preset": configuration.name, "presets": presets}
        lamps = lamp_rows(self._setup() or (self._made and self._made[2]), self._camera)
        state |= {"lamps": lamps, "other": self.other.name if self.other else ""}
        state["told"] = self.state.get("told", 0) + force  # so that a refused value is set back
        self.state = state
