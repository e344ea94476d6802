"""Settings of a tour. The command line takes its options, their defaults and their help from here."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hyjax.relighting.settings import read_schedule
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL
from hyjax.util.settings import Settings

if TYPE_CHECKING:
    from hyjax.choices.choice import Renderer
    from hyjax.configuration import Configuration
    from hyjax.core.schedule import Schedule

Engine = Literal["auto", "visitor", "server"]


@dataclasses.dataclass(frozen=True)
class TourSettings(Settings):
    """Relight a capture live in the browser: hour and weather, windows, lamps, furniture. Pictures are at most 640
    pixels wide unless --size says otherwise."""

    scene: SceneSettings = dataclasses.field(default_factory=SceneSettings)
    configuration: str | None = None
    """quality, balanced, fast, or a JSON file that tune wrote; see relight. The log names the choices that a
    tour does not follow."""
    guide: str | None = None
    """Guide of the diffusion: rgb (the default), small or a safetensors file; see relight."""
    schedule: Path | None = None
    """JSON file of one more schedule to choose from, such as tune writes."""
    keep_photo_light: bool = False
    """Leave the light that the frames were taken under in the pictures, and bounces out."""
    live: str | None = None
    """Follow frames that arrive: a folder in the 7-Scenes layout that grows, '-' for messages on stdin (see
    docs/live_frames.md), or 'record3d' for a phone with that app on USB (never tried). The photo's own light then
    stays in the pictures."""
    engine: Engine = "auto"
    """Who draws the pictures: visitor (their own GPU), server, or auto: the GPU where there is one, else the
    server. Moved furniture and frames that arrive are drawn by the server."""
    port: int = 8080
    """Where the page is served."""
    host: str = LOCAL
    """Address to listen at. Anybody who reaches another address than the default can use the tour."""
    out: Path = Path("tour")
    """Folder for saved files, and for the set-up, with which the tour goes on next time."""
    quiet: bool = False
    """No progress bars."""

    def check(self) -> "TourSettings":
        """These settings, if a tour can start with them as far as that can be known in advance.

        Raises:
            InputError: a port out of range, or a schedule or scene that cannot be opened.
        """
        if not 0 <= self.port <= 65535:
            raise InputError(f"port: must lie in 0..65535, got {self.port}")
        self.scene.check()
        if self.live is not None and (self.scene.capture is not None or self.scene.mesh is not None):
            raise InputError("live: frames that arrive make their own surface; leave --capture and --mesh out")
        self.open_schedules()
        return self

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the page."""
        return self.host in (LOCAL, "localhost")

    @property
    def renderer(self) -> "Renderer":
        """Name of the tour's renderer in the table of choices."""
        return "tour" if self.live is None else "live tour"

    def open_configuration(self) -> "Configuration":
        """Configuration by name or from a file, with the guide of these settings.

        Raises:
            InputError: no such configuration, or one that tours do not show.
        """
        from hyjax.configuration import DEFAULT, Configuration

        chosen = Configuration.open(self.configuration or DEFAULT)
        if self.guide is not None:
            chosen = chosen.with_choices({"guide": self.guide, "guide_size": None})
        chosen.followed_by(self.renderer, say=False)
        return chosen

    def open_schedules(self) -> dict[str, "Schedule"]:
        """Schedules to choose from, by name; the default first.

        Raises:
            InputError: the file cannot be read, or holds no schedule.
        """
        from hyjax.core.schedule import PRESETS, Schedule

        presets = {name: Schedule.preset(name) for name in PRESETS if not name.endswith("shadow")}
        if self.configuration is not None:
            presets = {f"configuration {self.configuration}": self.open_configuration().schedule} | presets
        if self.schedule is None:
            return presets
        tuned = read_schedule(self.schedule)
        return {f"{tuned.name} ({self.schedule.name})": tuned} | presets
