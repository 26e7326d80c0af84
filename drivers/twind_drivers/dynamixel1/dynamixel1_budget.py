"""Cycle of a bus of Protocol 1.0: bytes, seconds, reachable rate; or a refusal with the arithmetic. Pure."""

from dataclasses import dataclass

from twind_drivers.dynamixel1.dynamixel1_slow_registers import BLOCK
from twind_drivers.half_duplex.chained_read import ADAPTER
from twind_drivers.half_duplex.checksum_packet import OVERHEAD
from twind_drivers.half_duplex.pending_reply import wire

SIZE = 6  # bytes read of each device: position, speed, load
TURNAROUND = 0.00005  # s from a request to its reply beside the return delay (register 5)


@dataclass(frozen=True, slots=True)
class Dynamixel1Cycle:
    """Cycle of one bus. `alone`: devices without bulk read; `delay` (s): return delay of each."""

    count: int
    alone: int
    baud: int
    delay: float

    @property
    def bytes(self) -> int:
        """Bytes of goals and reading."""
        together = self.count - self.alone
        grouped = 7 + 3 * together if together else 0
        return 8 + 3 * self.count + grouped + 8 * self.alone + self.count * (OVERHEAD + SIZE)

    @property
    def seconds(self) -> float:
        """Bus time (s) of goals and reading."""
        return wire(self.bytes, self.baud) + self.count * (TURNAROUND + self.delay) + ADAPTER * self.alone

    def whole(self, rate_hz: float, usb_s: float) -> float:
        """Return the time (s) with the slow registers of some devices; `usb_s`: adapter per transaction."""
        part = -(-self.count // max(1, int(min(rate_hz, 100.0) / 20.0)))  # devices of one slow read
        alone = part if self.alone else 0
        slow = wire(7 + part * (3 + OVERHEAD + BLOCK[1]), self.baud) + part * (TURNAROUND + self.delay)
        return self.seconds + slow + ADAPTER * max(0, alone - 1) + 2.0 * usb_s

    def refusal(self, rate_hz: float, usb_s: float) -> str | None:
        """Return the reason why `rate_hz` is impossible, with the arithmetic; None: it is possible."""
        needed = self.whole(rate_hz, usb_s)
        if needed * rate_hz <= 1.0:
            return None
        return (
            f"{rate_hz:g} Hz leaves {1e6 / rate_hz:.0f} us, the bus needs {needed * 1e6:.0f} us "
            f"({1.0 / needed:.0f} Hz): {self.line}. {self.remedy}"
        )

    @property
    def line(self) -> str:
        """The arithmetic."""
        way = f"{self.alone} of them one by one" if self.alone else "by bulk read"
        return (
            f"{self.bytes} bytes for goals and {SIZE} bytes of each of {self.count} servos, {way}; "
            f"{self.count} return delays of {(TURNAROUND + self.delay) * 1e6:.0f} us; "
            f"{BLOCK[1]} slow bytes of some; the adapter"
        )

    @property
    def remedy(self) -> str:
        """Settings that make the cycle shorter."""
        delay = "set return_delay_us to 0 in file and servos, " if self.delay else ""
        return f"Remedy: {delay}use another port for some of the servos, or a lower `rate_hz`"
