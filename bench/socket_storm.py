"""Clients that leave the daemon no rest: `python -m bench.socket_storm SOCKETS`, a process of its own.

Connections that come and go, calls of `Check` with megabytes, and `GetStatus` without pause. Ends with its
standard input. Refused calls and closed connections are what it is made for; it counts nothing.
"""

import json
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

CONNECTIONS = 1000  # opened one after the other, then closed together
POINTS = 4600  # of a `Check` of 24 joints: 2.7 MB
STATUS = b'{"method":"io.twind.Control.GetStatus","parameters":{"joints":true}}\0'
PAUSE = 0.2  # s after an attempt that failed


def connected(path: Path) -> socket.socket:
    """A new connection."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    made.settimeout(10.0)
    made.connect(str(path))
    return made


def exchanged(line: socket.socket, call: bytes) -> bytes:
    """The end of the answer to one call."""
    line.sendall(call)
    data = b"?"
    while data and data[-1]:
        data = line.recv(1 << 16)
    return data


def connect_many(path: Path) -> None:
    """Open connections until one is refused or all are open, then close them."""
    lines = []
    try:
        for _ in range(CONNECTIONS):
            lines.append(connected(path))
    finally:
        for line in lines:
            line.close()


def check_much(path: Path, joints: list[str]) -> None:
    """One `Check` of the largest kind."""
    points = [
        {"positions": [1e-6 * k] * len(joints), "time_from_start": 0.01 * (k + 1)} for k in range(POINTS)
    ]
    call = {
        "method": "io.twind.Control.Check",
        "parameters": {"trajectory": {"joint_names": joints, "points": points}},
    }
    with connected(path) as line:
        exchanged(line, json.dumps(call).encode() + b"\0")


def ask_status(path: Path) -> None:
    """A thousand `GetStatus` on one connection."""
    with connected(path) as line:
        for _ in range(1000):
            exchanged(line, STATUS)


def main() -> int:
    """Storm until the end of standard input."""
    path = Path(sys.argv[1]) / "control.sock"
    joints = sys.argv[2].split(",")
    ended = threading.Event()

    def again(what: Callable[[], None]) -> None:
        while not ended.is_set():
            try:
                what()
            except OSError:
                time.sleep(PAUSE)

    storms = (
        lambda: connect_many(path),
        lambda: check_much(path, joints),
        lambda: ask_status(path),
        lambda: ask_status(path),
    )
    for storm in storms:
        threading.Thread(target=again, args=(storm,), daemon=True).start()
    with suppress(KeyboardInterrupt):
        sys.stdin.read()
    ended.set()
    return 0


if __name__ == "__main__":
    sys.exit(main())
