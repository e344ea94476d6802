"""Controls of one viewer: frame, wipe, stage to show and schedule; and the times of its last picture."""

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
import viser
from jaxtyping import UInt8

from hyjax.core.schedule import Schedule
from hyjax.tour.checks import clamp_number
from hyjax.tour.viewpoint import Shown, Viewpoint, scale_schedule

KAPPA_RANGE, MOST_STEPS = 1.5, 4.0
STAGES = {
    "photo light": "light that bounces",
    "g-buffer": "surface seen by the camera",
    "shaded": "light and shadow maps",
    "guide": "guide",
    "cascade": "diffusion of the light",
    "shadow pass": "diffusion of the shadows",
    "composite": "times the photo",
    "show": "to the screen's bytes",
}


class ViewControls:
    """Control panel of one viewer. Values are checked: a browser may send anything.

    Attributes:
        frame_slider, wipe_slider, play_box, back_button: to follow what is done with them.
        refinement: the controls of stage and schedule, likewise.

    Args:
        gui: of the browser.
        schedules: to choose from, by name; the first is the default.
        frames: how many the capture has.
        live: whether more of them arrive.
    """

    def __init__(
        self, gui: viser.GuiApi, schedules: Mapping[str, Schedule], frames: int, *, live: bool = False
    ) -> None:
        self._schedules, self._last = schedules, frames - 1
        with gui.add_folder("View", order=-2):
            self.frame_slider: Any = gui.add_slider(
                "Frame", 0, max(self._last, 1), 1, 0, hint="Where the photo was taken from"
            )
            self.wipe_slider = gui.add_slider(
                "Photo over it", 0.0, 1.0, 0.01, 0.0, hint="Wipe the photo over the relit one, from the left"
            )
            self.play_box = gui.add_checkbox("Play the capture", False)
            self._follow_box = gui.add_checkbox("Follow", live, visible=live, hint="Always show the newest frame")
            self.back_button = gui.add_button("Back into the picture", visible=False, color="orange")
            self._rate = gui.add_markdown("Compiling the first picture …")
        with gui.add_folder("How it works", expand_by_default=False, order=2):
            self._shown = gui.add_dropdown("Show", get_args(Shown), hint="A stage of the picture")
            self._schedule = gui.add_dropdown("Schedule", tuple(schedules), hint="Steps of diffusion by size")
            less = "Less: fainter edges stop the light"
            self._kappa = gui.add_slider("κ × 10^", -KAPPA_RANGE, KAPPA_RANGE, 0.05, 0.0, hint=less)
            self._steps = gui.add_slider("Steps ×", 0.0, MOST_STEPS, 0.5, 1.0, hint="0: nothing is repaired")
            self._times = gui.add_markdown("")
            self._photo = gui.add_image(np.zeros((3, 4, 3), np.uint8), label="The photo", format="jpeg")
        self.refinement = (self._shown, self._schedule, self._kappa, self._steps)

    @property
    def frame(self) -> int:
        """Number of the frame."""
        return round(clamp_number(self.frame_slider.value, 0, self._last))

    @frame.setter
    def frame(self, number: int) -> None:
        self.frame_slider.value = round(clamp_number(number, 0, self._last))

    @property
    def follow(self) -> bool:
        """Whether the newest frame is to be shown."""
        return bool(self._follow_box.value)

    def set_frames(self, count: int) -> None:
        """Set the number of frames that the capture has by now."""
        self._last = count - 1
        self.frame_slider.max = max(self._last, 1)
        if self.frame_slider.value > self._last:
            self.frame_slider.value = self._last

    @property
    def wipe(self) -> float:
        """Share of the picture that the photo covers."""
        return clamp_number(self.wipe_slider.value, 0.0, 1.0)

    def viewpoint(self) -> Viewpoint:
        """Frame, stage and schedule as the controls say."""
        shown: Any = self._shown.value if self._shown.value in get_args(Shown) else "relit"
        schedule = self._schedules.get(self._schedule.value, next(iter(self._schedules.values())))
        kappa = 10.0 ** clamp_number(self._kappa.value, -KAPPA_RANGE, KAPPA_RANGE)
        steps = clamp_number(self._steps.value, 0.0, MOST_STEPS)
        return Viewpoint(self.frame, shown, scale_schedule(schedule, steps, kappa))

    def show_photo(self, photo: UInt8[np.ndarray, "h w 3"]) -> None:
        """Show the frame as it was taken."""
        self._photo.image = photo

    def show_rate(self, seconds: float) -> None:
        """Show how long a picture took."""
        rate = f"**{1 / seconds:.0f} fps** · " if seconds < 1 else ""
        self._rate.content = f"{rate}{1e3 * seconds:.0f} ms for this picture"

    def show_stages(self, milliseconds: Mapping[str, float]) -> None:
        """Show how long each stage of a picture took."""
        rows = "\n".join(f"| {label} | {milliseconds[k]:.1f} |" for k, label in STAGES.items() if k in milliseconds)
        self._times.content = f"| stage | ms |\n|---|---|\n{rows}"
