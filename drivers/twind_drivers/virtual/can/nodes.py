"""Nodes of one bus: receivers of a frame, and the times of unrequested frames."""

from collections.abc import Callable, Sequence
from math import inf

from twind_drivers.ports.frame import EXTENDED, STANDARD_MASK
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node import BOOT, VirtualCanNode
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_cubemars import VirtualCubeMars
from twind_drivers.virtual.can.virtual_damiao import VirtualDamiao
from twind_drivers.virtual.can.virtual_odrive import VirtualODrive
from twind_drivers.virtual.can.virtual_robstride import VirtualRobStride

KINDS: dict[str, type[VirtualCanNode]] = {
    "damiao": VirtualDamiao,
    "cubemars": VirtualCubeMars,
    "robstride": VirtualRobStride,
    "odrive": VirtualODrive,
}


class VirtualCanNodes:
    """Nodes of one bus (m) in rows. `say(row, message, now)` takes the frames that they send."""

    def __init__(
        self,
        specs: Sequence[NodeSpec],
        muscles: CanMotorPhysics,
        now: float,
        say: Callable[[int, CanMessage, float], None],
    ) -> None:
        """Raises ValueError for a node that cannot be simulated."""
        self.motors = CanMotors(muscles, [spec.torque for spec in specs], now)
        self._say = say
        self.each: list[VirtualCanNode] = [
            KINDS[spec.spoken()](spec, row, self.motors, now) for row, spec in enumerate(specs)
        ]
        self.twins: set[int] = set()  # rows beside which a second node with the same id answers
        self.present = [True] * len(specs)  # has power and a plugged connector
        self._times = [inf] * len(specs)  # s, when each does something by itself
        self.update_membership()

    def update_membership(self) -> None:
        """Update the nodes on the wire after a change of power or a connector, or after a frame."""
        self._rows: dict[int, list[int]] = {}  # id, or its part that addresses a node -> rows that receive it
        for row in range(len(self.each)):
            self._look(row)
        self._sum()

    def receive_frame(self, message: CanMessage, now: float, but: int) -> None:
        """Pass a frame on the wire to all connected nodes, `but` the row that sent it."""
        self.motors.settle(now)
        id = message.id
        key = id & 0xFF | EXTENDED if id & EXTENDED else id & STANDARD_MASK
        if key not in self._rows:
            self._rows[key] = [row for row, node in enumerate(self.each) if node.accepts_id(key)]
        for row in self._rows[key]:
            if row != but and self.present[row]:
                node = self.each[row]
                for answer in node.handle_frame(message, now):
                    self._answer(row, answer, now)
                self._look(row)
        self._sum()

    def run_timers(self, now: float) -> None:
        """Run the timers due by `now` (s): watchdogs, boots, heartbeats."""
        self.motors.settle(now)
        for row, node in enumerate(self.each):
            if node.boots_at <= now:
                node.boot(now)
                self._look(row)
            if node.watch.expiry(node.shaft.on) <= now:
                self._send_unsolicited(row, node.on_watchdog_timeout(now), now)
            if node.powered and node.next_beat() <= now:
                self._send_unsolicited(row, node.beat(now), now)
            self._look(row)
        self._sum()

    def power(self, rows: Sequence[int], on: bool, now: float) -> None:
        """Supply of these; they boot when it comes."""
        for row in rows:
            node = self.each[row]
            if on != (node.powered or node.boots_at < inf):
                node.down(now + node.spec.settings.get("boot", BOOT) if on else inf)
        self.update_membership()

    def inject_fault(self, row: int, bits: int, now: float) -> None:
        """A fault in the vendor's code."""
        self._send_unsolicited(row, self.each[row].inject_fault(bits), now)
        self.update_membership()

    def _look(self, row: int) -> None:
        node = self.each[row]
        self.present[row] = node.powered and not node.silenced
        own = min(node.watch.expiry(node.shaft.on), node.next_beat())
        self._times[row] = own if node.powered else node.boots_at

    def _sum(self) -> None:
        self.there = sum(self.present)  # how many
        self.event = min(self._times, default=inf)  # s, when the next one does something by itself

    def _send_unsolicited(self, row: int, messages: Sequence[CanMessage], now: float) -> None:
        """Send frames of a node by itself; none leaves with its connector pulled."""
        for message in messages if self.present[row] else ():
            self._say(row, message, now)

    def _answer(self, row: int, answer: CanMessage, now: float) -> None:
        self._say(row, answer, now)
        if row in self.twins:
            other = bytes(each ^ 0x10 if place == 2 else each for place, each in enumerate(answer.data))
            self._say(row, CanMessage(answer.id, other), now)
