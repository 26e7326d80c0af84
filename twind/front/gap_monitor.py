"""Live gap, the front's side: samples to a process of low priority, its figures into the status.

Front process. A pipe that is full drops samples; neither loop nor clients wait for it.
"""

from __future__ import annotations

import asyncio
import math
import os
import socket
import struct
import subprocess
import sys
import threading
from typing import Any

import msgspec

from twind import link
from twind.front.front_core import FrontCore
from twind.robot.event_codes import EventCode
from twind.robot.modes import Mode
from twind.sealed_memfd import seal

SETTLED = 10.0  # s of torque before the start: no figure comes sooner, and a short run costs nothing
AGAIN = 60.0  # s until a process that ended is started again
STALE = 5.0  # s without a report: its figures are not shown any more
LARGEST = 1 << 17  # bytes of a report


class GapMonitor:
    """Process of the gap and its socket. None of it in other modes than live, or if `gap` is off.

    Nor with compensation of gravity: the goals of a tick are without the offset that the servos get.
    """

    def __init__(self, front: FrontCore) -> None:
        self._front = front
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._armed_since = math.inf  # s
        self._next = 0.0  # s, earliest time of a start
        self._reported = 0.0  # s, of the last report
        self._reported_stop = False

    def tick(self, tick: link.Tick) -> None:
        """Pass a tick on, if its goals went to the robot."""
        if tick.mode != Mode.LIVE or not tick.armed:
            self._armed_since = math.inf
            return
        self._armed_since = min(self._armed_since, tick.time)
        if self._socket is None:
            if tick.time - self._armed_since > SETTLED:
                self._start()
            return
        columns = (tick.goal, tick.position, tick.velocity, tick.effort)
        try:
            self._socket.send(struct.pack("d", tick.time) + b"".join(columns), socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return
        except OSError:
            self._report_stop("its process ended")
            self.close()

    def housekeep(self, now: float) -> None:
        """Withdraw figures that are old: the robot is not driven any more."""
        if self._front.world.gap is not None and now > self._reported + STALE:
            self._front.world.gap = None

    def close(self) -> None:
        """End the process by end-of-file on its socket, and by a signal."""
        if self._socket is not None:
            self._front.loop.remove_reader(self._socket)
            self._socket.close()
            self._socket = None
        if self._process is not None:
            self._process.kill()
            threading.Thread(target=self._process.wait, name="gap", daemon=True).start()  # no zombie, no wait
            self._process = None

    def _start(self) -> None:
        """Start the process in a thread, unless it is not wanted, or too soon: a start takes milliseconds."""
        now = self._front.now()
        briefing = self._front.world.briefing
        if now < self._next or not briefing.parameters.get("gap", True) or not briefing.binding:
            return
        if briefing.description.get("compensate_gravity"):
            return
        self._next = now + AGAIN
        starting = self._front.loop.run_in_executor(None, _begin, briefing.binding, briefing.rate_hz)
        starting.add_done_callback(self._attach)

    def _attach(self, starting: asyncio.Future[tuple[subprocess.Popen[bytes], socket.socket]]) -> None:
        """Take over a process that was started; after a failure it is tried again later."""
        if starting.cancelled():
            return
        if (error := starting.exception()) is not None:
            self._report_stop(f"its process could not be started: {error}")
            return
        self.close()
        self._process, self._socket = starting.result()
        self._front.loop.add_reader(self._socket, self._readable)

    def _readable(self) -> None:
        """Take a report."""
        assert self._socket is not None
        try:
            data = self._socket.recv(LARGEST)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._report_stop("its process ended")
            self.close()
            return
        report = msgspec.json.decode(data)
        self._reported = self._front.now()
        self._reported_stop = False
        self._front.world.gap = report["gap"]
        for grown in report["grown"]:
            self._grown(grown)

    def _report_stop(self, reason: str) -> None:
        """Report once why there are no figures; it is tried again."""
        if not self._reported_stop:
            self._reported_stop = True
            text = f"no gap between robot and simulation is worked out: {reason}; next try in {AGAIN:g} s"
            self._warn(EventCode.GAP_STOPPED, text)

    def _grown(self, grown: dict[str, Any]) -> None:
        """Report a joint whose gap has grown."""
        message = (
            f"{grown['joint']}: {grown['value']:.0%} of its {grown['quantity']} unexplained, "
            f"bound {grown['bound']:.0%}, "
            "1.5 times the identified; look for a load, wear or a loose horn, then identify again"
        )
        self._warn(EventCode.GAP_GROWN, message)

    def _warn(self, code: EventCode, message: str) -> None:
        """Report to the log and to subscribers of events."""
        event = link.Event(time=self._front.now(), sequence=0, level="warning", code=code, message=message)
        self._front.telemetry.event(event)
        self._front.log.write("warning", code, event.time, message=message)


def _begin(binding: bytes, rate_hz: float) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a process with this bound robot; return it and our end of its socket. Raises OSError."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    fd = seal("twind-gap", binding)
    program = [sys.executable, "-P", "-m", "twind.gap.gap_worker"]
    program += ["--binding", str(fd), "--period", repr(1.0 / rate_hz)]
    try:
        process = subprocess.Popen(program, stdin=theirs.fileno(), pass_fds=(fd,))
    except OSError:
        ours.close()
        raise
    finally:
        theirs.close()
        os.close(fd)
    ours.setblocking(False)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    return process, ours
