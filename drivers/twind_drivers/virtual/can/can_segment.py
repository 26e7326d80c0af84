"""CAN segment: nodes, wire and the host's controller; frames in, frames out, as time passes."""

from collections.abc import Sequence
from math import inf

import numpy as np

from twind_drivers.can.can_units import COUNT
from twind_drivers.ports.frame import Frames
from twind_drivers.virtual.can.can_bus_faults import CanFaults
from twind_drivers.virtual.can.can_controller import BROKEN, CanAdapter, VirtualHostController
from twind_drivers.virtual.can.can_message import CanMessage, as_frames, messages
from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics
from twind_drivers.virtual.can.can_wire import HOST, CanWire
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.nodes import VirtualCanNodes
from twind_drivers.virtual.can.slcan_text import SlcanText
from twind_drivers.virtual.shown_position_log import ShownPositionLog

IDLE = 0.01  # s after which the physics advances without a request
STRANGER = -2  # sender: another master on the wire


class VirtualCanSegment:
    """m nodes on one wire, and a controller that gives frames. Time (s) is an argument and never goes back.

    A frame takes the time of its own bits, stuff bits counted; nodes answer as soon as it is over.
    """

    def __init__(
        self,
        name: str,
        nodes: Sequence[NodeSpec],
        muscles: CanMotorPhysics,
        *,
        bitrate: int = 1_000_000,
        wire_timing: bool = True,
        now: float = 0.0,
        adapter: CanAdapter | None = None,
        seed: int = 0,
    ) -> None:
        """Raises ValueError for a node that cannot be simulated, and a bitrate that is none."""
        if bitrate <= 0:
            raise ValueError(f"bus {name}: {bitrate} bit/s is not a rate")
        self.name = name
        self._now = now
        self.wire = CanWire(bitrate, self._may_send, timing=wire_timing)
        self.controller = VirtualHostController(
            self.wire, adapter or CanAdapter(), bitrate, lambda: self._may_send(HOST)
        )
        self.nodes = VirtualCanNodes(nodes, muscles, now, self._queue_node_frame)
        self.text = SlcanText(self.controller, seed)
        self.faults = CanFaults(name, self.nodes, self.controller, self.text)
        self.faults.now = now
        self._noted = now
        self._hears = self._host_may = False  # the controller; see `_changed`
        self._alone = False  # no node acknowledges the controller's frames

    @property
    def is_plugged(self) -> bool:
        """True if the adapter is plugged in."""
        return self.faults.plugged

    @property
    def history(self) -> ShownPositionLog | None:
        """Positions kept by `record`, in counts, in the order of `ids`."""
        return self.faults.history

    def ids(self) -> list[int]:
        """Return the ids of the nodes, in the order of rows."""
        return [node.id for node in self.nodes.each]

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each node at `now`, independent of the bus; raw units of `can_units`.

        Keys: see `VirtualCanNode.truth`.
        """
        self._run(now)
        self.nodes.motors.advance(now)
        return [node.truth(now) for node in self.nodes.each]

    def take_host_frames(self, frames: Frames, now: float) -> int:
        """Give frames of the host to its controller at `now`; return how many it did not take."""
        self._run(now)
        taken = [self.controller.take(message, now) for message in messages(frames)]
        return len(taken) - sum(taken)

    def next_output_time(self) -> float:
        """Return the s before which no frame comes; `inf`: none is under way, `-inf`: some are there."""
        if self.controller.inbox:
            return -inf
        own = self.nodes.event
        if self.faults.masters:
            own = min(own, self.faults.next_command())
        own += self.wire.soonest_answer()
        self._look()
        sending = self.wire.next()
        if sending is None:
            return own
        ends = sending.end
        if sending.sender == HOST and not self.controller.echo:
            ends += self.wire.soonest_answer()
        return min(own, ends)

    def give_host_frames(self, now: float) -> Frames:
        """Return the frames that have arrived at the controller by `now`, error frames among them."""
        return as_frames(self._arrived(now))

    def advance(self, now: float) -> None:
        """Let time pass without traffic: muscles, watchdogs, boots, heartbeats."""
        self._run(now)
        if now - self.nodes.motors.at >= IDLE:
            self.nodes.motors.advance(now)

    # ------------------------------------------------------------------------------------- what happens

    def _arrived(self, now: float) -> list[CanMessage]:
        self._run(now)
        inbox = self.controller.inbox
        heard = list(inbox)
        inbox.clear()
        return heard

    def _run(self, until: float) -> None:
        """Process every event that is over by `until`."""
        while True:
            self._look()
            sending = self.wire.next()
            ends = inf if sending is None else sending.end
            own = self.nodes.event
            if self.faults.masters:
                own = min(own, self.faults.next_command())
            if min(ends, own) > until:
                break
            self._now = max(self._now, min(ends, own))
            self.faults.now = self._now
            if own <= ends:
                self._act()
            else:
                self._deliver()
            self._note()
        self._now = max(self._now, until)
        self.faults.now = self._now
        if not self._host_may:
            self._despair()

    def _despair(self) -> None:
        """Become error passive, as a controller does by repeating a frame that no node acknowledges."""
        controller = self.controller
        tries = controller.up and not controller.off and not controller.stalled and controller.backlog()
        if tries and not self._alone:
            self._alone = True
            controller.doubt(True)

    def _look(self) -> None:
        """Update after faults or the channel have changed what may be sent."""
        controller = self.controller
        if controller.news or controller.broken:
            self._update_membership()
            self.wire.noise(self._now, controller.broken * BROKEN / self.wire.bitrate)
            controller.news = False
            controller.broken = 0

    def _update_membership(self) -> None:
        """Update after a change of the nodes on the bus or of the permitted senders."""
        controller = self.controller
        self._hears = controller.sound() and not controller.listens_only
        self._host_may = self._hears and not controller.stalled and self.nodes.there > 0
        self.wire.update_membership(self._now)

    def _act(self) -> None:
        there = self.nodes.there
        for message in self.faults.commands(self._now):
            self.wire.put(STRANGER, message, self._now)
        if self.nodes.event <= self._now:
            self.nodes.run_timers(self._now)
        if there != self.nodes.there:
            self._update_membership()

    def _deliver(self) -> None:
        sent = self.wire.take()
        if sent is None:
            return
        there = self.nodes.there
        self.nodes.receive_frame(sent.message, sent.end, sent.sender)
        if there != self.nodes.there:
            self._update_membership()
        if sent.sender == HOST and self._alone:
            self._alone = False
            self.controller.doubt(False)
        if sent.sender != HOST or self.controller.echo:
            self.controller.receive_frame(sent.message, self._now)

    def _queue_node_frame(self, row: int, message: CanMessage, now: float) -> None:
        """Queue a frame that a node sends."""
        if not self.faults.active:
            self.wire.put(row, message, now)
            return
        struck = self.faults.strike(self.nodes.each[row].id, message)
        for each in struck.sent:
            self.wire.put(row, each, now + struck.late)

    def _may_send(self, sender: int) -> bool:
        """Return True if the sender is on the bus and a receiver is there to acknowledge."""
        if sender == HOST:
            return self._host_may
        if sender == STRANGER:
            return self._hears or self.nodes.there > 0
        return self.nodes.present[sender] and (self._hears or self.nodes.there > 1)

    def _note(self) -> None:
        history = self.history
        at = self.nodes.motors.at
        if history is not None and at > self._noted:
            self._noted = at
            places = [node.shaft.read_state()[0] / COUNT for node in self.nodes.each]
            history.note(at, np.rint(places).astype(np.int64))
