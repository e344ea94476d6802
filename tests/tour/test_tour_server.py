"""The tour's server by itself: noise, and uploads that are too large."""

import json
import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import msgspec.msgpack
import pytest
from extras import need

need("tour")

import viser
from viser import _messages as messages

from hyjax.tour.server import address, open_server
from hyjax.tour.uploads import Upload, take_uploads

NOISE = (
    b"",
    b"[" * 1000,
    msgspec.msgpack.encode({"type": "NoSuchMessage"}),
    msgspec.msgpack.encode({"type": "GuiUpdateMessage"}),
    msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": [1], "updates": 3}),
)


@pytest.fixture
def server() -> Iterator[Any]:
    server = open_server("127.0.0.1", 0)
    yield server
    server.stop()


def connected(server: Any) -> Any:
    from websockets.sync.client import connect

    protocols: Any = [f"viser-v{viser.__version__}"]
    return connect(f"ws://127.0.0.1:{server.get_port()}", subprotocols=protocols)


def until(condition: Any) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_noise_is_a_line_each(server: Any, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        for count, noise in enumerate(NOISE, start=1):
            with connected(server) as wire:
                wire.send(noise)
                until(lambda count=count: len(caplog.records) >= count)
    for record in caplog.records:
        assert record.getMessage().startswith("tour: left out a message that no page of it sends (")
        assert record.exc_info is None and record.exc_text is None


def raised(act: Callable[[], object]) -> Exception:
    with pytest.raises(Exception) as caught:
        act()
    return caught.value


def test_only_messages_that_cannot_be_read_are_shortened_and_only_while_it_runs(
    server: Any, caplog: pytest.LogCaptureFixture
) -> None:
    def log(act: Callable[[], object]) -> bool:
        """Whether an error keeps its traceback."""
        logging.getLogger("asyncio").error("failed", exc_info=raised(act))
        return caplog.records[-1].exc_info is not None and caplog.records[-1].getMessage() == "failed"

    read = messages.Message.deserialize
    assert not log(lambda: read(b""))
    assert log(lambda: address("a", None))  # type: ignore[arg-type]  # our own
    assert log(lambda: json.loads("{"))  # none of viser's
    server.stop()
    assert log(lambda: read(b""))


def upload(server: Any, button: Any, content: bytes, told: int | None = None) -> None:
    """Send a file that is said to have so many bytes, in parts of 40."""
    ids = {"source_component_uuid": button._impl.uuid, "transfer_uuid": "a"}
    parts = [content[at : at + 40] for at in range(0, len(content), 40)]
    start = {"filename": "a.ply", "mime_type": "", "part_count": len(parts)}
    size = len(content) if told is None else told
    until(lambda: not server.get_clients())
    with connected(server) as wire:
        for message in (
            {"type": "FileTransferStartUpload", **start, "size_bytes": size},
            *({"type": "FileTransferPart", "part_index": k, "content": part} for k, part in enumerate(parts)),
        ):
            wire.send(msgspec.msgpack.encode(message | ids))
        camera = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 0), "look_at": (0, 0, 1), "up_direction": (0, 1, 0)}
        camera |= {"fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 1, "image_width": 1}
        wire.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage"} | camera))
        until(server.get_clients)  # what was sent before has been handled


def test_uploads_beyond_the_limit_are_refused_and_none_is_kept(server: Any) -> None:
    refused: list[tuple[str, int]] = []
    taken: list[Upload] = []
    button = server.gui.add_upload_button("Bring a mesh")
    take_uploads(button, 100, taken.append, lambda client, name, size: refused.append((name, size)))
    upload(server, button, bytes(101))
    assert refused == [("a.ply", 101)]
    upload(server, button, bytes(300), told=90)  # more than it says
    assert not taken and not server.gui._current_file_upload_states
    upload(server, button, b"ply" * 33)
    until(lambda: taken)
    upload(server, button, b"")
    until(lambda: taken[1:])
    assert refused == [("a.ply", 101)] and button.value.content == b""
    assert [(each.name, each.content) for each in taken] == [("a.ply", b"ply" * 33), ("a.ply", b"")]


def test_uploads_that_arrive_together_are_told_apart(server: Any) -> None:
    """Their messages are handled one after the other, before the first thread looks at the button."""
    taken: list[Upload] = []
    refused: list[str] = []
    button = server.gui.add_upload_button("Bring a mesh")
    take_uploads(button, 100, taken.append, lambda client, name, size: refused.append(name))
    handlers = server.gui._websock_interface._incoming_handlers
    (begin,) = handlers[messages.FileTransferStartUpload]
    (go_on,) = handlers[messages.FileTransferPart]
    for number in range(5):
        begin(
            number,
            messages.FileTransferStartUpload(
                source_component_uuid=button._impl.uuid,
                transfer_uuid=f"{number}",
                filename=f"{number}.ply",
                mime_type="",
                part_count=1,
                size_bytes=100,
            ),
        )
    assert refused == ["4.ply"]  # 400 bytes are on their way
    for number in range(5):
        go_on(number, messages.FileTransferPart(button._impl.uuid, f"{number}", 0, bytes([number]) * 100))
    until(lambda: len(taken) == 4)
    assert sorted(taken) == [Upload(number, f"{number}.ply", bytes([number]) * 100) for number in range(4)]
