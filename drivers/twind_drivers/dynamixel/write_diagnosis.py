"""Why a device does not hold what it was given: hardware error, watchdog, mode, limit registers.

Read-only scripts. Sync writes are never answered: a refusal is only seen by reading back, and its reason
stands in other registers.
"""

from contextlib import suppress

from twind_drivers.bus import DeviceRefused, NoReply, Script
from twind_drivers.dynamixel.control_tables import TableRegister
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.operating_modes import MODES, POSITION
from twind_drivers.dynamixel.servo_command_state import ServoCommandState

TRIPPED = 255  # what the bus watchdog (98) reads when it has tripped
LIMITED = ("goal_current", "goal_velocity", "goal_pwm")  # each has one register that bounds it


def limit_words(reader: DynamixelReader, id: int, field: TableRegister) -> Script[str]:
    """Name and value of the register that bounds `field`; empty where none does, or the device is silent."""
    if field.rule.limit is not None:
        with suppress(NoReply, DeviceRefused):
            bound = yield from reader.read(id, field.rule.limit)
            return f": {bound.name} ({bound.address}) is {bound.value}"
    return ""


def explain(
    reader: DynamixelReader, servo: ServoCommandState, where: RegisterBlock, data: bytes
) -> Script[str]:
    """What explains that `data` did not stay at `where`: "; reason; reason", empty where nothing does.

    Never raises for a device that does not answer: then only what is known already is said.
    """
    found: list[str] = []
    for look in (_state, _mode, _limits):
        try:
            found += yield from look(reader, servo, where, data)
        except (NoReply, DeviceRefused):
            continue
    return "".join(f"; {reason}" for reason in found)


def _state(
    reader: DynamixelReader, servo: ServoCommandState, where: RegisterBlock, data: bytes
) -> Script[list[str]]:
    place = reader.ids.index(servo.id)
    state = reader.registers
    status = servo.layout.status
    with suppress(NoReply, DeviceRefused):  # then what was read of it before explains
        yield from reader.collect((servo.id,), status.address, status.size)  # kept in `registers`
    if state.fault[place] > 0:
        return [f"hardware error {state.fault[place]:#04x} (register 70): find the cause, then reboot it"]
    return ["its bus watchdog has tripped"] if state.watchdog[place] == TRIPPED else []


def _mode(
    reader: DynamixelReader, servo: ServoCommandState, where: RegisterBlock, data: bytes
) -> Script[list[str]]:
    mode = (yield from reader.read(servo.id, "operating_mode")).value
    if mode == servo.mode.number:
        return []
    name = MODES[mode].name if mode in MODES else "not driven here"
    wanted = f"{servo.mode.number} ({servo.mode.name})"
    return [f"operating mode (11) is {mode} ({name}), {wanted} is needed: disarm, then write register 11"]


def _limits(
    reader: DynamixelReader, servo: ServoCommandState, where: RegisterBlock, data: bytes
) -> Script[list[str]]:
    table = servo.table
    found = []
    for name in (*LIMITED, "goal_position"):
        at = where.offset(table[name]) if name in table else None
        if at is None:
            continue
        wanted = table[name].decode(data[at : at + table[name].size])
        if name == "goal_position":
            if servo.mode.number != POSITION:
                continue
            least = yield from reader.read(servo.id, "min_position_limit")
            most = yield from reader.read(servo.id, "max_position_limit")
            if not least.value <= wanted <= most.value:
                ends = f"{least.value}..{most.value} (registers {least.address}, {most.address})"
                found.append(f"goal {wanted} is outside its position limits {ends}")
            continue
        register = table[name].rule.limit
        if register is None:
            continue
        limit = yield from reader.read(servo.id, register)
        if abs(wanted) > limit.value:
            found.append(f"{wanted} is beyond its {limit.name} {limit.value} (register {limit.address})")
    return found
