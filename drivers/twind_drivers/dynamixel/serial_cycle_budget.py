"""Cost of a cycle on the wire: bytes, seconds, reachable rate, refusal with the arithmetic. Pure.

10 bits a byte (8N1). Sources: e-manual "Protocol 2.0" for the packet sizes; a return delay counts once per
status, so N times for a plain sync read and once for a fast one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor

from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.wire_cycle_budget import WireCycleBudget

CYCLIC = 10  # bytes read of each device every cycle: current or load 2, velocity 4, position 4
GOAL = 4  # bytes written to each device every cycle
STATUS_BLOCK = 35  # torque enable .. bus watchdog
STATE_BLOCK = 7  # torque enable .. hardware error
WATCHDOG = 1
HEALTH_BLOCK = 27  # realtime tick .. input voltage, temperature
# lowest refresh rates of the slow registers
STATUS_HZ = 20.0
HEALTH_HZ = 5.0


def sync_request(count: int) -> int:
    """Return the bytes of a (fast) sync read request to `count` devices."""
    return 14 + count


def plain_reply(count: int, size: int) -> int:
    """Return the bytes of `count` statuses of `size` data bytes each."""
    return count * (11 + size)


def fast_reply(count: int, size: int) -> int:
    """Return the bytes of one fast reply of `count` devices."""
    return 8 + count * (4 + size)


def bulk_request(count: int) -> int:
    """Return the bytes of a (fast) bulk read request to `count` devices, with address and size of each."""
    return 10 + 5 * count


def sync_write(count: int, size: int) -> int:
    """Return the bytes of a sync write of `size` bytes to each of `count` devices."""
    return 14 + count * (1 + size)


def slice_bytes(count: int, size: int, *, fast: bool) -> int:
    """Return the bytes of one read of `size` bytes of `count` devices, both directions."""
    return sync_request(count) + (fast_reply if fast else plain_reply)(count, size)


@dataclass(frozen=True, slots=True)
class SlowReadSchedule:
    """Round robin of the slow registers: in `slots` calls the status of all devices, one slice of health.

    Called f times a second, `slots = floor(f / 20 Hz)`; one call in a round reads the health of `health`
    devices (all of them in 4 rounds, 1/5 s), the others the status of all, in as few slices as have room. The
    calls left over read nothing. Below 40 Hz two slots are the least, and the refresh is half the call rate.

    A plain read costs a return delay and 11 bytes a device, so status is one block (torque .. watchdog, 35
    bytes) of `state` devices a call. A fast read costs 4 bytes, so for many devices the 27 bytes between the
    hardware error and the watchdog are not worth it: the first 7 of `state` devices, and in other calls the
    watchdog of `watch` devices. At 100 Hz and 24 devices, with the least room: 4 x 6 plainly; fast 3 x 8 and
    1 x 24.
    """

    slots: int
    state: int  # devices in a slice of the (first) status block
    watch: int  # devices in a slice of the watchdog; 0: it stands in the status block
    health: int  # devices in a health slice
    fast: bool  # slices are fast reads

    @property
    def status_rows(self) -> list[tuple[int, int]]:
        """Devices and bytes of each device in the slices of the status."""
        split = [(self.state, STATE_BLOCK), (self.watch, WATCHDOG)]
        return split if self.watch else [(self.state, STATUS_BLOCK)]

    @property
    def most(self) -> int:
        """Bytes of the longest slice, both directions."""
        rows = [*self.status_rows, (self.health, HEALTH_BLOCK)]
        return max(slice_bytes(count, size, fast=self.fast) for count, size in rows)


def upkeep(
    groups: Sequence[int],
    rate_hz: float,
    *,
    fast: bool = False,
    fits: Callable[[int, int], bool] = lambda _count, _size: False,
) -> SlowReadSchedule:
    """Make the round robin that refreshes all registers at STATUS_HZ and HEALTH_HZ with `rate_hz` calls.

    `groups`: devices of each register layout; one slice holds devices of one layout. `fits(count, size)`:
    a read of `size` bytes of `count` devices has room beside the cyclic reading. The status takes as few
    slices as fit, since each transaction costs the processor as much as a short one. Where none fits, or
    without `fits`, the slices are as short as the refresh rates allow.
    """
    slots = max(2, floor(rate_hz / STATUS_HZ + 1e-9))
    health = _cut(groups, max(1, round(STATUS_HZ / HEALTH_HZ)))
    turns = slots - 1
    for status in range(len(groups), turns):
        for watching in range(status - len(groups) + 1 if fast else 1):
            if 0 < watching < len(groups):
                continue
            watch = _cut(groups, watching) if watching else 0
            plan = SlowReadSchedule(slots, _cut(groups, status - watching), watch, health, fast)
            if all(fits(count, size) for count, size in plan.status_rows):
                return plan
    if not fast or turns < 2 * len(groups):
        return SlowReadSchedule(slots, _cut(groups, turns), 0, health, fast)
    each = (STATE_BLOCK + 4, WATCHDOG + 4)  # bytes of a device in either block
    watching = min(turns - len(groups), max(len(groups), round(turns * each[1] / sum(each))))
    return SlowReadSchedule(slots, _cut(groups, turns - watching), _cut(groups, watching), health, fast)


def _cut(groups: Sequence[int], turns: int) -> int:
    """Return the devices per slice, so that `turns` slices hold all; layouts do not share a slice."""
    size = ceil(sum(groups) / turns)
    while size < max(groups, default=0) and sum(ceil(count / size) for count in groups) > turns:
        size += 1
    return max(1, size)


@dataclass(frozen=True, slots=True)
class SerialCycleBudget(WireCycleBudget):
    """Budget of one serial bus's cycle."""

    bytes: int  # of a whole cycle: goals, request, replies, upkeep slice


def budget(
    count: int,
    baud: int,
    *,
    fast: bool,
    return_delay_us: float,
    upkeep_hz: float | None = None,
    usb_s: float = 0.0,
    groups: Sequence[int] = (),
    sensor: tuple[int, float] | None = None,
) -> SerialCycleBudget:
    """Return the budget of a cycle: goals, cyclic reading, with `upkeep_hz` the longest slice.

    `groups`: devices of each register layout if there are several: read by bulk read, written in one packet
    for each. `usb_s`: time that the adapter adds to each transaction, s. `sensor`: bytes and return delay
    (us) of a sensor on the bus. Raises ValueError for no devices or no baud rate.
    """
    if count < 1 or baud < 1:
        raise ValueError(f"a budget needs devices and a baud rate, got {count} and {baud}")
    reply = fast_reply(count, CYCLIC) if fast else plain_reply(count, CYCLIC)
    rows: list[tuple[str, int, int]] = []  # what, bytes, return delays
    mixed = len(groups) > 1
    rows.append((f"goals to {count}", sum(sync_write(each, GOAL) for each in groups or (count,)), 0))
    kind = ("fast " if fast else "") + ("bulk read" if mixed else "sync read")
    rows.append((f"{kind} request", (bulk_request if mixed else sync_request)(count), 0))
    rows.append((f"{kind} reply, {CYCLIC} bytes of {count}", reply, 1 if fast else count))
    transactions = 1
    if upkeep_hz is not None:
        plan = upkeep(groups or (count,), upkeep_hz, fast=fast)
        delays = 1 if plan.watch else max(plan.state, plan.health)
        rows.append((f"longest slice of upkeep ({plan.state} a slice)", plan.most, delays))
        transactions = 2
    own = 0.0
    if sensor is not None:
        rows.append((f"reading of a sensor, {sensor[0]} bytes", 14 + 11 + sensor[0], 0))
        own = sensor[1]
        transactions = transactions + 1
    return sum_up(rows, baud, return_delay_us, transactions * usb_s, own)


def sum_up(
    rows: Sequence[tuple[str, int, int]], baud: int, delay_us: float, usb_s: float, own_us: float
) -> SerialCycleBudget:
    """Add up the rows (text, bytes, return delays). `own_us`: return delay of a sensor."""
    total = sum(size for _, size, _ in rows)
    delays = sum(each for _, _, each in rows)
    seconds = wire(total, baud) + (delays * delay_us + own_us) * 1e-6 + usb_s
    lines = [f"{what}: {size} bytes = {wire(size, baud) * 1e6:.0f} us" for what, size, _ in rows]
    lines.append(f"return delay: {delays} x {delay_us:g} us = {delays * delay_us:.0f} us")
    if own_us:
        lines.append(f"return delay of the sensor: {own_us:g} us")
    if usb_s:
        lines.append(f"adapter: {usb_s * 1e6:.0f} us")
    lines.append(f"together {total} bytes at {baud} baud = {seconds * 1e6:.0f} us")
    return SerialCycleBudget(seconds, 1.0 / seconds, tuple(lines), total)
