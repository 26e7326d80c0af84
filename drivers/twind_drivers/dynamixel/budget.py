"""What a cycle costs on the wire: bytes, seconds, reachable rate, refusal with the arithmetic. Pure.

10 bits a byte (8N1). Sources: e-manual "Protocol 2.0" for the packet sizes; a return delay counts once per
status, so N times for a plain sync read and once for a fast one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

BITS = 10  # per byte: start, 8 data, stop
CYCLIC = 10  # bytes read of each device every cycle: current or load 2, velocity 4, position 4
GOAL = 4  # bytes written to each device every cycle
STATUS_BLOCK = 35  # torque enable .. bus watchdog
HEALTH_BLOCK = 3  # input voltage, temperature
STATUS_HZ, HEALTH_HZ = 20.0, 5.0  # refresh of the slow registers, at least


def wire(count: int, baud: int) -> float:
    """Seconds that `count` bytes take."""
    return count * BITS / baud


def sync_request(count: int) -> int:
    """Bytes of a (fast) sync read request to `count` devices."""
    return 14 + count


def plain_reply(count: int, size: int) -> int:
    """Bytes of `count` statuses that carry `size` data bytes each."""
    return count * (11 + size)


def fast_reply(count: int, size: int) -> int:
    """Bytes of one fast reply of `count` devices."""
    return 8 + count * (4 + size)


def sync_write(count: int, size: int) -> int:
    """Bytes of a sync write of `size` bytes to each of `count` devices."""
    return 14 + count * (1 + size)


@dataclass(frozen=True, slots=True)
class Upkeep:
    """Round robin of the slow registers: in every `slots` calls all devices' status, one slice of health.

    Called f times a second, `slots = floor(f / 20 Hz)`: `slots - 1` calls read the status of `status` devices
    each (all of them every 1/20 s), one call the health of `health` devices (all of them every 4 x 1/20 s =
    1/5 s). At 100 Hz and 24 devices: 5 slots, 4 x 6 status and 1 x 6 health. Below 40 Hz two slots are the
    least, and the refresh is half the call rate.
    """

    slots: int
    status: int  # devices in a status slice
    health: int  # devices in a health slice


def upkeep(count: int, rate_hz: float) -> Upkeep:
    """The round robin that refreshes `count` devices at STATUS_HZ and HEALTH_HZ when called `rate_hz`."""
    slots = max(2, floor(rate_hz / STATUS_HZ + 1e-9))
    rounds = max(1, round(STATUS_HZ / HEALTH_HZ))
    return Upkeep(slots, ceil(count / (slots - 1)), ceil(count / rounds))


@dataclass(frozen=True, slots=True)
class Budget:
    """One bus's cycle at one rate. `lines` is the arithmetic, for people."""

    bytes: int  # of a whole cycle: goals, request, replies, upkeep slice
    seconds: float
    reachable_hz: float
    lines: tuple[str, ...]

    def refusal(self, rate_hz: float) -> str | None:
        """Why `rate_hz` is impossible, with the arithmetic; None: it is possible."""
        if self.reachable_hz >= rate_hz:
            return None
        return (
            f"{rate_hz:g} Hz leaves {1e6 / rate_hz:.0f} us a cycle, "
            f"the bus needs {self.seconds * 1e6:.0f} us ({self.reachable_hz:.0f} Hz): "
            + "; ".join(self.lines)
        )


def budget(
    count: int,
    baud: int,
    *,
    fast: bool,
    return_delay_us: float,
    write: bool = True,
    upkeep_hz: float | None = None,
    usb_s: float = 0.0,
    read_size: int = CYCLIC,
) -> Budget:
    """The cycle of `count` devices: goals (`write`), cyclic reading, and with `upkeep_hz` its status slice.

    `usb_s`: what the adapter adds to each transaction, s. Raises ValueError for no devices or no baud rate.
    """
    if count < 1 or baud < 1:
        raise ValueError(f"a budget needs devices and a baud rate, got {count} and {baud}")
    reply = fast_reply(count, read_size) if fast else plain_reply(count, read_size)
    rows: list[tuple[str, int, int]] = []  # what, bytes, return delays
    if write:
        rows.append((f"goals to {count}", sync_write(count, GOAL), 0))
    kind = "fast sync read" if fast else "sync read"
    rows.append((f"{kind} request", sync_request(count), 0))
    rows.append((f"{kind} reply, {read_size} bytes of {count}", reply, 1 if fast else count))
    transactions = 1
    if upkeep_hz is not None:
        k = upkeep(count, upkeep_hz).status
        rows.append((f"upkeep of {k}", sync_request(k) + plain_reply(k, STATUS_BLOCK), k))
        transactions = 2
    return _sum(rows, baud, return_delay_us, transactions * usb_s)


def _sum(rows: Sequence[tuple[str, int, int]], baud: int, delay_us: float, usb_s: float) -> Budget:
    total = sum(size for _, size, _ in rows)
    delays = sum(each for _, _, each in rows)
    seconds = wire(total, baud) + delays * delay_us * 1e-6 + usb_s
    lines = [f"{what}: {size} bytes = {wire(size, baud) * 1e6:.0f} us" for what, size, _ in rows]
    lines.append(f"return delay: {delays} x {delay_us:g} us = {delays * delay_us:.0f} us")
    if usb_s:
        lines.append(f"adapter: {usb_s * 1e6:.0f} us")
    lines.append(f"together {total} bytes at {baud} baud = {seconds * 1e6:.0f} us")
    return Budget(total, seconds, 1.0 / seconds, tuple(lines))
