"""Subject: settings of servos, from surveys, robot file and calibration."""

from collections.abc import Iterator

from twind.config.calibration_file import JointCalibration
from twind.config.counts import tick_range
from twind.config.robot_spec import JointSpec
from twind.doctor.check import ALONE, ZERO_MOVES, Check, DoctorFinding, Severity, merge_findings
from twind.doctor.check_context import CheckContext, Inspection
from twind_drivers.servo_tools.doctor.register_fix import format_command
from twind_drivers.servo_tools.doctor.serial_bus_survey import SurveyedServo
from twind_drivers.servo_tools.doctor.servo_judges import judged

SERVOS = "servos"  # subject in the report
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
    yield from merge_findings(judged(context, lambda own: own.settings))


def check_calibrated(context: CheckContext) -> Found:
    """CALIBRATION_CHANGED."""
    yield from merge_findings(judged(context, lambda own: (_calibrated,)))


def check_limits(context: CheckContext) -> Found:
    """FENCE_TIGHT, SHUTDOWN_MASK."""
    yield from merge_findings(judged(context, lambda own: (_fence, *own.limits)))


def _calibrated(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    entry = calibration_of(context, joint)
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
    """Check position limits, in position mode alone.

    Without a calibration only their width is compared.
    """
    least = "min_position_limit"
    most = "max_position_limit"
    if joint.mode != "position" or least not in servo.values or most not in servo.values:
        return
    fence = servo.values[least], servo.values[most]
    if fence[0] == fence[1] and servo.tools.demanded is not None:
        return  # equal limits choose another mode: OPERATING_MODE
    entry = calibration_of(context, joint)
    needs = tick_range(joint, 0 if entry is None else entry.zero_ticks, *joint.span)
    text = f"position limits are {fence[0]}..{fence[1]}"
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


def calibration_of(context: CheckContext, joint: JointSpec) -> JointCalibration | None:
    """Return the calibration of a joint; None: it has none."""
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
