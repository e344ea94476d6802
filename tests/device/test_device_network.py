"""`tune --device` across a network: two hosts with a link between them that breaks and comes back."""

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from extras import need

need("device")

ADDRESSES = "10.213.7.1", "10.213.7.2"
HOST = """
import sys
from hyjax.core.schedule import guided_schedule
from hyjax.tuning.device_latency import DeviceWorkload
from hyjax.tuning.device_measuring import ConnectedDevice
from hyjax.tuning.device_request import latency_request
schedules = [guided_schedule([(2, 2)]), guided_schedule([(1, 1)])]
device = ConnectedDevice(sys.argv[1], 0, lambda line: print(line, flush=True))
print(device.server.address, flush=True)
found = device.latency(latency_request(DeviceWorkload(height=64, width=64, lights=1), schedules), schedules)
print("found", found.device.name, len(found.rounds), [timed.time.median for timed in found.measured], flush=True)
device.close()
"""
DEVICE = """
import json, ssl, sys, time, urllib.request
address, context = sys.argv[1], ssl._create_unverified_context()
def ask(path, content=None):
    body = None if content is None else json.dumps(content).encode()
    while True:
        try:
            request = urllib.request.Request(address + path, body, {"Content-Type": "application/json"})
            return json.load(urllib.request.urlopen(request, timeout=1, context=context))
        except OSError as error:
            if hasattr(error, "code"):
                raise
            print("lost", flush=True)
            time.sleep(0.2)
ask("hello", {"name": "Phone", "adapter": "a", "agent": "b", "timer": "gpu"})
job = ask("job")
for number in range(12):
    warm_up = {"seconds": 0.1, "runs": 2}
    times = {"milliseconds": [1.0, 2.0], "warm_up": warm_up, "last": number == 11}
    print("sent", ask("round", {"job": job["job"], "round": number} | times)["done"], flush=True)
    time.sleep(0.1)
"""


def ip(*arguments: str) -> int:
    return subprocess.run(["ip", *arguments], capture_output=True, check=False).returncode


@pytest.fixture
def spaces() -> Iterator[tuple[str, str]]:
    """Two network name spaces with a cable between them."""
    names = f"hyjax-{os.getpid()}-a", f"hyjax-{os.getpid()}-b"
    ends = "vhx0", "vhx1"
    try:
        try:
            made = all(ip("netns", "add", name) == 0 for name in names)
        except FileNotFoundError:
            made = False
        cable = "link", "add", ends[0], "netns", names[0], "type", "veth", "peer", ends[1], "netns", names[1]
        if not made or ip(*cable):
            pytest.skip("needs the right to make network name spaces, and `ip`")
        for name, end, address in zip(names, ends, ADDRESSES, strict=True):
            ip("-n", name, "address", "add", f"{address}/24", "dev", end)
            ip("-n", name, "link", "set", end, "up")
        yield names
    finally:
        for name in names:
            ip("netns", "del", name)


def inside(space: str, program: str, *arguments: str) -> "subprocess.Popen[str]":
    command = ["ip", "netns", "exec", space, sys.executable, "-c", program, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def said(process: "subprocess.Popen[str]", start: str) -> str:
    """The next line that starts so."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(start):
            return line.strip()
    raise AssertionError(f"ended without {start!r}")


@pytest.mark.slow
def test_a_device_across_a_network_whose_link_breaks(spaces: tuple[str, str]) -> None:
    """All rounds arrive once; nothing on the other host reaches the page without its token."""
    host = inside(spaces[0], HOST, ADDRESSES[0])
    device = None
    try:
        address = said(host, "https://")
        assert address.startswith(f"https://{ADDRESSES[0]}:")
        device = inside(spaces[1], DEVICE, address.rpartition("/")[0] + "/")
        assert said(device, "sent") == "sent 1"
        ip("-n", spaces[1], "link", "set", "vhx1", "down")
        assert said(device, "lost") == "lost"
        ip("-n", spaces[1], "link", "set", "vhx1", "up")
        assert said(host, "found") == "found Phone 12 [1.0, 2.0]"
        assert device.wait(60) == 0 and host.wait(60) == 0
    finally:
        for process in (host, device):
            if process is not None:
                process.kill()
                process.communicate()
