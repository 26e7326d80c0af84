"""Checks of the settings and the state of servos, from surveys, robot file and calibration."""

from collections.abc import Iterator

from twind.config.actuator_types import ServoType
from twind.config.calibration_file import JointCalibration
from twind.config.counts import tick_range
from twind.config.robot_spec import JointSpec
from twind.doctor import register_fix
from twind.doctor.bus_surveys import merge_findings, servos
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.survey import MAPPED, SurveyedServo
from twind_drivers.dynamixel.control_tables import number_of, table

# Bits of drive mode (10), startup configuration (60) and shutdown (63) (e-manual).
REVERSE = 1
TIME_PROFILE = 4
TORQUE_BY_GOAL = 8
TORQUE_AT_BOOT = 1
RAM_RESTORED = 2
PROTECTION = {4: "overheating", 16: "electrical shock", 32: "overload"}
MAX_OFFSET = 1024  # counts: beyond it position mode ignores the homing offset (e-manual, address 20)
CAPPED = "current_based_position"
MOVES = ("velocity_limit", "pwm_limit", "current_limit")
TRIPPED = 255  # what a bus watchdog reads as after it ran out
# Register 70, bit by bit (e-manual, "Hardware Error Status").
ERRORS = {
    0: ("ERROR_VOLTAGE", "input voltage"),
    2: ("ERROR_HEAT", "overheating"),
    3: ("ERROR_ENCODER", "encoder"),
    4: ("ERROR_SHOCK", "electrical shock"),
    5: ("ERROR_OVERLOAD", "overload"),
}


def settings(examined: CheckContext) -> Iterator[DoctorFinding]:
    """STATUS_LEVEL, OPERATING_MODE, TORQUE_BY_GOAL, TORQUE_AT_BOOT, RAM_RESTORE, OFFSET_IGNORED, REVERSED,
    PROFILE_IN_TIME, REGISTER_DIFFERS."""
    yield from merge_findings(_settings(examined))


def _settings(examined: CheckContext) -> Iterator[DoctorFinding]:
    for _, servo in servos(examined):
        yield from _level(examined, servo)
        yield from _mode(servo)
        yield from _drive(examined, servo)
        yield from _startup(servo)
        yield from _demanded(servo)


def _level(examined: CheckContext, servo: SurveyedServo) -> Iterator[DoctorFinding]:
    """Yield STATUS_LEVEL for a status return level (68) below 2.

    A servo that answers pings alone reports no registers at all, and counts as such.
    """
    level = servo.values.get("status_return_level")
    if level is None and not servo.values:
        yield DoctorFinding(
            "STATUS_LEVEL", servo.thing, "answers pings, and no read", "status return level (68) 2"
        )
    elif level is not None and level < 2:
        yield DoctorFinding(
            "STATUS_LEVEL",
            servo.thing,
            f"status return level (68) is {level}",
            "2",
            register_fix.command(servo, "status_return_level", 2),
            register_fix.register(examined, servo, "status_return_level", 2),
        )


def _mode(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    assert servo.joint is not None
    mode = servo.values.get("operating_mode")
    wanted = servo.joint.operating_mode
    if mode is not None and mode != wanted:
        how = register_fix.command(servo, "operating_mode", wanted)
        yield DoctorFinding("OPERATING_MODE", servo.thing, f"operating mode (11) is {mode}", f"{wanted}", how)
    offset = servo.values.get("homing_offset", 0)
    if abs(offset) > MAX_OFFSET and servo.joint.mode == "position":
        how = register_fix.command(servo, "homing_offset", 0)
        yield DoctorFinding("OFFSET_IGNORED", servo.thing, f"homing offset (20) is {offset}", "0", how)


def _drive(examined: CheckContext, servo: SurveyedServo) -> Iterator[DoctorFinding]:
    drive = servo.values.get("drive_mode", 0)
    if drive & TORQUE_BY_GOAL:
        wanted = drive & ~TORQUE_BY_GOAL
        how = register_fix.command(servo, "drive_mode", wanted)
        yield DoctorFinding("TORQUE_BY_GOAL", servo.thing, f"drive mode (10) is {drive}", f"{wanted}", how)
    if drive & TIME_PROFILE:
        wanted = drive & ~TIME_PROFILE
        how = register_fix.command(servo, "drive_mode", wanted)
        yield DoctorFinding("PROFILE_IN_TIME", servo.thing, f"drive mode (10) is {drive}", f"{wanted}", how)
    entry = _entry(examined, servo.joint)
    adopted = entry is not None and entry.device.drive_mode & REVERSE
    if drive & REVERSE and (entry is None or adopted):  # else it has changed, which is told as that
        yield DoctorFinding("REVERSED", servo.thing, f"drive mode (10) is {drive}", "bit 0 clear")


def _startup(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    startup = servo.values.get("startup_configuration", 0)
    how = register_fix.command(servo, "startup_configuration", 0)
    measured = f"startup configuration (60) is {startup}"
    if startup & TORQUE_AT_BOOT:
        yield DoctorFinding("TORQUE_AT_BOOT", servo.thing, measured, "0", how)
    if startup & RAM_RESTORED:
        yield DoctorFinding("RAM_RESTORE", servo.thing, measured, "0", how)


def _demanded(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    assert servo.joint is not None
    for name, wanted in servo.joint.registers.items():
        value = servo.values.get(name)
        if value is not None and value != wanted:
            how = register_fix.command(servo, name, wanted)
            yield DoctorFinding("REGISTER_DIFFERS", servo.thing, f"{name} is {value}", f"{wanted}", how)


def calibrated(examined: CheckContext) -> Iterator[DoctorFinding]:
    """CALIBRATION_CHANGED, FIRMWARE_CHANGED."""
    yield from merge_findings(_calibrated(examined))


def _calibrated(examined: CheckContext) -> Iterator[DoctorFinding]:
    for _, servo in servos(examined):
        entry = _entry(examined, servo.joint)
        if entry is None:
            continue
        then = entry.device
        recorded = {
            "homing_offset": then.homing_offset_ticks,
            "drive_mode": then.drive_mode,
            "operating_mode": then.operating_mode,
            "min_position_limit": then.min_ticks,
            "max_position_limit": then.max_ticks,
        }
        for name, was in recorded.items():
            value = servo.values.get(name)
            if value is not None and value != was:
                how = register_fix.command(servo, name, was)
                yield DoctorFinding(
                    "CALIBRATION_CHANGED", servo.thing, f"{name} is {value}", f"{was}, as calibrated", how
                )
        if servo.firmware is not None and servo.firmware != then.firmware:
            measured = f"firmware {servo.firmware}"
            yield DoctorFinding("FIRMWARE_CHANGED", servo.thing, measured, f"{then.firmware}, as calibrated")


def limits(examined: CheckContext) -> Iterator[DoctorFinding]:
    """FENCE_TIGHT, LIMIT_ZERO, CURRENT_CAP, SHUTDOWN_MASK, PROFILE_LEFT, INDIRECT_LEFT."""
    yield from merge_findings(_limits(examined))


def _limits(examined: CheckContext) -> Iterator[DoctorFinding]:
    for _, servo in servos(examined):
        yield from _fence(examined, servo)
        for name in MOVES:
            if servo.values.get(name) == 0:
                delivered = _delivered(servo, name)
                yield DoctorFinding(
                    "LIMIT_ZERO", servo.thing, f"{name} is 0", f"what the joint needs{delivered}"
                )
        yield from _cap(servo)
        yield from _mask(servo)
        yield from _check_leftover_settings(servo)


def _fence(examined: CheckContext, servo: SurveyedServo) -> Iterator[DoctorFinding]:
    """Check position limits, in position mode alone (e-manual, addresses 48 and 52).

    Uncalibrated: by width.
    """
    joint = servo.joint
    least = "min_position_limit"
    most = "max_position_limit"
    assert joint is not None
    if joint.mode != "position" or least not in servo.values or most not in servo.values:
        return
    fence = servo.values[least], servo.values[most]
    entry = _entry(examined, joint)
    needs = tick_range(joint, 0 if entry is None else entry.zero_ticks, *joint.span)
    tight = fence[1] - fence[0] < needs[1] - needs[0]
    if entry is not None:
        tight = fence[0] > needs[0] or fence[1] < needs[1]
    if tight:
        span = f"{needs[0]}..{needs[1]}" if entry is not None else f"a width of {needs[1] - needs[0]}"
        measured = f"position limits (52, 48) are {fence[0]}..{fence[1]}"
        command = ""
        advice = ""
        if entry is not None:
            then = entry.device.min_ticks, entry.device.max_ticks
            command = "\n".join(
                register_fix.command(servo, *pair) for pair in zip((least, most), then, strict=True)
            )
            if then == fence or then[0] > needs[0] or then[1] < needs[1]:
                command = ""  # another fence than the calibration's would be CALIBRATION_CHANGED
                advice = f"calibrate {joint.name} anew, or tighten its `limits_rad` in the robot file"
        expected = f"{span} counts for its joint limits"
        yield DoctorFinding("FENCE_TIGHT", servo.thing, measured, expected, command, advice=advice)


def _delivered(servo: SurveyedServo, name: str) -> str:
    """Describe the factory value of this servo model; "" where no page documents it."""
    assert servo.joint is not None
    field = table(number_of(servo.joint.type.device)).fields.get(name)
    value = None if field is None else field.rule.default
    return "" if value is None else f", {value} at most, as delivered"


def _cap(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    assert servo.joint is not None
    assert isinstance(servo.joint.type, ServoType)
    cap = servo.joint.current_cap
    limit = servo.values.get("current_limit")
    if cap is not None and limit is not None and 0 < limit < cap:
        amperes = f"{limit * servo.joint.type.current_lsb_a:.2f} A"
        measured = f"current limit (38) is {limit}, {amperes}"
        advice = (
            f"lower `current_limit_a` of type {servo.joint.type.name} to {amperes}; "
            f"only where the joint needs {cap} counts, write that to its current_limit, with torque off"
        )
        yield DoctorFinding("CURRENT_CAP", servo.thing, measured, f"{cap} or more", advice=advice)


def _mask(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    """Check the shutdown mask; silent where the robot file names it, since REGISTER_DIFFERS compares that."""
    assert servo.joint is not None
    if "shutdown" in servo.joint.registers:
        return
    mask = servo.values.get("shutdown")
    lacks = [name for bit, name in PROTECTION.items() if mask is not None and not mask & bit]
    if mask is None or not lacks:
        return
    wanted = mask | sum(PROTECTION)
    yield DoctorFinding(
        "SHUTDOWN_MASK",
        servo.thing,
        f"shutdown (63) is {mask}: not for {' and '.join(lacks)}",
        f"{wanted}",
        register_fix.command(servo, "shutdown", wanted),
    )


def _check_leftover_settings(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    speeds = {name: servo.values.get(name, 0) for name in ("profile_velocity", "profile_acceleration")}
    if any(speeds.values()) and servo.values.get("torque_enable") == 0:
        said = " and ".join(f"{name} is {value}" for name, value in speeds.items() if value)
        yield DoctorFinding("PROFILE_LEFT", servo.thing, said, "0")
    known = None if servo.model is None else table(servo.model, servo.firmware or 0)
    if known is None or "indirect_data_1" not in known:
        return
    first = known["indirect_data_1"].address
    maps = {name: value for name, value in servo.values.items() if name.startswith(MAPPED)}
    moved = [name for name, value in maps.items() if value != first + int(name.removeprefix(MAPPED)) - 1]
    if moved:
        said = f"{moved[0]} is {maps[moved[0]]}" + (f", and {len(moved) - 1} more" if moved[1:] else "")
        yield DoctorFinding("INDIRECT_LEFT", servo.thing, said, "the address of its own data")


def state(examined: CheckContext) -> Iterator[DoctorFinding]:
    """ERROR_OVERLOAD, ERROR_HEAT, ERROR_VOLTAGE, ERROR_ENCODER, ERROR_SHOCK, SERVO_HOT, TORQUE_ON,
    WATCHDOG_TRIPPED, WATCHDOG_OFF, WATCHDOG_LEFT."""
    yield from merge_findings(_state(examined))


def _state(examined: CheckContext) -> Iterator[DoctorFinding]:
    armed = examined.daemon is not None and bool(examined.daemon.status["armed"])
    for _, servo in servos(examined):
        assert servo.joint is not None
        torque = servo.values.get("torque_enable") == 1
        bits = servo.values.get("hardware_error_status", 0)
        for bit, (code, name) in ERRORS.items():
            if bits >> bit & 1:
                how = "" if torque else f"twindctl reboot {servo.bus} {servo.id}"  # it would let go
                yield DoctorFinding(code, servo.thing, f"hardware error (70) is {bits}: {name}", "0", how)
        warm = servo.values.get("present_temperature")
        bound = servo.joint.type.heat.warn
        if warm is not None and warm >= bound:
            yield DoctorFinding("SERVO_HOT", servo.thing, f"{warm} degC", f"below {bound:g} degC")
        if torque and not armed:
            yield DoctorFinding("TORQUE_ON", servo.thing, "torque is on", "off", "twindctl disarm")
        yield from _watchdog(examined, servo, torque=torque, armed=armed)


def _watchdog(
    examined: CheckContext, servo: SurveyedServo, *, torque: bool, armed: bool
) -> Iterator[DoctorFinding]:
    value = servo.values.get("bus_watchdog")
    if value is None:
        return
    if torque and value in (TRIPPED, 0):
        code = "WATCHDOG_TRIPPED" if value else "WATCHDOG_OFF"
        yield DoctorFinding(
            code, servo.thing, f"bus watchdog (98) is {value}", "5, 100 ms, while torque is on"
        )
    elif value and not torque and not armed:
        yield DoctorFinding(
            "WATCHDOG_LEFT",
            servo.thing,
            f"bus watchdog (98) is {value}" + (", tripped" if value == TRIPPED else f", {20 * value} ms"),
            "0 while torque is off",
            register_fix.command(servo, "bus_watchdog", 0),
            register_fix.register(examined, servo, "bus_watchdog", 0),
        )


def _entry(examined: CheckContext, joint: JointSpec | None) -> JointCalibration | None:
    if joint is None or examined.calibration is None:
        return None
    return examined.calibration.by_name.get(joint.actuator)
