"""Is a serial servo one that a joint can have? Registers as identified in, texts out. Pure.

Registers are compared and named, never written. What is not known refuses, but is not called wrong.
"""

from collections.abc import Iterator, Mapping

from twind.config.actuator_types import DeviceWarning, ExpectedDevice
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.control_tables import ControlTable

NEEDED = ("operating_mode", "homing_offset", "drive_mode")  # every model but the gripper has them
SECONDARY = ("secondary_shadow_id", "secondary_id")  # the second id, by the model's table
MAX_ID = 252  # above it the second id is off (e-manual, address 12) ...
OFF = 255  # ... as delivered
# startup configuration, bits 0 and 1
TORQUE_AT_BOOT = 0b0001
RAM_AT_BOOT = 0b0010
# bits of drive mode that must be 0
DRIVE_BITS = {
    0b0010: "bit 1, slave, must be 0: it follows the cable of another servo, not its goals",
    0b1000: "bit 3, torque on by goal update, must be 0",
    0b0100: "bit 2, time-based profile, must be 0: a speed limit written to it would be a time",
}


def unfit(joint: ExpectedDevice, device: IdentifiedDevice, known: ControlTable) -> Iterator[str]:
    """Yield the reasons why this servo is unusable for this joint, whatever the calibration says.

    `known`: table of the model that the joint needs. The registers of another model are not compared.
    """
    settings = device.settings
    if device.model_name != known.model:
        found = device.model_name or "a model that is in no table"
        yield f"is {found} (model number {device.model_number}), the robot file says {joint.type.device}"
        return
    yield from _wrong_mode(joint, settings, known)
    yield from _shadowing(settings, known)
    unread = [register for register in NEEDED if register not in settings]
    if unread:
        yield (
            f"{', '.join(unread)} not read, so nothing is known of them: its answers were lost, or its "
            f"{known.place('status_return_level')} is 0 (answers pings only)"
        )
    offset = settings.get("homing_offset", 0)
    most = known.facts.offset_limit
    if most is not None and abs(offset) > most and joint.mode == "position":
        where = known.place("homing_offset")
        yield f"{where} is {offset}; beyond ±{most} position mode ignores it: write 0"
    yield from _geared(settings, known.facts.gear)
    yield from _without_force(settings, known)
    yield from _driven_otherwise(settings, known)
    for register, wanted in joint.registers.items():
        found_value = settings.get(register)
        if found_value is None and not unread:
            yield f"{register} must be {wanted}, but is not read from servos: remove it from the robot file"
        elif found_value is not None and found_value != wanted:
            yield f"{register} is {found_value}, the robot file says {wanted}"


def _wrong_mode(joint: ExpectedDevice, settings: Mapping[str, int], known: ControlTable) -> Iterator[str]:
    """Another operating mode than the robot file names, or a cap that the servo does not take."""
    mode = settings.get("operating_mode")
    wanted = joint.operating_mode
    if mode is not None and mode != wanted:
        where = known.place("operating_mode")
        yield (
            f"{where} is {mode}, {joint.mode} mode is {wanted}: with torque off write {wanted} to register "
            f"{known['operating_mode'].address}, then calibrate anew; or correct the robot file"
        )
    limit = settings.get("current_limit")
    cap = joint.current_cap
    if cap is not None and mode is not None and (limit is None or limit < cap):
        where = known.place("current_limit")
        yield (
            f"{where} is {limit}, current_limit_a of the robot file asks for {cap}: "
            f"lower current_limit_a, or raise register {known['current_limit'].address}"
        )


def _geared(settings: Mapping[str, int], gear: int) -> Iterator[str]:
    """Another electronic gear ratio than that of the gear: counts and speeds would be of another shaft."""
    numerator = settings.get("electronic_gearratio_numerator", gear)
    denominator = settings.get("electronic_gearratio_denominator", 1)
    if gear and not numerator == gear * denominator > 0:
        yield f"electronic gear ratio (96, 100) is {numerator}/{denominator}: write {gear} and 1"


def _without_force(settings: Mapping[str, int], known: ControlTable) -> Iterator[str]:
    """A limit of 0 on what gives force: preparing sets the goal register to it, and torque reads on."""
    for register in ("pwm_limit", "current_limit") if known.facts.caps_current else ("pwm_limit",):
        if settings.get(register) == 0:
            yield f"{known.place(register)} is 0: with torque on it would take goals, and not move"


def _driven_otherwise(settings: Mapping[str, int], known: ControlTable) -> Iterator[str]:
    """Something else than this bus and its goals moves the servo, or switches its torque on."""
    drive = settings.get("drive_mode", 0)
    for bit, why in DRIVE_BITS.items():
        if drive & bit:
            yield f"{known.place('drive_mode')} is {drive}: {why}"
    startup = settings.get("startup_configuration", 0)  # older firmware has no such register
    if startup & TORQUE_AT_BOOT:
        where = known.place("startup_configuration")
        yield f"{where} is {startup}: bit 0, torque on at boot, must be 0"


def _shadowing(settings: Mapping[str, int], known: ControlTable) -> Iterator[str]:
    """A second id that the servo obeys as well, without an answer (e-manual, "Secondary(Shadow) ID (12)").

    It is read in one block with the operating mode: where it was not read, neither was that, which refuses.
    """
    for register in SECONDARY:
        value = settings.get(register, OFF)
        if value <= MAX_ID:
            where = known.place(register)
            yield (
                f"{where} is {value}: it obeys goals for id {value} too; "
                f"with torque off write {OFF}, off, to register {known[register].address}"
            )


def doubts(
    joint: ExpectedDevice, device: IdentifiedDevice, known: ControlTable, described: int
) -> Iterator[DeviceWarning]:
    """Yield warnings: a return delay above the `described` one (µs), RAM from a backup, no own limits.

    `known`: table of the model that the joint needs; a device of another model may have other registers.
    """
    register = device.settings.get("return_delay_time")
    if register is not None and 2 * register > described:
        remedy = f"`twindctl register write {joint.bus} {joint.id} return_delay_time {described // 2}`"
        text = (
            f"answers slowly: return delay is {2 * register} us, the robot file says {described}: "
            f"rate at risk; with torque off {remedy}"
        )
        yield DeviceWarning(text, 2.0 * register, float(described))
    startup = device.settings.get("startup_configuration", 0)
    if startup & RAM_AT_BOOT and device.model_name == known.model:
        where = known.place("startup_configuration")
        text = f"{where} is {startup}: bit 1, RAM from its backup at boot; write 0"
        yield DeviceWarning(text, float(startup), 0.0)
    if not joint.type.fenced(joint.mode):  # goals of many turns (e-manual, registers 48, 52: mode 3 only)
        text = (
            f"in {joint.mode} mode the servo's own position limits (48, 52) do nothing: "
            "the daemon's clamp is the only fence"
        )
        yield DeviceWarning(text, float(joint.operating_mode), 3.0)
