"""Checks of the doctor for servos of protocol 2.0: what their registers alone can have."""

from collections.abc import Iterator

from twind.config.robot_spec import JointSpec
from twind.doctor.check import DoctorFinding, Severity
from twind.doctor.check_context import CheckContext
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.device_layout import layout_of
from twind_drivers.dynamixel.dynamixel_identification import find_table, supports_fast
from twind_drivers.dynamixel.serial_cycle_budget import budget
from twind_drivers.dynamixel.servo_check import SECONDARY
from twind_drivers.dynamixel.servo_type import ServoType
from twind_drivers.servo_tools.doctor.register_fix import format_command, offer_fix
from twind_drivers.servo_tools.doctor.serial_bus_survey import SerialBusSurvey, SurveyedServo
from twind_drivers.servo_tools.doctor.servo_judges import ServoJudges
from twind_drivers.servo_tools.doctor.servo_settings import WRITE, calibration_of
from twind_drivers.slow_read_rate import upkeep_stride

SECOND_OFF = 252  # above it the second id is off
# Bits of drive mode, startup configuration and shutdown (e-manual).
REVERSE = 1
SLAVE = 2
TIME_PROFILE = 4
TORQUE_BY_GOAL = 8
TORQUE_AT_BOOT = 1
RAM_RESTORED = 2
PROTECTION = {4: "overheating", 16: "electrical shock", 32: "overload"}
MOVES = ("velocity_limit", "pwm_limit", "current_limit")

Found = Iterator[DoctorFinding]


def _second_id(_: CheckContext, servo: SurveyedServo, __: JointSpec) -> Found:
    for name in SECONDARY:
        value = servo.values.get(name, SECOND_OFF + 1)
        if value <= SECOND_OFF:
            command = format_command(servo, name, 255)
            text = f"{_place(servo, name)} is {value}"
            yield DoctorFinding("SECOND_ID", servo.thing, text, "255, off", command)


def _unwatched(_: CheckContext, servo: SurveyedServo, __: JointSpec) -> Found:
    known = _table(servo)
    least = None if known is None else known.facts.watchdog_from
    if least is not None and servo.firmware is not None and servo.firmware < least:
        text = f"firmware {servo.firmware}"
        yield DoctorFinding("WATCHDOG_UNKNOWN", servo.thing, text, f"{least} or newer")


def _delays(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    assert isinstance(joint.type, ServoType)
    described = joint.type.return_delay_us
    counts = servo.values.get("return_delay_time")
    if counts is not None and 2 * counts > described:
        wanted = described // 2
        yield DoctorFinding(
            "RETURN_DELAY",
            servo.thing,
            f"return delay (9) is {2 * counts} us",
            f"{described} us",
            format_command(servo, "return_delay_time", wanted),
            offer_fix(context, servo, "return_delay_time", wanted),
        )


def _level(context: CheckContext, servo: SurveyedServo, _: JointSpec) -> Found:
    """Yield STATUS_LEVEL below 2. A servo that answers pings alone reports no registers."""
    level = servo.values.get("status_return_level")
    if level is None and not servo.values:
        yield DoctorFinding("STATUS_LEVEL", servo.thing, "answers pings, and no read", "2")
    elif level is not None and level < 2:
        yield DoctorFinding(
            "STATUS_LEVEL",
            servo.thing,
            f"{_place(servo, 'status_return_level')} is {level}",
            "2",
            format_command(servo, "status_return_level", 2),
            offer_fix(context, servo, "status_return_level", 2),
        )


def _mode(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    mode = servo.values.get("operating_mode")
    wanted = joint.operating_mode
    if mode is not None and mode != wanted:
        command = format_command(servo, "operating_mode", wanted)
        text = f"{_place(servo, 'operating_mode')} is {mode}"
        yield DoctorFinding("OPERATING_MODE", servo.thing, text, f"{wanted}", command)
    offset = servo.values.get("homing_offset", 0)
    most = joint.type.homing_offset_limit
    if most is not None and abs(offset) > most and joint.mode == "position":
        command = format_command(servo, "homing_offset", 0)
        text = f"{_place(servo, 'homing_offset')} is {offset}: position mode ignores it"
        yield DoctorFinding("OPERATING_MODE", servo.thing, text, "0", command)


def _drive(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    drive = servo.values.get("drive_mode", 0)
    text = f"{_place(servo, 'drive_mode')} is {drive}"
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
    if drive & SLAVE:
        wanted = drive & ~SLAVE
        command = format_command(servo, "drive_mode", wanted)
        what = f"{text}: a slave follows the cable of another servo, not its goals"
        yield DoctorFinding("REGISTER_DIFFERS", servo.thing, what, f"{wanted}", command)
    entry = calibration_of(context, joint)
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
        text = f"{_place(servo, 'startup_configuration')} is {startup}"
        yield DoctorFinding("TORQUE_AT_BOOT", servo.thing, text, "0", command, severity=severity)


def _demanded(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Found:
    for name, wanted in joint.registers.items():
        value = servo.values.get(name)
        if value is not None and value != wanted:
            command = format_command(servo, name, wanted)
            yield DoctorFinding("REGISTER_DIFFERS", servo.thing, f"{name} is {value}", f"{wanted}", command)


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
        text = f"{_place(servo, 'current_limit')} is {limit}, {amperes}"
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
        text = f"{_place(servo, 'shutdown')} is {mask}: not for {' and '.join(lacks)}"
        command = format_command(servo, "shutdown", wanted)
        yield DoctorFinding("SHUTDOWN_MASK", servo.thing, text, f"{wanted}", command)


def _budget(context: CheckContext, survey: SerialBusSurvey) -> Found:
    """Judge the cycle with the return delays and firmwares of the devices."""
    robot = context.need_robot()
    known = survey.described_servos
    rate = context.settings.rate_hz if context.settings and context.settings.rate_hz else robot.rate_hz
    joints = [joint for joint in robot.joints if joint.bus == survey.spec.name]
    layouts = [layout_of(table(number_of(joint.type.device))) for joint in joints]
    fast = len(known) == len(joints) and all(_is_fast(servo) for servo in known)
    delays = [2 * servo.values["return_delay_time"] for servo in known if "return_delay_time" in servo.values]
    cycle = budget(
        len(joints),
        survey.spec.baud,
        fast=fast,
        return_delay_us=max(delays, default=0),
        upkeep_hz=rate / upkeep_stride(rate),
        usb_s=survey.spec.latency_timer_ms * 1e-3,
        groups=[layouts.count(each) for each in dict.fromkeys(layouts)],
    )
    refusal = cycle.refusal(rate)
    if known and refusal is not None:
        slow = [f"{servo.id} (firmware {servo.firmware})" for servo in known if _is_outdated(servo)]
        reason = f"{refusal}; ids without fast read: {', '.join(slow)}" if slow else refusal
        text = f"up to {cycle.reachable_hz:.0f} Hz: {reason}"
        bus = f"bus {survey.spec.name} ({survey.port})"
        yield DoctorFinding("BUS_BUDGET", bus, text, f"{rate:g} Hz")


def _is_fast(servo: SurveyedServo) -> bool:
    known = _table(servo)
    return known is not None and servo.firmware is not None and supports_fast(known.stem, servo.firmware)


def _is_outdated(servo: SurveyedServo) -> bool:
    """Return whether a firmware update would add the fast read, without which every reply takes longer."""
    known = _table(servo)
    least = None if known is None else known.facts.fast_from
    return least is not None and servo.firmware is not None and servo.firmware < least


def _place(servo: SurveyedServo, register: str) -> str:
    """Return a register that was read, with its address in this servo."""
    known = _table(servo)
    return register if known is None else known.place(register)


def _table(servo: SurveyedServo) -> ControlTable | None:
    return None if servo.model is None else find_table(servo.model, servo.firmware or 0)


JUDGES = ServoJudges(
    models=(_second_id, _unwatched),
    settings=(_level, _mode, _drive, _startup, _demanded),
    limits=(_zero_limits, _cap, _mask),
    delays=(_delays,),
    bus=_budget,
)
