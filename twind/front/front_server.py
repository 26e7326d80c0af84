"""Front server: accepts clients on both sockets, passes calls to the loop and its news to them.

Front process.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING

from twind.briefing import Briefing
from twind.front.accepted_trajectories import PendingVerdict
from twind.front.client_calls import Caller
from twind.front.daemon_log import DaemonLog
from twind.front.event_logger import EventLogger
from twind.front.flight_dumper import FlightDumper, RecorderHandover
from twind.front.front_core import FrontCore, FrontSession
from twind.front.gap_monitor import GapMonitor
from twind.front.message_stream import MessageStream
from twind.front.reload_queue import ReloadQueue
from twind.front.reserved_descriptors import PLACES, RESERVED, ReservedDescriptors
from twind.front.socket_acceptor import SocketAcceptor
from twind.front.streamer_report_cache import StreamerReportCache
from twind.front.trajectory_check_queue import TrajectoryCheckQueue
from twind.link import ConnectionClosed, Event, Outward, Overview, ReloadWanted, Reply, Tick
from twind.protocol import CONTROL, SERVICE, load
from twind.robot.event_codes import EventCode

if TYPE_CHECKING:
    from twind.twin.trajectory_precheck import TrajectoryPrecheck

LIMITS = {"operator": 4 << 20, "observer": 64 << 10}  # bytes of one message
TEND = 0.25  # s between two rounds of housekeeping, and heartbeats

MakeSession = Callable[["FrontServer", Caller, MessageStream, float], FrontSession]


class FrontServer(FrontCore):
    """The front process: its clients, its queues, and the messages of the loop."""

    def __init__(
        self,
        link: socket.socket,
        briefing: Briefing,
        log: DaemonLog,
        make_session: MakeSession,
        recorded: RecorderHandover | None = None,
    ) -> None:
        """Make the server; `recorded`: the flight recorder; None: there is none."""
        super().__init__(link, briefing, log, self.handle_loop_message)
        self._make_session = make_session
        self.interfaces = {name: load(name) for name in (SERVICE, CONTROL)}
        self.foreseen = TrajectoryCheckQueue(self)
        self.reloads = ReloadQueue(self, self.adopt)
        self.flights = FlightDumper(self, recorded)
        self.streams = StreamerReportCache(self.world, self.telemetry)
        self.gap = GapMonitor(self)
        self.submitted = PendingVerdict()
        self.listening = SocketAcceptor(self.loop, self.link, self._accept)
        self._spares = ReservedDescriptors(RESERVED)
        self._starved = False
        self._report = EventLogger(log)
        self._housekeep()

    # ----------------------------------------------------------------------------- clients

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
        session = self.sessions[caller.number] = self._make_session(self, caller, stream, self.now())
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

    def on_disconnect(self, session: FrontSession) -> None:
        """Report a closed connection to the loop if it had a command from it: its lease lapses."""
        number = session.caller.number
        if self.sessions.pop(number, None) is not None:
            self.telemetry.forget(number)
            self.streams.forget(number, self.now())
            if self.tickets.forget(number):
                self.link.owe(ConnectionClosed(client=number))

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
            self.gap.tick(news)
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
        if self.world.is_known:
            self.reloads.put_back_gains(now)
        self.flights.housekeep(now)
        self.streams.drop_silent(now)
        self.gap.housekeep(now)
        self._starved = not self._spares.refill()
        if self.world.is_known:
            self.listening.open()
            self.listening.check()
        for method in self.tickets.expire(now):
            self.log.write("error", EventCode.LOOP_SILENT, now, method=method)
        for session in list(self.sessions.values()):
            session.close_if_stalled(now)
        self._drop_old_rates(now)
