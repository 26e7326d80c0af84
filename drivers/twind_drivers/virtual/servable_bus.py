"""What serves a virtual bus (a pseudo-terminal, the loopback) needs of it, whatever hangs on its wire."""

from typing import Any, Protocol

from twind_drivers.virtual.reading_history import ReadingHistory


class ServableBus(Protocol):
    """Bytes in, bytes out, as time passes (s, never back); and what is true of its devices."""

    name: str
    kind: str  # as the robot file has it: `dynamixel2` or `can`
    faults: Any  # its orders, by name; `stalled`: it takes nothing from the host

    @property
    def plugged(self) -> bool:
        """Is the adapter there?"""

    @property
    def backlog(self) -> int:
        """Bytes that a stalled adapter has taken and not sent."""

    @property
    def history(self) -> ReadingHistory | None:
        """What `record` keeps, in the order of `ids`; None: nothing."""

    def flush(self) -> None:
        """Those bytes are never sent."""

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the host, sent at `now`."""

    def due(self) -> float:
        """Nothing comes before this, s; `inf`: nothing is under way."""

    def take(self, now: float) -> bytes:
        """Bytes that have arrived at the host by `now`."""

    def advance(self, now: float) -> None:
        """Let time pass without traffic."""

    def line(self, baud: int) -> None:
        """The host's port is set to `baud`."""

    def ids(self) -> list[int]:
        """Of the devices, in rows."""

    def truth(self, now: float) -> list[dict[str, Any]]:
        """What is true of each device, past the bus."""

    def slip(self, seconds: float) -> None:
        """Time that the devices did not live; clocks of theirs that go on count it."""
