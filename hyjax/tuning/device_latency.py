"""Device latency file: times of schedules that some engine took on a device; see docs/latency_format.md."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from hyjax.core.diffusion import Norm
from hyjax.core.schedule import Pooling, Schedule, Upsampling, guided_schedule
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.factors import schedule_key
from hyjax.util.errors import InputError
from hyjax.util.files import write_text
from hyjax.util.reading import parse_json, read_bytes

FORMAT: Literal[1] = 1
"""Version of the file and of the request for it. Counted up when an older reader would misunderstand one."""
FEWEST_SAMPLES = 10
"""Fewest samples of each schedule: fewer say nothing of a 95th percentile."""
MOST_BYTES = 16 << 20
SHORTEST_MS, LONGEST_MS = 1e-3, 1e6
"""Milliseconds; a time below a microsecond is in another unit."""
NOISE_RATIO = 1.9
"""A schedule with more steps may seem so many times faster."""

Duration = Annotated[float, msgspec.Meta(ge=SHORTEST_MS, le=LONGEST_MS)]
"""Milliseconds of something that was timed."""
Instant = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
"""Seconds since the first round began."""
Side = Annotated[int, msgspec.Meta(ge=1, le=1 << 14)]
Channels = Annotated[int, msgspec.Meta(ge=1, le=256)]
Factor = Annotated[int, msgspec.Meta(ge=1, le=4096)]
Count = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
Text = Annotated[str, msgspec.Meta(max_length=300)]
Precision = Literal["f32", "f16"]


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Base of the file's parts."""


class Device(Record, frozen=True):
    """Measured device.

    Attributes:
        name: what people call it.
        adapter: its graphics processor.
        agent: engine or browser with its version.
        timer: `gpu` where the graphics processor's own clock timed, `wall` where the host's did.
    """

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
    adapter: Text = ""
    agent: Text = ""
    timer: Literal["gpu", "wall"] = "wall"


class DeviceWorkload(Record, frozen=True, omit_defaults=False):
    """Shapes that were timed: the diffusion stage of an exported frame.

    Attributes:
        height, width: pixels.
        lights: of the set-up; the picture that is diffused has 2 + ceil(lights / 4) groups of four channels.
        features: channels of the guide.
        precision: of pictures between passes.
    """

    height: Side
    width: Side
    lights: Channels
    features: Channels = 3
    precision: Precision = "f32"

    def __str__(self) -> str:
        return f"{self.width}x{self.height}, lights {self.lights}, guide channels {self.features}, {self.precision}"


class Form(Record, frozen=True):
    """Steps by factor and form of a schedule, which decide its time. The default is the form that is searched.

    Attributes:
        steps: by downsampling factor.
        pooling, upsampling, norm: as in a schedule.
        fidelity: whether its levels hold on to their cell means.
        name: for people.
    """

    steps: dict[Factor, Count]
    pooling: Pooling = "guide"
    upsampling: Upsampling = "guide"
    norm: Norm = "l2"
    fidelity: bool = True
    name: Text = ""

    @classmethod
    def of(cls, schedule: Schedule, **rest: Any) -> Any:
        """Form of a schedule.

        Raises:
            InputError: one that no device can be asked to time.
        """
        attached = {level.fidelity is not None for level in schedule.levels}
        if len(attached) > 1:
            raise InputError(f"schedule {schedule.name}: either all levels have a fidelity or none")
        return cls(
            steps={level.factor: level.steps for level in schedule.levels},
            pooling=schedule.pooling,
            upsampling=schedule.upsampling,
            norm=schedule.norm,
            fidelity=attached.pop(),
            name=schedule.name,
            **rest,
        )

    def schedule(self) -> Schedule:
        """A schedule that takes this time.

        Raises:
            InputError: none has these factors.
        """
        options = {"pooling": self.pooling, "upsampling": self.upsampling, "norm": self.norm}
        if not self.fidelity:
            options |= {"fidelity": None}  # type: ignore[dict-item]
        levels = sorted(((f, n) for f, n in self.steps.items() if n), reverse=True)
        return guided_schedule(levels, name=self.name or "unnamed", **options)

    @property
    def key(self) -> str:
        """Key of the schedule."""
        return schedule_key(self.schedule())


class Timed(Form, frozen=True):
    """Schedule with its times: either all samples, one a round, or their statistics.

    Attributes:
        milliseconds: samples in the order of the rounds.
        median, p95, samples: in their place; how many there were.
    """

    milliseconds: tuple[Duration, ...] = ()
    median: Duration | None = None
    p95: Duration | None = None
    samples: Count | None = None

    @property
    def time(self) -> Milliseconds:
        """Median and 95th percentile."""
        if self.median is not None and self.p95 is not None:
            return Milliseconds(self.median, self.p95)
        values = np.array(self.milliseconds)
        return Milliseconds(float(np.median(values)), float(np.percentile(values, 95)))

    def check(self) -> None:
        """Raise `InputError` unless these are the times of a schedule."""
        self.schedule()
        given = [value is not None for value in (self.median, self.p95, self.samples)]
        if self.milliseconds and any(given):
            raise InputError("give either milliseconds, or median, p95 and samples")
        if not self.milliseconds and not all(given):
            raise InputError("needs milliseconds, or median, p95 and samples")
        count = len(self.milliseconds) or self.samples or 0
        if count < FEWEST_SAMPLES:
            raise InputError(f"{count} samples are too few; at least {FEWEST_SAMPLES} are needed")
        if self.median is not None and self.p95 is not None and self.p95 < self.median:
            raise InputError(f"p95 {self.p95:g} is below the median {self.median:g}")


class Stage(Record, frozen=True):
    """Another stage of a frame with its times."""

    median: Duration
    p95: Duration


class WarmUp(Record, frozen=True):
    """Warm-up runs before the first round, which do not count."""

    seconds: Instant
    runs: Count


class DeviceLatency(Record, frozen=True):
    """Content of the file.

    Attributes:
        format: see `FORMAT`.
        device: what was measured.
        workload: the shapes.
        measured: schedules with their times.
        stages: other stages of the frame, by name; all of them, where a budget is for the whole frame.
        warm_up: before the first round.
        rounds: when each round began. Samples follow the rounds, so that a device that gets hot shows it.
        created: ISO 8601.
    """

    format: Literal[1]
    device: Device
    workload: DeviceWorkload
    measured: Annotated[tuple[Timed, ...], msgspec.Meta(min_length=1, max_length=10_000)]
    warm_up: WarmUp
    stages: dict[Text, Stage] = {}
    rounds: tuple[Instant, ...] = ()
    created: Text = ""

    def check(self) -> None:
        """Raise `InputError` unless the parts go together."""
        if list(self.rounds) != sorted(self.rounds):
            raise InputError("rounds: time stamps must rise")
        seen: dict[str, int] = {}
        for number, timed in enumerate(self.measured):
            where = f"measured[{number}]"
            try:
                timed.check()
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
            if (twin := seen.setdefault(timed.key, number)) != number:
                raise InputError(f"{where}: the schedule of measured[{twin}] again")
            if self.rounds and timed.milliseconds and len(timed.milliseconds) != len(self.rounds):
                raise InputError(f"{where}: {len(timed.milliseconds)} samples in {len(self.rounds)} rounds")
        _check_rising(self.measured)
        for name, stage in self.stages.items():
            if stage.p95 < stage.median:
                raise InputError(f"stages.{name}: p95 {stage.p95:g} is below the median {stage.median:g}")

    def drift(self) -> float | None:
        """Slowdown of the last third of the rounds over the first, 0.1 for 10 %; None if unknown."""
        return drift([timed.milliseconds for timed in self.measured if len(timed.milliseconds) >= 6])

    @property
    def fingerprint(self) -> str:
        """A short hash."""
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:16]


def _check_rising(measured: Sequence[Timed]) -> None:
    """Raise `InputError` where more steps of the same levels take less time, by more than noise."""
    alike: dict[Any, list[int]] = {}
    for number, timed in enumerate(measured):
        form = timed.pooling, timed.upsampling, timed.norm, timed.fidelity
        alike.setdefault((form, tuple(sorted(f for f, n in timed.steps.items() if n))), []).append(number)
    for (_, factors), numbers in alike.items():
        steps = np.array([[measured[k].steps[factor] for factor in factors] for k in numbers])
        medians = np.array([measured[k].time.median for k in numbers])
        for place, number in enumerate(numbers):
            slower = np.all(steps <= steps[place], axis=1) & (medians > NOISE_RATIO * medians[place])
            if slower.any():
                other = int(slower.argmax())
                raise InputError(
                    f"measured[{number}]: {medians[place]:g} ms, but measured[{numbers[other]}] takes "
                    f"{medians[other]:g} ms for fewer steps of the same levels; times must rise with steps"
                )


def drift(samples: Sequence[Sequence[float]]) -> float | None:
    """Slowdown of the last third of the rounds over the first, over several schedules' samples."""
    ratios = []
    for values in samples:
        third = max(1, len(values) // 3)
        ratios.append(np.median(values[-third:]) / np.median(values[:third]))
    return float(np.median(ratios)) - 1.0 if ratios else None


def parse_latency(text: str | bytes, name: str = "latency file") -> DeviceLatency:
    """Latency of a device from JSON.

    Args:
        text: the file's content.
        name: of the file, for the error.

    Raises:
        InputError: not of this format; the message says where.
    """
    plain = parse_json(text, name, only_finite=True)
    found = plain.get("format") if isinstance(plain, dict) else None
    if found != FORMAT:
        raise InputError(f"{name}: format {found!r:.40}; this version of hyjax reads format {FORMAT}")
    try:
        latency = msgspec.convert(plain, DeviceLatency, str_keys=True)
        latency.check()
    except msgspec.ValidationError as error:
        raise InputError(f"{name}: {str(error).splitlines()[0]}") from None
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    return latency


def read_latency(path: Path) -> DeviceLatency:
    """Latency of a device from a file.

    Raises:
        InputError: it cannot be read, is too large, or is not of this format.
    """
    return parse_latency(read_bytes(path, most=MOST_BYTES), str(path))


def write_latency(path: Path, latency: DeviceLatency) -> None:
    """Write the file.

    Raises:
        InputError: it cannot be written.
    """
    write_text(path, msgspec.json.format(msgspec.json.encode(latency), indent=1).decode() + "\n")
