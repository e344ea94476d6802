"""Web server of a tour: where it listens, and which pages may talk to it."""

import contextlib
import functools
import io
import logging
import socket
from collections.abc import Mapping
from traceback import walk_tb
from typing import Any
from urllib.parse import urlsplit

import msgspec
import viser
from websockets.exceptions import InvalidHandshake

from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL

UNREADABLE = (msgspec.MsgspecError, KeyError, TypeError, ValueError, AttributeError, AssertionError)
"""Errors that viser raises over foreign messages."""


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server that neither draws on the terminal, nor opens a tunnel, nor talks to pages of other sites."""
    check_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # viser draws a box
        server = viser.ViserServer(host, port, label="hyjax room tour", verbose=False)
    loggers = [logging.getLogger(name) for name in ("websockets.server", "asyncio")]
    shorten, stop = functools.partial(_shorten), server.stop  # a filter of this server's own

    def stop_all() -> None:
        stop()
        for logger in loggers:
            logger.removeFilter(shorten)

    for logger in loggers:
        logger.addFilter(shorten)
    server.stop = stop_all  # type: ignore[method-assign]
    server.request_share_url = _no_tunnel  # type: ignore[method-assign]

    async def same_site(connection: Any) -> None:
        """Hang up on pages of other sites: a browser lets them talk to servers of its own machine."""
        wire = server._websock_server._live_connections[connection.client_id]
        headers: Mapping[str, str] = wire.request.headers if wire.request is not None else {}
        origin, asked = headers.get("Origin"), headers.get("Host", "")
        foreign = origin is not None and urlsplit(origin).netloc != asked
        renamed = host in (LOCAL, "localhost") and urlsplit(f"//{asked}").hostname not in (LOCAL, "localhost")
        if foreign or renamed:
            await wire.close(1008, "not a page of this tour")

    server._websock_server.on_client_connect(same_site)
    server._websock_server.disconnect_all_clients()  # who connected before comes back, and is checked
    return server


def address(host: str, server: viser.ViserServer) -> str:
    """Address of the page."""
    return f"http://{'localhost' if host in (LOCAL, '0.0.0.0') else host}:{server.get_port()}"


def check_port(host: str, port: int) -> None:
    """Raise `InputError` unless the port can be listened at."""
    try:
        with socket.socket() as test:
            test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            test.bind((host, port))
    except OSError as error:
        raise InputError(
            f"port {port} on {host}: {error.strerror or error}; choose another --port or --host"
        ) from None


def _shorten(record: logging.LogRecord) -> bool:
    """Filter that shortens errors of foreign messages to one line; others keep their traceback."""
    error = record.exc_info[1] if record.exc_info else None
    if error is None:
        return True
    packages = {str(frame.f_globals.get("__name__")).split(".")[0] for frame, _ in walk_tb(error.__traceback__)}
    if isinstance(error, InvalidHandshake):
        left_out = "a connection that is no page's"
    elif isinstance(error, UNREADABLE) and "viser" in packages and "hyjax" not in packages:
        left_out = "a message that no page of it sends"
    else:
        return True
    record.msg, record.args = "tour: left out %s (%s)", (left_out, type(error).__name__)
    record.exc_info = record.exc_text = None
    return True


def _no_tunnel(verbose: bool = True) -> None:
    """Refusal in the place of viser's tunnel through a public server: a tour stays on its own machine."""
