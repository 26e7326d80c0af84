"""Checks of serial buses and of who is on them. Each looks at the surveys alone."""

from collections.abc import Iterator
from statistics import median

from twind.config.actuator_types import ServoType
from twind.ctl.instances import stop
from twind.doctor import register_fix
from twind.doctor.bus_surveys import merge_findings, serial, servos
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.survey import SerialSurvey, SurveyedServo, device_of
from twind.robot.attitude import G
from twind_drivers.dynamixel.bus_scan import Kind
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.device_layout import layout_of
from twind_drivers.dynamixel.dynamixel_identification import supports_fast
from twind_drivers.dynamixel.serial_cycle_budget import budget
from twind_drivers.slow_read_rate import upkeep_stride

# as delivered (e-manual)
FACTORY_BAUD = 57_600
FACTORY_ID = 1
LOST = 0.01  # of the answers of those who are there: more is no accident
LEAST = 3  # lost or garbled answers below which nothing is said
LATE = 0.001  # s that a servo's quickest answer may be later than the others'
SECONDARY = ("secondary_shadow_id", "secondary_id")  # register 12, by the model's table
POWER = "is the power on, is the data line plugged in, is it the right port? "
CABLE = "look at its cable and power, and at its id: "
ODD = 0.1  # of g: zero offsets of cheap sensors are 0.05 to 0.08 on an axis
LAST_ID = 252  # above it the second id is off


def line(examined: CheckContext) -> Iterator[DoctorFinding]:
    """BUS_SILENT, BUS_TALK, BUS_ECHO, PROTOCOL_OLD, BUS_NOISE."""
    for survey in serial(examined):
        thing = _bus(survey)
        if not survey.servos and not survey.elsewhere and survey.missing:
            measured = "no answer at any baud rate" if examined.daemon is None else "no answer"
            yield DoctorFinding("BUS_SILENT", thing, measured, advice=POWER + _scan(examined, survey))
        kinds = {trouble.kind for trouble in survey.troubles}
        if Kind.TALK in kinds:
            yield DoctorFinding("BUS_TALK", thing, "bytes on a line where nobody was asked", "silence")
        if Kind.ECHO in kinds:
            yield DoctorFinding(
                "BUS_ECHO", thing, "every packet comes back before its answer", "the answer alone"
            )
        for trouble in survey.troubles:
            if trouble.kind is Kind.OLD:
                ids = ", ".join(map(str, trouble.ids))
                yield DoctorFinding(
                    "PROTOCOL_OLD", thing, f"protocol 1.0 answers of ids {ids}", "protocol 2.0"
                )
        yield from _noise(survey)


def _noise(survey: SerialSurvey) -> Iterator[DoctorFinding]:
    bad = survey.garbled + survey.lost
    noisy = any(trouble.kind in (Kind.NOISE, Kind.FOREIGN) for trouble in survey.troubles)
    if noisy or (bad >= LEAST and bad > LOST * survey.asked):
        measured = f"{survey.garbled} garbled and {survey.lost} lost of {survey.asked} answers"
        if not bad:
            measured = "bytes came that were no sound answer"
        yield DoctorFinding("BUS_NOISE", _bus(survey), measured, "none")


def who(examined: CheckContext) -> Iterator[DoctorFinding]:
    """BAUD_WRONG, SERVO_FRESH, SERVO_MISSING, ID_TWICE, SERVO_FOREIGN."""
    for survey in serial(examined):
        yield from _elsewhere(survey)
        if survey.servos or survey.elsewhere:  # else the bus is silent, and that is told
            advice = CABLE + _scan(examined, survey)
            yield from merge_findings(
                DoctorFinding("SERVO_MISSING", device_of(each), "no answer", advice=advice)
                for each in survey.missing
            )
        for servo in survey.servos:
            if servo.trouble:
                yield DoctorFinding("ID_TWICE", servo.thing, servo.trouble.what)
            elif servo.joint is None:
                yield DoctorFinding("SERVO_FOREIGN", servo.thing, f"a {_model(servo)} answers", "nobody")


def inertial(examined: CheckContext) -> Iterator[DoctorFinding]:
    """IMU_SILENT, IMU_GRAVITY."""
    for imu in [survey.imu for survey in serial(examined) if survey.imu is not None]:
        if not imu.heard or imu.force is None:
            yield DoctorFinding("IMU_SILENT", imu.thing, "no answer")
        elif not abs(imu.force / G - 1.0) <= ODD:
            yield DoctorFinding("IMU_GRAVITY", imu.thing, f"{imu.force:.2f} m/s²", f"{G:.2f} m/s² at rest")


def _elsewhere(survey: SerialSurvey) -> Iterator[DoctorFinding]:
    """Those who answer at other rates: as from the factory, or all of one rate told at once."""
    missing = {joint.id for joint in survey.missing}
    delivered = [each for each in survey.elsewhere if each.baud == FACTORY_BAUD]
    fresh = delivered if [each.id for each in delivered] == [FACTORY_ID] else []  # else the bus has that rate
    for each in fresh:
        names = ", ".join(f"id {joint.id} ({joint.name})" for joint in survey.missing)
        yield DoctorFinding(
            "SERVO_FRESH",
            f"{_bus(survey)} id {FACTORY_ID} at {FACTORY_BAUD} baud",
            f"a {each.model_name or 'servo'} with the factory's id and rate",
            f"{names} at {survey.spec.baud} baud",
            command=f"twindctl adopt {survey.missing[0].name if len(survey.missing) == 1 else 'JOINT'}",
        )
    rates = dict.fromkeys(each.baud for each in survey.elsewhere if each not in fresh)
    for baud in rates:
        ids = sorted(each.id for each in survey.elsewhere if each.baud == baud)
        whose = "of this robot" if missing.issuperset(ids) else "some of them not of this robot"
        yield DoctorFinding(
            "BAUD_WRONG",
            _bus(survey),
            f"ids {', '.join(map(str, ids))} ({whose}) answer at {baud} baud",
            f"{survey.spec.baud} baud",
        )


def model(examined: CheckContext) -> Iterator[DoctorFinding]:
    """SERVO_MODEL, WATCHDOG_UNKNOWN, FIRMWARE_SLOW, SECOND_ID."""
    for servo in (servo for survey in serial(examined) for servo in survey.described_servos):
        if servo.joint is not None and not servo.is_expected_model:
            yield DoctorFinding(
                "SERVO_MODEL", servo.thing, f"a {_model(servo)}", f"a {servo.joint.type.device}"
            )
        yield from _second(servo)
    yield from merge_findings(_firmware(examined))


def _firmware(examined: CheckContext) -> Iterator[DoctorFinding]:
    for _, servo in servos(examined):
        known = _table(servo)
        if known is None or servo.firmware is None:
            continue
        least = known.facts.watchdog_from
        if least is not None and servo.firmware < least:
            yield DoctorFinding(
                "WATCHDOG_UNKNOWN", servo.thing, f"firmware {servo.firmware}", f"{least} or newer"
            )
        least = known.facts.fast_from
        if least is not None and servo.firmware < least:
            yield DoctorFinding(
                "FIRMWARE_SLOW", servo.thing, f"firmware {servo.firmware}", f"{least} or newer"
            )


def _second(servo: SurveyedServo) -> Iterator[DoctorFinding]:
    for name in SECONDARY:
        value = servo.values.get(name, LAST_ID + 1)
        if value <= LAST_ID:
            how = register_fix.command(servo, name, 255)
            yield DoctorFinding("SECOND_ID", servo.thing, f"{name} (12) is {value}", "255, off", how)


def speed(examined: CheckContext) -> Iterator[DoctorFinding]:
    """BUS_BUDGET, RETURN_DELAY, SERVO_SLOW."""
    yield from merge_findings(_delays(examined))
    for survey in serial(examined):
        yield from _late(survey)
        yield from _budget(examined, survey)


def _delays(examined: CheckContext) -> Iterator[DoctorFinding]:
    for _, servo in servos(examined):
        assert servo.joint is not None
        assert isinstance(servo.joint.type, ServoType)
        described = servo.joint.type.return_delay_us
        counts = servo.values.get("return_delay_time")
        if counts is not None and 2 * counts > described:
            wanted = described // 2
            yield DoctorFinding(
                "RETURN_DELAY",
                servo.thing,
                f"return delay (9) is {2 * counts} us",
                f"{described} us",
                register_fix.command(servo, "return_delay_time", wanted),
                register_fix.register(examined, servo, "return_delay_time", wanted),
            )


def _late(survey: SerialSurvey) -> Iterator[DoctorFinding]:
    """Each one's quickest answer without its own return delay, against the others'."""
    beyond = {
        servo: servo.delay - 2e-6 * servo.values.get("return_delay_time", 0)
        for servo in survey.servos
        if servo.delay is not None
    }
    usual = median(beyond.values()) if beyond else 0.0
    for servo, took in beyond.items():
        if len(beyond) > 2 and took > usual + LATE:
            measured = f"its quickest answer takes {1e3 * took:.1f} ms beside the wire's time"
            yield DoctorFinding("SERVO_SLOW", servo.thing, measured, f"{1e3 * usual:.1f} ms, as the others")


def _budget(examined: CheckContext, survey: SerialSurvey) -> Iterator[DoctorFinding]:
    """The cycle with the return delays and firmwares that are really there."""
    robot = examined.need_robot()
    known = survey.described_servos
    rate = examined.settings.rate_hz if examined.settings and examined.settings.rate_hz else robot.rate_hz
    joints = [joint for joint in robot.joints if joint.bus == survey.spec.name]
    tables = [table(number_of(joint.type.device)) for joint in joints]
    fast = len(known) == len(joints) and all(_fast(servo) for servo in known)
    delays = [2 * servo.values["return_delay_time"] for servo in known if "return_delay_time" in servo.values]
    layouts = [layout_of(each) for each in tables]
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
        yield DoctorFinding(
            "BUS_BUDGET", _bus(survey), f"up to {cycle.reachable_hz:.0f} Hz: {refusal}", f"{rate:g} Hz"
        )


def _fast(servo: SurveyedServo) -> bool:
    known = _table(servo)
    return known is not None and servo.firmware is not None and supports_fast(known.stem, servo.firmware)


def _table(servo: SurveyedServo) -> ControlTable | None:
    try:
        return None if servo.model is None else table(servo.model, servo.firmware or 0)
    except KeyError:
        return None


def _model(servo: SurveyedServo) -> str:
    return servo.model_name or f"servo of model number {servo.model}"


def _bus(survey: SerialSurvey) -> str:
    return f"bus {survey.spec.name} ({survey.port})"


def _scan(examined: CheckContext, survey: SerialSurvey) -> str:
    """How to see who is there: while a daemon has the port nobody else can open it."""
    alone = f"`twindctl scan --port {survey.port}`"
    if examined.daemon is None:
        return f"{alone} looks for every id at every rate"
    end = f"`{stop(examined.daemon.path)}`, or Ctrl-C where it runs"
    return (
        f"`twindctl scan {survey.spec.name}` asks these ids again; for every id at every rate stop the "
        f"daemon, which lowers the robot ({end}), then {alone}"
    )
