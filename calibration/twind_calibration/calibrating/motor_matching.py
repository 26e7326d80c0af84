"""Assignment of a foreign file's motors to actuators: by a map file, else by id. Pure."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

from twind.command_line.verb import Rejected
from twind.config.config_reader import ConfigReader, Text
from twind.config.yaml_tree import parse
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.lerobot_file import LeRobotMotor

Names = Mapping[str, str | None]  # motor -> actuator; None: to be left out


def read_map(text: str, file: str) -> Names:
    """`MOTOR: ACTUATOR` a line; `MOTOR: null` leaves it out. Raises ConfigError."""
    section = ConfigReader(file, parse(text, file))
    return {name: None if section.plain(name) is None else section.value(name, Text) for name in section}


def matched(
    motors: Mapping[str, LeRobotMotor], slots: Sequence[CalibrationActuator], names: Names | None
) -> dict[str, LeRobotMotor]:
    """Return the motor of each actuator. Raises Rejected: an unassigned motor, or two of one actuator."""
    found: dict[str, LeRobotMotor] = {}
    for motor in motors.values():
        slot = _by_id(motor, slots) if names is None else _find_slot(motor, slots, names)
        if slot is None:
            continue
        if slot.name in found:
            raise Rejected(f"{motor.name} and {found[slot.name].name} are both {slot.name}")
        if slot.joint.id != motor.id:
            raise Rejected(f"{motor.name} has id {motor.id}, and {slot.name} has id {slot.joint.id}")
        found[slot.name] = motor
    unknown = set(names or ()) - set(motors)
    if unknown:
        raise Rejected(f"the map names {sorted(unknown)[0]}, which is no motor: {', '.join(motors)}")
    return found


def _by_id(motor: LeRobotMotor, slots: Sequence[CalibrationActuator]) -> CalibrationActuator:
    same = [slot for slot in slots if slot.joint.id == motor.id]
    if not same:
        raise Rejected(
            f"{motor.name} has id {motor.id}, which is no actuator's: `--map FILE` says which it is"
        )
    if len(same) > 1:
        both = " and ".join(f"{slot.name} on bus {slot.joint.bus}" for slot in same)
        raise Rejected(f"{motor.name} has id {motor.id}, as have {both}: `--map FILE` says which it is")
    return same[0]


def _find_slot(
    motor: LeRobotMotor, slots: Sequence[CalibrationActuator], names: Names
) -> CalibrationActuator | None:
    if motor.name not in names:
        raise Rejected(f"the map does not name {motor.name}: `{motor.name}: null` leaves it out")
    wanted = names[motor.name]
    if wanted is None:
        return None
    known = {slot.name: slot for slot in slots}
    if wanted not in known:
        near = get_close_matches(wanted, known, 1)
        hint = f"nearest: {near[0]}" if near else f"there are {', '.join(known)}"
        raise Rejected(f"the map calls {motor.name} {wanted!r}, which is no actuator; {hint}")
    return known[wanted]
