"""A host on an in-process virtual CAN bus under a fake clock: sends frames, collects what comes."""

from collections.abc import Sequence

import numpy as np

from twind_drivers.clock import FakeClock
from twind_drivers.ports.frame import ERROR
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_message import CanMessage, as_frames, messages
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus

LIMP = bytes.fromhex("7FFF7FF0000007FF")  # an MIT command of zeros (facts 2, golden)


def mit(last: int) -> bytes:
    """One of the special frames."""
    return bytes([255] * 7 + [last])


class CanHost:
    """Nodes at 0 rad on one bus of 1 Mbit/s; time moves by `wait` and while frames come."""

    def __init__(
        self,
        nodes: Sequence[NodeSpec],
        *,
        start: float = 0.0,
        adapter: CanAdapter | None = None,
        wire_timing: bool = True,
        opened: bool = True,
    ) -> None:
        self.muscles = FirstOrderCanPhysics(np.full(len(nodes), start))
        self.bus = VirtualCanBus("test", nodes, self.muscles, adapter=adapter, wire_timing=wire_timing)
        self.clock = FakeClock()
        self.faults = self.bus.faults
        self.errors: list[CanMessage] = []  # error frames that came
        if opened:
            self.bus.controller.connect(True)

    def ask(self, *sent: tuple[int, bytes], wait: float = 0.005) -> list[CanMessage]:
        """Frames out; what has come after so many s."""
        self.bus.take_host_frames(as_frames([CanMessage(*each) for each in sent]), self.clock.now())
        return self.wait(wait)

    def wait(self, seconds: float) -> list[CanMessage]:
        """Frames that have come by then, without error frames."""
        self.clock.sleep_until(self.clock.now() + seconds)
        self.bus.advance(self.clock.now())
        heard = messages(self.bus.give_host_frames(self.clock.now()))
        self.errors += [each for each in heard if each.id & ERROR]
        return [each for each in heard if not each.id & ERROR]

    def truth(self, row: int = 0) -> dict:
        return self.bus.truth(self.clock.now())[row]
