"""Fault commands on a Unix stream socket, one JSON object a line in, one out. Single-threaded, never blocks.

`{"fault": "silence", "bus": "main", "id": 12}` → `{"ok": true}`; `{"query": "state"}` → the state of every
servo. An invalid order is answered with the valid ones.
"""

import json
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from twind.exceptions import InvalidInput

LINE = 65536  # bytes, longest order
NO_JSON = 'not JSON: an order is one object a line, as {"fault": "drop", "count": 3} or {"query": "state"}'

Order = dict[str, Any]
FaultArguments = Mapping[str, Mapping[str, type | tuple[type, ...]]]
REAL = (int, float)
# Arguments of the faults that families share, as methods of a bus's `faults`; those ending in ? are optional.
SHARED_FAULTS: FaultArguments = {
    "drop": {"count": int, "id?": int},
    "foreign": {"count": int, "id?": int},
    "duplicate": {"count": int, "id?": int},
    "delay": {"seconds": REAL, "id?": int},
    "echo": {"on?": bool},
    "stall": {"on?": bool},
    "seed": {"number": int},
    "silence": {"id?": int, "on?": bool},
    "damage": {"id": int, "bits": int},
    "brown_out": {"id": int},
    "supply": {"volts": REAL},
    "heat": {"id": int, "celsius": REAL},
    "lock": {"id": int},
    "free": {"id": int},
    "hand": {"id?": int, "to?": REAL, "rad?": REAL, "speed?": REAL, "off?": bool, "pose?": dict},
    "lay": {"base": str},
    "freeze": {"id": int, "on?": bool},
    "record": {"count": int},
    "unplug": {},
    "replug": {"renamed?": bool},
    "clear": {},
}
# Of the body that all buses move, as the methods of `BaseSupport`; `imu` as `VirtualSensor.err`.
BODY_FAULTS: FaultArguments = {
    "hold": {"on?": bool},
    "push": {"forward?": REAL, "left?": REAL, "up?": REAL, "seconds?": REAL},
    "imu": {"gyro_noise?": REAL, "acceleration_noise?": REAL, "gyro_bias?": REAL},
}


def arguments(order: Order, faults: FaultArguments) -> tuple[str, dict[str, Any]]:
    """Fault and its arguments, of those of one kind of bus. Raises InvalidInput."""
    if "fault" not in order:
        raise InvalidInput('an order names a fault or a query, as {"fault": "drop", "count": 3}')
    name = order["fault"]
    if not isinstance(name, str) or name not in faults:
        raise InvalidInput(f"no fault {name!r}; there are {', '.join(faults)}")
    kinds = {key.rstrip("?"): kind for key, kind in faults[name].items()}
    given = {key: value for key, value in order.items() if key not in ("fault", "bus")}
    for key, value in given.items():
        if key not in kinds:
            raise InvalidInput(f"{name} takes {', '.join(kinds) or 'no arguments'}, not {key!r}")
        if not isinstance(value, kinds[key]) or (isinstance(value, bool) and kinds[key] is not bool):
            raise InvalidInput(f"{name}: {key} is {value!r}, of the wrong type")
    missing = [key for key in faults[name] if key not in given and not key.endswith("?")]
    if missing:
        raise InvalidInput(f"{name} needs {', '.join(missing)}")
    return name, given


def _refuse_taken(path: Path) -> None:
    """Raise OSError if a process answers there; a socket without listener is a leftover."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return
    raise OSError(f"{path}: another twind-virtual takes orders there; end it, or name another socket")


class FaultCommandSocket:
    """The socket and its clients. `answer` executes one order; InvalidInput and KeyError become replies."""

    def __init__(self, path: Path, answer: Callable[[Order], Order]) -> None:
        """Bind the socket. Raises OSError: the path cannot be bound."""
        self._path = path
        self._answer = answer
        if path.is_socket():
            _refuse_taken(path)
            path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        old = os.umask(0o177)  # no chmod afterwards: another file may be there by then
        try:
            self._listener.bind(str(path))
        finally:
            os.umask(old)
        self._listener.listen(8)
        self._listener.setblocking(False)
        self._clients: dict[socket.socket, bytes] = {}

    def filenos(self) -> list[int]:
        """Descriptors to wait for."""
        return [self._listener.fileno(), *(client.fileno() for client in self._clients)]

    def serve(self) -> None:
        """Take new clients, carry out what has come."""
        with suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                self._clients[client] = b""
        for client in list(self._clients):
            self._serve_client(client)

    def close(self) -> None:
        """Close all connections and remove the path."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        self._listener.close()
        self._path.unlink(missing_ok=True)

    def _serve_client(self, client: socket.socket) -> None:
        try:
            data = client.recv(LINE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        lines = (self._clients[client] + data).split(b"\n")
        self._clients[client] = lines.pop()
        try:
            for line in lines:
                client.sendall(json.dumps(self._judge(line)).encode() + b"\n")
        except OSError:  # gone, or does not read its answers
            data = b""
        if not data or len(self._clients[client]) > LINE:
            del self._clients[client]
            client.close()

    def _judge(self, line: bytes) -> Order:
        try:
            try:
                order = json.loads(line)
            except ValueError:
                raise InvalidInput(NO_JSON) from None
            if not isinstance(order, dict):
                raise InvalidInput('an order is an object as {"fault": "drop", "bus": "main", "count": 3}')
            return self._answer(order)
        except KeyError as error:
            return {"ok": False, "error": str(error.args[0])}
        except ValueError as error:  # InvalidInput, a value out of bounds
            return {"ok": False, "error": str(error)}
