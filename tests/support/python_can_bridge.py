"""Bridge from a virtual CAN bus to python-can's `virtual` interface, in one process.

python-can's interface has neither arbitration nor time: both happen here, before a frame is passed on. The
user calls `step` often enough; there is no thread and no blocking.
"""

import can

from twind_drivers.ports.frame import ERROR, EXTENDED, EXTENDED_MASK, REMOTE
from twind_drivers.virtual.can.can_message import CanMessage, as_frames, messages
from twind_drivers.virtual.can.can_segment import VirtualCanSegment


class PythonCanBridge:
    """Bridge of frames between the host and the nodes."""

    def __init__(self, line: VirtualCanSegment, bus: can.BusABC) -> None:
        """Make the bridge; `bus`: a separate end on the host's channel."""
        self._line = line
        self._bus = bus
        line.controller.connect(True)

    def step(self, now: float) -> float:
        """Process everything until `now` (s); return the latest time of the next call, s."""
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
