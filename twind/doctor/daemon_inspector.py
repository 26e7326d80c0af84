"""The running daemon, asked over its socket: reading methods alone, each answer once. Never commands."""

import socket
import struct
from functools import cached_property
from typing import Any

from twind.client import CallError, Client, ClientError
from twind.doctor.check import CheckUnavailable

PATIENCE = 2.0  # s for one answer: a daemon in trouble must not hang who looks for it
PEER = struct.Struct("3i")  # struct ucred: pid, uid, gid (unix(7))
Answer = dict[str, Any]


class DaemonInspector:
    """One daemon by one connection. Every property may raise CannotLook: it went away, or serves it not."""

    def __init__(self, client: Client) -> None:
        """`client`: of the observe or the control socket; connected already."""
        self.client = client
        self.path = client.path
        self._silent = ""  # why nothing more is asked: who waited once need not wait for every question

    @cached_property
    def status(self) -> Answer:
        """`Status` of the interface."""
        status: Answer = self._both["status"]
        return status

    @cached_property
    def joints(self) -> list[Answer]:
        """`[]Joint` of the interface, in the order of the robot file."""
        joints: list[Answer] = self._both["joints"]
        return joints

    @cached_property
    def parameters(self) -> Answer:
        """The settings in force: mode, robot, individual, source (the file they came from), …"""
        parameters: Answer = self.ask("GetParameters")["parameters"]
        return parameters

    @cached_property
    def robot(self) -> Answer:
        """`robot` (the file as checked: path, text_sha256, joints, …), `calibration` or None, `mjcf`."""
        return self.ask("GetRobot")

    @cached_property
    def latency(self) -> dict[str, Answer]:
        """`Latency` of the interface by hop: request, reply, state, twin, …"""
        if self._silent:
            raise CheckUnavailable(self._silent)
        try:
            for news in self.client.stream("Monitor", topics=["latency"], rate=10.0):
                return {str(hop["hop"]): hop for hop in news.get("latency") or ()}
        except ClientError as error:
            raise CheckUnavailable(f"the daemon does not answer Monitor: {error}") from error
        raise CheckUnavailable("the daemon ended Monitor without an answer")

    @property
    def is_live(self) -> bool:
        """May it write to the bus? Reading registers needs no live mode."""
        return bool(self.status["mode"] == "live")

    @cached_property
    def listener(self) -> int:
        """Pid of who listens on the socket: the daemon, or the service manager that handed it the socket."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
            try:
                asking.settimeout(PATIENCE)
                asking.connect(self.path)
            except OSError as error:
                raise CheckUnavailable(f"{self.path}: {error.strerror or error}") from error
            found = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER.size)
        return int(PEER.unpack(found)[0])

    def register(self, bus: str, id: int, name: str) -> int:
        """A register as the daemon reads it now, counts. Raises CannotLook: silent, unknown, no right to."""
        return int(self.ask("ReadRegister", bus=bus, id=id, name=name)["register"]["value"])

    def ask(self, method: str, **parameters: Any) -> Answer:
        """Call a reading method. Raises CannotLook with what the daemon said."""
        if self._silent:
            raise CheckUnavailable(self._silent)
        try:
            return self.client.call(method, **parameters)
        except CallError as error:
            raise CheckUnavailable(f"{method}: {error}") from error
        except ClientError as error:
            self._silent = f"the daemon does not answer {method}: {error}"
            raise CheckUnavailable(self._silent) from error

    @cached_property
    def _both(self) -> Answer:
        return self.ask("GetStatus", joints=True)
