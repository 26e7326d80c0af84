"""A virtual CAN bus on python-can's `virtual` interface: frames between the two, in one process.

python-can's interface knows neither arbitration nor time: both happen here, before a frame is handed over.
Whoever drives it calls `step` often enough; it has no thread and never blocks.
"""

import can

from twind_drivers.can.frame import ERROR, EXTENDED, EXTENDED_MASK, REMOTE
from twind_drivers.virtual.can.can_message import CanMessage, as_frames, messages
from twind_drivers.virtual.can.can_segment import VirtualCanSegment


class PythonCanBridge:
    """Moves what the host has sent to the nodes, and what they have said to the host."""

    def __init__(self, line: VirtualCanSegment, bus: can.BusABC) -> None:
        """`bus`: an end of its own on the host's channel."""
        self._line = line
        self._bus = bus
        line.controller.connect(True)

    def step(self, now: float) -> float:
        """Everything until `now` (s); when to call again at the latest, s."""
        sent = []
        while (given := self._bus.recv(timeout=0.0)) is not None:
            if not given.is_error_frame:
                sent.append(_taken(given))
        if sent:
            self._line.take_host_frames(as_frames(sent), now)
        self._line.advance(now)
        for each in messages(self._line.give_host_frames(now)):
            self._bus.send(_given(each))
        return self._line.next_output_time()


def _taken(given: can.Message) -> CanMessage:
    flags = (EXTENDED if given.is_extended_id else 0) | (REMOTE if given.is_remote_frame else 0)
    data = bytes(given.dlc) if given.is_remote_frame else bytes(given.data)
    return CanMessage(given.arbitration_id | flags, data)


def _given(message: CanMessage) -> can.Message:
    id, data = message
    remote = bool(id & REMOTE)
    return can.Message(
        arbitration_id=id & EXTENDED_MASK,
        is_extended_id=bool(id & EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(id & ERROR),
        dlc=len(data),
        data=None if remote else data,
    )
