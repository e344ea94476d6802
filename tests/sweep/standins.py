"""Functions that stand in for the work of a sweep, in a module that workers can import."""

import os
import resource
import signal
import threading
import time
from pathlib import Path
from typing import Any

from hyjax.util.errors import InputError

Payload = dict[str, Any]


def double(payload: Payload) -> Payload:
    """Twice a number; a line in a log for every call; for numbers above 20, once the gate's file is there."""
    while "gate" in payload and payload["number"] > 20 and not Path(payload["gate"]).exists():
        time.sleep(0.02)
    if "log" in payload:
        with Path(payload["log"]).open("a") as file:
            file.write(f"{payload['number']}\n")
    time.sleep(payload.get("sleep", 0.0))
    return {"double": 2 * payload["number"]}


def refuse_odd(payload: Payload) -> Payload:
    """An input error for odd numbers."""
    if payload["number"] % 2:
        raise InputError(f"number: {payload['number']} is odd")
    return double(payload)


def fail_at_first(payload: Payload) -> Payload:
    """An exception, as often as the payload says."""
    marks = Path(payload["marks"])
    tried = len(list(marks.iterdir()))
    (marks / str(tried)).touch()
    if tried < payload["failures"]:
        raise ZeroDivisionError("by nothing")
    return {"tried": tried + 1}


def die_at_three(payload: Payload) -> Payload:
    """A kill of its own process, for the number three."""
    if payload["number"] == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return double(payload)


def die_afterwards(payload: Payload) -> Payload:
    """A kill of its own process after the result has been reported, where no mark is left yet."""
    doubled = double(payload)
    if not (mark := Path(payload["mark"])).exists():
        threading.Timer(1.0, lambda: (mark.touch(), os.kill(os.getpid(), signal.SIGKILL))).start()
    return doubled


def fill_disk(payload: Payload) -> Payload:
    """A process whose files may not grow any more, from the number three on."""
    if payload["number"] == 3:
        _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (payload["bytes"], most))
    return double(payload)


def loss(payload: Payload) -> Payload:
    """A loss that the configuration, the scene and the lights decide."""
    if payload["configuration"]["mode"] == "paper" and payload["lights"] == "night-moon":
        raise InputError("lights: too dark for the paper")
    offset = len(payload["scene"]) + 0.1 * len(payload["lights"]) + payload["seed"]
    return {"loss": payload["configuration"]["light"]["sampling"] + 0.01 * offset, "psnr": 30.0}


def milliseconds(payload: Payload) -> Payload:
    """Times that the configuration decides."""
    return {"median_ms": 10.0 / payload["configuration"]["light"]["sampling"], "p95_ms": 11.0}


def slow_loss(payload: Payload) -> Payload:
    """The same, after a second."""
    time.sleep(1.0)
    return loss(payload)
