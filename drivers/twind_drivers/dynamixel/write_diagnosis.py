"""Diagnosis of a write that a device did not keep: hardware error, watchdog, mode, limit registers.

The scripts only read. Sync writes have no reply: a refusal is only visible in the read-back, and its reason
in other registers.
"""

from contextlib import suppress

from twind_drivers.bus import DeviceRefused, NoReply, Script
from twind_drivers.dynamixel.control_tables import TableRegister
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.operating_modes import MODES, POSITION
from twind_drivers.dynamixel.servo_command_settings import ServoCommandSettings

TRIPPED = 255  # reading of the bus watchdog (98) after it has tripped
LIMITED = ("goal_current", "goal_velocity", "goal_pwm")  # each has one register that bounds it


def limit_words(reader: DynamixelReader, id: int, field: TableRegister) -> Script[str]:
    """Return name and value of the register that bounds `field`; empty for none or a silent device."""
    if field.rule.limit is not None:
        with suppress(NoReply, DeviceRefused):
            bound = yield from reader.read(id, field.rule.limit)
            return f": {bound.name} ({bound.address}) is {bound.value}"
    return ""


def explain(
    reader: DynamixelReader, servo: ServoCommandSettings, where: RegisterBlock, data: bytes
) -> Script[str]:
    """Return the reasons why `data` did not stay at `where`: "; reason; reason", empty without any.

    Never raises for a silent device: then only the values already in `registers` are used.
    """
    found: list[str] = []
    for look in (_state, _mode, _limits):
        try:
            found += yield from look(reader, servo, where, data)
        except (NoReply, DeviceRefused):
            continue
    return "".join(f"; {reason}" for reason in found)


def _state(
    reader: DynamixelReader, servo: ServoCommandSettings, where: RegisterBlock, data: bytes
) -> Script[list[str]]:
    place = reader.ids.index(servo.id)
    state = reader.registers
    for block in servo.layout.status:
        with suppress(NoReply, DeviceRefused):  # without a reply the values read before serve
            yield from reader.collect((servo.id,), block.address, block.size)  # kept in `registers`
    if state.fault[place] > 0:
        at = servo.table["hardware_error_status"].address
        return [f"hardware error {state.fault[place]:#04x} (register {at}): find the cause, then reboot it"]
    return ["its bus watchdog has tripped"] if state.watchdog[place] == TRIPPED else []


def _mode(
    reader: DynamixelReader, servo: ServoCommandSettings, where: RegisterBlock, data: bytes
) -> Script[list[str]]:
    mode = (yield from reader.read(servo.id, "operating_mode")).value
    if mode == servo.mode.number:
        return []
    name = MODES[mode].name if mode in MODES else "not driven here"
    wanted = f"{servo.mode.number} ({servo.mode.name})"
    at = servo.table["operating_mode"].address
    return [f"operating mode ({at}) is {mode} ({name}), {wanted} is needed: disarm, then write register {at}"]


def _limits(
    reader: DynamixelReader, servo: ServoCommandSettings, where: RegisterBlock, data: bytes
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
