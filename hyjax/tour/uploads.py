"""Uploads to a tour that are refused while they are announced, and kept no longer than they are used."""

from collections.abc import Callable
from typing import Any

import viser
from viser import _messages


def limit_uploads(gui: viser.GuiApi, most: int, refuse: Callable[[int, str, int], None]) -> None:
    """Take no file that says it is larger, or that is larger than it says: viser keeps all of it in memory.

    Args:
        gui: of the server.
        most: bytes.
        refuse: called with the browser's number, the file's name and the bytes that it was to have.
    """
    wire, states = gui._websock_interface, gui._current_file_upload_states
    begin, go_on = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def begin_small(client: Any, message: Any) -> None:
        size, parts = message.size_bytes, message.part_count
        if 0 <= size <= most and 0 <= parts <= max(size, 1):
            begin(client, message)
            return
        ids = {"source_component_uuid": message.source_component_uuid, "transfer_uuid": message.transfer_uuid}
        # The page shows the transfer until all of it has arrived.
        wire.queue_message(_messages.FileTransferPartAck(**ids, transferred_bytes=size, total_bytes=size))
        refuse(client, message.filename, size)

    def go_on_small(client: Any, message: Any) -> None:
        state = states.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] + len(message.content) > state["total_bytes"]:
            del states[message.transfer_uuid]
            return
        go_on(client, message)

    wire.unregister_handler(_messages.FileTransferStartUpload, begin)
    wire.register_handler(_messages.FileTransferStartUpload, begin_small)
    wire.unregister_handler(_messages.FileTransferPart, go_on)
    wire.register_handler(_messages.FileTransferPart, go_on_small)


def taken(button: viser.GuiUploadButtonHandle) -> tuple[str, bytes]:
    """Name and content of the file that was uploaded last; viser does not keep it any longer."""
    file = button.value
    button._impl.value = viser.UploadedFile("", b"")
    return file.name, file.content
