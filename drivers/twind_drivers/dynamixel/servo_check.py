"""Is a serial servo one that a joint can have? Registers as identified in, texts out. Pure.

Registers are compared and named, never written. What is not known refuses, but is not called wrong.
"""

from collections.abc import Iterator, Mapping

from twind.config.actuator_types import DeviceWarning, ExpectedDevice
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.dynamixel_models import ModelCapabilities

NEEDED = ("operating_mode", "homing_offset", "drive_mode")  # every model has them
SECONDARY = ("secondary_shadow_id", "secondary_id")  # register 12, by the model's table
MAX_ID = 252  # above it the second id is off (e-manual, address 12)
# startup configuration (60), bits 0 and 1
TORQUE_AT_BOOT = 0b0001
RAM_AT_BOOT = 0b0010
# drive mode (10), bits 2 and 3
TIME_PROFILE = 0b0100
TORQUE_BY_GOAL = 0b1000


def unfit(joint: ExpectedDevice, device: IdentifiedDevice, facts: ModelCapabilities) -> Iterator[str]:
    """Yield the reasons why this servo is unusable for this joint, whatever the calibration says.

    `facts`: of the model that the joint needs.
    """
    settings = device.settings
    if not _same_model(device.model_name, joint.type.device):
        found = device.model_name or "a model that is in no table"
        yield f"is {found} (model number {device.model_number}), the robot file says {joint.type.device}"
    yield from _wrong_mode(joint, settings)
    yield from _shadowing(settings)
    unread = [register for register in NEEDED if register not in settings]
    if unread:
        yield (
            f"{', '.join(unread)} not read, so nothing is known of them: its answers were lost, or its "
            "status_return_level (68) is 0 (answers pings only)"
        )
    offset = settings.get("homing_offset", 0)
    drive = settings.get("drive_mode", 0)
    most = facts.offset_limit
    if most is not None and abs(offset) > most and joint.mode == "position":
        yield f"homing_offset (20) is {offset}; beyond ±{most} position mode ignores it: write 0"
    yield from _geared(settings, facts.gear)
    if drive & TORQUE_BY_GOAL:
        yield f"drive_mode (10) is {drive}: bit 3, torque on by goal update, must be 0"
    if drive & TIME_PROFILE:
        why = "bit 2, time-based profile, must be 0: a speed limit written to it would be a time"
        yield f"drive_mode (10) is {drive}: {why}"
    startup = settings.get("startup_configuration", 0)  # older firmware has no such register
    if startup & TORQUE_AT_BOOT:
        yield f"startup_configuration (60) is {startup}: bit 0, torque on at boot, must be 0"
    for register, wanted in joint.registers.items():
        found_value = settings.get(register)
        if found_value is None and not unread:
            yield f"{register} must be {wanted}, but is not read from servos: remove it from the robot file"
        elif found_value is not None and found_value != wanted:
            yield f"{register} is {found_value}, the robot file says {wanted}"


def _wrong_mode(joint: ExpectedDevice, settings: Mapping[str, int]) -> Iterator[str]:
    """Another operating mode than the robot file names, or a cap that the servo does not take."""
    mode = settings.get("operating_mode")
    wanted = joint.operating_mode
    if mode is not None and mode != wanted:
        yield (
            f"operating_mode (11) is {mode}, {joint.mode} mode is {wanted}: "
            f"with torque off write {wanted} to register 11, then calibrate anew; or correct the robot file"
        )
    limit = settings.get("current_limit")
    cap = joint.current_cap
    if cap is not None and mode is not None and (limit is None or limit < cap):
        yield (
            f"current_limit (38) is {limit}, current_limit_a of the robot file asks for {cap}: "
            "lower current_limit_a, or raise register 38"
        )


def _geared(settings: Mapping[str, int], gear: int) -> Iterator[str]:
    """Another electronic gear ratio than that of the gear: counts and speeds would be of another shaft."""
    ratio = tuple(settings.get(f"electronic_gearratio_{part}", 0) for part in ("numerator", "denominator"))
    if gear and ratio[0] != gear * ratio[1]:
        yield f"electronic gear ratio (96, 100) is {ratio[0]}/{ratio[1]}: write {gear} and 1"


def _shadowing(settings: Mapping[str, int]) -> Iterator[str]:
    """A second id that the servo obeys as well, without an answer (e-manual, "Secondary(Shadow) ID (12)").

    It is read in one block with the operating mode: where it was not read, neither was that, which refuses.
    """
    for register in SECONDARY:
        value = settings.get(register, 255)
        if value <= MAX_ID:
            yield (
                f"{register} (12) is {value}: it obeys goals for id {value} too; "
                "with torque off write 255, off, to register 12"
            )


def _same_model(found: str | None, wanted: str) -> bool:
    """XM430-W350-T and -R are XM430-W350 with another connector."""
    return found is not None and found.lower() == wanted.lower().removesuffix("-t").removesuffix("-r")


def doubts(joint: ExpectedDevice, device: IdentifiedDevice, described: int) -> Iterator[DeviceWarning]:
    """Yield warnings: a return delay above the `described` one (µs), RAM from a backup, no own limits."""
    register = device.settings.get("return_delay_time")
    if register is not None and 2 * register > described:
        remedy = f"`twindctl register write {joint.bus} {joint.id} return_delay_time {described // 2}`"
        text = (
            f"answers slowly: return delay is {2 * register} us, the robot file says {described}: "
            f"rate at risk; with torque off {remedy}"
        )
        yield DeviceWarning(text, 2.0 * register, float(described))
    startup = device.settings.get("startup_configuration", 0)
    if startup & RAM_AT_BOOT:
        text = f"startup_configuration (60) is {startup}: bit 1, RAM from its backup at boot; write 0"
        yield DeviceWarning(text, float(startup), 0.0)
    if not joint.type.fenced(joint.mode):  # goals of many turns (e-manual, registers 48, 52: mode 3 only)
        text = (
            f"in {joint.mode} mode the servo's own position limits (48, 52) do nothing: "
            "the daemon's clamp is the only fence"
        )
        yield DeviceWarning(text, float(joint.operating_mode), 3.0)
