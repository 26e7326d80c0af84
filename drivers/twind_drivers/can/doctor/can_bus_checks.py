"""Subject: CAN buses and their actuators, on the free channel or through the daemon. Reads only.

Their rows are those of the servos' doctor.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from twind.config.robot_spec import BusSpec, JointSpec, RobotFile
from twind.doctor.check import (
    Check,
    Devices,
    DoctorFinding,
    Severity,
    merge_findings,
)
from twind.doctor.check_context import CheckContext, Inspection, device_of, is_armed
from twind.doctor.family_doctor import DeviceSurvey, SurveyedDevice
from twind.doctor.inspectors import Answer, DaemonInspector, scan_bus
from twind.exceptions import OperationFailed
from twind.protocol.messages import JointMessage
from twind_drivers.bus import Bools, DeviceRefused, NoReply, PortError, ReadRequest
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_type import KIND, CanType
from twind_drivers.can.doctor.can_bus_inspector import CanBusInspector
from twind_drivers.can.register_access import STATE
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.run_script import perform

ACTUATORS = "CAN actuators"  # subject in the report
LISTEN = 0.12  # s: an ODrive reports its state ten times a second, another master sends more often
AFTER = 0.01  # s after a reply in which a second one of the same id would come, or a late one
TRIES = 3  # of an unanswered question
ROUNDS = 5  # of questions to all
MOST = 3  # rounds in which a second reply must come before it counts
UNKNOWN_TORQUE = 255  # torque of an actuator that does not report it
ROUNDING = 1  # thousandths
# Parameters that the checks compare, by family.
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "damiao": ("position_range", "velocity_range", "torque_range", "mode", "timeout"),
    "robstride": ("run_mode", "timeout", "bus_voltage"),
    "odrive": ("bus_voltage",),
    "cubemars": (),
}
MUTE = ("cubemars",)  # families that reply to commands alone
# Range of the frames, in thousandths -> key of the robot file, unit.
RANGES = {
    "position_range": ("position_rad", "rad"),
    "velocity_range": ("velocity_rad_s", "rad/s"),
    "torque_range": ("torque_nm", "N·m"),
}
# Names that the daemon's scan has for the ranges.
SCANNED = {"pmax_milli": "position_range", "vmax_milli": "velocity_range", "tmax_milli": "torque_range"}
# Family -> register of its mode, and the value in which it takes the daemon's commands.
MODES = {"damiao": ("mode", 1), "robstride": ("run_mode", 0)}
# Bits of an actuator's fault, as the drivers report them.
FAULTS = (
    *("input voltage", "not calibrated", "overheating", "encoder", "electrical shock", "overload"),
    *("lost its master", "an unknown code"),
)
CONDITIONS = {
    CanErrorState.PASSIVE: "the controller is error passive: many frames are broken",
    CanErrorState.OFF: "the controller has left the bus, or no device acknowledges its frames",
}
TORQUE = {True: 1, False: 0, None: -1}

ROWS: tuple[Check, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedCanActuator:
    """One actuator of a CAN bus that answered."""

    bus: str
    joint: JointSpec
    values: Mapping[str, int] = field(default_factory=dict)  # parameter -> number, a float in thousandths
    torque: int = -1  # 1 on, 0 off, -1 unknown
    faults: tuple[str, ...] = ()  # in words
    twice: bool = False  # more replies than questions

    @property
    def thing(self) -> Devices:
        """Name of the actuator in a finding."""
        return device_of(self.joint)


@dataclass(frozen=True, slots=True)
class CanSurvey(DeviceSurvey):
    """One CAN bus."""

    spec: BusSpec
    port: str
    nodes: tuple[SurveyedCanActuator, ...]
    missing: tuple[JointSpec, ...]  # without those that reply to commands alone
    condition: str = ""  # error of the controller; "": none, or unknown
    masters: int = 0  # frames of another master
    strangers: int = 0  # frames of ids that are not in the robot file

    @property
    def devices(self) -> tuple[SurveyedDevice, ...]:
        """All actuators that answered."""
        return tuple(
            SurveyedDevice(
                node.bus, node.joint.id, node.joint.name, node.joint.type.device, None, node.values
            )
            for node in self.nodes
        )


def is_queried(joint: JointSpec) -> bool:
    """Return whether its actuator answers questions. A CubeMars in MIT mode replies to commands alone."""
    return isinstance(joint.type, CanType) and joint.type.family not in MUTE


def can_surveys(context: CheckContext) -> Iterator[CanSurvey]:
    """Yield the survey of every CAN bus. Raises as `CheckContext.survey_buses`."""

    def look(spec: BusSpec) -> CanSurvey:
        if context.daemon is not None:
            return _survey_by_daemon(context.daemon, spec, context.need_robot())
        if spec.name not in context.lines:
            raise OperationFailed(f"bus {spec.name} has no port: name it with --port")
        return survey_can_line(context.lines[spec.name])

    return context.survey_buses((KIND,), look=look, kind=CanSurvey)


# ------------------------------------------------------------------------------------------- survey


def survey_can_line(line: CanBusInspector) -> CanSurvey:
    """Survey one bus completely. Raises OperationFailed."""
    try:
        return _survey(line)
    except PortError as error:
        raise OperationFailed(str(error)) from error


def _survey(line: CanBusInspector) -> CanSurvey:
    reader = line.reader
    clock = line.clock
    clock.sleep_until(clock.now() + LISTEN)
    unasked = reader.fleet.decode_frames(line.channel.receive(clock.now()))
    perform(reader, reader.identify(), clock)  # reported ranges become those of the frames
    present, twice, strangers = _ask_rounds(line)
    joints = [joint for joint in line.robot.joints if joint.bus == line.spec.name]
    if unasked.masters:  # then a second reply may be to the other master
        twice = set()
    nodes = tuple(_node(line, joint, twice=joint.id in twice) for joint in joints if joint.id in present)
    missing = tuple(joint for joint in joints if joint.id not in present and is_queried(joint))
    condition = CONDITIONS.get(line.channel.condition.line, "")
    strangers += unasked.strangers
    return CanSurvey(line.spec, line.port, nodes, missing, condition, unasked.masters, strangers)


def _node(line: CanBusInspector, joint: JointSpec, *, twice: bool) -> SurveyedCanActuator:
    torque, fault = _state(line, joint.id)
    faults = tuple(name for bit, name in enumerate(FAULTS) if fault >> bit & 1)
    return SurveyedCanActuator(joint.bus, joint, _parameters(line, joint), torque, faults, twice)


def _state(line: CanBusInspector, id: int) -> tuple[int, int]:
    """Return torque (-1: unknown) and fault bits."""
    for _ in range(TRIES):
        states = _ask_all(line)
        if id in states:
            torque, bits, known = states[id]
            return -1 if torque == UNKNOWN_TORQUE else torque, bits if known else 0
    return -1, 0


def _ask_rounds(line: CanBusInspector) -> tuple[set[int], set[int], int]:
    """Ask all actuators several times.

    Returns the ids that answered, late or not; the ids with more replies than questions in most rounds
    (never those that send unasked); and the number of frames of unknown ids. Not all rounds count: a second
    reply may come too late, or both may be one frame on the wire. Not one alone either: without an
    acknowledging device questions wait, and are then answered all at once.
    """
    reader = line.reader
    clock = line.clock
    present = np.zeros(len(reader.ids), np.bool_)
    more = np.zeros(len(reader.ids), np.int64)
    strangers = 0
    for _ in range(ROUNDS):
        _ask_all(line)
        count = reader.line.heard.count.copy()
        wanted = reader.line.expect.copy()
        clock.sleep_until(clock.now() + AFTER)
        late = reader.fleet.decode_frames(line.channel.receive(clock.now()))
        count += late.count
        strangers += reader.line.heard.strangers + late.strangers
        present |= count > 0
        more += count > wanted
    return _ids(reader, present), _ids(reader, reader.fleet.replies & (more >= MOST)), strangers


def _ids(reader: CanReader, rows: Bools) -> set[int]:
    return {id for id, chosen in zip(reader.ids, rows.tolist(), strict=True) if chosen}


def _ask_all(line: CanBusInspector) -> Mapping[int, bytes]:
    """Ask every actuator for torque and faults; return the replies by id."""
    reader = line.reader
    clock = line.clock
    reader.begin(ReadRequest(reader.ids, STATE, 3), clock.now())
    while not reader.feed(clock.now()) and clock.now() < reader.deadline:
        clock.wait([reader.channel], reader.deadline)
    return reader.answer(clock.now()).data


def _parameters(line: CanBusInspector, joint: JointSpec) -> Mapping[str, int]:
    """Read parameters by name, floats in thousandths; an unanswered one is left out."""
    assert isinstance(joint.type, CanType)
    found = {}
    for name in PARAMETERS[joint.type.family]:
        with suppress(NoReply, DeviceRefused):
            found[name] = perform(line.reader, line.reader.read(joint.id, name), line.clock).value
    return found


def _survey_by_daemon(daemon: DaemonInspector, spec: BusSpec, robot: RobotFile) -> CanSurvey:
    """Survey one bus by scan and status: a CAN bus has little time beside its cycle."""
    port = daemon.port_of(spec.name)
    joints = [joint for joint in robot.joints if joint.bus == spec.name]
    states = {joint["name"]: joint for joint in daemon.joints}
    with daemon.open_operator() as client:
        present = scan_bus(client, spec.name)
    nodes = tuple(
        _scanned_node(joint, present[joint.id], states.get(joint.name))
        for joint in joints
        if joint.id in present
    )
    missing = tuple(joint for joint in joints if joint.id not in present and is_queried(joint))
    return CanSurvey(spec, port, nodes, missing)


def _scanned_node(joint: JointSpec, found: Answer, state: JointMessage | None) -> SurveyedCanActuator:
    settings = {name: int(value) for name, value in (found.get("settings") or {}).items()}
    values = {SCANNED.get(name, name): value for name, value in settings.items()}
    if state is None:
        return SurveyedCanActuator(joint.bus, joint, values, TORQUE[None], ())
    if state["voltage"] is not None:
        values["bus_voltage"] = round(1e3 * state["voltage"])
    faults = tuple(name.replace("_", " ") for name in state["faults"] if name != "alert")
    return SurveyedCanActuator(joint.bus, joint, values, TORQUE[state["torque"]], faults)


# ------------------------------------------------------------------------------------------- checks


def check_buses(context: CheckContext) -> Iterator[DoctorFinding]:
    """BUS_SILENT, BUS_NOISE, BUS_TALK, SERVO_FOREIGN, SERVO_MISSING."""
    for survey in can_surveys(context):
        thing = f"bus {survey.spec.name} ({survey.port})"
        if survey.condition:
            advice = "check termination at both ends, every bit rate, the cable"
            yield DoctorFinding("BUS_NOISE", thing, survey.condition, advice=advice)
        if survey.masters:
            text = f"{survey.masters} commands of another master in {LISTEN:g} s"
            yield DoctorFinding("BUS_TALK", thing, text, "none")
        if survey.strangers:
            text = f"{survey.strangers} frames of unknown ids in a moment"
            yield DoctorFinding("SERVO_FOREIGN", thing, text, "none")
        if survey.missing and not survey.nodes:
            text = f"none of {len(survey.missing)} actuators answers"
            advice = "check power, an E-stop that cuts it, termination (60 Ω between the wires), bit rate"
            yield DoctorFinding("BUS_SILENT", thing, text, "all of them", advice=advice)
        else:
            advice = "check cable, power, its id and its `feedback_id` (vendor's tool)"
            yield from merge_findings(
                DoctorFinding("SERVO_MISSING", device_of(each), "no answer", advice=advice)
                for each in survey.missing
            )


def check_actuators(context: CheckContext) -> Iterator[DoctorFinding]:
    """ID_TWICE, REGISTER_DIFFERS, SERVO_ERROR, VOLTAGE_LOW, TORQUE_ON, WATCHDOG_UNKNOWN."""
    armed = is_armed(context)
    for survey in can_surveys(context):
        yield from merge_findings(found for node in survey.nodes for found in _actuator(node, armed=armed))


def _actuator(node: SurveyedCanActuator, *, armed: bool) -> Iterator[DoctorFinding]:
    kind = _kind(node.joint)
    if node.twice:
        yield DoctorFinding("ID_TWICE", node.thing, "more replies come than were asked for", "one")
    else:
        yield from _ranges(node)
        yield from _mode(node)
        if node.faults:
            advice = "correct the cause; `twindctl reset` and arm clear it; else switch its power off and on"
            yield DoctorFinding("SERVO_ERROR", node.thing, ", ".join(node.faults), "no fault", advice=advice)
        volts = node.values.get("bus_voltage")
        least = kind.supply.warn
        if volts is not None and volts * 1e-3 <= least:
            yield DoctorFinding("VOLTAGE_LOW", node.thing, f"{volts * 1e-3:.1f} V", f"above {least:.1f} V")
    off = node.torque == 1 and node.values.get("timeout") == 0
    if node.torque == 1 and (off or not armed):
        text = "torque is on" + ("; timeout is 0, off" if off else "")
        expected = "off, or armed with a watchdog of 100 ms"
        yield DoctorFinding("TORQUE_ON", node.thing, text, expected, "" if armed else "twindctl disarm")
    if not kind.watched:
        text = "`watchdog: unverified` in the robot file"
        advice = "set and verify it by the vendor's tool; keep a supply switch within reach"
        yield DoctorFinding("WATCHDOG_UNKNOWN", node.thing, text, advice=advice, severity=Severity.NOTE)


def _ranges(node: SurveyedCanActuator) -> Iterator[DoctorFinding]:
    kind = _kind(node.joint)
    for name, (key, unit) in RANGES.items():
        value = node.values.get(name)
        described = getattr(kind.ranges, key)
        if value is not None and abs(value - round(1e3 * described)) > ROUNDING:
            text = f"{name} is {value / 1e3:g} {unit}"
            expected = f"{described:g} {unit}, `ranges.{key}` of type {kind.name}"
            advice = "correct `ranges` of its type, or its registers by the vendor's tool"
            yield DoctorFinding("REGISTER_DIFFERS", node.thing, text, expected, advice=advice)


def _mode(node: SurveyedCanActuator) -> Iterator[DoctorFinding]:
    name, wanted = MODES.get(_kind(node.joint).family, ("", 0))
    value = node.values.get(name)
    if value is not None and value != wanted:
        command = f"twindctl register write {node.bus} {node.joint.id} {name} {wanted}"
        yield DoctorFinding("REGISTER_DIFFERS", node.thing, f"{name} is {value}", f"{wanted}", command)


def _kind(joint: JointSpec) -> CanType:
    assert isinstance(joint.type, CanType)
    return joint.type


CHECKS = (
    Inspection(
        ACTUATORS,
        ("BUS_SILENT", "BUS_NOISE", "BUS_TALK", "SERVO_FOREIGN", "SERVO_MISSING"),
        check_buses,
    ),
    Inspection(
        ACTUATORS,
        ("ID_TWICE", "REGISTER_DIFFERS", "SERVO_ERROR", "VOLTAGE_LOW", "TORQUE_ON", "WATCHDOG_UNKNOWN"),
        check_actuators,
    ),
)
