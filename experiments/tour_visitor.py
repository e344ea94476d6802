"""Visitors of a tour without a browser: its messages over a websocket, as viser's page sends and gets them."""

import contextlib
import socket
import struct
import threading
import time
import uuid
from typing import Any

import msgspec.msgpack

PART = 512 * 1024
"""Bytes of one part of an upload, as viser's page sends them."""
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: closing sends a reset and no farewell


class Visitor:
    """One connection to a tour's page.

    Attributes:
        pictures: that have come.
        last: when the last one came, by `time.monotonic`.
        answers: notices of the tour, their titles by how often they came.
        failed: whether the connection ended without `leave` or `vanish`.

    Args:
        url: of the tour.
        aspect: width by height of the page's scene.
    """

    def __init__(self, url: str, aspect: float = 1.5) -> None:
        import viser
        from websockets.sync.client import connect

        protocols: Any = [f"viser-v{viser.__version__}"]
        self._wire = connect(url.replace("http", "ws"), subprotocols=protocols, max_size=None)
        self.pictures, self.last, self.failed = 0, time.monotonic(), False
        self.answers: dict[str, int] = {}
        self._controls: dict[str, str] = {}
        self._left = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        camera = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 0), "look_at": (0, 0, 1), "up_direction": (0, 1, 0)}
        camera |= {"fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 600, "image_width": round(600 * aspect)}
        self.send("ViewerCameraMessage", **camera)

    def send(self, kind: str, **fields: Any) -> None:
        """Send a message of viser's."""
        self._wire.send(msgspec.msgpack.encode({"type": kind} | fields))

    def set(self, label: str, value: Any) -> None:
        """Set a control by its label, or press a button by `True`."""
        self.send("GuiUpdateMessage", uuid=self._control(label), updates={"value": value})

    def click(self, direction: tuple[float, float, float], origin: tuple[float, float, float]) -> None:
        """Click on the scene along a ray."""
        ray = {"ray_origin": origin, "ray_direction": direction, "screen_pos": ((0.5, 0.5),), "modifier": None}
        self.send("ScenePointerMessage", event_type="click", **ray)

    def upload(self, label: str, name: str, content: bytes, *, share: float = 1.0) -> None:
        """Upload a file to a control.

        Args:
            label: of the control.
            name, content: of the file.
            share: of its parts that are sent; less than 1 for an upload that does not end.
        """
        control, transfer = self._control(label), uuid.uuid4().hex
        parts = [content[at : at + PART] for at in range(0, len(content), PART)]
        start = {"filename": name, "mime_type": "", "part_count": len(parts), "size_bytes": len(content)}
        self.send("FileTransferStartUpload", source_component_uuid=control, transfer_uuid=transfer, **start)
        for index, part in enumerate(parts[: round(share * len(parts))]):
            ids = {"source_component_uuid": control, "transfer_uuid": transfer}
            self.send("FileTransferPart", **ids, part_index=index, content=part)

    def leave(self) -> None:
        """Close the page."""
        self._left = True
        self._wire.close()
        self._reader.join()

    def vanish(self) -> None:
        """Break the connection, as a page that is killed does."""
        self._left = True
        with contextlib.suppress(OSError):
            self._wire.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            self._wire.socket.shutdown(socket.SHUT_RDWR)
        self._reader.join()

    def wait_for_controls(self, *labels: str, seconds: float = 60.0) -> None:
        """Wait until controls of these labels are there."""
        for label in labels:
            self._control(label, seconds)

    def _control(self, label: str, seconds: float = 60.0) -> str:
        end = time.monotonic() + seconds
        while label not in self._controls:
            if time.monotonic() > end or self.failed:
                raise RuntimeError(f"the tour's page has no control {label!r}")
            time.sleep(0.01)
        return self._controls[label]

    def _read(self) -> None:
        from websockets.exceptions import WebSocketException

        try:
            while True:
                for message in _unpack(self._wire.recv()):
                    self._take(message)
        except (OSError, EOFError, WebSocketException):
            self.failed = not self._left

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "BackgroundImageMessage" and message["rgb_data"] is not None:
            self.pictures, self.last = self.pictures + 1, time.monotonic()
        elif kind == "NotificationShowMessage":
            title = str(message["props"]["title"])
            self.answers[title] = self.answers.get(title, 0) + 1
        elif "uuid" in message and isinstance(message.get("props"), dict) and "label" in message["props"]:
            self._controls[str(message["props"]["label"])] = message["uuid"]


def _unpack(raw: str | bytes) -> list[dict[str, Any]]:
    """Messages of one packet: two lengths, then MessagePack that is packed with Zstandard."""
    import zstandard

    assert isinstance(raw, bytes)
    length, packed = struct.unpack("<QQ", raw[:16])
    content = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=length)
    messages: list[dict[str, Any]] = msgspec.msgpack.decode(content)["messages"]
    return messages
