"""Calls of one client connection, in their order. Front process.

Answers leave in call order and a call begins when the one before it has ended. The exceptions are the
stopping methods: they begin at once, behind no other call, and only their answers wait.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan
from typing import Any

from twind.front.overlong_trajectory import OverlongTrajectory
from twind.front.state_cache import encode
from twind.protocol import CONTROL, SERVICE

STOPS = frozenset({"EStop", "Cancel", "Disarm"})  # never queued, never refused for a full pipe
STARTS = frozenset({"Arm", "FindStop", "Reset", "Setpoint", "SubmitTrajectory"})  # that a stop precedes
PENDING = 64  # calls that may wait on one connection before it is read no further


@dataclass(frozen=True, slots=True)
class Caller:
    """Identity of a caller: a connection and the process that opened it (SO_PEERCRED, fixed at connect)."""

    number: int  # of the connection, never used again
    role: str  # operator or observer, by the socket it came in at
    uid: int
    pid: int  # for people and for counting; a right never hangs on it
    reserved: bool = False  # came when all places were taken: may stop the robot, and nothing else

    @property
    def holder(self) -> str:
        """Name of the caller as other clients see it."""
        return f"uid {self.uid}, pid {self.pid}"


class ClientCall:
    """One call. `method` is without its interface."""

    def __init__(
        self,
        queue: "ConnectionCalls",
        interface: str,
        method: str,
        parameters: dict[str, Any],
        *,
        more: bool,
        oneway: bool,
    ) -> None:
        self._queue = queue
        self.caller = queue.caller
        self.interface = interface
        self.method = method
        self.parameters = parameters
        self.more = more
        self.oneway = oneway
        self.started = self.finished = False
        self.overlong: OverlongTrajectory | None = None  # what it has in place of parameters
        self.stops = 0  # of the robot, that clients had requested when it was received
        self.began = nan  # s, when it was whole and its turn had come
        self.output: list[bytes] = []  # while it is not this call's turn

    def reply(self, parameters: bytes, *, continues: bool = False) -> None:
        """Answer with encoded parameters."""
        tail = b',"continues":true}' if continues and self.more else b"}"
        self._put(b'{"parameters":' + parameters + tail, last=not (continues and self.more))

    def error(self, name: str, parameters: Mapping[str, object], interface: str = CONTROL) -> None:
        """Answer with an error; it is the last answer."""
        self._put(encode({"error": f"{interface}.{name}", "parameters": parameters}), last=True)

    def refuse(self, findings: list[dict[str, object]]) -> None:
        """The error `Refused`."""
        self.error("Refused", {"findings": findings})

    def invalid(self, parameter: str, reason: str) -> None:
        """Answer with `org.varlink.service.InvalidParameter`, with the reason beside the name."""
        self.error("InvalidParameter", {"parameter": parameter, "message": reason}, SERVICE)

    def _put(self, data: bytes, *, last: bool) -> None:
        if self.finished:
            return  # answered already: it took too long, or its connection is gone
        self.finished = last
        self._queue.put(self, data)


class ConnectionCalls:
    """The calls of one connection. `send` takes answers, `start` begins a call."""

    def __init__(
        self, caller: Caller, send: Callable[[bytes], None], start: Callable[[ClientCall], None]
    ) -> None:
        self.caller = caller
        self._send = send
        self._start = start
        self._line: deque[ClientCall] = deque()
        self._moving = False

    def __len__(self) -> int:
        return len(self._line)

    @property
    def full(self) -> bool:
        """True when no more calls should be read for now."""
        return len(self._line) >= PENDING

    def add(self, call: ClientCall) -> None:
        """Add a call that was received."""
        if call.oneway:
            call.started = True
            self._start(call)
            return
        self._line.append(call)
        if call.method in STOPS:
            call.started = True
            self._start(call)
        self.advance()

    def queue(self, call: ClientCall) -> None:
        """Queue a message that is no call, so that its answer leaves in turn."""
        self._line.append(call)

    def put(self, call: ClientCall, data: bytes) -> None:
        """Send an answer if it is the call's turn, else keep it."""
        if call.oneway:
            return
        if self._line and self._line[0] is call:
            self._send(data)
            self.advance()
        else:
            call.output.append(data)

    def advance(self) -> None:
        """End what is finished, begin what is next."""
        if self._moving:
            return
        self._moving = True
        try:
            while self._line:
                head = self._line[0]
                for data in head.output:
                    self._send(data)
                head.output.clear()
                if not head.started:
                    head.started = True
                    self._start(head)
                if not head.finished:
                    return
                if self._line and self._line[0] is head:  # else `clear` came from within
                    self._line.popleft()
        finally:
            self._moving = False

    def clear(self) -> None:
        """Drop all calls after the connection is gone: no answers are sent any more."""
        for call in self._line:
            call.finished = True
        self._line.clear()
