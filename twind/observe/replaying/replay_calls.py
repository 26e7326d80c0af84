"""Recorded commands as the calls that made them, and connections that many of them can be under way on."""

import json
import select
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from twind import link
from twind.client import NoDaemon
from twind.link import unpack_path
from twind.observe.replaying.replay_script import RecordedCommand

INTERFACE = "io.twind.Control"
INSIDE = (
    "kind",
    "ticket",
    "client",
    "uid",
    "holder",
    "received",
    "edited",
    "valid_until",
)  # no parameters of a call
Reply = tuple[dict[str, Any], str | None, bool]  # parameters, error without its prefix, more follow


def call(asked: RecordedCommand, names: Sequence[str]) -> tuple[str, dict[str, Any], bool]:
    """Method, parameters and `more` of a recorded command."""
    command = asked.command
    more = bool(getattr(command, "more", False))
    given: dict[str, Any]
    match command:
        case link.Submit():
            return asked.method, {"trajectory": _trajectory(command, asked.data, names)}, more
        case link.Setpoint() | link.LocateJoints():
            given = msgspec.to_builtins(command)
            given["joint_names"] = [names[joint] for joint in given.pop("joints")]
            if isinstance(command, link.Setpoint) and command.received is not None:
                given["valid_for"] = command.remaining(command.received)
        case link.FindStop():
            given = msgspec.to_builtins(command) | {"joint": names[command.joint]}
        case link.Arm():
            given = msgspec.to_builtins(command)
            given["joints"] = None if command.joints is None else [names[joint] for joint in command.joints]
        case link.Mark():
            given = msgspec.to_builtins(command.annotation)
        case _:
            given = msgspec.to_builtins(command)
    kept = {key: value for key, value in given.items() if key not in (*INSIDE, "more") and value is not None}
    if isinstance(command, link.Mark):
        kept["kind"] = command.annotation.kind
    return asked.method, kept, more


def _trajectory(command: link.Submit, data: bytes, names: Sequence[str]) -> dict[str, object]:
    path = unpack_path(data, command, len(names))
    joints = list(command.commanded)
    columns = {"positions": path.position, "velocities": path.velocity, "accelerations": path.acceleration}
    points = [
        {key: rows[point, joints].tolist() for key, rows in columns.items() if rows is not None}
        | {"time_from_start": float(path.time[point])}
        for point in range(command.points)
    ]
    tolerances = [
        {"joint": names[joint], "path": path, "goal": goal} for joint, path, goal in command.tolerances
    ]
    made = {
        "joint_names": [names[joint] for joint in joints],
        "points": points,
        "start_in": command.start_in or None,
        "goal_time": command.goal_time,
        "tolerances": [
            {key: value for key, value in each.items() if value is not None} for each in tolerances
        ],
        "policy": command.policy,
        "append_stop": command.append_stop or None,
    }
    return {key: value for key, value in made.items() if value not in (None, [])}


class ReplayConnection:
    """One connection. Calls leave at once, whatever is under way; answers come in the order of the calls."""

    def __init__(self, path: Path) -> None:
        """Raises NoDaemon."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise NoDaemon(f"{path}: {error.strerror}") from None
        self._takers: deque[Callable[[Reply], None]] = deque()
        self._buffer = b""
        self.open = True

    def fileno(self) -> int:
        """To wait for."""
        return self._socket.fileno()

    def send(
        self,
        method: str,
        parameters: Mapping[str, object],
        take: Callable[[Reply], None],
        *,
        more: bool = False,
    ) -> None:
        """Call; `take` is called with every reply."""
        message = {"method": f"{INTERFACE}.{method}", "parameters": parameters} | (
            {"more": True} if more else {}
        )
        self._takers.append(take)
        with suppress(OSError):  # it hung up: the call stays unanswered, and that is compared
            self._socket.sendall(json.dumps(message).encode() + b"\0")

    def deliver_replies(self) -> None:
        """Hand on the replies that have come."""
        try:
            data = self._socket.recv(1 << 18)
        except OSError:
            data = b""
        self.open = bool(data)
        *whole, self._buffer = (self._buffer + data).split(b"\0")
        for text in whole:
            message = json.loads(text)
            error = message.get("error")
            goes_on = bool(message.get("continues"))
            taker = self._takers[0] if goes_on else self._takers.popleft()
            name = None if error is None else str(error).rpartition(".")[2]
            taker((message.get("parameters") or {}, name, goes_on))

    def close(self) -> None:
        """Hang up."""
        self.open = False
        self._socket.close()


def wait(lines: Sequence[ReplayConnection], seconds: float) -> None:
    """Wait at most that long for received data of one of the connections, and process it."""
    alive = [line for line in lines if line.open]
    ready, _, _ = select.select(alive, [], [], max(0.0, seconds))
    for line in ready:
        line.deliver_replies()
