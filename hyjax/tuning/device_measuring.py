"""Measuring site: gives a device its jobs, and takes in the times that it sends back, round by round."""

import json
import threading
import time
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Annotated, Any

import msgspec

from hyjax.core.schedule import Schedule
from hyjax.device.server import JSON, Answer, FolderSite, Server
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.device_latency import (
    FEWEST_SAMPLES,
    FORMAT,
    Device,
    DeviceLatency,
    Duration,
    Record,
    Timed,
    WarmUp,
    drift,
)
from hyjax.tuning.device_request import LatencyRequest, job
from hyjax.util.clock import timestamp
from hyjax.util.errors import InputError

WAIT = 15.0
"""Seconds that a device waits for its next job before it asks again."""
SILENCE = 30.0
"""Seconds after which a device is said to have gone away."""
HOT_RISE = 0.15
"""Rise of times from the first to the last rounds that is worth a word."""
FEWEST_SCHEDULES = 5
"""Schedules that must agree on it."""
PAGE = "measure.html"


class Round(Record, frozen=True):
    """Times of all schedules of a job in one round.

    Attributes:
        round: its number in the job, from 0.
        warm_up: what ran before the first round.
        last: whether the time for rounds is over.
    """

    job: int
    round: int
    milliseconds: Annotated[tuple[Duration, ...], msgspec.Meta(min_length=1, max_length=1000)]
    warm_up: WarmUp
    last: bool = False


class Trouble(Record, frozen=True):
    """Error on the device, in one line."""

    error: Annotated[str, msgspec.Meta(max_length=1000)]


class Alive(Record, frozen=True):
    """Sign of life."""


class _Job:
    def __init__(self, number: int, request: LatencyRequest, schedules: Sequence[Schedule]) -> None:
        self.number, self.request = number, request
        self.rounds, self.arrived = list[Round](), list[float]()
        self.content = job(number, request, schedules)

    @property
    def done(self) -> bool:
        return bool(self.rounds) and (self.rounds[-1].last or len(self.rounds) >= self.request.rounds)


class Measuring:
    """The site. The first device that says hello is the one that is measured."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = lambda line: say("".join(c if c.isprintable() else "?" for c in line))
        self.device: Device | None = None
        self._files = FolderSite(resources.files("hyjax.device").joinpath("page"), PAGE)  # type: ignore[arg-type]
        self._changed = threading.Condition()
        self._job: _Job | None = None
        self._jobs, self._heard, self._ended = 0, time.monotonic(), False

    def wait_for_device(self) -> Device:
        """The device that says hello."""
        with self._changed:
            while self.device is None:
                self._changed.wait(1.0)  # not to sleep through an interrupt
            return self.device

    def measure(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> tuple[list[Round], list[float]]:
        """Have the device time schedules; waits for it, also where it has gone away.

        Returns:
            Rounds, and seconds since the first of them was over.
        """
        with self._changed:
            self._jobs += 1
            current = self._job = _Job(self._jobs, request, schedules)
            self._heard, reported = time.monotonic(), False
            self._changed.notify_all()
            while not current.done:
                self._changed.wait(1.0)
                silent = time.monotonic() - self._heard > SILENCE
                if silent and not reported:
                    name = "the device" if self.device is None else self.device.name
                    self.say(f"nothing is heard of {name}; open the page again there, it goes on where it stopped")
                reported = silent
            self._job = None
            return current.rounds, [at - current.arrived[0] for at in current.arrived]

    def end(self) -> None:
        """End the session: the page gets no more jobs."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def get(self, path: str) -> Answer:
        if path == "bench.json":  # of a page on another host
            return Answer(204)
        if path != "job":
            return self._files.get(path)
        with self._changed:
            self._heard = time.monotonic()
            if self.device is None:
                return Answer.refuse(409, "say hello first")
            self._changed.wait_for(lambda: self._job is not None or self._ended, WAIT)
            self._heard = time.monotonic()
            if self._job is None:
                return Answer.refuse(410, "hyjax has all it needs") if self._ended else Answer(204)
            content = self._job.content | {"done": len(self._job.rounds)}
        return Answer(200, json.dumps(content).encode(), JSON)

    def post(self, path: str, body: bytes) -> Answer:
        takers: dict[str, tuple[Any, Callable[[Any], Any]]] = {
            "hello": (Device, self._hello),
            "round": (Round, self._round),
            "trouble": (Trouble, self._trouble),
            "alive": (Alive, lambda _: {}),
        }
        if path not in takers:
            return Answer.refuse(404, "no such address")
        form, take = takers[path]
        try:
            content = msgspec.json.decode(body, type=form)
            with self._changed:
                self._heard = time.monotonic()
                answer = take(content)
        except (msgspec.DecodeError, UnicodeDecodeError, InputError) as error:
            line = f"{path}: {str(error).splitlines()[0]}"
            self.say(f"the device sent what cannot be used: {line}")
            return Answer.refuse(400, line)
        return Answer(200, json.dumps(answer).encode(), JSON)

    def _hello(self, device: Device) -> dict[str, Any]:
        if self.device is None:
            self.say(f"{device.name} is there ({device.adapter or 'unknown adapter'})")
            self.device = device
            self._changed.notify_all()
        elif device != self.device:
            raise InputError(f"{self.device.name} is being measured, not {device.name}; close its page there")
        return {"format": FORMAT}

    def _round(self, sent: Round) -> dict[str, Any]:
        current = self._job
        if current is None or sent.job != current.number:
            return {"more": False}  # of a job that is over: a page in a second tab, or one that came back late
        if sent.round < len(current.rounds):
            return {"more": not current.done, "done": len(current.rounds)}
        if sent.round > len(current.rounds):
            raise InputError(f"round {sent.round} after {len(current.rounds)}")
        if len(sent.milliseconds) != len(current.request.schedules):
            raise InputError(f"{len(sent.milliseconds)} times of {len(current.request.schedules)} schedules")
        if sent.last and sent.round + 1 < FEWEST_SAMPLES:
            raise InputError(f"{sent.round + 1} rounds are too few; at least {FEWEST_SAMPLES} are needed")
        current.rounds.append(sent)
        current.arrived.append(self._heard)
        if current.done:
            self._changed.notify_all()
        return {"more": not current.done, "done": len(current.rounds)}

    def _trouble(self, sent: Trouble) -> dict[str, Any]:
        name = "the device" if self.device is None else self.device.name
        self.say(f"{name}: {' '.join(sent.error.split())}")
        return {}


class ConnectedDevice:
    """A device whose page is open, or will be."""

    def __init__(self, host: str, port: int, say: Callable[[str], None]) -> None:
        self.say, self.site = say, Measuring(say)
        self.server = Server(self.site, host, port, secret=True, page=PAGE)
        say(self.server.invitation())

    def identity(self) -> Device:
        """Identity that the device reports; waits for it."""
        return self.site.wait_for_device()

    def latency(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> DeviceLatency:
        """Times of schedules as a latency file has them."""
        device = self.identity()
        counted = "1 schedule" if len(schedules) == 1 else f"{len(schedules)} schedules"
        self.say(f"{device.name} times {counted} at {request.workload}")
        rounds, seconds = self.site.measure(request, schedules)
        columns = list(zip(*(r.milliseconds for r in rounds)))
        rise = drift(columns)
        if rise is not None and rise > HOT_RISE and len(columns) >= FEWEST_SCHEDULES:
            self.say(f"the device got slower by {100 * rise:.0f} % from the first to the last rounds: is it hot?")
        return DeviceLatency(
            format=FORMAT,
            device=device,
            workload=request.workload,
            measured=tuple(Timed.of(schedule, milliseconds=column) for schedule, column in zip(schedules, columns)),
            warm_up=rounds[0].warm_up,
            rounds=tuple(round(at, 3) for at in seconds),
            created=timestamp(),
        )

    def times(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> list[Milliseconds]:
        """Times of schedules, in turns."""
        return [timed.time for timed in self.latency(request, schedules).measured]

    def close(self) -> None:
        """End the page's session, and stop serving."""
        self.site.end()
        time.sleep(0.2)  # for the answer to the page's open request
        self.server.stop()
