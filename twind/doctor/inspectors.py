"""Access of the doctor to a running daemon. Reads only: nothing here writes to a device."""

import socket
import struct
from functools import cached_property
from pathlib import Path
from typing import Any

from twind.client import CallError, Client, ClientError
from twind.exceptions import OperationFailed
from twind.protocol.messages import JointMessage, StatusMessage

PATIENCE = 2.0  # s for one reply: a daemon in trouble must not block its diagnosis
SCAN_PATIENCE = 65.0  # s for one reply of an operator's connection: a scan of a slow bus
PEER = struct.Struct("3i")  # struct ucred: pid, uid, gid (unix(7))
Answer = dict[str, Any]


class DaemonInspector:
    """One daemon on one connection. Each property asks once; it may raise OperationFailed."""

    def __init__(self, client: Client) -> None:
        """`client`: connected to the observe or the control socket."""
        self.client = client
        self.path = client.path
        self._silent = ""  # reason why it is asked no more: one timeout is enough

    @cached_property
    def status(self) -> StatusMessage:
        """`Status` of the interface."""
        status: StatusMessage = self._both["status"]
        return status

    @cached_property
    def joints(self) -> list[JointMessage]:
        """`[]Joint` of the interface, in the order of the robot file."""
        joints: list[JointMessage] = self._both["joints"]
        return joints

    @cached_property
    def parameters(self) -> Answer:
        """Settings in force: mode, robot, individual, source (the file they came from), …"""
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
            raise OperationFailed(self._silent)
        try:
            for news in self.client.stream("Monitor", topics=["latency"], rate=10.0):
                return {str(hop["hop"]): hop for hop in news.get("latency") or ()}
        except ClientError as error:
            raise OperationFailed(f"the daemon does not answer Monitor: {error}") from error
        raise OperationFailed("the daemon ended Monitor without an answer")

    @property
    def is_live(self) -> bool:
        """True if it may write to the bus."""
        return bool(self.status["mode"] == "live")

    @cached_property
    def listener(self) -> int:
        """Pid of the listener: the daemon, or the service manager that passed the socket on."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.settimeout(PATIENCE)
                probe.connect(self.path)
            except OSError as error:
                raise OperationFailed(f"{self.path}: {error.strerror or error}") from error
            found = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER.size)
        return int(PEER.unpack(found)[0])

    def ask(self, method: str, **parameters: Any) -> Answer:
        """Call a reading method. Raises OperationFailed with the daemon's reply."""
        if self._silent:
            raise OperationFailed(self._silent)
        try:
            return self.client.call(method, **parameters)
        except CallError as error:
            raise OperationFailed(f"{method}: {error}") from error
        except ClientError as error:
            self._silent = f"the daemon does not answer {method}: {error}"
            raise OperationFailed(self._silent) from error

    def open_operator(self) -> Client:
        """Open a connection that may read registers. Raises OperationFailed: this user is no operator."""
        client = Client(Path(self.path).parent, timeout=SCAN_PATIENCE)
        try:
            client.connect()
        except ClientError as error:
            raise OperationFailed(f"registers are read by operators alone: {error}") from error
        return client

    def port_of(self, bus: str) -> str:
        """Return the port of a bus. Raises OperationFailed."""
        for each in self.status["buses"]:
            if each["name"] == bus:
                return str(each["port"])
        raise OperationFailed(f"the daemon has no bus {bus}: it runs with another robot file")

    @cached_property
    def _both(self) -> Answer:
        return self.ask("GetStatus", joints=True)


def scan_bus(client: Client, bus: str) -> dict[int, Answer]:
    """Scan a bus through the daemon: the devices that answer among those of its robot file, by id.

    Empty where all are silent. Raises OperationFailed: the bus failed, or the daemon does not answer.
    """
    try:
        return {int(found["id"]): dict(found) for found in client.stream("Scan", bus=bus)}
    except CallError as error:
        if error.name == "BusFailed" and error.parameters.get("silent"):
            return {}
        raise OperationFailed(f"bus {bus}: {error}") from error
    except ClientError as error:
        raise OperationFailed(f"the daemon does not answer Scan: {error}") from error
