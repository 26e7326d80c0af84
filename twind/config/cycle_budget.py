"""The cycle of every bus of a robot at a rate: bytes or frames, µs, Hz reachable; or a refusal."""

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

from twind.config.actuator_types import CAN, CanType, ServoType
from twind.config.config_reader import file_error
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind_drivers.can import can_cycle_budget as can
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.device_layout import layout_of
from twind_drivers.dynamixel.serial_cycle_budget import SerialCycleBudget, budget
from twind_drivers.slow_read_rate import upkeep_stride


class CycleBudget(Protocol):
    """One bus at one rate, whatever hangs on it."""

    @property
    def bus(self) -> BusSpec:
        """The bus, as described in the robot file."""

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is within reach."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""


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


@dataclass(frozen=True, slots=True)
class CanBudget:
    """One CAN bus at one rate."""

    bus: BusSpec
    count: int
    rate_hz: float
    cycle: can.CanCycleBudget

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        why = self.cycle.refusal(self.rate_hz)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """For people: frames and time of a cycle, then the arithmetic."""
        each = self.cycle
        rate = f"{self.bus.baud} bit/s, {self.rate_hz:g} Hz wanted"
        return (
            f"bus {self.bus.name}: {self.count} CAN actuators at {rate}",
            f"  {each.frames:.3g} frames, {each.seconds * 1e6:.0f} us, up to {each.reachable_hz:.0f} Hz",
            *(f"    {line}" for line in each.lines),
        )


def budgets(robot: RobotFile, rate_hz: float) -> tuple[CycleBudget, ...]:
    """The cycle of every bus: goals, reading, upkeep and the adapter's latency. Without joints: none."""
    joints = {bus.name: [joint for joint in robot.joints if joint.bus == bus.name] for bus in robot.buses}
    sensors = {} if robot.imu is None else {robot.imu.bus: robot.imu}
    return tuple(
        _can(bus, joints[bus.name], rate_hz)
        if bus.kind == CAN
        else _serial(bus, joints[bus.name], rate_hz, sensors.get(bus.name))
        for bus in robot.buses
        if joints[bus.name]
    )


def require_rate(robot: RobotFile, rate_hz: float) -> tuple[CycleBudget, ...]:
    """`budgets`, every one within reach. Raises ConfigError with the arithmetic of the first that is not."""
    found = budgets(robot, rate_hz)
    for each in found:
        if each.refusal is not None:
            raise file_error(str(robot.path), each.refusal)
    return found


def _can(bus: BusSpec, joints: list[JointSpec], rate_hz: float) -> CanBudget:
    families = Counter(joint.type.family for joint in joints if isinstance(joint.type, CanType))
    return CanBudget(bus, len(joints), rate_hz, can.budget(families, bus.baud, rate_hz))


def _serial(bus: BusSpec, joints: list[JointSpec], rate_hz: float, imu: ImuSpec | None) -> BusBudget:
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


def _groups(joints: list[JointSpec]) -> tuple[int, ...]:
    """Joints of each register layout; of an unknown or undrivable device, which is refused elsewhere: one."""
    try:
        found = Counter(layout_of(table(number_of(joint.type.device))) for joint in joints)
    except (KeyError, ValueError):
        return (len(joints),)
    return tuple(found.values())
