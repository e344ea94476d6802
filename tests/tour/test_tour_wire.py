"""The tour's server under what no page of it sends: noise, foreign pages, slow and many connections."""

import contextlib
import http.client
import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
from extras import need

need("tour")

from test_tour_protocol import DIM, PLAN
from visits import box_tour, visiting
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hyjax.tour import tasks
from hyjax.tour import wire as wire_module
from hyjax.tour.messages import MOST_BYTES, Message, read_message
from hyjax.tour.tour import Tour
from hyjax.tour.visitor import WAITING
from hyjax.util.errors import InputError

GOOD = {"task": "picture", "number": 1, "plan": {}}
LAMP = {"kind": "bulb", "position": [0, 0, 0]}
NOISE = (
    "",
    "[" * 60_000,
    "null",
    "nonsense",
    json.dumps({"task": "picture"}),
    json.dumps({**GOOD, "task": "shutdown"}),
    json.dumps({**GOOD, "number": -1}),
    json.dumps({**GOOD, "number": 1e400}),
    json.dumps({**GOOD, "more": 1}),
    json.dumps({**GOOD, "plan": {"hour": 99}}),
    json.dumps({**GOOD, "plan": {"day": "tomorrow"}}),
    json.dumps({**GOOD, "plan": {"lamps": [LAMP] * 17}}),
    json.dumps({**GOOD, "plan": {"pieces": [{"seed": [0, 0, 0], "file": "../secret.ply"}]}}),
    json.dumps({**GOOD, "view": {"frame": -1}}),
    json.dumps({**GOOD, "view": {"camera": [[1, 0, 0]] * 3}}),
    json.dumps({**GOOD, "view": {"steps": 5}}),
    json.dumps({**GOOD, "places": [[0, 0]] * 5}),
)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    tour = box_tour(tmp_path_factory.mktemp("tour"), engine="server")
    yield tour
    tour.stop()


@pytest.mark.parametrize("text", NOISE)
def test_noise_is_no_message(text: str) -> None:
    with pytest.raises(InputError) as refused:
        read_message(text)
    assert "\n" not in str(refused.value)


def test_noise_is_answered_by_a_line_and_the_visit_goes_on(tour: Tour) -> None:
    with visiting(tour) as visit:
        for noise in (*NOISE, b"\xff\xfe\x00"):
            visit.wire.send(noise)
            head, _ = visit.receive()
            assert 0 < len(head["refused"]) <= 500
            named = isinstance(noise, str) and '"number": 1,' in noise
            assert head["number"] == (1 if named else None), "a page waits for the answer to its number"
        assert visit.picture(PLAN).std() > 5


def test_a_message_that_is_too_long_ends_its_visit_alone(tour: Tour) -> None:
    with visiting(tour) as good, visiting(tour) as bad:
        bad.wire.send("x" * (MOST_BYTES + 1))
        with pytest.raises(ConnectionClosed):
            bad.receive()
        assert good.picture(PLAN).std() > 5


def answered(tour: Tour, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port(tour), timeout=20)
    try:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def port(tour: Tour) -> int:
    return int(tour.url.rpartition(":")[2])


def test_pages_of_other_sites_are_refused(tour: Tour) -> None:
    own = f"localhost:{port(tour)}"
    assert answered(tour, "/page.json", Host=own) == 200
    assert answered(tour, "/page.json", Host=own, Origin=f"http://{own}") == 200
    assert answered(tour, "/page.json", Host=own, Origin="http://elsewhere.example") == 403
    assert answered(tour, "/page.json", Host="renamed.example") == 403
    for origin in ("http://elsewhere.example", "null", f"http://localhost:{port(tour) + 1}"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://{own}/socket", origin=origin)  # type: ignore[arg-type]


def test_what_is_for_gpus_is_not_made_where_the_server_draws(tour: Tour) -> None:
    assert answered(tour, "/gpu.json") == 404


def test_slow_visitors_hold_up_nobody(tour: Tour, monkeypatch: pytest.MonkeyPatch) -> None:
    """One reads nothing of many answers, others say half a request: the next picture comes at once."""
    made: list[int] = []

    def long_answer(renderer: Any, message: Message) -> str:
        made.append(message.number)
        return "x" * 1_000_000

    monkeypatch.setattr(tasks, "answer", long_answer)
    held: list[Any] = []
    for _ in range(60):
        wire = socket.create_connection(("127.0.0.1", port(tour)))
        wire.sendall(b"GET /socket HTTP/1.1\r\nHost: loc")
        held.append(wire)
    slow = connect(f"{tour.url.replace('http', 'ws')}/socket", max_queue=1)
    try:
        ask = json.dumps({"task": "daylight", "number": 1, "plan": {}})
        for _ in range(400):
            slow.send(ask)
        with visiting(tour) as visit:
            visit.picture(PLAN)
            begun = time.monotonic()
            visit.picture(DIM)
            assert time.monotonic() - begun < 5
        before = 0
        while before < len(made):
            before = len(made)
            time.sleep(0.5)
        assert WAITING < len(made) < 100, "no more is made than can be sent"
    finally:
        for wire in held:
            wire.close()
        slow.socket.shutdown(socket.SHUT_RDWR)
        slow.socket.close()  # with what it has not read: the server's sends fail


def test_a_port_that_is_taken_after_it_was_checked() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match="choose another --port"):
            wire_module.Wire(
                "127.0.0.1", other.getsockname()[1], lambda path: None, lambda visitor: visitor.close()
            )


def test_a_connection_without_a_request_is_closed(tour: Tour, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_module, "REQUEST_SECONDS", 0.3)
    with socket.create_connection(("127.0.0.1", port(tour)), timeout=20) as wire:
        wire.sendall(b"GET / HTTP/1.1\r\nHost: loc")
        with contextlib.suppress(ConnectionResetError):
            assert wire.recv(1) == b""


def test_a_file_reaches_a_slow_reader_whole(tour: Tour) -> None:
    with socket.socket() as wire:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.settimeout(20)
        wire.connect(("127.0.0.1", port(tour)))
        wire.sendall(b"GET /viewer.js HTTP/1.1\r\nHost: localhost\r\n\r\n")
        content = b""
        while part := wire.recv(1024):
            content += part
            time.sleep(0.1 if len(content) < 12_000 else 0.0)
    head, _, body = content.partition(b"\r\n\r\n")
    assert f"content-length: {len(body)}" in head.decode().lower() and body.endswith(b"}\n")


def test_two_hundred_visitors_at_once(tour: Tour) -> None:
    wires = [connect(f"{tour.url.replace('http', 'ws')}/socket") for _ in range(200)]
    try:
        with visiting(tour) as visit:
            assert visit.picture(PLAN).std() > 5
            assert len(tour.visitors) >= 201
    finally:
        for wire in wires:
            wire.socket.shutdown(socket.SHUT_RDWR)
    end = time.monotonic() + 20
    while tour.visitors and time.monotonic() < end:
        time.sleep(0.05)
    assert not tour.visitors and not tour.queue.busy
