"""A connection to a front's socket that sends given bytes."""

import contextlib
import json
import socket
from typing import Any

from tests.support.loop_stand_in import StandIn
from twind.protocol import CONTROL, SERVICE, load

CONTRACT = load(CONTROL)


class Raw:
    """A connection that sends what it is told, byte for byte."""

    def __init__(self, loop: StandIn, name: str = "control", end: bytes = b"\0") -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(loop.directory / f"{name}.sock"))
        self.socket.settimeout(5.0)
        self.end = end
        self._buffer = b""

    def __enter__(self) -> "Raw":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, method: str, **keys: Any) -> None:
        interface = SERVICE if method in ("GetInfo", "GetInterfaceDescription") else CONTROL
        self.bytes(json.dumps({"method": f"{interface}.{method}", **keys}).encode() + self.end)

    def bytes(self, data: bytes) -> None:
        self.socket.sendall(data)

    def receive(self) -> Any:
        while self.end not in self._buffer:
            data = self.socket.recv(1 << 18)
            if not data:
                raise EOFError
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(self.end)
        return json.loads(message)

    def call(self, method: str, **parameters: Any) -> Any:
        self.send(method, parameters=parameters)
        return self.receive()

    def ended(self) -> bool:
        """The front hung up; what it said before is thrown away."""
        with contextlib.suppress(ConnectionResetError):
            while self.socket.recv(1 << 18):
                pass
        return True


def code(answer: dict[str, Any]) -> str:
    assert answer["error"] == f"{CONTROL}.Refused"
    return str(answer["parameters"]["findings"][0]["code"])
