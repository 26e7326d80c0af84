"""Write instruction of a servo: its error, and the effects of changed registers.

Errors by e-manual "Protocol 2.0", section Error: 4 range (and any goal while the bus watchdog has tripped), 5
length, 6 limit register, 7 access (read-only, undefined, EEPROM while torque is on). All or nothing.
"""

from twind_drivers.dynamixel.control_tables import TableRegister
from twind_drivers.dynamixel.packet import StatusErrorCode
from twind_drivers.virtual.drive_firmware import REVERSE, SLAVE, TIMED, TORQUE_BY_GOAL, WANTED
from twind_drivers.virtual.virtual_servos import VirtualServos

GOALS = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})
TIMED_FROM = 42  # firmware of X and MX
Changes = list[tuple[TableRegister, int]]


def write(
    servos: VirtualServos, row: int, address: int, data: bytes, *, shadow: bool = False
) -> StatusErrorCode:
    """Write `data` to one servo as its firmware would; `servos.changed` must follow. Returns the error.

    `shadow`: the packet came to the secondary id, which reaches RAM only (e-manual, "Secondary(Shadow) ID").
    """
    changes: Changes = []
    error = _judge_all(servos, row, address, data, changes, shadow=shadow)
    if error:
        return error
    for register, value in changes:
        if register.key != "torque_enable":  # `torque` compares with what is there
            servos.memory.store(row, register, value)
        _follow(servos, row, register.key, value)
    return StatusErrorCode.NONE


def judge(
    servos: VirtualServos, row: int, address: int, data: bytes, *, shadow: bool = False
) -> StatusErrorCode:
    """Return the error that `write` would give now; nothing is written."""
    return _judge_all(servos, row, address, data, [], shadow=shadow)


def _judge_all(
    servos: VirtualServos, row: int, address: int, data: bytes, changes: Changes, *, shadow: bool
) -> StatusErrorCode:
    """Check every register of the span, into `changes`. Indirect data is the register that it points at."""
    layout = servos.memory.layouts[row]
    end = address + len(data)
    if not data:
        return StatusErrorCode.DATA_LENGTH
    if end > servos.memory.where.shape[1]:
        return StatusErrorCode.ACCESS
    where: list[int] = servos.memory.where[row, address:end].tolist()
    place = 0
    while place < len(data):
        register = layout.get(where[place])
        if register is None:
            return StatusErrorCode.ACCESS
        follows = place + register.size
        if where[place:follows] != list(range(register.address, register.end)):
            return StatusErrorCode.DATA_LENGTH  # also of indirect data that maps only a part of a register
        value = register.decode(data[place:follows])
        error = StatusErrorCode.ACCESS if shadow and register.eeprom else _judge(servos, row, register, value)
        if error:
            return error
        changes.append((register, value))
        place = follows
    return StatusErrorCode.NONE


def _judge(servos: VirtualServos, row: int, register: TableRegister, value: int) -> StatusErrorCode:
    rule = register.rule
    key = register.key
    if not rule.writable or (register.eeprom and servos["torque_enable"][row]):
        return StatusErrorCode.ACCESS
    if not register.takes(value) or (key == "drive_mode" and value & ~_drive_bits(servos, row)):
        return StatusErrorCode.DATA_RANGE
    if servos.tripped[row] and (key in GOALS or (key == "bus_watchdog" and value != 0)):
        return StatusErrorCode.DATA_RANGE
    if rule.limit and rule.limit in servos.memory.tables[row]:
        limit = servos.memory.tables[row][rule.limit]
        if abs(value) > servos.memory.value(row, limit):
            return StatusErrorCode.DATA_LIMIT
    if key == "goal_position" and not servos.allows(row, value):
        return StatusErrorCode.DATA_LIMIT
    return StatusErrorCode.NONE


def _drive_bits(servos: VirtualServos, row: int) -> int:
    """Return the bits of this model and firmware (e-manual, "Drive Mode"); the others are always 0."""
    table = servos.memory.tables[row]
    firmware = servos.memory.firmwares[row]
    since = table.facts.torque_on_by_goal_from
    bits = REVERSE
    if table.stem == "mx_106" or ("540" in table.stem and not table.stem.startswith("xw")):
        bits |= SLAVE
    if firmware >= TIMED_FROM or not table.stem.startswith(("x", "2x", "mx")):
        bits |= TIMED
    return bits if since is None or firmware < since else bits | TORQUE_BY_GOAL


def _follow(servos: VirtualServos, row: int, key: str, value: int) -> None:
    """Apply the effects of a register that was just stored."""
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
        case _ if key.startswith("indirect_address_"):
            servos.memory.remap(row)
        case _ if key in GOALS and servos["drive_mode"][row] & TORQUE_BY_GOAL:
            mode = int(servos["operating_mode"][row])
            if key == f"goal_{WANTED.get(mode, 'position')}":
                servos.torque(row, True)
                servos.registers.put(key, value, row)
