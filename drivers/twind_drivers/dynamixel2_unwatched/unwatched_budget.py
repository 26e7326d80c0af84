"""Cycle of a bus of XL-320 or PRO -R: bytes, seconds, reachable rate; or a refusal with the arithmetic."""

from dataclasses import dataclass

from twind.config.driver_family import BudgetRequest
from twind.config.robot_spec import BusSpec
from twind_drivers.dynamixel.serial_cycle_budget import (
    SerialCycleBudget,
    plain_reply,
    slice_bytes,
    sum_up,
    sync_request,
    sync_write,
)
from twind_drivers.dynamixel2_unwatched.unwatched_servo_type import UnwatchedServoType
from twind_drivers.half_duplex.slow_register_slices import ROUNDS_HZ
from twind_drivers.slow_read_rate import upkeep_stride


@dataclass(frozen=True, slots=True)
class UnwatchedBudget:
    """One bus at one rate."""

    bus: BusSpec
    count: int
    rate_hz: float
    plain: SerialCycleBudget

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        why = self.plain.refusal(self.rate_hz)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""
        found = self.plain
        return (
            f"bus {self.bus.name}: {self.count} servos at {self.bus.baud} baud, {self.rate_hz:g} Hz wanted",
            f"  {found.bytes} bytes, {found.seconds * 1e6:.0f} us, up to {found.reachable_hz:.0f} Hz",
            *(f"    {line}" for line in found.lines),
        )


def unwatched_budget(request: BudgetRequest) -> UnwatchedBudget:
    """Return the cycle of a bus: goals, reading, upkeep and the adapter's latency."""
    kinds = [joint.type for joint in request.joints if isinstance(joint.type, UnwatchedServoType)]
    count = len(kinds)
    layout = kinds[0].layout
    goal = layout.table["goal_position"].size
    size = layout.row.itemsize
    upkeep_hz = request.rate_hz / upkeep_stride(request.rate_hz)
    slots = max(1, int(upkeep_hz / ROUNDS_HZ + 1e-9) - len(layout.slow) + 1)
    part = -(-count // slots)  # devices of one slow read
    rows = [
        (f"goals to {count}", sync_write(count, goal), 0),
        ("sync read request", sync_request(count), 0),
        (f"sync read reply, {size} bytes of {count}", plain_reply(count, size), count),
        (f"longest slice of upkeep ({part} a slice)", slice_bytes(part, layout.slow[0][1], fast=False), part),
    ]
    delay = max(kind.return_delay_us for kind in kinds)
    found = sum_up(rows, request.bus.baud, delay, 2.0 * request.bus.latency_timer_ms * 1e-3, 0.0)
    return UnwatchedBudget(request.bus, count, request.rate_hz, found)
