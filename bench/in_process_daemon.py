"""A whole daemon in this process under a fake clock: real loop, driver and bytes, virtual servos.

Only the front is missing: its end of the link is in our hands, over a real socket pair, so that encoding and
sending the news is paid for. Built from the pieces of `twind` and `twind-virtual`, as those build themselves.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil

import numpy as np

from twind import link, sealed_memfd
from twind.config.robot_file import load_robot
from twind.loop.bus.bus_opener import BusOpener
from twind.loop.ipc.front_link import FrontLink
from twind.loop.process.service_notify import Notifier
from twind.loop.tick import assembly
from twind.loop.tick.bound_robot import BoundRobot
from twind.loop.tick.control_loop import Loop
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.safety.gate import GateThresholds
from twind.twin.binding import bind
from twind.virtual.virtual_robot_spec import buses, calibration, make_spec
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.serial_loopback import Loopback

BEGIN = 100.0  # s, the fake clock at the start
CHUNK = 0.1  # s between two looks at the news: the pipe takes more than that
CLIENT = 7


class InProcessFront:
    """In place of the front's process: a socket pair whose outer end is ours. Never ends, never overdue."""

    def __init__(self) -> None:
        self.socket: socket.socket | None
        self.socket, self.outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.setblocking(False)
        self.outer.setblocking(False)

    def alive(self, now: float) -> None:
        """Nobody watches."""

    def overdue(self, now: float) -> bool:
        """Never."""
        return False

    def reap(self) -> bool:
        """Nothing to bury."""
        return False

    def due(self, now: float) -> bool:
        """Never."""
        return False

    def finish(self) -> None:
        """Nothing is owed."""
        self.end(0.0)

    def end(self, now: float) -> None:
        """Close both ends."""
        if self.socket is not None:
            self.socket.close()
            self.outer.close()
        self.socket = None


class InProcessDaemon:
    """The loop, its clock, and the calls of one client."""

    def __init__(self, loop: Loop, clock: FakeClock, front: InProcessFront) -> None:
        self.loop = loop
        self.clock = clock
        self._front = front
        self._ticket = 0
        self._replies: dict[int, link.Reply] = {}  # the last to each ticket

    def run(self, seconds: float) -> None:
        """Let time pass; news are taken off the pipe as a front would, and only replies looked at."""
        period = self.loop.robot.period
        for _ in range(round(seconds / CHUNK)):
            self.loop.run(until=self.clock.now() + CHUNK - 0.5 * period)
            self.clock.sleep_until(self._next())
            self._take_news()

    def _next(self) -> float:
        """Start of the next tick, on the grid of the first, s."""
        period = self.loop.robot.period
        return BEGIN + ceil((self.clock.now() - BEGIN) / period - 1e-6) * period

    def _take_news(self) -> None:
        with suppress(BlockingIOError):
            while True:
                data = self._front.outer.recv(link.DATAGRAM)
                if len(data) < 1000:  # a tick is larger, and there are a hundred a second
                    news = link.decode_news(data)
                    if isinstance(news, link.Reply):
                        self._replies[news.ticket] = news

    def send(self, kind: type[link.Command], **parameters: object) -> int:
        """A call; its ticket."""
        self._ticket += 1
        self._front.outer.send(link.encode(self._command(kind, parameters)))
        return self._ticket

    def call(self, kind: type[link.Command], **parameters: object) -> None:
        """A call that must succeed within 10 s of the robot's time. Raises RuntimeError."""
        ticket = self.send(kind, **parameters)
        for _ in range(100):
            self.run(CHUNK)
            if ticket in self._replies:
                break
        self.demand(ticket)

    def submit(self, path: Trajectory) -> int:
        """Submit a path of all joints, followed; its ticket."""
        self._ticket += 1
        parameters: dict[str, object] = {
            "id": f"t{self._ticket}",
            "points": len(path.time),
            "commanded": np.flatnonzero(path.commanded).tolist(),
            "velocity": path.velocity is not None,
            "acceleration": path.acceleration is not None,
            "more": True,
        }
        fd = sealed_memfd.seal("path", link.pack_path(path))
        try:
            data = link.encode(self._command(link.Submit, parameters))
            socket.send_fds(self._front.outer, [data], [fd])
        finally:
            os.close(fd)
        return self._ticket

    def demand(self, ticket: int, **expected: object) -> None:
        """The last reply to a ticket was no error and says what is expected. Raises RuntimeError."""
        reply = self._replies.get(ticket)
        if reply is None or reply.error is not None or not expected.items() <= reply.parameters.items():
            raise RuntimeError(f"call {ticket}: expected {expected}, got {reply}")

    def _command(self, kind: type[link.Command], parameters: dict[str, object]) -> link.Inward:
        who = {"ticket": self._ticket, "client": CLIENT, "uid": 0, "holder": "bench"}
        return kind(**who, **parameters)  # type: ignore[arg-type, return-value]


@contextmanager
def indoors(*, physics: bool) -> Iterator[InProcessDaemon]:
    """`h24` in mode live, armed, holding; MuJoCo muscles with `physics`, else first-order ones."""
    clock = FakeClock(BEGIN)
    robot = load_robot("h24")
    made = make_spec(robot)
    virtual = buses(made, physics=physics, now=clock.now())
    measured = calibration(made)
    one = BoundRobot(robot, measured, bind(robot, measured))
    opened = BusOpener(robot, one.binding.joint_map, {}, robot.rate_hz)
    front = InProcessFront()
    loop = assembly.build(
        one,
        mode=Mode.LIVE,
        rate_hz=robot.rate_hz,
        clock=clock,
        where={bus.name: f"virtual:{bus.name}" for bus in robot.buses},
        opener=lambda name: opened.reader(name, Loopback(virtual[name], clock)),
        enabler=opened.enable,
        link=FrontLink(front),  # type: ignore[arg-type]
        notifier=Notifier({}),
        thresholds=GateThresholds(),
        realtime={},
    )
    try:
        whole = InProcessDaemon(loop, clock, front)
        whole.run(3.0)
        whole.call(link.AcquireLease)
        whole.call(link.Arm)
        yield whole
    finally:
        loop.close()
