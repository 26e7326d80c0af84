"""The rows in real time that are done by clients: deaf, dead, second, and without descriptors."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.support.processes import Daemon
from twind.client import CallError, ClientError

if TYPE_CHECKING:
    from tests.proof.faults.ground import Ground


def never_reads(ground: Ground) -> None:
    """Row 33: a client that asks for everything and reads nothing: the tick goes on, it is hung up on."""
    ground.moving(watched=True)
    deaf = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    ground.stack.callback(deaf.close)
    deaf.connect(str(ground.folder / "run" / "observe.sock"))
    call = '{"method":"io.twind.Control.Monitor","parameters":{"topics":["state"],"rate":100.0},"more":true}'
    deaf.sendall(call.encode() + b"\0")
    ground.begun = time.monotonic()
    ground.goes_on(2.0)
    time.sleep(6.0)
    deaf.settimeout(2.0)
    closed = False
    with suppress(TimeoutError):
        size = 0
        while size < 8 << 20:
            data = deaf.recv(1 << 16)
            size += len(data)
            if not data:
                closed = True
                break
    ground.claim(closed, "a client that never reads is kept")
    ground.claim(not ground.running.status()["faults"], "a fault is latched")


CLIENT = """
import sys, time
sys.path.insert(0, sys.argv[2])
from twind.client import Client
client = Client(sys.argv[1])
client.call("AcquireLease")
points = [{"positions": [0.6 * (k % 2)], "time_from_start": 1.2 * k} for k in range(1, 40)]
client.call("SubmitTrajectory", trajectory={"joint_names": ["head_yaw"], "points": points})
print("moving", flush=True)
while True:
    client.call("RenewLease")
    time.sleep(0.1)
"""


def client_dies(ground: Ground) -> None:
    """Row 34: a client's process is killed in motion."""
    first = ground.armed(watched=True)
    first.call("ReleaseLease")
    command = [sys.executable, "-c", CLIENT, str(ground.folder / "run"), str(Path(__file__).parents[3])]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"moving\n"
    time.sleep(float(ground.random.uniform(0.2, 1.5)))
    ground.begun = time.monotonic()
    process.kill()
    process.wait(5)
    process.stdout.close()
    ground.detected()
    time.sleep(0.5)
    ground.stands()
    ground.torque(True)
    ground.recover()


def second_daemon(ground: Ground) -> None:
    """Row 35: a second daemon and a second client are refused, the first go on."""
    ground.moving()
    port = f"main={ground.folder / 'ports' / 'main'}"
    other = Daemon(ground.folder / "other", "--mode", "mirror", "--port", port)
    ground.claim(other.end(signal.SIGCONT) == 1, "a second daemon was not refused")
    with ground.running.client() as client:
        for method, given in (("AcquireLease", {}), ("Arm", {}), ("RenewLease", {})):
            try:
                client.call(method, **given)
                ground.claim(False, f"{method} of another client was accepted")
            except CallError:
                pass
    ground.goes_on()


def no_descriptors(ground: Ground) -> None:
    """Row 36: the front has no descriptors left: new clients wait or are refused, the motion goes on."""
    ground.moving(watched=True)
    front = ground.running.front()
    count = len(os.listdir(f"/proc/{front}/fd"))
    before = resource.prlimit(front, resource.RLIMIT_NOFILE)
    resource.prlimit(front, resource.RLIMIT_NOFILE, (count, before[1]))
    tried: list[Any] = []
    for _ in range(8):
        made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        made.setblocking(False)
        with suppress(OSError):
            made.connect(str(ground.folder / "run" / "control.sock"))
        tried.append(made)
    ground.goes_on(2.0)
    resource.prlimit(front, resource.RLIMIT_NOFILE, before)
    for made in tried:
        made.close()
    time.sleep(0.5)
    with suppress(ClientError):
        ground.claim(not ground.running.status()["faults"], "a fault is latched")
        return
    ground.claim(False, "no client is served once there are descriptors again")
