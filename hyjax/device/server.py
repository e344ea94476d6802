"""Web server of a page for devices: for this machine alone, or by HTTPS with a self-signed certificate."""

import contextlib
import dataclasses
import http.server
import ipaddress
import mimetypes
import secrets
import socket
import ssl
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import unquote, urlsplit

from hyjax.device.certificate import qr_code, tls_context
from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL, LOCAL_NAMES

ANY_ADDRESS = ("0.0.0.0", "::")
MOST_BODY_BYTES = 1 << 20
"""Most bytes of a request's body."""
IDLE_SECONDS = 60.0
JSON = "application/json"
mimetypes.add_type("text/javascript", ".js")
mimetypes.add_type("text/plain", ".wgsl")


@dataclasses.dataclass(frozen=True)
class Answer:
    """Response to a request."""

    status: int
    content: bytes = b""
    kind: str = "text/plain; charset=utf-8"

    @classmethod
    def refuse(cls, status: int, line: str) -> "Answer":
        """Response with an error in one line."""
        return cls(status, line.encode())


class Site(Protocol):
    """Content of a server, called from several threads."""

    def get(self, path: str) -> Answer:
        """Response to a request for a path without a leading slash."""
        ...

    def post(self, path: str, body: bytes) -> Answer:
        """Response to JSON sent to a path."""
        ...


@dataclasses.dataclass(frozen=True)
class FolderSite:
    """Site of the files of a folder, and nothing else.

    Attributes:
        index: file for the folder itself.
    """

    root: Path
    index: str = "index.html"

    def get(self, path: str) -> Answer:
        root = self.root.resolve()
        try:
            file = (root / unquote(path)).resolve()
            if file.is_dir():
                file = (file / self.index).resolve()
            if not file.is_relative_to(root) or not file.is_file():
                return Answer.refuse(404, "no such file")
            content = file.read_bytes()
        except (OSError, ValueError):  # also a name with a zero byte
            return Answer.refuse(404, "no such file")
        return Answer(200, content, mimetypes.guess_type(file.name)[0] or "application/octet-stream")

    def post(self, path: str, body: bytes) -> Answer:
        return Answer.refuse(405, "nothing can be sent here")


class Server:
    """Server of a site, until `stop`.

    Args:
        host: address to listen at. Any but this machine's own has HTTPS.
        port: to listen at; 0 for any free one.
        secret: whether addresses contain a random token, where other machines can reach the server.
    """

    def __init__(
        self, site: Site, host: str = LOCAL, port: int = 0, *, secret: bool = False, page: str = ""
    ) -> None:
        self.site, self.is_local = site, host in LOCAL_NAMES
        self.token = secrets.token_urlsafe(12) if secret and not self.is_local else ""
        self.name = "localhost" if self.is_local else _own_address() if host in ANY_ADDRESS else host
        context = None if self.is_local else tls_context(self.name)
        try:
            self._server = _listen(host, port, self, context)
        except (OSError, OverflowError) as error:
            line = getattr(error, "strerror", None) or error
            raise InputError(f"port {port} on {host}: {line}; choose another --port or --host") from None
        self.port = int(self._server.server_address[1])
        shown = f"[{self.name}]" if ":" in self.name else self.name
        self.origin = f"{'http' if self.is_local else 'https'}://{shown}:{self.port}"
        self.address = f"{self.origin}/{f'{self.token}/' if self.token else ''}{page}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True, name="hyjax page")
        self._thread.start()

    def stop(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()

    def invitation(self) -> str:
        """Instructions in the terminal to open the page, on this machine or on another device."""
        if self.is_local:
            return (
                f"Open {self.address} in a browser with WebGPU on this machine. For an Android phone by cable: "
                f"adb reverse tcp:{self.port} tcp:{self.port}, then the same address on the phone."
            )
        return (
            f"{qr_code(self.address)}\nOpen {self.address} on the device. Its browser warns once, as nobody "
            "vouches for this certificate: go on to the page. Where it does not let you, there are two other ways: "
            f"without --host, adb reverse tcp:{self.port} tcp:{self.port} makes the page localhost on an Android "
            "phone; or put the folder of `hyjax export --to bench` on any HTTPS host, save latency.json there, "
            "carry it back, and give it to hyjax tune --latency."
        )

    def refusal(self, headers: Any, path: str) -> Answer | None:
        """Reason to refuse a request: not from this site, or without the token; None to accept it."""
        host = headers.get("Host", "")
        with contextlib.suppress(ValueError):
            if self.is_local and urlsplit(f"//{host}").hostname in LOCAL_NAMES:
                host = ""
        if self.is_local and host:
            return Answer.refuse(403, "not an address of this machine")
        origin = headers.get("Origin")
        if origin is not None and origin.partition("://")[2] != headers.get("Host", ""):
            return Answer.refuse(403, "not a page of this site")
        if self.token and not secrets.compare_digest(path.split("/")[0].encode(), self.token.encode()):
            return Answer.refuse(403, "the address lacks its token: take it from the terminal once more")
        return None


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = IDLE_SECONDS
    owner: Server

    def do_GET(self) -> None:
        self._answer(lambda path: self.owner.site.get(path))

    do_HEAD = do_GET

    def do_POST(self) -> None:
        refused = self.owner.refusal(self.headers, self._path())
        if refused is not None:  # before anything of it is read
            self.close_connection = True
            return self._send(refused)
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            return self._refuse(411, "the length of the content must be given")
        if not 0 <= length <= MOST_BODY_BYTES:
            return self._refuse(413, f"larger than {MOST_BODY_BYTES >> 20} MiB")
        body = self.rfile.read(length)
        if self.headers.get_content_type() != JSON:  # a page of another site cannot send it unasked
            return self._refuse(415, f"must be {JSON}")
        return self._answer(lambda path: self.owner.site.post(path, body))

    def _path(self) -> str:
        return self.path.partition("?")[0].removeprefix("/")

    def _refuse(self, status: int, line: str) -> None:
        self.close_connection = True
        self._send(Answer.refuse(status, line))

    def _answer(self, respond: Callable[[str], Answer]) -> None:
        path = self._path()
        refused = self.owner.refusal(self.headers, path)
        if refused is None and self.owner.token:
            _, slash, path = path.partition("/")
            if not slash:
                refused = Answer.refuse(404, "no such file")
        self._send(refused or respond(path))

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        headers = {} if answer.status == 204 else {"Content-Length": str(len(answer.content))}
        headers |= {
            "Content-Type": answer.kind,
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            # Isolated pages have finer timers.
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Embedder-Policy": "require-corp",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(answer.content)

    def log_message(self, *_: object) -> None:
        """Log nothing, to keep the terminal clear."""


class _Listener(http.server.ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128  # of five, fifty connections that say nothing keep others waiting for seconds
    context: ssl.SSLContext | None = None

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Handle the handshake, then the requests, in the connection's own thread."""
        if self.context is None:
            super().finish_request(request, client_address)
            return
        request.settimeout(IDLE_SECONDS)
        with self.context.wrap_socket(request, server_side=True) as wrapped:
            super().finish_request(wrapped, client_address)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of devices that go away, and of browsers that reject a self-signed certificate."""


def _listen(host: str, port: int, owner: Server, context: ssl.SSLContext | None) -> _Listener:
    handler = type("Handler", (_Handler,), {"owner": owner})
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = type("Listener", (_Listener,), {"address_family": family, "context": context})
    made: _Listener = listener((host, port), handler)
    return made


def _own_address() -> str:
    """Address of this machine in the local network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent
            return str(ipaddress.ip_address(probe.getsockname()[0]))
        except OSError:
            return LOCAL
