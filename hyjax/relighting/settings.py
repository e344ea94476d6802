"""Settings of a relighting run. The command line takes its options, their defaults and their help from here."""

import dataclasses
import functools
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hyjax.choices.choice import named_values
from hyjax.scene.settings import Occluders, SceneSettings, check_lights_name
from hyjax.util.errors import InputError
from hyjax.util.reading import read_text
from hyjax.util.settings import Settings

if TYPE_CHECKING:
    from hyjax.choices.choice import Renderer as ChoiceRenderer
    from hyjax.configuration import Configuration
    from hyjax.core.schedule import Schedule
    from hyjax.pipeline import Mode

_log = logging.getLogger(__name__)
Renderer = Literal["shadow_map", "blender", "webgpu"]


@dataclasses.dataclass(frozen=True)
class RelightSettings(Settings):
    """Relight the frames of a capture; without arguments, the built-in room."""

    scene: SceneSettings = dataclasses.field(default_factory=SceneSettings)
    frames: str = "all"
    """Which frames, by position in the capture: all, 7, 0:300:30, or a list such as 0,5,9:12."""
    lights: str = "evening-lamps"
    """noon-window, golden-hour, evening-lamps, night-moon, center-point, two-colors, or a YAML or JSON file."""
    configuration: str | None = None
    """quality, balanced, fast, default, paper, or a JSON file that tune wrote: all that follows on how a frame is
    relit. What is given beside it takes the place of the configuration's."""
    schedule: str | None = None
    """hyjax, paper-50, paper-80, naive-50, naive-1000, or a JSON file. Default: hyjax; in paper mode paper-80."""
    kappa: float | None = None
    """Edge sensitivity of a named schedule. Default: 0.05 for hyjax and in paper mode, 0.02 for the others."""
    guide: str | None = None
    """Guide of the diffusion: rgb (the default) is the frame itself, small the network that comes with hyjax,
    small-half that network at half the frame's size; or a safetensors file that train or tune wrote."""
    choices: tuple[str, ...] = ()
    """Choices in the place of the configuration's, such as photo_exponent=1.2 bounces=false."""
    paper_mode: bool = False
    """Exactly the paper: multiply display values, leave holes in the mesh black."""
    keep_photo_light: bool = False
    """Leave the light that the frames were taken under in the picture, as the paper does, and bounces out."""
    video: bool = False
    """For neighbouring frames of a recording: carry refined light from each to the next, against flicker."""
    shadows: bool = True
    """Whether lights cast shadows."""
    occluders: Occluders = "completed"
    """Mesh that casts shadows: completed is the lit one with small holes closed and, if there are depth maps, a
    finer fusion of them; surface is the bare mesh, as always in paper mode."""
    renderer: Renderer = "shadow_map"
    """Renderer of the light: shadow_map; blender: Cycles, which traces every shadow and takes its time; or webgpu:
    whole frames on a graphics processor, by the shaders of an exported page."""
    sampling: int | None = None
    """Refine light at the picture's size over this, as far as the schedule's cells allow, and bring it up under the
    frame: 2 (the default) is half the size. 1 is all of it, as paper mode, blender and webgpu always have it."""
    save_filters: bool = False
    """Also write each frame's raw and refined filter."""
    save_visibility: bool = False
    """Also write each frame's refined visibility."""
    exr: bool = False
    """Also write each picture's linear values, in half precision."""
    each_light: bool = False
    """Relight by each light alone, with --exr, into a folder of its own: any mix is a sum of these pictures."""
    out: Path = Path("out")
    """Folder for the results."""
    quiet: bool = False
    """No progress bars."""

    def check(self) -> "RelightSettings":
        """These settings, if a run can start with them as far as that can be known in advance.

        Raises:
            InputError: a value out of range or of another form, a schedule or set-up that does not exist, or
                options that exclude each other.
        """
        from hyjax.data.frames import frame_numbers

        if self.kappa is not None and self.configuration is not None and self.schedule is None:
            raise InputError("kappa: the configuration brings its own; give --kappa with a named --schedule only")
        if (self.schedule, self.configuration) == (None, None):
            self.open_schedule()
        if self.each_light and self.mode == "paper":
            raise InputError("each_light: pictures of paper mode do not add up; leave one of the two out")
        if self.renderer == "webgpu" and self.video:
            raise InputError("renderer: webgpu makes no videos; leave one of the two out")
        for renderer in self.renderers:
            self.open_configuration().followed_by(renderer, say=False)
        check_lights_name(self.lights)
        frame_numbers(self.frames)
        self.scene.check()
        return self

    @property
    def renderers(self) -> "list[ChoiceRenderer]":
        """Renderers of the run that do not follow all choices of a configuration."""
        found: list[ChoiceRenderer] = ["video" if self.video else "frames"]
        return found + ([] if self.renderer == "shadow_map" else [self.renderer])

    @property
    def divides_photo_light(self) -> bool:
        """Whether the light that the frames were taken under is divided out."""
        return self.open_configuration().light.photo_light == "divided"

    @property
    def mode(self) -> "Mode":
        """Mode of the pipeline."""
        return self.open_configuration().mode

    def open_configuration(self) -> "Configuration":
        """Configuration by name or from a file, with the other options' changes."""
        return self._configuration

    @functools.cached_property
    def _configuration(self) -> "Configuration":
        from hyjax.configuration import DEFAULT, Configuration

        name = self.configuration or ("paper" if self.paper_mode else DEFAULT)
        chosen = Configuration.open(name)
        if self.paper_mode and chosen.mode != "paper":
            raise InputError(f"configuration {name}: is of linear light; leave it or --paper-mode out")
        if self.schedule is not None or self.kappa is not None:
            chosen = dataclasses.replace(chosen, schedule=self.open_schedule())
        values: dict[str, Any] = dict(named_values(self.choices))
        if values.get("mode") == "paper":
            raise InputError("choices: for the paper's form give --paper-mode or --configuration paper, not mode")
        if self.sampling is not None:
            values["sampling"] = self.sampling
        if self.keep_photo_light:
            values["photo_light"] = "kept"
        if self.guide is not None:
            values |= {"guide": self.guide, "guide_size": None, "guide_every": 1}
        made = chosen.with_choices(values).check()
        if idle := named_values(self.choices).keys() - made.values().keys():
            _log.warning("choices: %s: of no effect beside the others", ", ".join(sorted(idle)))
        return made

    def open_schedule(self) -> "Schedule":
        """Schedule by name or from a file.

        Raises:
            InputError: no such schedule, a file that cannot be used, or a κ beside a file's own.
        """
        from hyjax.core.schedule import PAPER_KAPPA

        text = self.schedule or ("paper-80" if self.paper_mode else "hyjax")
        papers = self.paper_mode and self.kappa is None and not is_schedule_file(text)
        return open_schedule(text, PAPER_KAPPA if papers else self.kappa)

    def record(self) -> dict[str, Any]:
        """Options as a run's record has them."""
        options = dataclasses.asdict(self)
        options.pop("scene")
        return (
            self.scene.options()
            | options
            | {
                "capture": str(self.scene.capture or "built-in room"),
                "out": str(self.out),
                "choices": list(self.choices),
                "photo_sources": None if self.scene.photo_sources is None else str(self.scene.photo_sources),
            }
        )


def is_schedule_file(text: str) -> bool:
    """Whether a schedule is named by its file."""
    return Path(text).suffix.lower() == ".json"


def open_schedule(text: str, kappa: float | None = None) -> "Schedule":
    """Schedule by name or from a file."""
    from hyjax.core.schedule import Schedule

    if not is_schedule_file(text):
        return Schedule.preset(text, kappa=kappa)
    if kappa is not None:
        raise InputError(f"kappa: {text} brings its own; give --kappa with a named schedule only")
    return read_schedule(Path(text))


def read_schedule(path: Path) -> "Schedule":
    """Schedule from a JSON file, such as `hyjax tune` writes."""
    from hyjax.core.schedule import Schedule

    text = read_text(path)
    try:
        return Schedule.from_json(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
