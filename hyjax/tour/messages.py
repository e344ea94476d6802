"""Messages of a page to the server of its tour, each with all that a visitor has set up, and their answers."""

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec.structs import replace

from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.tour.plan import FILE_NAME, TourPlan
from hyjax.tour.viewpoint import KAPPA_RANGE, MOST_STEPS, Shown
from hyjax.util.errors import InputError

MOST_BYTES = 64 * 1024
"""Bytes of a message."""
Task = Literal[
    "picture",
    "keep",
    "daylight",
    "surface",
    "furniture",
    "window",
    "bring",
    "png",
    "exr",
    "lights",
    "mesh",
    "page",
    "video",
]
Number = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
Vector = tuple[Number, Number, Number]


class View(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a visitor looks at.

    Attributes:
        frame: its number.
        shown: stage.
        schedule: its name; that of the tour if there is none of that name.
        kappa: power of ten of the factor on the edge sensitivity.
        steps: factor on the number of steps.
        camera: right, down, forward and position of a camera that has left the frame's; None for the frame's.
        seconds: that have passed, for what flickers.
    """

    frame: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)] = 0
    shown: Shown = "relit"
    schedule: Annotated[str, msgspec.Meta(max_length=300)] = ""
    kappa: Annotated[float, msgspec.Meta(ge=-KAPPA_RANGE, le=KAPPA_RANGE)] = 0.0
    steps: Annotated[float, msgspec.Meta(ge=0, le=MOST_STEPS)] = 1.0
    camera: tuple[Vector, Vector, Vector, Vector] | None = None
    seconds: Annotated[float, msgspec.Meta(ge=0, le=1e7)] = 0.0

    def free_camera(self, intrinsics: Intrinsics) -> Camera:
        """Camera that has left the frame's."""
        assert self.camera is not None
        pose = np.eye(4)
        pose[:3] = np.array(self.camera).T
        turn = pose[:3, :3]
        if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
            raise InputError("camera: right, down and forward must be a right-handed system of unit vectors")
        return Camera(intrinsics, pose)


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A page's message.

    Attributes:
        task: what is asked for.
        number: that the answer bears.
        plan: what is set up.
        view: what is looked at.
        places: pixels of the picture, for what points at it.
        name: of a file that is brought.
        part: of its content.
        rest: bytes of it that are still to come.
    """

    task: Task
    number: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    plan: TourPlan
    view: View = View()
    places: Annotated[tuple[tuple[Number, Number], ...], msgspec.Meta(max_length=4)] = ()
    name: Annotated[str, msgspec.Meta(max_length=255, pattern=FILE_NAME)] = ""
    part: bytes = b""
    rest: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0

    def differs_in_time_only(self, other: "Message") -> bool:
        """Whether it asks for the same picture at another time."""
        same_view = replace(self.view, seconds=0.0) == replace(other.view, seconds=0.0)
        return self.view.seconds != other.view.seconds and same_view and self.plan == other.plan


class _Numbered(msgspec.Struct):
    """What of a message names it; anything else may be wrong."""

    number: Annotated[int, msgspec.Meta(ge=0, le=2**53)]


def number_of(text: str | bytes) -> int | None:
    """Number of a message that may be invalid otherwise; None if it has none."""
    try:
        return msgspec.json.decode(text, type=_Numbered).number
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None


def read_message(text: str | bytes) -> Message:
    """A message, checked."""
    try:
        message = msgspec.json.decode(text, type=Message)
    except msgspec.MsgspecError as error:
        raise InputError(f"message: {error}") from None
    except RecursionError:
        raise InputError("message: nested too deeply") from None
    message.plan.check()
    return message


def packed(head: dict[str, Any], content: bytes) -> bytes:
    """An answer with binary content: one line of JSON, then the content."""
    return msgspec.json.encode(head) + b"\n" + content
