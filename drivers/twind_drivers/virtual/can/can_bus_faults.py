"""Faults on order of one virtual CAN bus, by name; `docs/virtual.md` lists them."""

from twind_drivers.virtual.can.can_controller import VirtualHostController
from twind_drivers.virtual.can.frame_faults import FrameFaults
from twind_drivers.virtual.can.node_faults import NodeFaults
from twind_drivers.virtual.can.nodes import VirtualCanNodes
from twind_drivers.virtual.can.slcan_text import SlcanText


class CanFaults(FrameFaults, NodeFaults):
    """Faults of one bus: of replies, of nodes, of the line and the adapter."""

    def __init__(
        self, bus: str, nodes: VirtualCanNodes, controller: VirtualHostController, text: SlcanText
    ) -> None:
        FrameFaults.__init__(self)
        NodeFaults.__init__(self, bus, nodes, controller)
        self._controller = controller
        self._text = text
        self.plugged = True
        self.stalled = False

    def require(self, id: int) -> None:
        """Check that a node has this id. Raises KeyError that lists the ids."""
        self.rows(id)

    def corrupt(self, count: int, kind: str = "") -> None:
        """The next lines of slcan text to the host are broken: see `text.KINDS`; empty: any of them.

        Raises ValueError.
        """
        self._text.spoil(count, kind)

    def unacknowledged(self, on: bool = True) -> None:
        """Cut the cable behind the adapter: no node receives, and it repeats its first frame.

        Frames of the host wait, and leave when the cable is whole.
        """
        self._controller.cut = on
        self._controller.update_membership()

    def bus_off(self, on: bool = True) -> None:
        """Take the controller off the bus; off: start it again, and send the waiting frames.

        slcan does not report it; closing and opening the channel starts it again too.
        """
        self._controller.go_offline(on)

    def passive(self, on: bool = True) -> None:
        """Set the controller to error-passive, which it reports; frames pass as before."""
        self._controller.doubt(on)

    def error_frames(self, count: int) -> None:
        """Break so many frames on the wire; they are reported as error frames. Raises ValueError."""
        if not 0 <= count <= 10_000:
            raise ValueError(f"error_frames: {count} are outside 0..10000")
        self._controller.errors(count)

    def echo(self, on: bool = True) -> None:
        """The adapter gives the host back what it has sent, when that has left."""
        self._controller.echo = on

    def stall(self, on: bool = True) -> None:
        """The adapter takes nothing from the host; what it has taken goes out. Off: it goes on."""
        self.stalled = self._controller.stalled = on
        self._controller.update_membership()

    def unplug(self) -> None:
        """The adapter is pulled out: what it holds is lost; the nodes keep power and time."""
        self.plugged = False
        self._controller.plug(False)
        self._text.forget()

    def replug(self, renamed: bool = False) -> None:
        """The adapter is back, its channel closed. `renamed`: as another device; here there is no name."""
        self.plugged = True
        self._controller.plug(True)

    def seed(self, number: int) -> None:
        """Start the random numbers of this bus anew. Raises ValueError below 0."""
        if number < 0:
            raise ValueError(f"seed: {number}: a seed is 0 or more")
        self._text.restart(number)

    def clear(self) -> None:
        """Answers, line and connectors are sound; faults of nodes, supply, heat, power and plug stay."""
        FrameFaults.clear(self)
        NodeFaults.clear(self)
        self._text.spoil(0, "")
        self._controller.heal()
        self.stalled = False
