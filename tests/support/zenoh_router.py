"""A real Zenoh router in a process of its own, on loopback: `zenoh_router.py ENDPOINT [FILE [gossip]]`.

It ends with its standard input. Kill it, stop it, start it anew at the same place.
"""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType


def free_port() -> int:
    """A TCP port of loopback that nobody has."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
    return port


class Router:
    """Runs until `kill` or the end of the context. `file`: its configuration, but where it listens.

    `gossip`: peers learn from it of each other, as from the router of ROS.
    """

    def __init__(self, *, scheme: str = "tcp", file: Path | None = None, gossip: bool = False) -> None:
        self.endpoint = f"{scheme}/127.0.0.1:{free_port()}"
        self._words = (str(file or ""), "gossip" if gossip else "")
        self.process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        """Begin to serve; returns when it does."""
        command = [sys.executable, __file__, self.endpoint, *self._words]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"up\n", "the router did not start"

    def signal(self, number: int) -> None:
        """Stop it (SIGSTOP), let it go on (SIGCONT)."""
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        """At once. May be called twice."""
        if self.process is None:
            return
        self.process.kill()
        self.process.wait(10)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()
        self.process = None

    def __enter__(self) -> "Router":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()


def main(endpoint: str, file: str = "", gossip: str = "") -> None:
    """Route until standard input ends."""
    import zenoh

    config = zenoh.Config.from_file(file) if file else zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": bool(gossip),
    }.items():
        config.insert_json5(key, json.dumps(value))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C of a test run: whoever started us ends us
    with zenoh.open(config):
        os.write(1, b"up\n")
        os.read(0, 1)


if __name__ == "__main__":
    main(*sys.argv[1:])
