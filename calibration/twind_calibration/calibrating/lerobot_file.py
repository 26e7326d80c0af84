"""Reader of LeRobot calibration files: values by motor. Pure: text in, values out.

Its JSON has an object a motor: id, drive_mode, homing_offset, range_min, range_max. The range is in counts
that the servo told with that homing offset written into it. Nothing is guessed and nothing is left out:
whatever is not of this shape is refused with words.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twind.command_line.verb import Rejected
from twind.config.calibrated_device import MAX_TICKS
from twind.exceptions import InvalidInput
from twind.protocol.strict_json import loads

LARGEST = 256 << 10  # bytes
FIELDS = {
    "id": (0, 252),
    "drive_mode": (0, 255),
    "homing_offset": (-MAX_TICKS, MAX_TICKS),
    "range_min": (-MAX_TICKS, MAX_TICKS),
    "range_max": (-MAX_TICKS, MAX_TICKS),
}
SHAPE = '{"NAME": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 700, "range_max": 3200}, ...}'
LISTS = "motor_names"  # of the older format: lists whose order is the only key


@dataclass(frozen=True, slots=True)
class LeRobotMotor:
    """One motor, in counts of its servo."""

    name: str
    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int


def read(data: bytes, file: str) -> dict[str, LeRobotMotor]:
    """Name -> motor. Raises Rejected: no JSON, another shape, a field too many or too few."""
    try:
        told = loads(data)
    except InvalidInput as error:
        raise Rejected(f"{file}: {error}") from None
    if isinstance(told, dict) and (LISTS in told or any(isinstance(each, list) for each in told.values())):
        raise Rejected(
            f"{file}: lists, in whose order alone stands which motor is meant, are not taken: have LeRobot "
            f"calibrate again, and give the file that it writes then: {SHAPE}"
        )
    if not isinstance(told, dict) or not told:
        raise Rejected(f"{file}: {_kind(told)} where an object of motors must be: {SHAPE}")
    return {name: _motor(name, each, file) for name, each in told.items()}


def _motor(name: str, entry: Any, file: str) -> LeRobotMotor:
    if not isinstance(entry, Mapping):
        raise Rejected(f"{file}: {name}: {_kind(entry)} where an object must be: {SHAPE}")
    unknown = [key for key in entry if key not in FIELDS]
    missing = [key for key in FIELDS if key not in entry]
    if unknown:
        raise Rejected(
            f"{file}: {name}.{unknown[0]} cannot be expressed: a calibration here knows {', '.join(FIELDS)}"
        )
    if missing:
        raise Rejected(f"{file}: {name}.{missing[0]} is missing")
    values = {key: _parse_integer(f"{name}.{key}", entry[key], file) for key in FIELDS}
    motor = LeRobotMotor(name, **values)
    if not motor.range_min < motor.range_max:
        raise Rejected(
            f"{file}: {name}: range_min {motor.range_min} is not below range_max {motor.range_max}: was it "
            "measured across the seam of the encoder?"
        )
    return motor


def _parse_integer(path: str, value: Any, file: str) -> int:
    low, high = FIELDS[path.rpartition(".")[2]]
    if isinstance(value, bool) or not isinstance(value, int):
        raise Rejected(f"{file}: {path} is {_kind(value)}, not a whole number")
    if not low <= value <= high:
        raise Rejected(f"{file}: {path} is {value}, outside {low}..{high}")
    return value


def _kind(value: Any) -> str:
    """Describe a value in a message."""
    if isinstance(value, str):
        return f"the text {value[:40]!r}"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, int | float):
        return f"{value!r}"
    return "a list" if isinstance(value, list) else "an object"
