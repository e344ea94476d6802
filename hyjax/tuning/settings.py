"""Settings of a tuning run. The command line takes its options, their defaults and their help from here."""

import dataclasses
import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from hyjax.choices.choice import named_values
from hyjax.scene.settings import SceneSettings, check_lights_name
from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL
from hyjax.util.settings import Settings
from hyjax.util.sizes import parse_size

if TYPE_CHECKING:
    from hyjax.tuning.request import Budget

BudgetStage = Literal["cascade", "frame"]
SETUPS = ("evening-lamps", "two-colors", "golden-hour", "night-moon")
"""Light set-ups that frames are tuned under by default."""
DIFFUSION_LIGHTS = "two-colors"
"""The set-up that the diffusion alone is tuned under by default."""
TRIALS, MOST_TRIALS = 60, 100_000
USUAL_SECONDS = 300.0
"""Time limit of a search on a capture where neither it nor the number of trials is given."""
ROOM_PHOTOS = 12
"""Number of photos of a room of known truth."""
CONVERGED_TARGET = "converged"
"""Target where there is no better mesh: the converged diffusion that the paper's cascade approximates."""


@dataclasses.dataclass(frozen=True)
class TuneScene(SceneSettings):
    """A capture, its rough surface, and the size to work at."""

    mesh: str | None = None
    """The rough mesh: a file, 'captured' (came with the capture), 'scan' (simulated headset scan), or 'fused' (from
    depth maps). Default: captured where there is one, else scan."""
    size: str | None = "512"
    """Work at this size: 512 (square) or 640x480 (width x height)."""
    seed: int = 0
    """Of the search and of a simulated scan. The same seed on the same latency table makes the same search,
    unless a time limit cuts it short; the clock has the last word on what fits."""


@dataclasses.dataclass(frozen=True)
class OtherDevice(Settings):
    """Another device than this machine, that a schedule is tuned for."""

    device: bool = False
    """Tune for the device that opens a page which this command serves: it times schedules in its browser."""
    host: str = LOCAL
    """With --device: address to listen at; any but the default has HTTPS and a token, for a phone nearby."""
    port: int = 8090
    """With --device: where the page is served; 0 for any port that is free."""
    latency: Path | None = None
    """Tune for the device whose times are in this file, by a page or another engine (docs/latency_format.md)."""
    request: Path | None = None
    """Write into this file which schedules another engine is to time for --latency, and do nothing else."""

    def check(self, stage: str) -> None:
        """Raise `InputError` for options that exclude each other, or a file or port that cannot be used."""
        if self.latency is not None and self.device:
            raise InputError("device: give either --device or --latency, not both")
        if self.device and stage != "cascade":
            raise InputError(
                "stage: a page times the diffusion alone; give --stage cascade, or --latency with a file that "
                "has the other stages of a frame"
            )
        if not 0 <= self.port <= 65535:
            raise InputError(f"port: must lie in 0..65535, got {self.port}")
        if self.latency is not None:
            from hyjax.tuning.device_latency import read_latency

            read_latency(self.latency)


@dataclasses.dataclass(frozen=True)
class FrameOptions(Settings):
    """Search over configurations of the whole frame."""

    rooms: tuple[str, ...] = ()
    """Rooms of known truth to tune on, instead of the capture: builtin-0 random-5-6-day random-11-0-both and such.
    Each is rendered on first use, which takes some minutes."""
    holdout_rooms: tuple[str, ...] = ()
    """Rooms of known truth that are only reported on."""
    room_size: str = "320x240"
    """Width x height of the rooms' pictures."""
    room_frames: int = 4
    """Of each room, under each set-up of lights."""
    trials: int | None = None
    """Configurations, or schedules of the diffusion, to try, besides those that are timed and judged in the end.
    Default: 60, fewer where time is short."""
    lpips: float = 0.0
    """Weight of LPIPS in the loss; it needs the extra lpips."""
    paper_form: bool = False
    """Tune the paper's own form as well, to compare both at their best."""
    choices: tuple[str, ...] = ()
    """Choices that are held instead of searched, such as light_edges=true scale=2; see hyjax info --choices."""

    @functools.cached_property
    def held(self) -> dict[str, Any]:
        """Values of the choices that are held."""
        if not self.choices:
            return {}
        from hyjax.choices.table import CASCADES, choice_named
        from hyjax.configuration import Configuration
        from hyjax.guide.choose import configured_guide

        values = named_values(self.choices)
        for name in values:
            # The cascades limit the sampling.
            if choice_named(name).tried is None or choice_named(name).part in CASCADES or name == "sampling":
                raise InputError(f"choices: {name} cannot be held; leave it out")
        own = Configuration().with_choices(values)
        if "guide" in values:
            configured_guide(own.guide)  # a file that cannot be used is told now
        return {name: own.value(name) for name in values}

    @property
    def trial_count(self) -> int:
        """Number of trials."""
        return TRIALS if self.trials is None else self.trials

    def check(self) -> None:
        """Raise `InputError` for a value out of range, or a room that does not exist."""
        from hyjax.tuning.rooms import check_room

        for room in (*self.rooms, *self.holdout_rooms):
            check_room(room)
        if both := set(self.rooms) & set(self.holdout_rooms):
            raise InputError(f"holdout rooms: {', '.join(sorted(both))} is tuned on as well; leave it out of one")
        if self.holdout_rooms and not self.rooms:
            raise InputError("holdout rooms: go with --rooms; of a capture give --holdout")
        parse_size(self.room_size)
        if not 4 <= self.trial_count <= MOST_TRIALS:
            raise InputError(f"trials: must lie in 4..{MOST_TRIALS}, got {self.trials}")
        if not 1 <= self.room_frames <= ROOM_PHOTOS:
            raise InputError(f"room frames: must be between 1 and {ROOM_PHOTOS}, got {self.room_frames}")
        if not (math.isfinite(self.lpips) and self.lpips >= 0):
            raise InputError(f"lpips: the weight must be finite and >= 0, got {self.lpips}")
        _ = self.held


@dataclasses.dataclass(frozen=True)
class TuneSettings(Settings):
    """Find the configuration of whole frames, or the schedule of the diffusion alone, for a time budget.

    The one that makes the best picture on this machine or another device."""

    scene: TuneScene = dataclasses.field(default_factory=TuneScene)
    target_device: OtherDevice = dataclasses.field(default_factory=OtherDevice)
    frame: FrameOptions = dataclasses.field(default_factory=FrameOptions)
    fps: tuple[float, ...] = ()
    """Frame rates to reach, such as 60, or several: 30 60 120."""
    budget_ms: tuple[float, ...] = ()
    """Budgets in milliseconds, besides or instead of frame rates."""
    stage: BudgetStage | None = None
    """Scope of the budget: frame, the whole frame, all of whose choices are searched; or cascade, the diffusion
    alone. Default: frame; of another device, cascade."""
    renderer: Annotated[Literal["page", "tour"] | None, tyro.conf.arg(name="for")] = None
    """Search only choices that an exported page, or a tour, follows. Times are those of `hyjax relight` here."""
    target: str | None = None
    """The accurate mesh that the picture should look like: a file, 'true', 'fused' (at 2 cm), or 'converged' (1000
    steps of diffusion on the rough mesh). Default: true for the built-in room, else fused where there is depth."""
    lights: str | None = None
    """A named set-up, or a YAML or JSON file; of a frame also several, with commas between them. Default:
    evening-lamps,two-colors,golden-hour,night-moon; of the diffusion two-colors."""
    frames: str | None = None
    """Which frames to tune on, see relight. Default: four of the first three quarters."""
    holdout: str | None = None
    """Which frames are only reported on. Default: four of the last quarter."""
    guide: str = "rgb"
    """Guide of the diffusion, where it is tuned alone: rgb, small or a safetensors file; see relight."""
    time_limit: float | None = None
    """Seconds that all may take, about: the search ends early enough to time and judge what it has. Default: 300;
    none with --trials, --rooms or --paper-form."""
    extra: bool = True
    """Also tune for a few more budgets, to draw the curve of quality against time."""
    recalibrate: bool = False
    """Measure the device anew instead of using the latency table from the cache."""
    out: Path | None = None
    """Folder for configuration.json (of the diffusion schedule.json), pareto.csv, pareto.png, contact_sheet.png and
    report.html."""
    resume: bool = False
    """Go on with the interrupted run in the out folder."""
    quiet: bool = False
    """No progress bars."""

    def check(self) -> "TuneSettings":
        """These settings, if a run can start with them as far as that can be known in advance.

        Raises:
            InputError: no budget, a value out of range, or a mesh, target or set-up that does not exist.
        """
        from hyjax.scene.surfaces import check_mesh_name

        if self.target_device.request is None:
            self.budgets()
        self.target_device.check(self.tuned_stage)
        if self.time_limit is not None and not 0 < self.time_limit < math.inf:
            raise InputError(f"time limit: must be finite and > 0 seconds, got {self.time_limit:g}")
        several = self.set_ups()
        if len(several) > 1 and not self.tunes_frame:
            raise InputError(f"lights: the diffusion is tuned under one set-up, got {', '.join(several)}")
        for lights in several:
            check_lights_name(lights)
        self.frame.check()
        if self.tunes_frame:
            self._check_frame_alone()
        elif self.renderer is not None:
            raise InputError("for: goes with the whole frame on this machine; every renderer follows a schedule")
        elif self.frame.choices:
            raise InputError("choices: are of the whole frame on this machine; leave them out of --stage cascade")
        self.scene.check()
        if self.target != CONVERGED_TARGET:
            check_mesh_name(self.target)
        return self

    def _check_frame_alone(self) -> None:
        """Raise `InputError` for options of the diffusion alone, or of a capture where rooms are tuned on."""
        from hyjax.choices.choice import RENDERERS
        from hyjax.choices.table import CHOICES

        usual, renderer = TuneSettings(), self.renderer
        for name, value in self.frame.held.items():
            row = CHOICES[name]
            if renderer is not None and not row.followed_by(renderer) and value != row.usual_value:
                raise InputError(f"choices: {name} {value} is not for {RENDERERS[renderer]}; leave it out")
        for name in ("guide", "recalibrate"):
            if getattr(self, name) != getattr(usual, name):
                raise InputError(f"{name}: goes with --stage cascade; of a frame all guides are searched")
        for name in ("target", "frames", "holdout") if self.frame.rooms else ():
            if getattr(self, name) != getattr(usual, name):
                raise InputError(f"{name}: is of a capture; with --rooms give --room-frames and --holdout-rooms")

    @property
    def limit_seconds(self) -> float | None:
        """Time limit, the usual one among them; None for none."""
        more = self.frame.trials is not None or self.frame.rooms or self.frame.paper_form
        usual = None if more else USUAL_SECONDS
        return usual if self.time_limit is None else self.time_limit

    @property
    def tuned_stage(self) -> BudgetStage:
        """Stage that the budget is for."""
        other = self.target_device
        elsewhere = other.device or other.latency is not None or other.request is not None
        return self.stage or ("cascade" if elsewhere else "frame")

    @property
    def tunes_frame(self) -> bool:
        """Whether all choices of a whole frame are searched: on this machine, where each can be timed."""
        other = self.target_device
        return self.tuned_stage == "frame" and other.latency is None and other.request is None

    def set_ups(self) -> tuple[str, ...]:
        """Set-ups of lights by name or file."""
        if self.lights is None:
            return SETUPS if self.tunes_frame else (DIFFUSION_LIGHTS,)
        return tuple(dict.fromkeys(name.strip() for name in self.lights.split(",") if name.strip())) or ("",)

    def budgets(self) -> list["Budget"]:
        """Time budgets, frame rates first, without repetitions.

        Raises:
            InputError: none, or one that is not finite and > 0.
        """
        from hyjax.tuning.request import parse_budgets

        return parse_budgets(self.fps, self.budget_ms)

    def record(self) -> dict[str, Any]:
        """Options as a run's record has them."""
        options = dataclasses.asdict(self)
        options.pop("scene")
        scene = self.scene.options() | options.pop("target_device") | options.pop("frame")
        other = self.target_device
        paths = {"out": self.out, "latency": other.latency, "request": other.request}
        paths |= {"photo_sources": self.scene.photo_sources}
        named = {name: None if path is None else str(path) for name, path in paths.items()}
        return scene | options | {"capture": str(self.scene.capture or "built-in room")} | named
