"""Wire of a tour: an HTTP server for its page's files, and WebSockets for what visitors ask."""

import asyncio
import contextlib
import http
import logging
import socket
import threading
from collections.abc import Awaitable, Callable
from urllib.parse import unquote, urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHandshake
from websockets.http11 import Request, Response

from hyjax.tour.messages import MOST_BYTES
from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL, LOCAL_NAMES

MOST_VISITORS = 256
"""Connections at a time."""
SOCKET = "socket"
"""Path of the WebSocket."""
REQUEST_SECONDS, FILE_SECONDS = 10.0, 600.0
"""Within which a connection must have sent its request, and within which a file is made and sent."""
_log = logging.getLogger(__name__)


class Wire:
    """Server, on a thread of its own, until it is stopped.

    Args:
        host, port: where to listen; port 0 for any free one.
    """

    def __init__(
        self,
        host: str,
        port: int,
        files: Callable[[str], tuple[bytes, str] | None],
        visit: Callable[[ServerConnection], Awaitable[None]],
    ) -> None:
        self._host, self._files, self._visit, self._visitors = host, files, visit, 0
        self._socket, self.loop, self._ended = listen(host, port), asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="tour's server", daemon=True)
        self._thread.start()
        shown = "localhost" if host in (LOCAL, "0.0.0.0") else f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self._socket.getsockname()[1]}"

    def stop(self) -> None:
        """Close all connections and end the thread."""
        self.loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5.0)

    def _run(self) -> None:
        with contextlib.closing(self.loop):
            self.loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        quiet = logging.getLogger(f"{__name__}.websockets")
        quiet.filters = [_one_line]
        async with serve(
            self._connected,
            sock=self._socket,
            process_request=self._request,
            create_connection=_Connection,
            open_timeout=FILE_SECONDS,
            close_timeout=FILE_SECONDS,
            compression=None,
            server_header=None,
            logger=quiet,
            max_size=MOST_BYTES,
            max_queue=4,
        ):
            await self._ended.wait()

    async def _connected(self, connection: ServerConnection) -> None:
        self._visitors += 1
        try:
            await self._visit(connection)
        finally:
            self._visitors -= 1

    async def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer to a request for a file; None lets a WebSocket be opened."""
        origin, asked = request.headers.get("Origin"), request.headers.get("Host", "")
        renamed = self._host in LOCAL_NAMES and urlsplit(f"//{asked}").hostname not in LOCAL_NAMES
        if renamed or (origin is not None and urlsplit(origin).netloc != asked):
            return _response(http.HTTPStatus.FORBIDDEN, b"not a page of this tour\n")
        path = unquote(urlsplit(request.path).path).lstrip("/")
        if path == SOCKET:
            full = self._visitors >= MOST_VISITORS
            return _response(http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many visitors\n") if full else None
        try:
            found = await asyncio.get_running_loop().run_in_executor(None, self._files, path)
        except InputError as error:
            return _response(http.HTTPStatus.NOT_FOUND, f"{error}\n".encode())
        except Exception:
            _log.exception("a file of the tour's page could not be made")
            return _response(http.HTTPStatus.INTERNAL_SERVER_ERROR, b"see the terminal\n")
        if found is None:
            return _response(http.HTTPStatus.NOT_FOUND, b"no such file\n")
        return _response(http.HTTPStatus.OK, *found)


class _Connection(ServerConnection):
    """Connection that is closed if no request comes."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.loop.call_later(REQUEST_SECONDS, self._expire)

    def _expire(self) -> None:
        if self.request is None:
            self.transport.abort()


def _response(status: http.HTTPStatus, content: bytes, kind: str = "text/plain; charset=utf-8") -> Response:
    headers = Headers()
    headers["Content-Type"], headers["Content-Length"] = kind, str(len(content))
    headers["Cache-Control"], headers["X-Content-Type-Options"] = "no-store", "nosniff"
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, content)


def listen(host: str, port: int) -> socket.socket:
    """Socket at a port; `InputError` unless the port can be listened at."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        reason = str(error.strerror or error).partition(" (")[0]  # Python adds the address
        raise InputError(f"port {port} on {host}: {reason}; choose another --port or --host") from None


def _one_line(record: logging.LogRecord) -> bool:
    """Filter that shortens what the library says of foreign connections to one line, and of lost ones to none."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg, record.args = "tour: left out a connection that is no page's (%s)", (type(error).__name__,)
    record.exc_info = record.exc_text = None
    return isinstance(error, InvalidHandshake)
