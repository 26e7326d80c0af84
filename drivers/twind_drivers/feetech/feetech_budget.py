"""Cycle of a Feetech bus: bytes, seconds, reachable rate; or a refusal with the arithmetic. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twind_drivers.half_duplex.chained_read import ADAPTER
from twind_drivers.half_duplex.checksum_packet import OVERHEAD
from twind_drivers.half_duplex.pending_reply import wire

SHORT = 6  # bytes: position, speed, load
WHOLE = 15  # up to the current
SLOW = 26  # bytes of the slow registers
DELAY = 0.0001  # s from a request to its reply, assumed: register 7 has no effect on an STS
ROOM = 0.5  # share of a cycle that the long cyclic reading may take


def cycle_bytes(count: int, alone: int, size: int) -> int:
    """Return the bytes of goals and reading of `size` bytes; `alone`: devices without sync read."""
    goals = 8 + 3 * count
    grouped = 8 + count - alone if count > alone else 0
    return goals + grouped + 8 * alone + count * (OVERHEAD + size)


def cycle_seconds(count: int, alone: int, size: int, *, baud: int, delay: float = DELAY) -> float:
    """Return the bus time (s) of goals and reading, with the return delay (s) of each device."""
    return wire(cycle_bytes(count, alone, size), baud) + count * delay + ADAPTER * alone


def cyclic_size(has_current: Sequence[bool], seconds: Callable[[int], float], period: float) -> int:
    """Return the bytes read of each device: with the current where all have one and the cycle has room."""
    return WHOLE if all(has_current) and seconds(WHOLE) <= ROOM * period else SHORT


@dataclass(frozen=True, slots=True)
class FeetechCycle:
    """Cycle of one bus at one rate."""

    count: int
    alone: int
    size: int  # bytes read of each device
    bytes: int
    seconds: float  # upkeep and adapter included

    @property
    def reachable_hz(self) -> float:
        """Highest rate."""
        return 1.0 / self.seconds

    def refusal(self, rate_hz: float) -> str | None:
        """Return the reason why `rate_hz` is impossible, with the arithmetic; None: it is possible."""
        if self.reachable_hz >= rate_hz:
            return None
        return (
            f"{rate_hz:g} Hz leaves {1e6 / rate_hz:.0f} us, the bus needs {self.seconds * 1e6:.0f} us "
            f"({self.reachable_hz:.0f} Hz): {self.line}"
        )

    @property
    def line(self) -> str:
        """The arithmetic."""
        way = f"{self.alone} of them one by one" if self.alone else "by sync read"
        return (
            f"{self.bytes} bytes for goals and {self.size} bytes of each of {self.count} servos, {way}; "
            f"{self.count} return delays of {DELAY * 1e6:.0f} us; {SLOW} slow bytes of some; the adapter"
        )


def cycle(
    has_current: Sequence[bool], alone: int, *, baud: int, rate_hz: float, usb_s: float
) -> FeetechCycle:
    """Return the cycle of these devices; `usb_s`: time that the adapter adds to each transaction, s."""
    count = len(has_current)
    size = cyclic_size(has_current, lambda size: cycle_seconds(count, alone, size, baud=baud), 1.0 / rate_hz)
    seconds = cycle_seconds(count, alone, size, baud=baud)
    part = -(-count // max(1, int(min(rate_hz, 100.0) / 20.0)))  # devices of one slow read
    seconds += wire(8 + part * (1 + OVERHEAD + SLOW), baud) + part * DELAY + 2.0 * usb_s
    return FeetechCycle(count, alone, size, cycle_bytes(count, alone, size), seconds)
