"""Wire of a tour: an HTTP server for its page's files, and WebSockets for what visitors ask."""

import asyncio
import contextlib
import http
import logging
import socket
import threading
from collections.abc import Awaitable, Callable
from typing import Any
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
        check_port(host, port)
        self._host, self._files, self._visit, self._visitors = host, files, visit, 0
        self.loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._refused: OSError | None = None
        started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(port, started), name="tour's server", daemon=True)
        self._thread.start()
        started.wait()
        if self._refused is not None:
            raise _no_port(host, port, self._refused)
        shown = "localhost" if host in (LOCAL, "0.0.0.0") else f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.port}"

    def stop(self) -> None:
        """Close all connections and end the thread."""
        self.loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5.0)

    def _run(self, port: int, started: threading.Event) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_until_complete(self._serve(port, started))
        except OSError as error:  # another program has taken the port since it was checked
            self._refused = error
        finally:
            self.loop.close()
            started.set()

    async def _serve(self, port: int, started: threading.Event) -> None:
        quiet = logging.getLogger(f"{__name__}.websockets")
        quiet.filters = [_one_line]
        options: dict[str, Any] = {"max_size": MOST_BYTES, "max_queue": 4}
        async with serve(
            self._connected,
            self._host,
            port,
            process_request=self._request,
            create_connection=_Connection,
            open_timeout=FILE_SECONDS,
            close_timeout=FILE_SECONDS,
            compression=None,
            server_header=None,
            logger=quiet,
            **options,
        ) as server:
            self.port = int(next(iter(server.sockets)).getsockname()[1])
            started.set()
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


def check_port(host: str, port: int) -> None:
    """Raise `InputError` unless the port can be listened at."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with contextlib.closing(socket.socket(family)) as test:
            test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            test.bind((host, port))
    except OSError as error:
        raise _no_port(host, port, error) from None


def _no_port(host: str, port: int, error: OSError) -> InputError:
    return InputError(f"port {port} on {host}: {error.strerror or error}; choose another --port or --host")


def _one_line(record: logging.LogRecord) -> bool:
    """Filter that shortens what the library says of foreign connections to one line, and of lost ones to none."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg, record.args = "tour: left out a connection that is no page's (%s)", (type(error).__name__,)
    record.exc_info = record.exc_text = None
    return isinstance(error, InvalidHandshake)
