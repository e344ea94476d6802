"""What the page's server answers, to whom, and what a device may send."""

import http.client
import json
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from extras import need

from hyjax import InputError
from hyjax.core.schedule import guided_schedule
from hyjax.device.serve import ServeSettings, open_folder
from hyjax.device.server import MOST_BODY_BYTES, FolderSite, Server
from hyjax.tuning import device_measuring as measuring
from hyjax.tuning.device_latency import DeviceWorkload
from hyjax.tuning.device_measuring import ConnectedDevice
from hyjax.tuning.device_request import latency_request

JSON = {"Content-Type": "application/json"}
WORKLOAD = DeviceWorkload(height=32, width=32, lights=1)
SCHEDULES = [guided_schedule([(2, 2)]), guided_schedule([(1, 1)])]
PHONE = {"name": "Phone", "adapter": "adapter", "agent": "browser", "timer": "wall"}


def ask(server: Server, path: str, body: Any = None, headers: dict[str, str] | None = None) -> tuple[int, str]:
    """Status and text of an answer."""
    if server.is_local:
        connection = http.client.HTTPConnection(server.name, server.port, timeout=10)
    else:
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection = http.client.HTTPSConnection(server.name, server.port, timeout=10, context=context)
    content = body if isinstance(body, bytes | None) else json.dumps(body).encode()
    method = "GET" if body is None else "POST"
    connection.request(method, path, content, {**(JSON if body is not None else {}), **(headers or {})})
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A page, beside a secret that is no part of it."""
    (tmp_path / "secret.txt").write_text("secret")
    page = tmp_path / "page"
    (page / "inner").mkdir(parents=True)
    (page / "index.html").write_text("<p>page")
    (page / "inner" / "script.js").write_text("1")
    (page / "link.txt").symlink_to(tmp_path / "secret.txt")
    return page


@pytest.fixture
def server(folder: Path) -> Iterator[Server]:
    server = Server(FolderSite(folder))
    yield server
    server.stop()


def test_files_of_the_folder(server: Server) -> None:
    assert ask(server, "/") == (200, "<p>page") == ask(server, "/index.html?x=1")
    assert ask(server, "/inner/script.js") == (200, "1")
    for path in ("/missing.txt", "/inner", "/index.html/x"):
        assert ask(server, path)[0] == 404, path
    assert ask(server, "/index.html", {})[0] == 405


@pytest.mark.parametrize(
    "path",
    ["/../secret.txt", "/inner/../../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt", "//etc/passwd",
     "/%2fetc/passwd", "/link.txt", "/%00", "/..\\secret.txt"],
)  # fmt: skip
def test_nothing_outside_of_the_folder(path: str, server: Server) -> None:
    status, text = ask(server, path)
    assert status == 404 and "secret" not in text


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://other.example"},
        {"Origin": "http://localhost:1"},
        {"Origin": "null"},
        {"Host": "other.example"},
        {"Host": "localhost.other.example"},
    ],
)
def test_other_sites_get_nothing(headers: dict[str, str], server: Server) -> None:
    assert ask(server, "/", headers=headers)[0] == 403


def test_sizes_and_kinds_of_what_is_sent(server: Server) -> None:
    origin = {"Origin": f"http://localhost:{server.port}"}
    assert ask(server, "/job", b"{}", origin)[0] == 405
    assert ask(server, "/job", b"{}", {"Content-Type": "text/plain"})[0] == 415
    assert ask(server, "/job", b"", {"Content-Length": str(MOST_BODY_BYTES + 1)})[0] == 413
    assert ask(server, "/job", b"", {"Content-Length": "-1"})[0] == 413
    assert ask(server, "/job", b"", {"Content-Length": "many"})[0] == 411


def test_a_port_that_is_taken(server: Server, folder: Path) -> None:
    with pytest.raises(InputError, match=rf"port {server.port} .*choose another --port"):
        Server(FolderSite(folder), port=server.port)
    with pytest.raises(InputError, match="no such folder"):
        open_folder(ServeSettings(folder / "missing"))
    with pytest.raises(InputError, match=r"no index\.html"):
        open_folder(ServeSettings(folder / "inner"))
    with pytest.raises(InputError, match="port"):
        open_folder(ServeSettings(folder, port=70000))


def test_other_machines_need_the_token(folder: Path) -> None:
    need("device")
    server = Server(FolderSite(folder), "127.0.0.2", secret=True)  # no name of this machine to the server
    try:
        path = f"/{server.token}/"
        assert server.address == f"https://127.0.0.2:{server.port}{path}" and len(server.token) > 12
        assert ask(server, path) == (200, "<p>page")
        for wrong in ("/", "/index.html", f"/{server.token}x/index.html", "/%2e%2e/"):
            assert ask(server, wrong)[0] == 403, wrong
        assert ask(server, path, headers={"Origin": "https://other.example"})[0] == 403
        words = server.invitation()
        assert "▄" in words and server.address in words
        assert all(hint in words for hint in ("warns once", "adb reverse", "export --to bench"))
    finally:
        server.stop()


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2"])
def test_connections_that_hang_break_off_or_send_rubbish_hold_up_nobody(host: str, folder: Path) -> None:
    """Neither in HTTP nor in HTTPS, where the handshake hangs, too."""
    need("device")
    server, begin = Server(FolderSite(folder), host), time.monotonic()
    long, visitors = b"POST /hello HTTP/1.1\r\nContent-Length: 100\r\n\r\n{", list[socket.socket]()
    try:
        for sent in (b"", long, bytes(range(256)) * 40, b"\x16\x03\x01\xff\xff", b"GET /" + b"x" * 70_000):
            for closes in (False, True):
                visitors.append(socket.create_connection((host, server.port), timeout=5))
                visitors[-1].sendall(sent)
                if closes:
                    visitors[-1].close()
        for _ in range(50):
            visitors.append(socket.create_connection((host, server.port), timeout=5))
        assert ask(server, "/")[0] == 200
    finally:
        server.stop()
        for visitor in visitors:
            visitor.close()
    assert time.monotonic() - begin < 5


class Phone:
    """A device as a page behaves."""

    def __init__(self, device: ConnectedDevice, **identity: str) -> None:
        self.server, self.identity = device.server, PHONE | identity

    def hello(self) -> tuple[int, str]:
        return ask(self.server, "/hello", self.identity)

    def job(self) -> dict[str, Any]:
        status, text = ask(self.server, "/job")
        assert status == 200, text
        return json.loads(text)

    def round(self, job: int, number: int, times: Any = (1.0, 2.0), **rest: Any) -> tuple[int, str]:
        warm_up = {"seconds": 0.1, "runs": 2}
        content = {"job": job, "round": number, "milliseconds": times, "warm_up": warm_up} | rest
        return ask(self.server, "/round", content)


@pytest.fixture
def device() -> Iterator[tuple[ConnectedDevice, list[str]]]:
    lines: list[str] = []
    device = ConnectedDevice("127.0.0.1", 0, lines.append)
    yield device, lines
    device.close()


def start(device: ConnectedDevice, found: list[Any]) -> threading.Thread:
    request = latency_request(WORKLOAD, SCHEDULES)
    thread = threading.Thread(target=lambda: found.append(device.latency(request, SCHEDULES)), daemon=True)
    thread.start()
    return thread


def test_a_device_that_goes_away_and_comes_back(
    device: tuple[ConnectedDevice, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    connected, lines = device
    monkeypatch.setattr(measuring, "SILENCE", 0.5)
    phone, found = Phone(connected), list[Any]()
    assert ask(connected.server, "/job")[0] == 409  # before it has said who it is
    assert phone.hello()[0] == 200
    thread = start(connected, found)
    job = phone.job()
    assert job["done"] == 0 and [entry["steps"] for entry in job["request"]["schedules"]] == [{"2": 2}, {"1": 1}]
    for number in range(4):
        assert json.loads(phone.round(job["job"], number)[1]) == {"more": True, "done": number + 1}
    thread.join(2.5)
    assert sum("nothing is heard of Phone" in line for line in lines) == 1
    assert phone.hello()[0] == 200 and phone.job()["done"] == 4  # where it stopped
    assert json.loads(phone.round(job["job"], 3)[1])["done"] == 4  # sent again: not counted again
    for number in range(4, 12):
        phone.round(job["job"], number, last=number == 11)
    thread.join(10)
    (latency,) = found
    assert latency.device.name == "Phone" and len(latency.rounds) == 12
    assert [timed.time.median for timed in latency.measured] == [1.0, 2.0]
    assert json.loads(phone.round(job["job"], 12)[1]) == {"more": False}  # too late


def test_what_cannot_be_used_is_refused_and_told(device: tuple[ConnectedDevice, list[str]]) -> None:
    connected, lines = device
    phone, found = Phone(connected), list[Any]()
    phone.hello()
    thread = start(connected, found)
    number = phone.job()["job"]
    bad: list[Any] = [
        b"", b"[", b"\xff", b'{"job": NaN}', {}, [1], {"job": number}, "text",
    ]  # fmt: skip
    for content in bad:
        status, line = ask(connected.server, "/round", content)
        assert status == 400 and line.startswith("round: ") and "\n" not in line
    for times in ([1.0], [1.0, -2.0], [1.0, 0.0], [1.0, "2"], [1.0, None], [1.0, 2.0, 3.0], []):
        assert phone.round(number, 0, times)[0] == 400
    assert "after 0" in phone.round(number, 5)[1]
    assert "too few" in phone.round(number, 0, last=True)[1]
    assert len(lines) >= 2 + len(bad) + 9 and all("\n" not in line for line in lines)
    status, line = Phone(connected, name="Tablet").hello()
    assert status == 400 and "Phone is being measured, not Tablet" in line
    assert ask(connected.server, "/nothing", {})[0] == 404
    for n in range(10):
        phone.round(number, n, last=n == 9)
    thread.join(10)
    assert found and len(found[0].rounds) == 10  # nothing of it is lost
    ask(connected.server, "/trouble", {"error": "the adapter\nis gone"})
    assert lines[-1] == "Phone: the adapter is gone"


def test_the_page_is_there(device: tuple[ConnectedDevice, list[str]]) -> None:
    server = device[0].server
    for name in ("measure.html", "measure.js", "timing.js", "engine.js", ""):
        assert ask(server, f"/{name}")[0] == 200, name
    assert ask(server, "/bench.json") == (204, "")
    assert "adb reverse" in device[1][0]
