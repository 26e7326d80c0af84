"""Cycle of a serial bus of servos at a rate: bytes, µs, Hz reachable; or a refusal."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.driver_family import BudgetRequest
from twind.config.robot_spec import BusSpec, JointSpec
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.device_layout import layout_of
from twind_drivers.dynamixel.serial_cycle_budget import SerialCycleBudget, budget
from twind_drivers.dynamixel.servo_type import ServoType
from twind_drivers.slow_read_rate import upkeep_stride


@dataclass(frozen=True, slots=True)
class BusBudget:
    """One serial bus at one rate. `plain` is what every servo can do, `fast` needs newer firmware."""

    bus: BusSpec
    count: int
    rate_hz: float
    plain: SerialCycleBudget
    fast: SerialCycleBudget

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach even with fast reads; None: it is not."""
        why = self.fast.refusal(self.rate_hz)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """For people: one line per way of reading, then the arithmetic of the slower one."""
        head = f"bus {self.bus.name}: {self.count} servos at {self.bus.baud} baud, {self.rate_hz:g} Hz wanted"
        rows = [
            f"  {name}: {each.bytes} bytes, {each.seconds * 1e6:.0f} us, up to {each.reachable_hz:.0f} Hz"
            for name, each in (("sync read", self.plain), ("fast sync read", self.fast))
        ]
        return (head, *rows, *(f"    {line}" for line in self.plain.lines))


def servo_budget(request: BudgetRequest) -> BusBudget:
    """Return the cycle of a serial bus: goals, reading, upkeep and the adapter's latency."""
    bus = request.bus
    joints = request.joints
    rate_hz = request.rate_hz
    imu = request.imu
    delay = max(joint.type.return_delay_us for joint in joints if isinstance(joint.type, ServoType))
    latency = bus.latency_timer_ms * 1e-3
    groups = _groups(joints)
    # A reply that does not fill the adapter's buffer ends on its latency timer: one period at most.
    plain, fast = (
        budget(
            len(joints),
            bus.baud,
            fast=way,
            return_delay_us=delay,
            upkeep_hz=rate_hz / upkeep_stride(rate_hz),
            usb_s=latency,
            groups=groups,
            sensor=None if imu is None else (imu.span[1], imu.return_delay_us),
        )
        for way in (False, True)
    )
    return BusBudget(bus, len(joints), rate_hz, plain, fast)


def _groups(joints: Sequence[JointSpec]) -> tuple[int, ...]:
    """Joints of each register layout; of an unknown or undrivable device, which is refused elsewhere: one."""
    try:
        found = Counter(layout_of(table(number_of(joint.type.device))) for joint in joints)
    except (KeyError, ValueError):
        return (len(joints),)
    return tuple(found.values())
