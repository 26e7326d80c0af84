"""Comparison of the identified actuators with the files (CALIB_MISMATCH). Pure.

Registers are compared and named, never written. An unknown value refuses, without a mismatch.
"""

from collections.abc import Iterator, Mapping

from twind.config.calibrated_device import STAMPED, DeviceRecord
from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.counts import rad_per_tick
from twind.config.robot_spec import JointSpec, RobotFile
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind_drivers.bus import IdentifiedDevice

Devices = Mapping[tuple[str, int], IdentifiedDevice]

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
            refusals.append(Finding(ReasonCode.DEVICE_MISSING, place, message=message))
        else:
            where = f"id {joint.id} on bus {joint.bus}"
            unfit = [f"{where}: {why}" for why in joint.type.unfit(joint, device)]
            refusals.extend(Finding(ReasonCode.DEVICE_MISMATCH, place, message=text) for text in unfit)
            doubts = joint.type.doubts(joint, device)
            warnings.extend(Finding(ReasonCode.DEVICE_MISMATCH, place, **doubt._asdict()) for doubt in doubts)
    return Verdict(refusals=tuple(refusals), warnings=tuple(warnings))


def compare(robot: RobotFile, calibration: Calibration | None, devices: Devices) -> Verdict:
    """`check_devices`, and every servo is as it was when it was calibrated (CALIB_MISMATCH).

    Refusals: no calibration; other model, homing offset, drive mode, operating mode, position limits.
    Warnings: other firmware, travel that is implausible beside the described limits.
    """
    fit = check_devices(robot, devices)
    refusals = list(fit.refusals)
    warnings = list(fit.warnings)
    known = {} if calibration is None else calibration.by_name
    for place, joint in enumerate(robot.joints):
        entry = known.get(joint.actuator)
        device = devices.get((joint.bus, joint.id))
        if entry is None:
            refusals.append(Finding(ReasonCode.CALIB_MISSING, place, message="not calibrated"))
            continue
        warnings.extend(_travel(place, joint, entry))
        if device is not None:
            refusals.extend(_find_differences(place, joint, entry.device, device))
            warnings.extend(_firmware(place, joint, entry.device, device))
    return Verdict(refusals=tuple(refusals), warnings=tuple(warnings))


def _find_differences(
    place: int, joint: JointSpec, then: DeviceRecord, now: IdentifiedDevice
) -> Iterator[Finding]:
    def differs(register: str, value: int | None, recorded: int) -> Finding:
        text = f"{register} is {value}, was {recorded} when calibrated: restore it, or calibrate anew"
        if value is None:
            text = f"{register} was not read; it was {recorded} when calibrated"
        number = None if value is None else float(value)
        return Finding(ReasonCode.CALIB_MISMATCH, place, value=number, bound=float(recorded), message=text)

    if now.model_number != then.model_number:
        yield differs("model_number", now.model_number, then.model_number)
    for register, name in _COMPARED.items():
        value = now.settings.get(register)
        recorded = int(getattr(then, name))
        if value != recorded:
            yield differs(register, value, recorded)
    yield from _stamp(place, then, now)


def _stamp(place: int, then: DeviceRecord, now: IdentifiedDevice) -> Iterator[Finding]:
    tag = now.settings.get(STAMPED)
    if then.tag is not None and tag != then.tag:
        said = "was not read" if tag is None else f"is {tag}"
        text = f"{STAMPED} {said}, its tag was {then.tag} when calibrated: another servo, or a reset one?"
        number = None if tag is None else float(tag)
        yield Finding(ReasonCode.CALIB_MISMATCH, place, value=number, bound=float(then.tag), message=text)
    if then.unique_id is not None and now.unique_id != then.unique_id:
        text = f"its unique id is {now.unique_id}, was {then.unique_id} when calibrated: another device; "
        remedy = "put the right one back, or calibrate anew"
        yield Finding(ReasonCode.CALIB_MISMATCH, place, message=text + remedy)


def _firmware(place: int, joint: JointSpec, then: DeviceRecord, now: IdentifiedDevice) -> Iterator[Finding]:
    if now.firmware != then.firmware:
        text = f"firmware is {now.firmware}, was {then.firmware} when calibrated: prove it again"
        value = float(now.firmware)
        bound = float(then.firmware)
        yield Finding(ReasonCode.CALIB_MISMATCH, place, value=value, bound=bound, message=text)


def _travel(place: int, joint: JointSpec, entry: JointCalibration) -> Iterator[Finding]:
    travel = (entry.sweep_ticks[1] - entry.sweep_ticks[0]) * abs(rad_per_tick(joint))
    share = travel / joint.reach
    if not PLAUSIBLE_SWEEP[0] <= share <= PLAUSIBLE_SWEEP[1]:
        low, high = (f"{100 * bound:.0f}" for bound in PLAUSIBLE_SWEEP)
        text = (
            f"travel is {100 * share:.0f} % of the range that stop_rad, else limits_rad describes, "
            f"not {low}..{high} %: check joint and ratio, or set stop_rad"
        )
        bound = PLAUSIBLE_SWEEP[0] if share < PLAUSIBLE_SWEEP[0] else PLAUSIBLE_SWEEP[1]
        yield Finding(ReasonCode.CALIB_MISMATCH, place, value=share, bound=bound, message=text)
