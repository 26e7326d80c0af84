"""The monitor that fits a bus of a robot file: of serial servos, or of a CAN bus."""

from pathlib import Path

from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.can.motors import CanLimits
from tests.proof.busmon.can.read import is_can, read
from tests.proof.busmon.limits import Limits
from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.protocol1.protocol1_monitor import Protocol1Monitor

AnyLimits = Limits | CanLimits
AnyMonitor = Monitor | Protocol1Monitor | CanMonitor
PORT_BAUD = 1_000_000  # of the adapter's port, where the bus has a bit rate of its own


def limits_of(
    robot_file: Path, calibration_file: Path, bus: str, *, rate_hz: float | None = None
) -> AnyLimits:
    """From the two files. Raises KeyError, ValueError: something is missing or makes no sense."""
    if is_can(robot_file, bus):
        return read(robot_file, calibration_file, bus, rate_hz=rate_hz)
    return Limits.read(robot_file, calibration_file, bus, rate_hz=rate_hz)


def monitor_of(limits: AnyLimits, *, writes: bool = True, hearsay: float = 0.0) -> AnyMonitor:
    """A monitor that has heard nothing yet."""
    if isinstance(limits, CanLimits):
        return CanMonitor(limits, writes=writes, hearsay=hearsay)
    if limits.registers is not None:
        return Protocol1Monitor(limits, writes=writes, hearsay=hearsay)
    return Monitor(limits, writes=writes, hearsay=hearsay)


def port_baud(limits: AnyLimits) -> int:
    """Initial rate of the port to the bus."""
    return PORT_BAUD if isinstance(limits, CanLimits) else limits.baud
