"""Faults of single frames of nodes on their way to the host: lost, late, twice, among foreign ones."""

from collections.abc import Sequence
from typing import NamedTuple

from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.fault_orders import FaultOrders

FOREIGN = CanMessage(0x6F3, bytes([0xF0, 0x0D, 0, 0, 0, 0, 0, 0]))  # of no node on this bus


class FaultedFrame(NamedTuple):
    """Result of the faults on one frame: the frames `sent` in its place, `late` s later."""

    late: float
    sent: Sequence[CanMessage]


class FrameFaults(FaultOrders):
    """Faults of the next frames that nodes send."""

    def delay(self, seconds: float, id: int | None = None) -> None:
        """Send every frame (of one id) that much later, so an answer of one cycle comes in the next.

        Until set to 0. Raises ValueError outside 0..10 s, KeyError.
        """
        self._delay(seconds, id)

    def strike(self, id: int, message: CanMessage) -> FaultedFrame:
        """Apply the faults to this frame of the node `id`."""
        late = self._late.get(id, 0.0) or self._late.get(None, 0.0)
        if self._hit("drop", id) is not None:
            return FaultedFrame(late, ())
        sent = [message]
        if self._hit("duplicate", id) is not None:
            sent.append(message)
        if self._hit("foreign", id) is not None:
            sent.insert(0, FOREIGN)
        self.look()
        return FaultedFrame(late, sent)
