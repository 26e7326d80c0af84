"""Subject: buses and the devices on them. Silence, noise, other masters, ids, models, speed.

Rows that a CAN bus shares are here; its checks are in `can_bus.py`. Each check reads the surveys alone.
"""

from collections.abc import Iterator, Sequence
from statistics import median

from twind.config.robot_spec import RobotFile
from twind.ctl.instance_paths import stop
from twind.doctor.check import (
    ALONE,
    FIRMWARE,
    OTHER_MASTER,
    UNPLUGGED,
    Check,
    DoctorFinding,
    Severity,
    merge_findings,
)
from twind.doctor.check_context import CheckContext, Inspection, device_of
from twind.robot.attitude import G
from twind_drivers.servo_tools.bus_scan import ScanFaultKind
from twind_drivers.servo_tools.doctor.serial_bus_survey import (
    SerialBusSurvey,
    SurveyedServo,
    serial_surveys,
)
from twind_drivers.servo_tools.doctor.servo_judges import judged, judges_of
from twind_drivers.servo_tools.family_tools import ServoLocation, need_tools

BUSES = "serial buses"  # subject in the report
LOST = 0.01  # share of lost or garbled replies above which a line is noisy
LEAST = 3  # lost or garbled replies below which no finding is made
LATE = 0.001  # s that a servo's quickest reply may be later than the others'
CHECKSUM_KINDS = ("dynamixel1", "feetech")  # buses of servos with the framing of Protocol 1.0
POWER = "is the power on, is the data line plugged in, is it the right port? "
CABLE = "look at its cable and power, and at its id: "
ODD = 0.1  # share of g: zero offsets of cheap sensors are 0.05 to 0.08 on an axis

ROWS = (
    Check(
        "BUS_SILENT",
        "no device answers on a bus",
        "its joints are neither read nor moved; CAN frames wait, and leave when power returns",
        "check power, an E-stop that cuts it, data line, port, bit rate, CAN termination (60 Ω)",
        Severity.FAULT,
        caution="make sure that no person works at the robot, and stop the daemon: "
        f"waiting commands move it when power returns; {UNPLUGGED}",
        explains=("SERVO_MISSING",),
    ),
    Check(
        "BUS_TALK",
        "another master or noise on a bus",
        "replies are corrupt; joints obey both masters in turn",
        "end the other program or unplug its adapter; check termination and ground",
        Severity.FAULT,
        caution=OTHER_MASTER,
        explains=("BUS_SILENT", "SERVO_MISSING", "BUS_NOISE", "ID_TWICE"),
    ),
    Check(
        "BUS_NOISE",
        "replies are lost, corrupt, late or echoed",
        "each loss leaves a joint unknown for a cycle; many cause HOLD; the whole bus waits for a late servo",
        "check connectors, cable length, ground, CAN termination and bit rate; then a lower `baud`",
        Severity.WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "BAUD_WRONG",
        "servos have another baud rate or protocol, or factory settings",
        "the daemon does not reach them: it uses the robot file's rate and protocol 2.0 only",
        "`twindctl adopt JOINT`; or correct `baud`, or set rate and protocol by the vendor's tool",
        Severity.FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING", "BUS_SILENT"),
    ),
    Check(
        "SERVO_MISSING",
        "a servo, actuator or IMU does not answer",
        "its joint is neither read nor moved; arming is refused; without IMU no balancing program may run",
        "check cable, power and id; daemon stopped: `twindctl scan --port PORT`",
        Severity.FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "ID_TWICE",
        "two devices have one id",
        "their replies collide, and both obey every command",
        "disconnect one, give the other a free id, reconnect the first",
        Severity.FAULT,
        caution=UNPLUGGED,
        explains=("BUS_NOISE",),
    ),
    Check(
        "SERVO_FOREIGN",
        "a device is not in the robot file",
        "it is neither commanded nor monitored, and may have torque",
        "add its joint to the robot file, correct its id, or unplug it",
        Severity.WARNING,
        caution=f"it may have torque or belong to another robot: {UNPLUGGED}",
    ),
    Check(
        "IMU_GRAVITY",
        "at rest the IMU does not measure 1 g",
        "registers are described wrongly or it is broken: attitude is wrong",
        "repeat at rest; compare its `acceleration` in the robot file with the manual",
        Severity.WARNING,
    ),
    Check(
        "SERVO_MODEL",
        "another model than the robot file says",
        "counts, currents and limits differ: arming is refused",
        "exchange the servo, or correct `device` of its type",
        Severity.FAULT,
        caution="a servo of another rated voltage burns on this supply: compare both pages before "
        f"you exchange it; {UNPLUGGED}",
    ),
    Check(
        "WATCHDOG_UNKNOWN",
        "a device has no watchdog, or one that cannot be read back",
        "if the daemon dies, it may continue; a servo without watchdog is not armed",
        "update firmware, or set and verify the watchdog by the vendor's tool; keep a supply switch in reach",
        Severity.FAULT,
        caution=f"{FIRMWARE}; do not try it out by killing the daemon with hands on the robot: the actuator "
        "may continue, and no stop reaches it",
    ),
    Check(
        "SECOND_ID",
        "a servo obeys a second id",
        "it silently obeys another servo's commands",
        "`twindctl register write BUS ID secondary_shadow_id 255`, torque off",
        Severity.FAULT,
        caution="where two servos turn one joint, the second id couples them: leave it",
    ),
    Check(
        "BUS_BUDGET",
        "the bus cannot hold the rate",
        "ticks are missed and readings grow old",
        "shorter return delays, higher baud rate, fast read (firmware), another bus, lower rate",
        Severity.FAULT,
        caution="write return delay and baud rate to every servo, torque off: one left out is lost; "
        f"{FIRMWARE}",
    ),
    Check(
        "RETURN_DELAY",
        "the return delay exceeds the robot file's",
        "every reply waits: 500 us take most of a 10 ms cycle of 20 servos",
        "`twindctl register write BUS ID return_delay_time COUNTS` (2 us each), torque off",
        Severity.WARNING,
        caution="the adapter must switch direction within the delay: on RS-485 try one servo first",
        explains=("BUS_BUDGET",),
    ),
)


def check_line(context: CheckContext) -> Iterator[DoctorFinding]:
    """BUS_SILENT, BUS_TALK, BUS_NOISE; BAUD_WRONG by protocol 1.0."""
    for survey in serial_surveys(context):
        thing = _bus(survey)
        kinds = {trouble.kind for trouble in survey.troubles}
        answered = survey.servos or survey.other_rates or ScanFaultKind.OLD in kinds
        if not answered and survey.missing:
            text = "no answer at any baud rate" if context.daemon is None else "no answer"
            yield DoctorFinding("BUS_SILENT", thing, text, advice=POWER + _scan(context, survey))
        if ScanFaultKind.TALK in kinds:
            yield DoctorFinding("BUS_TALK", thing, "bytes without a request", "silence")
        if ScanFaultKind.ECHO in kinds:
            text = "every packet comes back before its reply"
            advice = "the daemon removes the echo; for others switch it off, or exchange the adapter"
            yield DoctorFinding("BUS_NOISE", thing, text, "the reply alone", advice=advice)
        for trouble in survey.troubles:
            if trouble.kind is ScanFaultKind.OLD:
                yield _other_protocol(context.need_robot(), survey, trouble.ids)
        yield from _noise(survey)


def _other_protocol(robot: RobotFile, survey: SerialBusSurvey, ids: Sequence[int]) -> DoctorFinding:
    """Return BAUD_WRONG for servos that answer with the framing of Protocol 1.0, which Feetech has too."""
    text = f"protocol 1.0 answers of ids {', '.join(map(str, ids))}"
    advice = "set protocol 2.0 by the vendor's tool (register 13), if it is a Dynamixel that has it"
    for bus in robot.buses:
        here = {joint.id for joint in robot.joints if joint.bus == bus.name}
        if bus.kind in CHECKSUM_KINDS and here.issuperset(ids):
            advice = f"exchange the ports if these are the servos of bus {bus.name}; else {advice}"
    return DoctorFinding("BAUD_WRONG", _bus(survey), text, "protocol 2.0", advice=advice)


def _noise(survey: SerialBusSurvey) -> Iterator[DoctorFinding]:
    bad = survey.garbled + survey.lost
    noisy = any(trouble.kind in (ScanFaultKind.NOISE, ScanFaultKind.FOREIGN) for trouble in survey.troubles)
    if noisy or (bad >= LEAST and bad > LOST * survey.asked):
        text = f"{survey.garbled} garbled and {survey.lost} lost of {survey.asked} replies"
        if not bad:
            text = "bytes came that were no valid reply"
        yield DoctorFinding("BUS_NOISE", _bus(survey), text, "none")


def check_devices(context: CheckContext) -> Iterator[DoctorFinding]:
    """BAUD_WRONG, SERVO_MISSING, ID_TWICE, SERVO_FOREIGN."""
    for survey in serial_surveys(context):
        yield from _other_rates(survey)
        if survey.servos or survey.other_rates:  # else BUS_SILENT reports it
            advice = CABLE + _scan(context, survey)
            yield from merge_findings(
                DoctorFinding("SERVO_MISSING", device_of(each), "no answer", advice=advice)
                for each in survey.missing
            )
        for servo in survey.servos:
            if servo.trouble and servo.trouble.kind is ScanFaultKind.CLASH:
                yield DoctorFinding("ID_TWICE", servo.thing, servo.trouble.what)
            elif servo.joint is None:
                fresh = ServoLocation(servo.id, survey.spec.baud) in _factory_places(survey)
                text = f"a {_model(servo)} answers" + (", as delivered" if fresh else "")
                command = _adopt(survey) if fresh else ""
                yield DoctorFinding("SERVO_FOREIGN", servo.thing, text, "no device", command)


def _other_rates(survey: SerialBusSurvey) -> Iterator[DoctorFinding]:
    """Yield BAUD_WRONG for replies at other rates: one factory-new servo, else all of one rate at once."""
    missing = {joint.id for joint in survey.missing}
    places = _factory_places(survey)
    rates = {place.baud for place in places}
    delivered = [each for each in survey.other_rates if each.baud in rates]
    alone = len(delivered) == 1 and ServoLocation(delivered[0].id, delivered[0].baud) in places
    fresh = delivered if alone else []  # else the bus has that rate
    for each in fresh:
        names = ", ".join(f"id {joint.id} ({joint.name})" for joint in survey.missing)
        yield DoctorFinding(
            "BAUD_WRONG",
            f"{_bus(survey)} id {each.id} at {each.baud} baud",
            f"a {each.model_name or 'servo'} with the factory's id and rate",
            f"{names} at {survey.spec.baud} baud",
            command=_adopt(survey),
        )
    for baud in dict.fromkeys(each.baud for each in survey.other_rates if each not in fresh):
        ids = sorted(each.id for each in survey.other_rates if each.baud == baud)
        whose = "of this robot" if missing.issuperset(ids) else "some of them not of this robot"
        text = f"ids {', '.join(map(str, ids))} ({whose}) answer at {baud} baud"
        yield DoctorFinding("BAUD_WRONG", _bus(survey), text, f"{survey.spec.baud} baud")


def _factory_places(survey: SerialBusSurvey) -> set[ServoLocation]:
    """Return where the servos of the missing joints answer as delivered."""
    tools = need_tools(survey.spec.kind)
    return {place for joint in survey.missing for place in tools.delivered(joint.type.device)}


def _adopt(survey: SerialBusSurvey) -> str:
    return f"twindctl adopt {survey.missing[0].name if len(survey.missing) == 1 else 'JOINT'}"


def check_imu(context: CheckContext) -> Iterator[DoctorFinding]:
    """SERVO_MISSING of the IMU, as a warning; IMU_GRAVITY."""
    for imu in [survey.imu for survey in serial_surveys(context) if survey.imu is not None]:
        if not imu.heard or imu.force is None:
            advice = "check cable, power, and `bus` and `id` under `sensors` in the robot file"
            yield DoctorFinding(
                "SERVO_MISSING", imu.thing, "no answer", advice=advice, severity=Severity.WARNING
            )
        elif not abs(imu.force / G - 1.0) <= ODD:
            yield DoctorFinding("IMU_GRAVITY", imu.thing, f"{imu.force:.2f} m/s²", f"{G:.2f} m/s² at rest")


def check_models(context: CheckContext) -> Iterator[DoctorFinding]:
    """SERVO_MODEL, SECOND_ID, WATCHDOG_UNKNOWN."""
    for servo in (servo for survey in serial_surveys(context) for servo in survey.described_servos):
        if servo.joint is not None and not servo.is_expected_model:
            wanted = servo.joint.type.device
            yield DoctorFinding("SERVO_MODEL", servo.thing, f"a {_model(servo)}", f"a {wanted}")
    yield from merge_findings(judged(context, lambda own: own.models))


def check_speed(context: CheckContext) -> Iterator[DoctorFinding]:
    """RETURN_DELAY, BUS_BUDGET; BUS_NOISE of a servo that is later than the others."""
    yield from merge_findings(judged(context, lambda own: own.delays))
    for survey in serial_surveys(context):
        yield from _late(survey)
        judge = judges_of(survey.spec.kind).bus
        yield from () if judge is None else judge(context, survey)


def _late(survey: SerialBusSurvey) -> Iterator[DoctorFinding]:
    """Compare the quickest reply of each servo, without its return delay, with the others'."""
    for servo in survey.servos:
        if servo.trouble and servo.trouble.kind is ScanFaultKind.LATE:
            yield DoctorFinding("BUS_NOISE", servo.thing, servo.trouble.what, advice=servo.trouble.remedy)
    beyond = {
        servo: servo.delay - 2e-6 * servo.values.get("return_delay_time", 0)
        for servo in survey.servos
        if servo.delay is not None
    }
    usual = median(beyond.values()) if beyond else 0.0
    for servo, took in beyond.items():
        if len(beyond) > 2 and took > usual + LATE:
            text = f"its quickest reply takes {1e3 * took:.1f} ms beside the wire's time"
            advice = "check its cable and its neighbours' connectors; else exchange it"
            expected = f"{1e3 * usual:.1f} ms, as the others"
            yield DoctorFinding("BUS_NOISE", servo.thing, text, expected, advice=advice)


def _model(servo: SurveyedServo) -> str:
    return servo.model_name or f"servo of model number {servo.model}"


def _bus(survey: SerialBusSurvey) -> str:
    return f"bus {survey.spec.name} ({survey.port})"


def _scan(context: CheckContext, survey: SerialBusSurvey) -> str:
    """Describe how to scan: only the daemon that has a port can use it."""
    alone = f"`twindctl scan --port {survey.port}`"
    if context.daemon is None:
        return f"{alone} looks for every id at every rate"
    end = f"`{stop(context.daemon.path)}`, or Ctrl-C where it runs"
    return (
        f"`twindctl scan {survey.spec.name}` asks these ids again; for every id at every rate stop the "
        f"daemon, which lowers the robot ({end}), then {alone}"
    )


CHECKS = (
    Inspection(BUSES, ("BUS_SILENT", "BUS_TALK", "BUS_NOISE", "BAUD_WRONG"), check_line),
    Inspection(BUSES, ("BAUD_WRONG", "SERVO_MISSING", "ID_TWICE", "SERVO_FOREIGN"), check_devices),
    Inspection(BUSES, ("SERVO_MISSING", "IMU_GRAVITY"), check_imu),
    Inspection(BUSES, ("SERVO_MODEL", "SECOND_ID", "WATCHDOG_UNKNOWN"), check_models),
    Inspection(BUSES, ("RETURN_DELAY", "BUS_NOISE", "BUS_BUDGET"), check_speed),
)
