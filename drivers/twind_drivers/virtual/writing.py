"""What a servo does with a write: which error it answers, and what follows from a register that changed.

Errors by e-manual "Protocol 2.0", section Error: 4 range (and any goal while the bus watchdog has tripped),
5 length, 6 limit register, 7 access (read-only, undefined, EEPROM while torque is on). All or nothing.
"""

from twind_drivers.dynamixel.packet import Error
from twind_drivers.dynamixel.tables import Field
from twind_drivers.virtual.servos import TORQUE_BY_GOAL, Servos

MODES = frozenset({3, 4, 5})  # simulated; 0, 1 and 16 are refused as out of range
DRIVE_MODES = frozenset({0, 1, 8, 9})  # reverse, torque on by goal; slave and time-based profile are refused
GOALS = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})


def write(servos: Servos, row: int, address: int, data: bytes) -> Error:
    """Write `data` to one servo as its firmware would; `servos.changed` must follow. Returns the error."""
    changes: list[tuple[Field, int]] = []
    layout, place = servos.memory.layouts[row], address
    if not data:
        return Error.DATA_LENGTH
    while place < address + len(data):
        register = layout.get(place)
        if register is None:
            return Error.ACCESS
        if register.end > address + len(data):
            return Error.DATA_LENGTH
        value = register.decode(data[place - address :])
        error = _judge(servos, row, register, value)
        if error:
            return error
        changes.append((register, value))
        place = register.end
    for register, value in changes:
        if register.key != "torque_enable":  # `torque` compares with what is there
            servos.memory.store(row, register, value)
        _follow(servos, row, register.key, value)
    return Error.NONE


def _judge(servos: Servos, row: int, register: Field, value: int) -> Error:
    rule, key = register.rule, register.key
    if not rule.writable or (register.eeprom and servos["torque_enable"][row]):
        return Error.ACCESS
    if not register.takes(value) or not _simulated(key, value):
        return Error.DATA_RANGE
    if servos.tripped[row] and (key in GOALS or (key == "bus_watchdog" and value != 0)):
        return Error.DATA_RANGE
    if rule.limit and rule.limit in servos.memory.tables[row]:
        limit = servos.memory.tables[row][rule.limit]
        if abs(value) > servos.memory.value(row, limit):
            return Error.DATA_LIMIT
    if key == "goal_position" and not servos.allows(row, value):
        return Error.DATA_LIMIT
    return Error.NONE


def _simulated(key: str, value: int) -> bool:
    if key == "operating_mode":
        return value in MODES
    if key == "drive_mode":
        return value in DRIVE_MODES
    return key != "protocol_type" or value == 2


def _follow(servos: Servos, row: int, key: str, value: int) -> None:
    """What a register that was just stored sets off."""
    match key:
        case "torque_enable":
            servos.torque(row, bool(value))
        case "operating_mode":
            servos.power.reset_mode(row)
        case "drive_mode":
            servos.power.reframe(row, one_turn=servos["operating_mode"][row] == 3)
        case "homing_offset":
            servos.power.reframe(row, one_turn=False)
        case "bus_watchdog" if value == 0:
            servos.untrip(row)
        case "goal_position" if servos["drive_mode"][row] & TORQUE_BY_GOAL:
            servos.torque(row, True)
            servos.registers.put("goal_position", value, row)
