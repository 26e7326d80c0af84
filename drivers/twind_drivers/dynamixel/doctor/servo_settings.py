"""Subject: settings of servos, from surveys, robot file and calibration."""

from collections.abc import Callable, Iterator

from twind.config.calibration_file import JointCalibration
from twind.config.counts import tick_range
from twind.config.robot_spec import JointSpec
from twind.doctor.check import ALONE, ZERO_MOVES, Check, DoctorFinding, Severity, merge_findings
from twind.doctor.check_context import CheckContext, Inspection
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.doctor.register_fix import format_command, offer_fix
from twind_drivers.dynamixel.doctor.serial_bus_survey import SurveyedServo, expected_servos
from twind_drivers.dynamixel.servo_type import ServoType

SERVOS = "servos"  # subject in the report
# Bits of drive mode (10), startup configuration (60) and shutdown (63) (e-manual).
REVERSE = 1
TIME_PROFILE = 4
TORQUE_BY_GOAL = 8
TORQUE_AT_BOOT = 1
RAM_RESTORED = 2
PROTECTION = {4: "overheating", 16: "electrical shock", 32: "overload"}
MOVES = ("velocity_limit", "pwm_limit", "current_limit")

WRITE = "`twindctl register write BUS ID {0}`, torque off"

ROWS = (
    Check(
        "STATUS_LEVEL",
        "a servo does not answer all requests",
        "level 0 answers pings only; level 1 hides refused writes",
        WRITE.format("status_return_level 2") + "; or power it off and on",
        Severity.FAULT,
        caution="without power the joint goes limp: support the robot first",
    ),
    Check(
        "OPERATING_MODE",
        "operating mode, homing offset or direction differ from the robot file",
        "goals or zeros have another meaning: arming is refused; a direction bit hides the sign of torque",
        "write operating_mode, homing_offset or drive_mode, torque off, then calibrate; or correct `mode`",
        Severity.FAULT,
        caution=ZERO_MOVES,
    ),
    Check(
        "TORQUE_BY_GOAL",
        "a goal alone switches torque on",
        "a limp servo moves when it receives a goal (drive mode, bit 3); arming is refused",
        WRITE.format("drive_mode VALUE") + ", the value without 8",
        Severity.FAULT,
        caution="another program may rely on it and would misread goals afterwards",
    ),
    Check(
        "TORQUE_AT_BOOT",
        "a servo switches torque on or restores saved RAM at power-on",
        "it moves without a daemon, so arming is refused; or it starts with foreign gains and profiles",
        WRITE.format("startup_configuration 0"),
        Severity.FAULT,
        caution="at the next power-on the joint is limp: support it",
        explains=("STATUS_LEVEL", "WATCHDOG_LEFT"),
    ),
    Check(
        "CALIBRATION_CHANGED",
        "a servo or its firmware differs from its calibration",
        "its zero may differ, or it may be another servo: with another setting arming is refused",
        "restore the calibrated value, or calibrate the joint",
        Severity.FAULT,
        caution="switch torque off and support the robot; restore only to the servo that was calibrated: "
        "after an exchange or a removed horn the zero differs; compare with the monitor before any motion",
    ),
    Check(
        "REGISTER_DIFFERS",
        "a register differs from what robot file or daemon require",
        "arming is refused; or speeds of other programs are taken as times (drive mode, bit 2)",
        WRITE.format("NAME VALUE") + ", or by the vendor's tool; or correct the robot file",
        Severity.FAULT,
        caution="the robot file may be wrong: compare with the model's page, limits above all; "
        f"another program may rely on the value; {ALONE}",
    ),
    Check(
        "FENCE_TIGHT",
        "a limit of the servo is tighter than the joint needs",
        "it refuses goals, stops short, or never moves: position, velocity, PWM or current limit",
        WRITE.format("NAME COUNTS") + "; or calibrate, or tighten `limits_rad` or `current_limit_a`",
        Severity.FAULT,
        caution="a limit may protect joint, endstop or cable: torque off, move the joint over its range "
        "first; raise it to what the joint needs, and no further",
    ),
    Check(
        "SHUTDOWN_MASK",
        "a servo does not protect itself",
        "no shutdown at overload, heat or shock (register 63): it burns",
        WRITE.format("shutdown VALUE"),
        Severity.FAULT,
        caution="a servo that shuts down drops its load: where that is worse, support the joint or keep "
        "the mask",
    ),
)

Found = Iterator[DoctorFinding]


def check_settings(context: CheckContext) -> Found:
    """STATUS_LEVEL, OPERATING_MODE, TORQUE_BY_GOAL, TORQUE_AT_BOOT, REGISTER_DIFFERS."""
    yield from merge_findings(_each(context, (_level, _mode, _drive, _startup, _demanded)))


def check_calibrated(context: CheckContext) -> Found:
    """CALIBRATION_CHANGED."""
    yield from merge_findings(_each(context, (_calibrated,)))


def check_limits(context: CheckContext) -> Found:
    """FENCE_TIGHT, SHUTDOWN_MASK."""
    yield from merge_findings(_each(context, (_fence, _zero_limits, _cap, _mask)))


def _each(
    context: CheckContext, judges: tuple[Callable[[CheckContext, SurveyedServo, JointSpec], Found], ...]
) -> Found:
    """Run each judge on every servo that has a joint and the joint's model."""
    for _, servo in expected_servos(context):
        assert servo.joint is not None
        for judge in judges:
            yield from judge(context, servo, servo.joint)


def _level(context: CheckContext, servo: SurveyedServo, _: JointSpec) -> Found:
    """Yield STATUS_LEVEL below 2. A servo that answers pings alone reports no registers."""
    level = servo.values.get("status_return_level")
    if level is None and not servo.values:
        yield DoctorFinding("STATUS_LEVEL", servo.thing, "answers pings, and no read", "2")
    elif level is not None and level < 2:
        yield DoctorFinding(
            "STATUS_LEVEL",
            servo.thing,
            f"status return level (68) is {level}",
            "2",
            format_command(servo, "status_return_level", 2),
            offer_fix(context, servo, "status_return_level", 2),
        )


def _mode(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    mode = servo.values.get("operating_mode")
    wanted = joint.operating_mode
    if mode is not None and mode != wanted:
        command = format_command(servo, "operating_mode", wanted)
        text = f"operating mode (11) is {mode}"
        yield DoctorFinding("OPERATING_MODE", servo.thing, text, f"{wanted}", command)
    offset = servo.values.get("homing_offset", 0)
    most = joint.type.homing_offset_limit
    if most is not None and abs(offset) > most and joint.mode == "position":
        command = format_command(servo, "homing_offset", 0)
        text = f"homing offset (20) is {offset}: position mode ignores it"
        yield DoctorFinding("OPERATING_MODE", servo.thing, text, "0", command)


def _drive(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    drive = servo.values.get("drive_mode", 0)
    text = f"drive mode (10) is {drive}"
    if drive & TORQUE_BY_GOAL:
        wanted = drive & ~TORQUE_BY_GOAL
        command = format_command(servo, "drive_mode", wanted)
        yield DoctorFinding("TORQUE_BY_GOAL", servo.thing, text, f"{wanted}", command)
    if drive & TIME_PROFILE:
        wanted = drive & ~TIME_PROFILE
        command = format_command(servo, "drive_mode", wanted)
        yield DoctorFinding(
            "REGISTER_DIFFERS",
            servo.thing,
            f"{text}: profiles are times",
            f"{wanted}",
            command,
            severity=Severity.WARNING,
        )
    entry = _entry(context, joint)
    adopted = entry is not None and entry.device.drive_mode & REVERSE
    if drive & REVERSE and (entry is None or adopted):  # else CALIBRATION_CHANGED reports it
        advice = "use the sign in the robot file; write drive_mode without 1, torque off, then calibrate"
        yield DoctorFinding(
            "OPERATING_MODE",
            servo.thing,
            f"{text}: it is reversed",
            "bit 0 clear",
            advice=advice,
            severity=Severity.NOTE,
        )


def _startup(_: CheckContext, servo: SurveyedServo, __: JointSpec) -> Found:
    startup = servo.values.get("startup_configuration", 0)
    if startup & (TORQUE_AT_BOOT | RAM_RESTORED):
        severity = Severity.FAULT if startup & TORQUE_AT_BOOT else Severity.WARNING
        command = format_command(servo, "startup_configuration", 0)
        text = f"startup configuration (60) is {startup}"
        yield DoctorFinding("TORQUE_AT_BOOT", servo.thing, text, "0", command, severity=severity)


def _demanded(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    for name, wanted in joint.registers.items():
        value = servo.values.get(name)
        if value is not None and value != wanted:
            command = format_command(servo, name, wanted)
            yield DoctorFinding("REGISTER_DIFFERS", servo.thing, f"{name} is {value}", f"{wanted}", command)


def _calibrated(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    entry = _entry(context, joint)
    if entry is None:
        return
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
            command = format_command(servo, name, was)
            text = f"{name} is {value}"
            yield DoctorFinding("CALIBRATION_CHANGED", servo.thing, text, f"{was}, as calibrated", command)
    if servo.firmware is not None and servo.firmware != then.firmware:
        yield DoctorFinding(
            "CALIBRATION_CHANGED",
            servo.thing,
            f"firmware {servo.firmware}",
            f"{then.firmware}, as calibrated",
            advice="move the joint by hand and compare with `twindctl monitor`; then calibrate",
            severity=Severity.WARNING,
        )


def _fence(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    """Check position limits, in position mode alone (e-manual, addresses 48 and 52).

    Without a calibration only their width is compared.
    """
    least = "min_position_limit"
    most = "max_position_limit"
    if joint.mode != "position" or least not in servo.values or most not in servo.values:
        return
    fence = servo.values[least], servo.values[most]
    entry = _entry(context, joint)
    needs = tick_range(joint, 0 if entry is None else entry.zero_ticks, *joint.span)
    text = f"position limits (52, 48) are {fence[0]}..{fence[1]}"
    if entry is None:
        width = needs[1] - needs[0]
        if fence[1] - fence[0] < width:
            expected = f"a width of {width} counts for its joint limits"
            yield DoctorFinding("FENCE_TIGHT", servo.thing, text, expected)
        return
    if fence[0] <= needs[0] and fence[1] >= needs[1]:
        return
    expected = f"{needs[0]}..{needs[1]} counts for its joint limits"
    then = entry.device.min_ticks, entry.device.max_ticks
    if then == fence or then[0] > needs[0] or then[1] < needs[1]:  # a wider one were CALIBRATION_CHANGED
        advice = f"calibrate {joint.name} anew, or tighten its `limits_rad` in the robot file"
        yield DoctorFinding("FENCE_TIGHT", servo.thing, text, expected, advice=advice)
    else:
        command = f"{format_command(servo, least, then[0])}\n{format_command(servo, most, then[1])}"
        yield DoctorFinding("FENCE_TIGHT", servo.thing, text, expected, command)


def _zero_limits(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    for name in MOVES:
        if servo.values.get(name) == 0:
            field = table(number_of(joint.type.device)).fields.get(name)
            most = None if field is None else field.rule.default
            delivered = "" if most is None else f", {most} at most, as delivered"
            advice = WRITE.format(f"{name} COUNTS") + "; see robot file or model page"
            expected = f"what the joint needs{delivered}"
            yield DoctorFinding("FENCE_TIGHT", servo.thing, f"{name} is 0", expected, advice=advice)


def _cap(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    assert isinstance(joint.type, ServoType)
    cap = joint.current_cap
    limit = servo.values.get("current_limit")
    if cap is not None and limit is not None and 0 < limit < cap:
        amperes = f"{limit * joint.type.current_lsb_a:.2f} A"
        text = f"current limit (38) is {limit}, {amperes}"
        advice = (
            f"lower `current_limit_a` of type {joint.type.name} to {amperes}; "
            f"only where the joint needs {cap} counts, write that to its current_limit, with torque off"
        )
        yield DoctorFinding("FENCE_TIGHT", servo.thing, text, f"{cap} or more", advice=advice)


def _mask(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    """Check the shutdown mask; a mask in the robot file is compared by REGISTER_DIFFERS."""
    mask = servo.values.get("shutdown")
    if mask is None or "shutdown" in joint.registers:
        return
    lacks = [name for bit, name in PROTECTION.items() if not mask & bit]
    if lacks:
        wanted = mask | sum(PROTECTION)
        text = f"shutdown (63) is {mask}: not for {' and '.join(lacks)}"
        command = format_command(servo, "shutdown", wanted)
        yield DoctorFinding("SHUTDOWN_MASK", servo.thing, text, f"{wanted}", command)


def _entry(context: CheckContext, joint: JointSpec) -> JointCalibration | None:
    return None if context.calibration is None else context.calibration.by_name.get(joint.actuator)


CHECKS = (
    Inspection(
        SERVOS,
        ("STATUS_LEVEL", "OPERATING_MODE", "TORQUE_BY_GOAL", "TORQUE_AT_BOOT", "REGISTER_DIFFERS"),
        check_settings,
    ),
    Inspection(SERVOS, ("CALIBRATION_CHANGED",), check_calibrated),
    Inspection(SERVOS, ("FENCE_TIGHT", "SHUTDOWN_MASK"), check_limits),
)
