"""Faults of single CAN nodes and of their supply, by name."""

import struct
from math import inf, tau

from twind_drivers.can.can_units import COUNT
from twind_drivers.ports.frame import EXTENDED
from twind_drivers.virtual.can.can_controller import VirtualHostController
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.node import VirtualCanNode
from twind_drivers.virtual.can.nodes import VirtualCanNodes
from twind_drivers.virtual.can.virtual_damiao import VirtualDamiao
from twind_drivers.virtual.hinge import ShaftGrip
from twind_drivers.virtual.shaft_faults import ShaftFaults
from twind_drivers.virtual.shown_position_log import ShownPositionLog

EVERY = 0.01  # s between two commands of another master


class NodeFaults(ShaftFaults):
    """Faults of nodes, a method for each order of the fault socket.

    Unless named otherwise they outlast `clear`, as a node's state does.
    """

    def __init__(self, bus: str, nodes: VirtualCanNodes, controller: VirtualHostController) -> None:
        self._nodes = nodes
        self._wire = controller
        self.now = 0.0  # s, kept by the bus
        self.history: ShownPositionLog | None = None
        hinges = [node.spec.hinge for node in nodes.each]
        grip = ShaftGrip(hinges, [tau] * len(hinges), self._place, nodes.motors.set_hand_position)
        super().__init__(f"bus {bus}: no node", lambda: [node.id for node in nodes.each], grip)
        self.masters: dict[int, float] = {}  # row -> s, when the other master commands it next

    def silence(self, id: int | None = None, on: bool = True) -> None:
        """Pull the connector of one node or (None) of all: it receives and sends nothing, keeps its power.

        `clear` plugs all in. Raises KeyError.
        """
        for node in self._some(id):
            node.silenced = on
        self._update_membership()

    def power(self, on: bool, id: int | None = None) -> None:
        """Switch the supply of one or all. On: they boot; values not stored are lost, zeros of some too."""
        rows = range(len(self._nodes.each)) if id is None else self.rows(id)
        self._nodes.power(list(rows), on, self.now)
        for row in rows if not on else ():
            self._wire.wire.drop(row)
        self._update_membership()

    def brown_out(self, id: int) -> None:
        """One node loses its supply for a moment and boots. Raises KeyError."""
        self.power(False, id)
        self.power(True, id)

    def supply(self, volts: float) -> None:
        """Set the supply of all nodes, V. Raises ValueError outside 0..100 V."""
        if not 0.0 <= volts <= 100.0:
            raise ValueError(f"supply: {volts} V is outside 0..100 V")
        for node in self._nodes.each:
            node.volts = volts
            node.suffer()
        self._update_membership()

    def heat(self, id: int, celsius: float) -> None:
        """Set the temperature of one node from now on. Raises KeyError, ValueError outside -40..200 °C."""
        if not -40.0 <= celsius <= 200.0:
            raise ValueError(f"heat: {celsius} °C is outside -40..200 °C")
        for node in self._some(id):
            node.celsius = celsius
            node.suffer()
        self._update_membership()

    def damage(self, id: int, bits: int) -> None:
        """A fault in the vendor's own code. Raises KeyError, ValueError.

        Damiao: status nibble 8..14. CubeMars: error byte. RobStride: six bits. ODrive: axis error.
        """
        for row in self.rows(id):
            node = self._nodes.each[row]
            lowest, highest = {"damiao": (8, 15), "cubemars": (1, 255), "robstride": (1, 63)}.get(
                node.spec.spoken(), (1, 0xFFFFFFFF)
            )
            if not lowest <= bits <= highest:
                raise ValueError(f"damage: {bits} is outside {lowest}..{highest} of a {node.spec.spoken()}")
            self._nodes.inject_fault(row, bits, self.now)
        self._update_membership()

    def ranges(self, id: int, position: float, velocity: float, torque: float) -> None:
        """Set the true spans of a node's fields. Only a Damiao reports them (registers 21-23).

        Raises KeyError, ValueError for a span that is not above 0.
        """
        if not min(position, velocity, torque) > 0.0:
            raise ValueError(f"ranges: {position} rad, {velocity} rad/s, {torque} N·m: all are above 0")
        for node in self._some(id):
            if isinstance(node, VirtualDamiao):
                node.rescale(position, velocity, torque)
            else:
                node.spans = (position, velocity, torque)

    def zero_lost(self, id: int, radians: float) -> None:
        """Shift the position that a node reports by so much from now on. Raises KeyError."""
        for node in self._some(id):
            node.shaft.zero -= radians
            node.shaft.kept_zero -= radians

    def wrap(self, id: int, turns: int = 1) -> None:
        """Shift a node's position by whole turns when it is enabled next, as a restart in between does.

        A Damiao also at its next change of mode. Raises KeyError, ValueError outside -3..3.
        """
        if not -3 <= turns <= 3:
            raise ValueError(f"wrap: {turns} turns are outside -3..3")
        for node in self._some(id):
            node.shaft.turns_due = turns

    def twin(self, id: int, on: bool = True) -> None:
        """Add a second node with this id, which answers too, with another position. Raises KeyError."""
        change = self._nodes.twins.update if on else self._nodes.twins.difference_update
        change(self.rows(id))

    def master(self, id: int, on: bool = True) -> None:
        """Add another master, which commands this node every 10 ms, with no torque. Raises KeyError."""
        for row in self.rows(id):
            self.masters.pop(row, None)
            if on:
                self.masters[row] = self.now + EVERY

    def record(self, count: int) -> None:
        """Keep the last `count` positions, in counts; 0: none. Raises ValueError outside 0..100,000."""
        self.history = ShownPositionLog(len(self._nodes.each), count) if count else None

    def clear(self) -> None:
        """Plug in every connector; remove all twins and the other master."""
        for node in self._nodes.each:
            node.silenced = False
        self._nodes.twins.clear()
        self.masters.clear()
        self._update_membership()

    def next_command(self) -> float:
        """Return the time of the other master's next frame, s."""
        return min(self.masters.values(), default=inf)

    def commands(self, now: float) -> list[CanMessage]:
        """Return the frames that the other master sends until then."""
        said = []
        for row, at in list(self.masters.items()):
            if at <= now:
                self.masters[row] = at + EVERY
                said.append(_limp(self._nodes.each[row]))
        return said

    def _block(self, row: int, held: bool) -> None:
        self._nodes.motors.block(row, held)

    def _freeze(self, row: int, on: bool) -> None:
        self._nodes.motors.freeze(row, on)

    def _set_base_pose(self, base: str) -> None:
        self._nodes.motors.muscles.set_base_pose(base)

    def _place(self, row: int, count: float) -> float:
        return count * COUNT + self._nodes.each[row].shaft.zero

    def _some(self, id: int | None) -> list[VirtualCanNode]:
        each = self._nodes.each
        return list(each) if id is None else [each[row] for row in self.rows(id)]

    def _update_membership(self) -> None:
        self._nodes.update_membership()
        self._wire.update_membership()


def _limp(node: VirtualCanNode) -> CanMessage:
    """Return a command without torque, in the form of the node's family."""
    family = node.spec.spoken()
    if family == "robstride":
        return CanMessage(EXTENDED | 1 << 24 | 0x7FFF << 8 | node.id, bytes.fromhex("7FFF7FFF00000000"))
    if family == "odrive":
        return CanMessage(node.id << 5 | 0x0E, struct.pack("<f", 0.0))
    return CanMessage(node.id, bytes.fromhex("7FFF7FF0000007FF"))
