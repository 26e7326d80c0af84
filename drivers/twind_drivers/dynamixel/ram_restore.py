"""Restoring of the RAM settings of one device: after a restart, and after a temporary mode.

A restart resets RAM to its defaults (e-manual, "Reboot"; registers: control table pages, "RAM area"). A
change of mode resets gains, profile and goal limits ("Operating Mode"). Torque, goals and the bus watchdog
are not restored: a caller that needs torque prepares for it anew.
"""

from collections.abc import Mapping

from twind_drivers.bus import DeviceRefused, Script, WriteRequest
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.dynamixel.control_tables import TableRegister
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.servo_command_settings import ServoCommandSettings
from twind_drivers.half_duplex.register_restart import reboot

RESTORED = (
    "led",
    "led_red",
    "led_green",
    "led_blue",
    "status_return_level",
    "velocity_i_gain",
    "velocity_p_gain",
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
    "velocity_ff_gain",  # of a Y, as the next three
    "position_ff_gain",
    "profile_acceleration_time",
    "profile_time",
    "goal_pwm",
    "goal_current",
    "profile_acceleration",
    "profile_velocity",
)
OFF = ("torque_enable", "bus_watchdog")  # registers that must read 0 afterwards
ORDERS = 2  # times that a 0 is sent until it has an effect: one packet may be lost


def restart(
    reader: DynamixelReader, servo: ServoCommandSettings, *, shut_down: bool
) -> Script[RestartResult]:
    """Restart and restore `servo`. Raises NoReply; DeviceRefused while its torque is on.

    `shut_down`: torque enable reads on, but the hardware error (70) has switched the output off. Refused if
    that error reads 0, or if Shutdown (63) ignores it: a restart would then drop the load.
    """
    fields = settings(servo)
    state = [servo.table[name] for name in (*OFF, "hardware_error_status")]
    before = yield from values(reader, servo, fields + state)
    yield from _require_unloaded(reader, servo, before, shut_down=shut_down)
    yield from reboot(reader, servo.id)
    yield from let_go(reader, servo)
    return (yield from give_back(reader, servo, before))


def give_back(
    reader: DynamixelReader, servo: ServoCommandSettings, before: Mapping[str, int]
) -> Script[RestartResult]:
    """Restore the RAM settings `before` on a device without torque and read them back. Raises NoReply."""
    fields = settings(servo)
    fallen = yield from values(reader, servo, fields)
    changed = [field for field in fields if fallen[field.key] != before[field.key]]
    for field in changed:
        if may_return(servo, field, before[field.key]):
            yield WriteRequest({servo.id: field.encode(before[field.key])}, field.address)
    after = (yield from values(reader, servo, fields)) if changed else fallen
    return _compare(fields, before, fallen, after)


def settings(servo: ServoCommandSettings) -> list[TableRegister]:
    """Return the registers that are restored for this model; a current that is a goal is not among them."""
    names = [name for name in RESTORED if name in servo.table and name != servo.mode.goal]
    return [servo.table[name] for name in names]


def may_return(servo: ServoCommandSettings, field: TableRegister, value: int) -> bool:
    """Return False for a goal current above the cap of mode 5; `prepare` sets that register anew."""
    most = field.bounds[1] if servo.cap is None else servo.cap
    return field.key != "goal_current" or 0 <= value <= most


def _require_unloaded(
    reader: DynamixelReader, servo: ServoCommandSettings, state: Mapping[str, int], *, shut_down: bool
) -> Script[None]:
    if state["torque_enable"] == 0:
        return
    if not shut_down:
        reason = "its torque is on and a restart would drop what it carries: disarm, then reboot"
        raise DeviceRefused(reader.name, servo.id, "reboot", reason)
    error = state["hardware_error_status"]
    stops = error  # without the register, as a Y, every error does
    if "shutdown" in servo.table:
        stops &= (yield from reader.read(servo.id, "shutdown")).value
    if stops == 0:
        at = servo.table["hardware_error_status"].address
        reason = (
            f"its torque is on and its hardware error ({at}) is {error}: nothing has shut it down; disarm"
        )
        raise DeviceRefused(reader.name, servo.id, "reboot", reason)


def let_go(reader: DynamixelReader, servo: ServoCommandSettings) -> Script[None]:
    """Switch torque and watchdog off and read them back. Raises DeviceRefused, NoReply.

    Startup configuration (60) can switch torque on at boot, so a restart alone does not remove it.
    """
    fields = [servo.table[name] for name in OFF]
    state = yield from values(reader, servo, fields)
    for field in fields:
        left = state[field.key]
        for _ in range(ORDERS):
            if left:
                yield WriteRequest({servo.id: bytes(field.size)}, field.address)
                left = (yield from reader.read(servo.id, field.key)).value
        if left:
            reason = f"reads {left} and cannot be switched off: cut its supply"
            raise DeviceRefused(reader.name, servo.id, f"{field.name} ({field.address})", reason)


def values(
    reader: DynamixelReader, servo: ServoCommandSettings, fields: list[TableRegister]
) -> Script[dict[str, int]]:
    """Read registers in one transaction; return their values by key."""
    first = min(field.address for field in fields)
    end = max(field.end for field in fields)
    raw = (yield from reader.collect((servo.id,), first, end - first))[servo.id]
    return {field.key: field.decode(raw[field.address - first :]) for field in fields}


def _compare(
    fields: list[TableRegister],
    before: Mapping[str, int],
    fallen: Mapping[str, int],
    after: Mapping[str, int],
) -> RestartResult:
    restored: list[RegisterAddress] = []
    differing: list[tuple[RegisterAddress, int]] = []
    for field in fields:
        now = RegisterAddress(field.name, field.address, field.size, after[field.key])
        if after[field.key] != before[field.key]:
            differing.append((now, before[field.key]))
        elif fallen[field.key] != before[field.key]:
            restored.append(now)
    return RestartResult(tuple(restored), tuple(differing))
