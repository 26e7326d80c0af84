"""Required register values of a new servo, and the order of their writes. Pure.

The daemon compares registers and never writes them (`config.servo_check`): here they are made what it asks.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from twind.command_line.verb import Rejected
from twind.config.robot_spec import JointSpec
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.dynamixel_identification import SETTINGS
from twind_drivers.dynamixel.servo_check import SECONDARY, unfit
from twind_drivers.dynamixel.servo_type import ServoType

REPORTS = ("torque_enable", "hardware_error_status")  # never written here
ANSWERS_ALL = 2  # status return level (68): pings, reads and writes are answered
OFF = 255  # second id (12): none
FIRST = ("status_return_level", "operating_mode", "drive_mode")  # a change of mode resets other registers


@dataclass(frozen=True, slots=True)
class RegisterStep:
    """One register that holds `now` and is to hold `then`."""

    register: str
    address: int
    now: int
    then: int

    def __str__(self) -> str:
        return f"{self.register} ({self.address}): {self.now} -> {self.then}"


def looked_at(table: ControlTable) -> tuple[str, ...]:
    """The registers that are read of a servo, by name: those that the daemon identifies it by."""
    return tuple(key for key in SETTINGS if key in table)


def required_registers(joint: JointSpec, table: ControlTable) -> dict[str, int]:
    """Return the required values by register; without a requirement the factory default.

    A register without a documented default and without a required value is left out.
    """
    kind = joint.type
    assert isinstance(kind, ServoType)
    own = {
        "status_return_level": ANSWERS_ALL,
        "operating_mode": joint.operating_mode,
        "drive_mode": 0,  # sign and offset live in the daemon's files, not in the servo
        "homing_offset": 0,
        "startup_configuration": 0,
        "return_delay_time": kind.return_delay_us // 2,
        **dict.fromkeys(SECONDARY, OFF),
        **joint.registers,
    }
    found = {key: own.get(key, table[key].rule.default) for key in looked_at(table) if key not in REPORTS}
    return {key: value for key, value in found.items() if value is not None}


def plan(
    joint: JointSpec, table: ControlTable, firmware: int, now: Mapping[str, int]
) -> tuple[RegisterStep, ...]:
    """The registers that differ, in the order to write them; `now`: what they hold (`looked_at`).

    Raises Rejected before anything is written: a value that the servo does not take, and a servo that the
    daemon would still not accept afterwards, with the reasons.
    """
    target = required_registers(joint, table)
    after = IdentifiedDevice(joint.id, table.number, table.model, firmware, {**now, **target})
    if wrong := list(unfit(joint, after, table.facts)):
        raise Rejected(f"{joint.name}: adopted, the daemon would refuse it all the same: {'; '.join(wrong)}")
    differing = [key for key, value in target.items() if now.get(key) != value]
    for key in differing:
        try:
            table[key].check(target[key])
        except ValueError as error:
            raise Rejected(f"{joint.name}: {error}; correct the robot file") from None
    order = sorted(differing, key=lambda key: FIRST.index(key) if key in FIRST else len(FIRST))
    return tuple(RegisterStep(key, table[key].address, now[key], target[key]) for key in order if key in now)


def different(joint: JointSpec, table: ControlTable, firmware: int, now: Mapping[str, int]) -> Iterator[str]:
    """Yield the differences of a servo's registers from the required values, as text; none: it is adopted."""
    device = IdentifiedDevice(joint.id, table.number, table.model, firmware, now)
    yield from unfit(joint, device, table.facts)
    for key, value in required_registers(joint, table).items():
        if now.get(key) != value:
            yield f"{key} ({table[key].address}) is {now.get(key)}, not {value}"
