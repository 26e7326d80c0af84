"""The daemon's own words, from its observe socket: a varlink client of as few lines as will do."""

import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.proof.busmon.words import STATES

CALL = {
    "method": "io.twind.Control.Monitor",
    "parameters": {"topics": ["events", "status"], "rate": 20.0},
    "more": True,
}
MOST = 1 << 22  # bytes of a message


class Observer:
    """A connection that comes and goes with the daemon's front."""

    def __init__(self, path: Path) -> None:
        # of the next e-stop: its event does not say
        self._path = path
        self.level = "settle"
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._new = True  # no status has come on this connection

    def fileno(self) -> int:
        """-1: not connected."""
        return -1 if self._socket is None else self._socket.fileno()

    def connect(self) -> bool:
        """Try; the call is sent at once."""
        if self._socket is not None:
            return True
        made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        made.settimeout(0.01)
        try:
            made.connect(str(self._path))
            made.sendall(json.dumps(CALL).encode() + b"\0")
        except OSError:
            made.close()
            return False
        made.setblocking(False)
        self._socket = made
        self._buffer = b""
        self._new = True
        return True

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def words(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Reports since the last call, in order, for `Monitor.take_report`."""
        if self._socket is None:
            return
        try:
            data = self._socket.recv(1 << 20)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data or len(self._buffer) > MOST:
            self.close()
            return
        *messages, self._buffer = (self._buffer + data).split(b"\0")
        for message in messages:
            with suppress(ValueError, KeyError, TypeError):
                yield from self._understood(json.loads(message)["parameters"])

    def _understood(self, message: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        """States come as events, which are never dropped and carry the daemon's own time; the first status
        says where they begin."""
        if message["topic"] == "status":
            yield "mode", {"mode": message["status"]["mode"]}
            if self._new:
                yield "state", {"state": message["status"]["state"]}
            self._new = False
        elif message["topic"] == "events" and message["event"]["code"] == "DAMP":
            yield "damp", {}
        elif message["topic"] == "events" and message["event"]["code"] in STATES:
            at = float(message["event"]["time"])
            yield "state", {"state": message["event"]["code"], "at": at}
            if message["event"]["code"] == "estop":
                yield "estop", {"level": self.level, "at": at}
                self.level = "settle"
