"""Visits of a tour without a browser: what its page sends, and what comes back."""

import contextlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from extras import need

need("tour")

from box_room import BoxCapture, box_room
from PIL import Image
from websockets.sync.client import ClientConnection, connect

from hyjax.core.schedule import Schedule
from hyjax.export.web import write_page
from hyjax.scene.scene import Scene
from hyjax.tour.plan import TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.tour import Tour

SCHEDULES = {name: Schedule.preset(name) for name in ("hyjax", "paper-50")}
WAIT = 60.0  # seconds


def box_tour(out: Path, **options: Any) -> Tour:
    """Tour of the room of boxes, at any free port."""
    renderer = Renderer(Scene(BoxCapture(), box_room()), folder=out)
    return Tour(renderer, SCHEDULES, out, **({"port": 0, "write_page": write_page} | options))


@contextlib.contextmanager
def visiting(tour: Tour) -> Iterator["Visit"]:
    """A visit of a tour."""
    with connect(f"{tour.url.replace('http', 'ws')}/socket", max_size=None) as wire:
        yield Visit(wire)


class Visit:
    """What a page does with its server."""

    def __init__(self, wire: ClientConnection) -> None:
        self.wire, self.number = wire, 0

    def send(self, task: str, plan: TourPlan, **content: Any) -> int:
        """Send a message; its number."""
        self.number += 1
        message = {"task": task, "number": self.number, "plan": plan, **content}
        self.wire.send(msgspec.json.encode(message).decode())
        return self.number

    def receive(self) -> tuple[dict[str, Any], bytes]:
        """The next answer, with its binary content."""
        answer = self.wire.recv(timeout=WAIT)
        if isinstance(answer, str):
            return json.loads(answer), b""
        head, _, content = answer.partition(b"\n")
        return json.loads(head), content

    def ask(self, task: str, plan: TourPlan, **content: Any) -> dict[str, Any]:
        """Answer to a task, its binary content as `content`."""
        return self.answer(self.send(task, plan, **content))

    def answer(self, number: int) -> dict[str, Any]:
        """Answer to a message."""
        while True:
            head, binary = self.receive()
            if head.get("number") == number:
                return {**head, "content": binary}

    def picture(self, plan: TourPlan, *, draft: bool = False, **view: Any) -> np.ndarray:
        """Picture of a plan, (h, w, 3) of bytes; with `draft` the first that comes, else the last."""
        number = self.send("picture", plan, view=view)
        while True:
            head, content = self.receive()
            assert "refused" not in head, head
            if head.get("picture") == number and (draft or not head["draft"]):
                return np.asarray(Image.open(io.BytesIO(content)))
