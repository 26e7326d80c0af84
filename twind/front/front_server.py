"""Front server: accepts clients on both sockets, passes calls to the loop and its news to them.

Front process.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from typing import TYPE_CHECKING, Any

from twind.briefing import Briefing
from twind.front.accepted_trajectories import PendingVerdict
from twind.front.client_calls import Caller, ClientCall
from twind.front.client_session import ClientSession
from twind.front.daemon_log import DaemonLog
from twind.front.event_logger import EventLogger
from twind.front.flight_dumper import FlightDumper, RecorderHandover
from twind.front.loop_connection import LoopConnection
from twind.front.message_stream import MessageStream
from twind.front.monitor_subscribers import SubscriberRegistry
from twind.front.reload_queue import ReloadQueue
from twind.front.reserved_descriptors import PLACES, RESERVED, ReservedDescriptors
from twind.front.socket_acceptor import SocketAcceptor
from twind.front.state_cache import StateCache
from twind.front.streamer_report_cache import StreamerReportCache
from twind.front.ticket_table import TicketTable
from twind.front.trajectory_check_queue import TrajectoryCheckQueue
from twind.link import ConnectionClosed, Event, Outward, Overview, ReloadWanted, Reply, Tick, VerdictReport
from twind.protocol import CONTROL, SERVICE, load
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode

if TYPE_CHECKING:
    from twind.twin.trajectory_precheck import TrajectoryPrecheck

LIMITS = {"operator": 4 << 20, "observer": 64 << 10}  # bytes of one message
TEND = 0.25  # s between two rounds of housekeeping, and heartbeats


class FrontServer:
    """State of the front process. `ended` is set when the loop has gone."""

    CALLS_PER_SECOND = 20  # of one peer and kind: trajectories, marks

    def __init__(
        self,
        link: socket.socket,
        briefing: Briefing,
        log: DaemonLog,
        recorded: RecorderHandover | None = None,
    ) -> None:
        """Make the server; `recorded`: the flight recorder; None: there is none."""
        loop = asyncio.get_running_loop()
        self.loop = loop
        self.log = log
        self.ended = asyncio.Event()
        self.world = StateCache(briefing)
        self.interfaces = {name: load(name) for name in (SERVICE, CONTROL)}
        self.telemetry = SubscriberRegistry(self.world)
        self.link = LoopConnection(link, loop, self.handle_loop_message, self.ended.set)
        # Counting from the clock: a number that an earlier front gave out is never given out again.
        self._number = time.monotonic_ns()
        self.tickets = TicketTable(self.world.names, self._number)
        self.sessions: dict[int, ClientSession] = {}
        self.foreseen = TrajectoryCheckQueue(self)
        self.reloads = ReloadQueue(self)
        self.flights = FlightDumper(self, recorded)
        self.streams = StreamerReportCache(self.world, self.telemetry)
        self.submitted = PendingVerdict()
        self.listening = SocketAcceptor(loop, self.link, self._accept)
        self._spares = ReservedDescriptors(RESERVED)
        self._starved = False
        self._paced: dict[tuple[int, int, str], list[float]] = {}
        self._report = EventLogger(log)
        self._housekeep()

    def now(self) -> float:
        """Monotonic time, s: the same clock as the loop's."""
        return self.loop.time()

    # ----------------------------------------------------------------------------- clients

    def part(self) -> None:
        """Close every connection at once: the loop is gone, and pending files are written later."""
        for session in list(self.sessions.values()):
            session.stream.close()

    def _accept(self, listener: socket.socket, role: str) -> None:
        if self.link.is_closed:  # its end may not be read yet
            self.listening.close()
            return
        reserved = False
        try:
            sock, _ = listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return
        except OSError:  # out of descriptors or memory: one may still stop the robot
            if not self._make_room(listener):
                return
            try:
                sock, _ = listener.accept()
            except OSError:
                return
            reserved = True
        sock.setblocking(False)
        pid, uid, _gid = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        self._number += 1
        caller = Caller(self._number, role, uid, pid, reserved=reserved or not self._has_place(role))
        stream = MessageStream(sock, LIMITS[role], self.loop)
        session = self.sessions[caller.number] = ClientSession(self, caller, stream, self.now())
        stream.start(session)

    def _has_place(self, role: str) -> bool:
        """A place is free; else the oldest reserved connection makes room if it must."""
        taken = [s for s in self.sessions.values() if s.caller.role == role and not s.caller.reserved]
        if len(taken) < PLACES[role]:
            return True
        reserved = [s for s in self.sessions.values() if s.caller.role == role and s.caller.reserved]
        if len(reserved) >= RESERVED:
            reserved[0].stream.close()
        return False

    def _make_room(self, listener: socket.socket) -> bool:
        """Free one descriptor: a spare one, else the oldest connection that is for an e-stop only."""
        if not self._starved:
            self._starved = True
            self.log.write(
                "error", EventCode.DESCRIPTORS, self.now(), message="none left: new clients may only stop"
            )
        if self._spares.give():
            return True
        reserved = [session for session in self.sessions.values() if session.caller.reserved]
        if reserved:
            reserved[0].stream.close()
            return True
        self.listening.rest(listener)  # it stays readable: polling it further would only cost CPU
        return False

    def on_disconnect(self, session: ClientSession) -> None:
        """Report a closed connection to the loop if it had a command from it: its lease lapses."""
        number = session.caller.number
        if self.sessions.pop(number, None) is not None:
            self.telemetry.forget(number)
            self.streams.forget(number, self.now())
            if self.tickets.forget(number):
                self.link.owe(ConnectionClosed(client=number))

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

    # ----------------------------------------------------------------------------- the loop

    def adopt(self, briefing: Briefing, foresight: TrajectoryPrecheck | None) -> None:
        """The loop has put these values in force: from now on this side goes by them too.

        `foresight`: what judges paths by them; None: limits and gains are the same.
        """
        self.world.apply_briefing(briefing)
        self.log.level(briefing.log_level)
        if foresight is not None:
            self.foreseen.replace(foresight)

    def handle_loop_message(self, news: Outward) -> None:
        """Process a message of the loop."""
        if isinstance(news, Tick | Overview):
            self._state(news)
        elif isinstance(news, Reply):
            if not self.reloads.answer(news):
                self.tickets.answer(news, self.now())
        elif isinstance(news, Event):
            self.telemetry.event(news)
            self.flights.event(news)
            state = None if self.world.tick is None else self.world.tick.state
            buses = [joint.bus for joint in self.world.briefing.joints]
            self._report.event(news, self.world.names, buses, state)
        elif isinstance(news, ReloadWanted):
            self.reloads.ask(None)
        else:
            self.telemetry.verdict(news)
            followed = self.submitted.resolve(news)
            if followed is not None:
                self.telemetry.accepted(followed, news)

    def _state(self, news: Tick | Overview) -> None:
        known = self.world.is_known
        self.world.take(news)
        if not self.world.is_known:
            return
        if not known:
            self.listening.open()
            self.foreseen.load()
        if isinstance(news, Tick):
            self.telemetry.tick(news)
        else:
            self.telemetry.overview(news)
            self._report.overview(news, self.world.tick)

    # ----------------------------------------------------------------------------- housekeeping

    def _housekeep(self) -> None:
        now = self.now()
        self.loop.call_later(TEND, self._housekeep)
        self.link.heartbeat()
        self.foreseen.keep()
        self.reloads.check_timeout(now)
        self.flights.housekeep(now)
        self.streams.drop_silent(now)
        self._starved = not self._spares.refill()
        if self.world.is_known:
            self.listening.open()
            self.listening.check()
        for method in self.tickets.expire(now):
            self.log.write("error", EventCode.LOOP_SILENT, now, method=method)
        for session in list(self.sessions.values()):
            session.close_if_stalled(now)
        for peer in [peer for peer, recent in self._paced.items() if now - recent[-1] > 1.0]:
            del self._paced[peer]


def _place(error: BaseException) -> dict[str, Any]:
    """Return exception type and source line of an error."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    where = f"{place.tb_frame.f_code.co_name}:{place.tb_lineno}" if place is not None else None
    return {"message": f"{type(error).__name__}: {error}", "place": where}
