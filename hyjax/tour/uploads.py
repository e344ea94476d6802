"""Uploads to a tour that are refused while they are announced, and kept no longer than they are used."""

from collections.abc import Callable
from typing import Any, NamedTuple

import viser
from viser import _messages
from viser._threadpool_exceptions import print_threadpool_errors

NO_FILE = viser.UploadedFile("", b"")


class Upload(NamedTuple):
    """A file that was uploaded.

    Attributes:
        client_id: number of the browser.
        name: of the file, as the browser says.
        content: of the file.
    """

    client_id: int
    name: str
    content: bytes


def take_uploads(
    button: viser.GuiUploadButtonHandle,
    most: int,
    take: Callable[[Upload], None],
    refuse: Callable[[int, str, int], None],
) -> None:
    """Take the files that are uploaded with a button; viser alone keeps all of any file in memory.

    A file that says it is larger is refused, as is one with which all that are on their way would be larger than
    four of the largest; one that is larger than it says is dropped.

    Args:
        button: the only one of its server.
        most: bytes of a file.
        take: called with each file, on a thread of its own.
        refuse: called with the browser's number, the file's name and the bytes that it was to have.
    """
    gui = button._impl.gui_api
    wire, states = gui._websock_interface, gui._current_file_upload_states
    begin, go_on = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def begin_small(client: Any, message: Any) -> None:
        size, parts = message.size_bytes, message.part_count
        on_the_way = sum(state["total_bytes"] for state in states.values())
        if 0 <= size <= most and 0 <= parts <= max(size, 1) and on_the_way + size <= 4 * most:
            begin(client, message)
            hand_over(client)
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
        hand_over(client)

    def hand_over(client: int) -> None:
        """Take a file that has arrived out of the button, which holds one, before the next message is handled."""
        file = button.value
        if file is not NO_FILE:
            button._impl.value = NO_FILE
            upload = Upload(client, file.name, file.content)
            gui._thread_executor.submit(take, upload).add_done_callback(print_threadpool_errors)

    button._impl.value = NO_FILE
    wire.unregister_handler(_messages.FileTransferStartUpload, begin)
    wire.register_handler(_messages.FileTransferStartUpload, begin_small)
    wire.unregister_handler(_messages.FileTransferPart, go_on)
    wire.register_handler(_messages.FileTransferPart, go_on_small)
