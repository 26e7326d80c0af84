"""The four motors in virtual time, a port to them, and the monitor between: where CAN daemons are tried."""

from contextlib import suppress
from typing import Any

from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.can.motors import CanLimits
from tests.proof.evil.can_good import Good
from tests.proof.evil.can_nodes import Nodes, limits
from tests.proof.evil.daemon_life import Over

AFTER = 0.3  # s that a daemon lives on after it was caught: what else does it break?
LIMITS = limits()


class VirtualPort:
    """A daemon's way to the motors, through the monitor. Time passes where the daemon waits."""

    def __init__(
        self, limits: CanLimits = LIMITS, *, writes: bool = True, monitor: type[CanMonitor] = CanMonitor
    ) -> None:
        self.monitor = monitor(limits, writes=writes)
        self.nodes = Nodes(limits)
        self.now = 0.0

    def write(self, data: bytes) -> None:
        wrong = self.monitor.violations
        if wrong and self.now > wrong[0].time + AFTER:
            raise Over
        self.monitor.sent(data, self.now)
        self.nodes.receive(data, self.now)

    def read(self, seconds: float) -> bytes:
        """Bytes that come within that time."""
        data = b""
        end = self.now + seconds
        while self.nodes.due() <= end:
            self.now = max(self.now, self.nodes.due())
            came = self.nodes.take(self.now)
            self.monitor.answered(came, self.now)
            data += came
        self.now = end
        return data

    def until(self, time: float) -> None:
        while self.now < time:
            self.now = min(self.now + 0.01, time)
            self.monitor.look(self.now)

    def say(self, what: str, **facts: Any) -> None:
        self.monitor.take_report(what, self.now, **facts)

    def ask_servos(self) -> None:
        """Report the velocities of the motors, for W11."""
        self.say("servos", velocity={id: node.velocity for id, node in self.nodes.nodes.items()})


def tried(daemon: type[Good], monitor: type[CanMonitor] = CanMonitor) -> CanMonitor:
    """A daemon's life, or what is left of it after it was caught; its monitor."""
    port = VirtualPort(monitor=monitor)
    with suppress(Over):
        daemon(port, LIMITS).live()
    return port.monitor
