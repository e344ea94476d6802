"""The controls that all viewers share: hour and weather, lamps and windows, furniture, what to save."""

import datetime
import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, get_args

import viser

from hyjax.tour.place import facing
from hyjax.tour.plan import KINDS, Plan
from hyjax.tour.sky import Weather
from hyjax.tour.viewer import Viewer, asked_by, guarded, within

if TYPE_CHECKING:
    from hyjax.tour.page import Tour

POINTS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
ICONS: dict[str, Any] = {
    "bulb": viser.Icon.BULB,
    "spot": viser.Icon.LAMP,
    "candle": viser.Icon.CANDLE,
    "strip": viser.Icon.LINE,
}
LARGEST_LUMEN, KELVIN = 5000.0, (1800, 8000)


class Controls:
    """See the module's docstring."""

    def __init__(self, tour: "Tour") -> None:
        self.tour = tour
        self._chosen: Any = None
        self._plain: dict[str, Any] = {}
        self._daylight()
        self._lamps()
        self._furniture()
        self._save()
        self.follow()

    # ---- the controls ----

    def _daylight(self) -> None:
        gui, plan = self.tour.server.gui, self.tour.plan
        with gui.add_folder("Daylight", order=-1):
            self._plain["hour"] = gui.add_slider(
                "Hour", 0.0, 24.0, 0.1, plan.hour, marks=((6, "6"), (12, "12"), (18, "18"))
            )
            self._plain["weather"] = gui.add_dropdown("Weather", get_args(Weather), initial_value=plan.weather)
            self._plain["exposure"] = gui.add_slider("Exposure", -4.0, 4.0, 0.1, plan.exposure, hint="Stops")
            self._told = gui.add_markdown("")
            with gui.add_folder("Where and when", expand_by_default=False):
                self._plain["day"] = gui.add_text("Date", plan.day, hint="As 2026-06-21")
                self._plain["latitude"] = gui.add_slider("Latitude", -90.0, 90.0, 0.5, plan.latitude)
                self._plain["north"] = gui.add_slider(
                    "North", 0.0, 360.0, 1.0, plan.north % 360, hint="Turns the house"
                )
            gui.add_button("Add a window", icon=viser.Icon.WINDOW, hint="Then draw it on a wall").on_click(
                self._tool("window")
            )
        for name, control in self._plain.items():
            control.on_update(guarded(self.tour, functools.partial(self._set, name)))

    def _set(self, name: str, event: Any) -> None:
        if name == "day" and len(str(event.target.value)) < len("2026-06-21"):
            return  # still being typed
        self.tour.change(**{name: event.target.value})

    def _lamps(self) -> None:
        gui = self.tour.server.gui
        with gui.add_folder("Lamps", order=0):
            gui.add_markdown("Choose one, then click where it goes.")
            for kind in KINDS:
                gui.add_button(kind.capitalize(), icon=ICONS[kind]).on_click(self._tool(kind))

    def _furniture(self) -> None:
        gui, tour = self.tour.server.gui, self.tour
        with gui.add_folder("Furniture", expand_by_default=False, order=1):
            gui.add_markdown("Light and shadow follow what moves; the photo itself keeps it where it was.")
            pick = gui.add_button("Pick up", icon=viser.Icon.HAND_GRAB, hint="Then click on it")
            pick.on_click(self._tool("furniture"))
            bring = gui.add_upload_button("Bring a mesh", icon=viser.Icon.UPLOAD, hint="PLY, OBJ or GLB, in metres")

        def uploaded(viewer: Viewer, event: Any) -> None:
            tour.bring(viewer, event.target.value.name, event.target.value.content)

        bring.on_upload(asked_by(tour, uploaded))

    def _save(self) -> None:
        gui, tour = self.tour.server.gui, self.tour
        with gui.add_folder("Take home", expand_by_default=False, order=3):
            for label, save, icon in (
                ("This picture", tour.save_view, viser.Icon.PHOTO),
                ("The lights", tour.save_setup, viser.Icon.BULB),
                ("A video", tour.save_video, viser.Icon.MOVIE),
            ):
                gui.add_button(label, icon=icon).on_click(asked_by(tour, functools.partial(_saved, save)))
            gui.add_button("Begin anew", icon=viser.Icon.TRASH, color="gray").on_click(asked_by(tour, self._anew))

    def _anew(self, *_: Any) -> None:
        first = self.tour.studio.first_plan()
        self.tour.handles.select(None)
        self.tour.change(redraw=True, **{name: getattr(first, name) for name in first.__dataclass_fields__})

    def _tool(self, tool: str) -> Any:
        async def take(event: Any) -> None:
            viewer = self.tour.viewers.get(event.client_id)
            if viewer is not None:
                viewer.take(None if viewer.tool == tool else tool)

        return take

    # ---- what they show ----

    def follow(self) -> None:
        """Show the plan as it is now."""
        plan = self.tour.plan
        for name, control in self._plain.items():
            value = getattr(plan, name)
            if name != "day" or len(control.value) >= len(value):  # not while it is being typed
                control.value = value % 360 if name == "north" else value
        self._told.content = told(plan, self.tour)

    def choose(self, chosen: tuple[str, int] | None) -> None:
        """Show the controls of one lamp, window or piece of furniture."""
        if self._chosen is not None:
            self._chosen.remove()
            self._chosen = None
        if chosen is None:
            return
        kind, index = chosen
        thing = getattr(self.tour.plan, kind)[index]
        gui, tour = self.tour.server.gui, self.tour
        name = {"windows": "Window", "pieces": "Furniture"}.get(kind) or thing.kind.capitalize()
        self._chosen = gui.add_folder(f"{name} {index + 1}", order=-1.5)

        def bind(control: Any, field: str, convert: Any = float) -> None:
            def set_field(event: Any) -> None:
                tour.replace(kind, index, **{field: convert(event.target.value)})

            control.on_update(guarded(tour, set_field))

        with self._chosen:
            if kind == "lamps":
                most, step = (100.0, 1.0) if thing.kind == "candle" else (LARGEST_LUMEN, 10.0)
                most = max(most, thing.lumen)
                bind(gui.add_slider("Lumen", 0.0, most, step, thing.lumen), "lumen")
                bind(gui.add_slider("Kelvin", *KELVIN, 50, round(within(thing.kelvin, *KELVIN))), "kelvin")
                bind(gui.add_checkbox("On", thing.on), "on", bool)
            elif kind == "windows":
                bind(gui.add_slider("Width", 0.2, 5.0, 0.05, within(thing.width, 0.2, 5.0)), "width")
                bind(gui.add_slider("Height", 0.2, 4.0, 0.05, within(thing.height, 0.2, 4.0)), "height")
            else:
                bind(gui.add_checkbox("Taken away", thing.removed), "removed", bool)
            done = gui.add_button("Done", icon=viser.Icon.CHECK)
            word = "Put back" if kind == "pieces" else "Remove"
            gone = gui.add_button(word, icon=viser.Icon.TRASH, color="gray")
        done.on_click(guarded(tour, lambda _: tour.handles.select(None)))
        gone.on_click(guarded(tour, lambda _: tour.remove(kind, index)))


def _saved(save: Callable[[Viewer], None], viewer: Viewer, _: Any) -> None:
    save(viewer)


def told(plan: Plan, tour: "Tour") -> str:
    """The daylight in words."""
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
    where = "".join(
        f"; window {number + 1} looks {POINTS[round(bearing / 45) % 8]}"
        for number, window in enumerate(plan.windows)
        for bearing in [(plan.north - facing(window, 0.0, tour.studio.up)) % 360]
    )
    return f"{day:%-d %B}, {clock}: {light}{where}"
