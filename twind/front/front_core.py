"""State and replies that all parts of the front process use: clock, log, link to the loop, sessions.

Front process. Imports none of the queues, which all hold a `FrontCore`.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from twind.briefing import Briefing
from twind.front.client_calls import Caller, ClientCall
from twind.front.daemon_log import DaemonLog
from twind.front.loop_connection import LoopConnection
from twind.front.message_stream import MessageStream, StreamOwner
from twind.front.monitor_subscribers import SubscriberRegistry
from twind.front.state_cache import StateCache
from twind.front.ticket_table import TicketTable
from twind.link import Outward, VerdictReport
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode


class FrontSession(StreamOwner, Protocol):
    """One client of the front process."""

    caller: Caller
    stream: MessageStream

    def paced(self, *, in_time: bool) -> None:
        """Record whether a call came at a permitted rate."""

    def close_if_stalled(self, now: float) -> None:
        """Close a connection that hangs."""


class FrontCore:
    """State of the front process. `ended` is set when the loop has gone."""

    CALLS_PER_SECOND = 20  # of one peer and kind: trajectories, marks

    def __init__(
        self, link: socket.socket, briefing: Briefing, log: DaemonLog, take: Callable[[Outward], None]
    ) -> None:
        """Make the state; `take` gets each message of the loop."""
        self.loop = asyncio.get_running_loop()
        self.log = log
        self.ended = asyncio.Event()
        self.world = StateCache(briefing)
        self.telemetry = SubscriberRegistry(self.world)
        self.link = LoopConnection(link, self.loop, take, self.ended.set)
        # Counting from the clock: a number that an earlier front gave out is never given out again.
        self._number = time.monotonic_ns()
        self.tickets = TicketTable(self.world.names, self._number)
        self.sessions: dict[int, FrontSession] = {}
        self._paced: dict[tuple[int, int, str], list[float]] = {}

    def now(self) -> float:
        """Monotonic time, s: the same clock as the loop's."""
        return self.loop.time()

    def part(self) -> None:
        """Close every connection at once: the loop is gone, and pending files are written later."""
        for session in list(self.sessions.values()):
            session.stream.close()

    def watch(self, call: ClientCall, topics: list[str], rate: float | None) -> None:
        """Begin a Monitor call."""
        session = self.sessions.get(call.caller.number)
        if session is not None:
            self.telemetry.watch(call, session.stream, topics, rate)

    def in_time(self, call: ClientCall, kind: str, remedy: str) -> bool:
        """RATE_LIMIT: at most so many calls of a kind per second of one peer; one too many is refused."""
        caller = call.caller
        now = self.now()
        recent = self._paced.setdefault((caller.uid, caller.pid, kind), [])
        recent[:] = [at for at in recent if now - at < 1.0]
        in_time = len(recent) < self.CALLS_PER_SECOND
        if in_time:
            recent.append(now)
        session = self.sessions.get(caller.number)
        if session is not None:
            session.paced(in_time=in_time)
        if not in_time:
            reason = f"{kind} per second of one peer; {remedy}"
            self.refuse(call, [Finding(ReasonCode.RATE_LIMIT, bound=self.CALLS_PER_SECOND, message=reason)])
        return in_time

    def refuse(self, call: ClientCall, findings: list[Finding]) -> None:
        """Answer with the error `Refused`, readable; report it to the log and to subscribers of verdicts."""
        call.refuse(self.report_refusal(call, findings)["refusals"])

    def not_allowed(self, call: ClientCall) -> None:
        """Report AUTH_ROLE to the log and to subscribers; the caller gets the error `NotAllowed`."""
        reason = f"{call.method} is not for an {call.caller.role}: control.sock takes it"
        self.report_refusal(call, [Finding(ReasonCode.AUTH_ROLE, message=reason)])

    def report_refusal(self, call: ClientCall, findings: list[Finding]) -> dict[str, list[dict[str, Any]]]:
        """Report the front's own refusal to the log and to subscribers; return it as a verdict.

        Its sequence is 0: the loop counts only its own.
        """
        named = self.world.names.findings(findings)
        verdict: dict[str, list[dict[str, Any]]] = {"refusals": named, "warnings": [], "changes": []}
        now = self.now()
        self.telemetry.verdict(VerdictReport(time=now, sequence=0, id="", verdict=verdict))
        first = named[0]
        fields = {"message": first["message"], "more": len(named) - 1 or None, "holder": call.caller.holder}
        self.log.write("warning", first["code"], now, **fields)
        return verdict

    def broken(self, caller: Caller, method: str, error: Exception) -> None:
        """Log a failed call, a defect of the front, with its place."""
        fields = {**_place(error), "method": method, "holder": caller.holder}
        self.log.write("error", EventCode.CALL_BROKE, self.now(), **fields)

    def unexpected(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Log a failure outside any call here, since the log of asyncio may block."""
        error = context.get("exception")
        fields = _place(error) if error is not None else {"message": str(context.get("message"))}
        self.log.write("error", EventCode.FRONT_BROKE, self.now(), **fields)

    def _drop_old_rates(self, now: float) -> None:
        for peer in [peer for peer, recent in self._paced.items() if now - recent[-1] > 1.0]:
            del self._paced[peer]


def _place(error: BaseException) -> dict[str, Any]:
    """Return exception type and source line of an error."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    where = f"{place.tb_frame.f_code.co_name}:{place.tb_lineno}" if place is not None else None
    return {"message": f"{type(error).__name__}: {error}", "place": where}
