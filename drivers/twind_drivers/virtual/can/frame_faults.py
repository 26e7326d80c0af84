"""Faults of single frames of nodes on their way to the host: lost, late, twice, among foreign ones."""

from collections.abc import Sequence
from typing import NamedTuple

from twind_drivers.virtual.can.can_controller import VirtualCanController
from twind_drivers.virtual.can.can_message import CanMessage

FOREIGN = CanMessage(0x6F3, bytes([0xF0, 0x0D, 0, 0, 0, 0, 0, 0]))  # of no node on this bus


class FaultedFrame(NamedTuple):
    """Result of the faults on one frame: the frames `sent` in its place, `late` s later."""

    late: float
    sent: Sequence[CanMessage]


class FrameFaults:
    """Faults of the next frames that nodes send. A count is of frames to come, of one id or (None) of any."""

    def __init__(self, controller: VirtualCanController) -> None:
        self._orders: dict[tuple[str, int | None], int] = {}
        self._late: dict[int | None, float] = {}
        self.active = False

    def drop(self, count: int, id: int | None = None) -> None:
        """Lose the next frames. Raises ValueError below 0, KeyError for an id that is not there."""
        self._order("drop", count, id)

    def duplicate(self, count: int, id: int | None = None) -> None:
        """Send each of the next frames twice. Raises ValueError, KeyError."""
        self._order("duplicate", count, id)

    def foreign(self, count: int, id: int | None = None) -> None:
        """Send a frame of an unknown node before each of the next frames. Raises ValueError, KeyError."""
        self._order("foreign", count, id)

    def delay(self, seconds: float, id: int | None = None) -> None:
        """Send every frame (of one id) that much later, so an answer of one cycle comes in the next.

        Until set to 0. Raises ValueError outside 0..10 s, KeyError.
        """
        if not 0.0 <= seconds <= 10.0:
            raise ValueError(f"delay: {seconds} s are outside 0..10 s")
        if id is not None:
            self.rows(id)
        self._late[id] = seconds
        self._look()

    def rows(self, id: int) -> list[int]:
        """Rows of the nodes with this id. Raises KeyError."""
        raise NotImplementedError

    def clear(self) -> None:
        """Remove all frame faults."""
        self._orders.clear()
        self._late.clear()
        self.active = False

    def strike(self, id: int, message: CanMessage) -> FaultedFrame:
        """Apply the faults to this frame of the node `id`."""
        late = self._late.get(id, 0.0) or self._late.get(None, 0.0)
        if self._spent("drop", id):
            return FaultedFrame(late, ())
        sent = [message]
        if self._spent("duplicate", id):
            sent.append(message)
        if self._spent("foreign", id):
            sent.insert(0, FOREIGN)
        self._look()
        return FaultedFrame(late, sent)

    def _order(self, name: str, count: int, id: int | None) -> None:
        if count < 0:
            raise ValueError(f"{name}: {count} frames: a count is 0 or more")
        if id is not None:
            self.rows(id)
        self._orders[name, id] = count
        self._look()

    def _spent(self, name: str, id: int) -> bool:
        for key in ((name, id), (name, None)):
            if self._orders.get(key, 0) > 0:
                self._orders[key] -= 1
                return True
        return False

    def _look(self) -> None:
        self.active = any(self._orders.values()) or any(self._late.values())
