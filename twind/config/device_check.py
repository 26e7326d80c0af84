"""Are the servos on the wire those the files speak of? Pure: devices as identified in, a verdict out (S09).

Registers are compared and named, never written. What is not known counts as different.
"""

from collections.abc import Iterator, Mapping

from twind.config.calibration_file import Calibration, DeviceRecord, JointCalibration
from twind.config.counts import rad_per_tick
from twind.config.robot_spec import JointSpec, RobotFile
from twind.robot.finding import Code, Finding, Verdict
from twind_drivers.bus import Device

Devices = Mapping[tuple[str, int], Device]

MAX_OFFSET = 1024  # counts: in position mode a servo ignores a homing offset beyond it (e-manual, address 20)
SECONDARY = ("secondary_shadow_id", "secondary_id")  # register 12, by the model's table
MAX_ID = 252  # above it the second id is off (e-manual, address 12)
TORQUE_AT_BOOT = 0b0001  # startup configuration (60), bit 0
TORQUE_BY_GOAL = 0b1000  # drive mode (10), bit 3
PLAUSIBLE_SWEEP = (0.6, 1.3)  # of the described range

# register in `Device.settings` -> field of the record
_COMPARED = {
    "homing_offset": "homing_offset_ticks",
    "drive_mode": "drive_mode",
    "operating_mode": "operating_mode",
    "min_position_limit": "min_ticks",
    "max_position_limit": "max_ticks",
}


def check_devices(robot: RobotFile, devices: Devices) -> Verdict:
    """Every joint's servo is there, is the model that the robot file names, and cannot energise by itself."""
    refusals: list[Finding] = []
    warnings: list[Finding] = []
    for place, joint in enumerate(robot.joints):
        device = devices.get((joint.bus, joint.id))
        if device is None:
            message = f"nothing answers as id {joint.id} on bus {joint.bus}"
            refusals.append(Finding(Code.DEVICE_MISSING, place, message=message))
        else:
            where = f"id {joint.id} on bus {joint.bus}"
            unfit = [f"{where}: {why}" for why in _unfit(joint, device)]
            refusals.extend(Finding(Code.DEVICE_MISMATCH, place, message=text) for text in unfit)
            warnings.extend(_slow(place, joint, device))
            warnings.extend(_unfenced(place, joint))
    return Verdict(refusals=tuple(refusals), warnings=tuple(warnings))


def compare(robot: RobotFile, calibration: Calibration | None, devices: Devices) -> Verdict:
    """`check_devices`, and every servo is as it was when it was calibrated (S09).

    Refusals: no calibration; other model, homing offset, drive mode, operating mode, position limits.
    Warnings: other firmware, travel that is implausible beside the described limits.
    """
    fit = check_devices(robot, devices)
    refusals, warnings = list(fit.refusals), list(fit.warnings)
    known = {} if calibration is None else calibration.by_name
    for place, joint in enumerate(robot.joints):
        entry, device = known.get(joint.name), devices.get((joint.bus, joint.id))
        if entry is None:
            refusals.append(Finding(Code.CALIB_MISSING, place, message="not calibrated"))
            continue
        warnings.extend(_travel(place, joint, entry))
        if device is not None:
            refusals.extend(_changed(place, joint, entry.device, device))
            warnings.extend(_firmware(place, joint, entry.device, device))
    return Verdict(refusals=tuple(refusals), warnings=tuple(warnings))


def _unfit(joint: JointSpec, device: Device) -> Iterator[str]:
    """What makes this servo unusable for this joint, whatever the calibration says."""
    settings = device.settings
    if not _same_model(device.model_name, joint.type.device):
        found = device.model_name or "a model that is in no table"
        yield f"is {found} (model number {device.model_number}), the robot file says {joint.type.device}"
    yield from _wrong_mode(joint, settings)
    yield from _shadowing(settings)
    offset = settings.get("homing_offset")
    if offset is None or (abs(offset) > MAX_OFFSET and joint.mode == "position"):
        yield f"homing_offset (20) is {offset}; beyond ±{MAX_OFFSET} position mode ignores it: write 0"
    drive = settings.get("drive_mode")
    if drive is None or drive & TORQUE_BY_GOAL:
        yield f"drive_mode (10) is {drive}: bit 3, torque on by goal update, must be 0"
    startup = settings.get("startup_configuration", 0)  # older firmware has no such register
    if startup & TORQUE_AT_BOOT:
        yield f"startup_configuration (60) is {startup}: bit 0, torque on at boot, must be 0"
    for register, wanted in joint.registers.items():
        found_value = settings.get(register)
        if found_value is None:
            yield f"{register} must be {wanted}, but is not read from servos: remove it from the robot file"
        elif found_value != wanted:
            yield f"{register} is {found_value}, the robot file says {wanted}"


def _wrong_mode(joint: JointSpec, settings: Mapping[str, int]) -> Iterator[str]:
    """Another operating mode than the robot file names, or a cap that the servo does not take."""
    mode, wanted = settings.get("operating_mode"), joint.operating_mode
    if mode != wanted:
        yield (
            f"operating_mode (11) is {mode}, {joint.mode} mode is {wanted}: "
            f"with torque off write {wanted} to register 11, then calibrate anew; or correct the robot file"
        )
    limit, cap = settings.get("current_limit"), joint.current_cap
    if cap is not None and (limit is None or limit < cap):
        yield (
            f"current_limit (38) is {limit}, current_limit_a of the robot file asks for {cap}: "
            "lower current_limit_a, or raise register 38"
        )


def _shadowing(settings: Mapping[str, int]) -> Iterator[str]:
    """A second id that the servo obeys as well, without an answer (e-manual, "Secondary(Shadow) ID (12)").

    It is read in one block with the operating mode: where it was not read, that refuses.
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


def _slow(place: int, joint: JointSpec, device: Device) -> Iterator[Finding]:
    register = device.settings.get("return_delay_time")
    described = joint.type.return_delay_us
    if register is not None and 2 * register > described:
        text = f"return delay is {2 * register} us, the robot file says {described}: rate at risk"
        bound = float(described)
        yield Finding(Code.DEVICE_MISMATCH, place, value=2.0 * register, bound=bound, message=text)


def _unfenced(place: int, joint: JointSpec) -> Iterator[Finding]:
    """In modes 4 and 5 the servo takes goals of many turns (e-manual, registers 48, 52: mode 3 only)."""
    if joint.mode != "position":
        text = (
            f"in {joint.mode} mode the servo's own position limits (48, 52) do nothing: "
            "the daemon's clamp is the only fence"
        )
        yield Finding(Code.DEVICE_MISMATCH, place, value=float(joint.operating_mode), bound=3.0, message=text)


def _changed(place: int, joint: JointSpec, then: DeviceRecord, now: Device) -> Iterator[Finding]:
    def differs(register: str, value: int | None, recorded: int) -> Finding:
        text = f"{register} is {value}, was {recorded} when calibrated: restore it, or calibrate anew"
        number = None if value is None else float(value)
        return Finding(Code.CALIB_MISMATCH, place, value=number, bound=float(recorded), message=text)

    if now.model_number != then.model_number:
        yield differs("model_number", now.model_number, then.model_number)
    for register, name in _COMPARED.items():
        value, recorded = now.settings.get(register), int(getattr(then, name))
        if value != recorded:
            yield differs(register, value, recorded)


def _firmware(place: int, joint: JointSpec, then: DeviceRecord, now: Device) -> Iterator[Finding]:
    if now.firmware != then.firmware:
        text = f"firmware is {now.firmware}, was {then.firmware} when calibrated: prove it again"
        value, bound = float(now.firmware), float(then.firmware)
        yield Finding(Code.CALIB_MISMATCH, place, value=value, bound=bound, message=text)


def _travel(place: int, joint: JointSpec, entry: JointCalibration) -> Iterator[Finding]:
    travel = (entry.sweep_ticks[1] - entry.sweep_ticks[0]) * abs(rad_per_tick(joint))
    share = travel / (joint.upper - joint.lower)
    if not PLAUSIBLE_SWEEP[0] <= share <= PLAUSIBLE_SWEEP[1]:
        low, high = (f"{100 * bound:.0f}" for bound in PLAUSIBLE_SWEEP)
        text = f"travel is {100 * share:.0f} % of the limits, not {low}..{high} %: wrong joint?"
        bound = PLAUSIBLE_SWEEP[0] if share < PLAUSIBLE_SWEEP[0] else PLAUSIBLE_SWEEP[1]
        yield Finding(Code.CALIB_MISMATCH, place, value=share, bound=bound, message=text)
