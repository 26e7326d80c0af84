"""Session of one client: bytes to calls, rights, limits.

Front process. A failure here ends only this session.
"""

from __future__ import annotations

from typing import Any

from twind.exceptions import InvalidInput
from twind.front.client_calls import STARTS, Caller, ClientCall, ConnectionCalls
from twind.front.front_server import FrontServer
from twind.front.interface_methods import METHODS, OBSERVER, refuse_overlong, service
from twind.front.message_stream import MessageStream
from twind.front.overlong_trajectory import overlong
from twind.protocol import CONTROL, SERVICE
from twind.protocol.strict_json import loads
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode

HANDSHAKE = 5.0  # s in which the first call must come; a reserved place is for that long only
STRIKES = 10  # messages that are no calls before the connection is closed
_KEYS = frozenset({"method", "parameters", "more", "oneway", "upgrade"})


class ClientSession:
    """A connection and its calls in their order."""

    def __init__(self, front: FrontServer, caller: Caller, stream: MessageStream, now: float) -> None:
        self.front = front
        self.caller = caller
        self.stream = stream
        self.calls = ConnectionCalls(caller, stream.send, self._begin)
        self._received_call = False
        self._deadline = now + HANDSHAKE
        self._strikes = self._too_fast = 0
        self._paused = self._done = False
        self._reported_refusals: set[str] = set()  # methods whose refusal for the role has been reported

    # --------------------------------------------------------------------------- events of the stream

    def message(self, data: bytes) -> bool:
        """One message: refused, or a call."""
        try:
            self._add_call(data)
        except Exception as error:  # noqa: BLE001  see `_begin`
            self._broke("", error)
        self._paused = self.calls.full
        return not self._paused

    def _add_call(self, data: bytes) -> None:
        try:
            message, path = overlong(data) or (loads(data), None)
        except InvalidInput as error:
            self._strike(ReasonCode.BAD_JSON, str(error))
            return
        try:
            call = self._call(message)
        except InvalidInput as error:
            self._strike(ReasonCode.BAD_SCHEMA, str(error))
            return
        call.overlong = path
        call.stops = self.front.foreseen.stops
        self._received_call = True
        self.calls.add(call)

    def too_large(self, limit: int) -> None:
        """Refuse and hang up: where the next message begins is unknown."""
        finding = Finding(ReasonCode.FRAME_TOO_LARGE, bound=limit, message="bytes in one message")
        self._answer_outside([finding])
        self.stream.finish()

    def ended(self) -> None:
        """The connection is closed."""
        self.calls.clear()
        self.front.on_disconnect(self)

    def close_if_stalled(self, now: float) -> None:
        """Close what hangs: a slow reader, a silent newcomer, a peer that went after its last word."""
        if self.stream.stuck(now):
            self.front.log.write(
                "warning", EventCode.SLOW_READER, now, holder=self.caller.holder, role=self.caller.role
            )
            self.stream.close()
            return
        idle = not self.calls
        too_late = now > self._deadline and idle and (self.caller.reserved or not self._received_call)
        if too_late or (self.stream.half_closed and (idle or self.stream.peer_gone())):
            if idle:
                self._refuse_unfinished()
            self.stream.finish()

    def paced(self, *, in_time: bool) -> None:
        """Return True if a call of limited rate came in time; a client that never waits is disconnected."""
        self._too_fast = 0 if in_time else self._too_fast + 1
        self._done = self._too_fast >= STRIKES

    # --------------------------------------------------------------------------- calls

    def _call(self, message: Any) -> ClientCall:
        """A message as a call. Raises InvalidInput."""
        if type(message) is not dict or type(message.get("method")) is not str:
            raise InvalidInput(
                'a call is {"method": "interface.Method", "parameters": {...}}', where="method"
            )
        unknown = message.keys() - _KEYS
        if unknown:
            raise InvalidInput(
                f"unknown key of a call; known: {', '.join(sorted(_KEYS))}", where=sorted(unknown)[0]
            )
        for key in ("more", "oneway", "upgrade"):
            if type(message.get(key, False)) is not bool and message[key] is not None:
                raise InvalidInput("expected true or false", where=key)
        parameters = message.get("parameters")
        parameters = {} if parameters is None else parameters
        if type(parameters) is not dict:
            raise InvalidInput("expected an object", where="parameters")
        more = bool(message.get("more"))
        oneway = bool(message.get("oneway"))
        if message.get("upgrade") or (more and oneway):
            raise InvalidInput("not served here", where="upgrade" if message.get("upgrade") else "oneway")
        interface, _, method = message["method"].rpartition(".")
        return ClientCall(self.calls, interface, method, parameters, more=more, oneway=oneway)

    def _begin(self, call: ClientCall) -> None:
        """Execute a call. A failure ends this connection only."""
        if self._done:  # read before that was known
            call.finished = True
            return
        call.began = self.front.now()
        try:
            if self._allowed(call):
                (METHODS[call.method] if call.interface == CONTROL else service)(self.front, call)
        except InvalidInput as error:
            call.invalid(error.where or "parameters", error.reason)
        except (OSError, MemoryError) as error:
            call.error("Busy", {"what": f"out of descriptors or memory: {error}"})
        except Exception as error:  # noqa: BLE001  one client's call must not end the front of all
            self._broke(call.method, error)
        if self._done:
            self.stream.finish()
        if self._paused and not self.calls.full:
            self._paused = False
            self.front.loop.call_soon(self.stream.resume)

    def _broke(self, method: str, error: Exception) -> None:
        self.front.broken(self.caller, method, error)
        self.stream.close()

    def _allowed(self, call: ClientCall) -> bool:
        """The method exists, its parameters fit, and this caller may call it. Raises InvalidInput."""
        interface = self.front.interfaces.get(call.interface)
        if interface is None and call.interface:
            call.error("InterfaceNotFound", {"interface": call.interface}, SERVICE)
            return False
        method = interface.methods.get(call.method) if interface else None
        if method is None:
            name = f"{call.interface}.{call.method}".lstrip(".")
            call.error("MethodNotFound", {"method": name}, SERVICE)
            return False
        if call.interface == CONTROL and call.method not in OBSERVER and self.caller.role != "operator":
            call.error("NotAllowed", {"role": self.caller.role, "method": call.method})
            if call.method not in self._reported_refusals:  # once: no client can flood the log
                self._reported_refusals.add(call.method)
                self.front.not_allowed(call)
            return False
        if self.caller.reserved and call.method != "EStop":
            call.error(
                "Busy", {"what": f"all places for an {self.caller.role} are taken; this one takes EStop only"}
            )
            return False
        if call.overlong is not None:
            refuse_overlong(self.front, call, call.overlong)
            return False
        method.parameters.check(call.parameters, "")
        if call.method in STARTS and call.stops != self.front.foreseen.stops:
            reason = "the robot was stopped before its turn came: send it again"
            self.front.refuse(call, [Finding(ReasonCode.BUSY, message=reason)])
            return False
        return True

    # --------------------------------------------------------------------------- what is no call

    def _strike(self, code: ReasonCode, reason: str) -> None:
        self._strikes += 1
        self._answer_outside([Finding(code, message=reason)])
        if self._strikes >= STRIKES:
            self.stream.finish()

    def _refuse_unfinished(self) -> None:
        """Answer a message without its terminator."""
        received = self.stream.drop_unfinished()
        if received:
            reason = f"{received} bytes without a terminator: end each message with NUL or a newline"
            self._answer_outside([Finding(ReasonCode.FRAME_INCOMPLETE, value=received, message=reason)])

    def _answer_outside(self, findings: list[Finding]) -> None:
        """Refuse something that is no call, in its turn."""
        call = ClientCall(self.calls, CONTROL, "", {}, more=False, oneway=False)
        call.started = True
        self.calls.queue(call)
        self.front.refuse(call, findings)
        self.calls.advance()
