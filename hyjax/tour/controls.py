"""Controls that all viewers share: hour and weather, lamps and windows, furniture, exports."""

import datetime
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, get_args

import numpy as np
import viser
from jaxtyping import Float

from hyjax.tour.checks import checked_flag, clamp_number
from hyjax.tour.events import change_handler, task_handler
from hyjax.tour.exports import save_setup, save_video, save_view
from hyjax.tour.placement import north_for_bearing
from hyjax.tour.plan import KINDS, LARGEST_FACTOR, TourPlan
from hyjax.tour.session import Session
from hyjax.tour.sky import Weather
from hyjax.tour.tools import MOST_UPLOADED, add_mesh, too_large, too_many
from hyjax.tour.uploads import Upload, take_uploads
from hyjax.tour.viewer import Viewer

COMPASS_POINTS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
ICONS: dict[str, Any] = {
    "bulb": viser.Icon.BULB,
    "spot": viser.Icon.LAMP,
    "candle": viser.Icon.CANDLE,
    "strip": viser.Icon.LINE,
}
LARGEST_LUMEN, KELVIN_RANGE = 5000.0, (1800, 8000)
DAY_LENGTH = len("2026-06-21")


class Controls:
    """Shared control panel."""

    def __init__(self, session: Session, gui: viser.GuiApi, viewers: Mapping[int, Viewer]) -> None:
        self.session, self._gui, self._viewers = session, gui, viewers
        self._selected: Any = None
        self._fields: dict[str, Any] = {}
        self._sources: dict[str, Any] = {}
        self._add_daylight()
        self._add_lamps()
        self._add_photo_sources()
        self._add_furniture()
        self._add_exports()
        self.show_plan()

    # ---- panels ----

    def _add_daylight(self) -> None:
        gui, plan = self._gui, self.session.plan
        with gui.add_folder("Daylight", order=-1):
            self._fields["hour"] = gui.add_slider(
                "Hour", 0.0, 24.0, 0.1, plan.hour, marks=((6, "6"), (12, "12"), (18, "18"))
            )
            self._fields["weather"] = gui.add_dropdown("Weather", get_args(Weather), initial_value=plan.weather)
            self._fields["exposure"] = gui.add_slider("Exposure", -4.0, 4.0, 0.1, plan.exposure, hint="Stops")
            self._daylight = gui.add_markdown("")
            with gui.add_folder("Where and when", expand_by_default=False):
                self._fields["day"] = gui.add_text("Date", plan.day, hint="As 2026-06-21")
                self._fields["latitude"] = gui.add_slider("Latitude", -90.0, 90.0, 0.5, plan.latitude)
                self._fields["north"] = gui.add_slider(
                    "North", 0.0, 360.0, 1.0, plan.north % 360, hint="Turns the house"
                )
            gui.add_button("Add a window", icon=viser.Icon.WINDOW, hint="Then draw it on a wall").on_click(
                self._tool_button("window")
            )
        for name, control in self._fields.items():
            control.on_update(change_handler(self._viewers, functools.partial(self._set_field, name)))

    def _set_field(self, name: str, event: Any) -> None:
        if name == "day" and len(str(event.target.value)) < DAY_LENGTH:
            return  # still being typed
        self.session.change(**{name: event.target.value})

    def _add_lamps(self) -> None:
        with self._gui.add_folder("Lamps", order=0):
            self._gui.add_markdown("Choose one, then click where it goes.")
            for kind in KINDS:
                self._gui.add_button(kind.capitalize(), icon=ICONS[kind]).on_click(self._tool_button(kind))

    def _add_photo_sources(self) -> None:
        light = self.session.renderer.photo_light
        if light is None:
            return
        gui = self._gui
        with gui.add_folder("The photo's own light", expand_by_default=False, order=0.5):
            gui.add_markdown("What is left of the light that the photos were taken in: 0 off, 1 as it was.")
            for name in light.estimate.names:
                slider = gui.add_slider(
                    spoken(name), 0.0, LARGEST_FACTOR, 0.05, self.session.plan.existing.get(name, 0.0)
                )
                slider.on_update(change_handler(self._viewers, functools.partial(self._set_source, name)))
                self._sources[name] = slider

    def _set_source(self, name: str, event: Any) -> None:
        self.session.keep_source(name, event.target.value)

    def _add_furniture(self) -> None:
        gui = self._gui
        with gui.add_folder("Furniture", expand_by_default=False, order=1):
            gui.add_markdown("Light and shadow follow what moves; the photo itself keeps it where it was.")
            pick = gui.add_button("Pick up", icon=viser.Icon.HAND_GRAB, hint="Then click on it")
            pick.on_click(self._tool_button("furniture"))
            bring = gui.add_upload_button("Bring a mesh", icon=viser.Icon.UPLOAD, hint="PLY, OBJ or GLB, in metres")

        def uploaded(viewer: Viewer, upload: Upload) -> None:
            add_mesh(self.session, viewer.frame, upload.name, upload.content)

        def refuse(number: int, name: str, size: int) -> None:
            viewer = self._viewers.get(number)
            if viewer is not None:
                viewer.notices.refuse(too_large(name, size) if size > MOST_UPLOADED else too_many(name))

        take_uploads(bring, MOST_UPLOADED, task_handler(self._viewers, uploaded), refuse)

    def _add_exports(self) -> None:
        gui = self._gui

        def add_button(label: str, icon: Any, task: Callable[[Viewer], None], color: Any = None) -> None:
            button = gui.add_button(label, icon=icon, color=color)
            button.on_click(task_handler(self._viewers, lambda viewer, _: task(viewer)))

        with gui.add_folder("Take home", expand_by_default=False, order=3):
            add_button("This picture", viser.Icon.PHOTO, save_view)
            add_button("The lights", viser.Icon.BULB, save_setup)
            add_button("A video", viser.Icon.MOVIE, save_video)
            add_button("Begin anew", viser.Icon.TRASH, lambda _: self.session.reset(), "gray")

    def _tool_button(self, tool: str) -> Any:
        async def clicked(event: Any) -> None:
            viewer = self._viewers.get(event.client_id)
            if viewer is not None:
                viewer.select_tool(None if viewer.tool == tool else tool)

        return clicked

    # ---- what they show ----

    def show_plan(self) -> None:
        """Show the plan's present values."""
        plan = self.session.plan
        for name, control in self._fields.items():
            value = getattr(plan, name)
            if name != "day" or len(control.value) >= len(value):  # not while it is being typed
                control.value = value % 360 if name == "north" else value
        for name, slider in self._sources.items():
            slider.value = plan.existing.get(name, 0.0)
        self._daylight.content = describe_daylight(plan, self.session.renderer.up)

    def show_selected(self) -> None:
        """Show the controls of the selected lamp, window or piece of furniture."""
        if self._selected is not None:
            self._selected.remove()
            self._selected = None
        if self.session.selected is None:
            return
        kind, index = self.session.selected
        thing = getattr(self.session.plan, kind)[index]
        gui, session, viewers = self._gui, self.session, self._viewers
        name = {"windows": "Window", "pieces": "Furniture"}.get(kind) or thing.kind.capitalize()
        self._selected = gui.add_folder(f"{name} {index + 1}", order=-1.5)

        def bind(control: Any, field: str, convert: Any = float) -> None:
            def set_field(event: Any) -> None:
                session.replace(kind, index, **{field: convert(event.target.value)})

            control.on_update(change_handler(viewers, set_field))

        def add_size(label: str, field: str, largest: float) -> None:
            value = clamp_number(getattr(thing, field), 0.2, largest)
            bind(gui.add_slider(label, 0.2, largest, 0.05, value), field)

        with self._selected:
            if kind == "lamps":
                most, step = (100.0, 1.0) if thing.kind == "candle" else (LARGEST_LUMEN, 10.0)
                bind(gui.add_slider("Lumen", 0.0, max(most, thing.lumen), step, thing.lumen), "lumen")
                kelvin = round(clamp_number(thing.kelvin, *KELVIN_RANGE))
                bind(gui.add_slider("Kelvin", *KELVIN_RANGE, 50, kelvin), "kelvin")
                bind(gui.add_checkbox("On", thing.on), "on", checked_flag)
            elif kind == "windows":
                add_size("Width", "width", 5.0)
                add_size("Height", "height", 4.0)
            else:
                bind(gui.add_checkbox("Taken away", thing.removed), "removed", checked_flag)
            done = gui.add_button("Done", icon=viser.Icon.CHECK)
            label = "Put back" if kind == "pieces" else "Remove"
            remove = gui.add_button(label, icon=viser.Icon.TRASH, color="gray")
        done.on_click(change_handler(viewers, lambda _: session.select(None)))
        remove.on_click(change_handler(viewers, lambda _: session.remove(kind, index)))


def spoken(name: str) -> str:
    """Name of a source as a page shows it: `window-1` becomes `Window 1`."""
    return name.replace("-", " ").replace("_", " ").capitalize()


def describe_daylight(plan: TourPlan, up: Float[np.ndarray, "3"]) -> str:
    """Date, hour, sun or moon, and where the windows look, as one line."""
    sky = plan.sky()
    h = plan.hour
    clock = f"{int(h):02d}:{int(h * 60 % 60):02d}"
    height = float(sky.toward[2])
    if plan.weather == "clear" and sky.direct > 1 and height > -0.02:
        light = f"sun {max(0.0, math.degrees(math.asin(height))):.0f}° high, {sky.direct:,.0f} lux"
    elif sky.direct > 0:
        light = f"moonlight, {sky.direct:.2g} lux"
    elif sky.sky > 1:
        light = f"{sky.sky:,.0f} lux from the sky"
    else:
        light = "dark outside"
    day = datetime.date.fromisoformat(plan.day)
    windows = "".join(
        f"; window {number + 1} looks {COMPASS_POINTS[round(bearing / 45) % 8]}"
        for number, window in enumerate(plan.windows)
        for bearing in [(plan.north - north_for_bearing(window, 0.0, up)) % 360]
    )
    return f"{day:%-d %B}, {clock}: {light}{windows}"
