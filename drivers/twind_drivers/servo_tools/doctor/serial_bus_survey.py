"""Survey of a serial bus: devices, registers, line quality. On the free port, or through the daemon.

Reads only. The daemon's scan delivers most registers; the others are read one by one, each in the spare time
of a tick, so that the loop keeps its rate. A value that is unknown is missing from `values`, never zero.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twind.client import CallError, Client, ClientError
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind.doctor.check import Devices
from twind.doctor.check_context import CheckContext
from twind.doctor.family_doctor import DeviceSurvey, SurveyedDevice
from twind.doctor.inspectors import Answer, DaemonInspector, scan_bus
from twind.exceptions import OperationFailed
from twind.protocol.messages import JointMessage
from twind_drivers.bus import PortError
from twind_drivers.register_sensor import decoded
from twind_drivers.servo_tools.bus_scan import ScanFault, ScannedDevice, scan, scan_rate
from twind_drivers.servo_tools.doctor.serial_bus_inspector import BusProbe, SerialBusInspector
from twind_drivers.servo_tools.family_tools import FamilyTools, need_tools, tool_kinds
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import ServoIdentity, ServoRegister, ServoTable

# Registers that the checks read beside those of identification. A model that lacks one is not asked for it.
MEASURED = ("present_input_voltage", "present_temperature")  # in the state of a joint, too
MORE = ("bus_watchdog", *MEASURED)
PINGS = 12  # of each servo, for the quality of the line and the delay of each
TRIES = 3  # of an unanswered read
SILENT = 1000.0  # ms: a silent IMU is asked at least once a second


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedServo:
    """One id that answered on a serial bus at its rate."""

    bus: str
    id: int
    joint: JointSpec | None  # None: no joint of the robot file has this id
    model: int | None
    model_name: str | None  # None: in no table
    firmware: int | None
    values: Mapping[str, int] = field(default_factory=dict)  # register -> counts, signed where it is
    trouble: ScanFault | None = None  # sign of two devices with this id
    delay: float | None = None  # s of its quickest reply beside wire time; None: not measured

    @property
    def thing(self) -> Devices:
        """Name of the servo in a finding."""
        return Devices(self.bus, [(self.id, "" if self.joint is None else self.joint.name)])

    @property
    def is_expected_model(self) -> bool:
        """True if it has the model of its joint: else its registers have another meaning."""
        return self.joint is not None and self.model == self.tools.number_of(self.joint.type.device)

    @property
    def tools(self) -> FamilyTools:
        """Tools of the family of its joint."""
        assert self.joint is not None
        return need_tools(self.joint.type.BUS)

    @property
    def table(self) -> ServoTable:
        """Registers of its joint's model."""
        assert self.joint is not None
        return self.tools.table_of(self.joint.type.device)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedImu:
    """IMU of a bus."""

    thing: str  # its name in a finding
    heard: bool
    force: float | None = None  # m/s², norm of the measured acceleration; None: no reply


@dataclass(frozen=True, slots=True, eq=False)
class SerialBusSurvey(DeviceSurvey):
    """One serial bus."""

    spec: BusSpec
    port: str
    servos: tuple[SurveyedServo, ...]  # in order of ids
    missing: tuple[JointSpec, ...]  # in the order of the robot file
    other_rates: tuple[ScannedDevice, ...] = ()  # replies at other rates; scanned where a device is missing
    troubles: tuple[ScanFault, ...] = ()  # of the whole line
    asked: int = 0  # pings
    garbled: int = 0  # of those: replies that were corrupt, or had bytes too many
    lost: int = 0  # of those: no reply
    imu: SurveyedImu | None = None  # None: the robot file describes none there

    @property
    def devices(self) -> tuple[SurveyedDevice, ...]:
        """All servos that answered."""
        return tuple(
            SurveyedDevice(
                servo.bus,
                servo.id,
                None if servo.joint is None else servo.joint.name,
                servo.model_name or servo.model,
                servo.firmware,
                servo.values,
            )
            for servo in self.servos
        )

    @property
    def described_servos(self) -> tuple[SurveyedServo, ...]:
        """Servos of the robot file, without shared ids."""
        return tuple(servo for servo in self.servos if servo.joint is not None and not servo.trouble)


def serial_surveys(context: CheckContext) -> Iterator[SerialBusSurvey]:
    """Yield the survey of every serial bus. Raises as `CheckContext.survey_buses`."""

    def look(spec: BusSpec) -> SerialBusSurvey:
        if context.daemon is not None:
            return survey_by_daemon(context.daemon, spec, context.need_robot())
        if spec.name not in context.lines:
            raise OperationFailed(f"bus {spec.name} has no port: name it with --port")
        return survey_port(context.lines[spec.name], spec, context.need_robot())

    return context.survey_buses(tuple(tool_kinds()), look=look, kind=SerialBusSurvey)


def expected_servos(context: CheckContext) -> Iterator[tuple[SerialBusSurvey, SurveyedServo]]:
    """Yield every servo that has a joint and the joint's model, with its bus. Raises as above."""
    for survey in serial_surveys(context):
        yield from ((survey, servo) for servo in survey.described_servos if servo.is_expected_model)


# ------------------------------------------------------------------------------------------- free port


def survey_port(
    line: SerialBusInspector, spec: BusSpec, robot: RobotFile, ids: Sequence[int] | None = None
) -> SerialBusSurvey:
    """Survey one bus completely; other rates only where a device is missing. Raises OperationFailed.

    `ids`: the ids to ping; all of them take about a second at each rate.
    """
    try:
        return _survey(line, spec, robot, ids)
    except PortError as error:
        raise OperationFailed(str(error)) from error


def _survey(
    line: SerialBusInspector, spec: BusSpec, robot: RobotFile, ids: Sequence[int] | None
) -> SerialBusSurvey:
    tools = line.tools
    rate = scan_rate(line.prober, ids)
    joints = {joint.id: joint for joint in robot.joints if joint.bus == spec.name}
    probe = line.open_probe()
    answered = {each.id: each for each in rate.found}
    for id in joints.keys() - answered.keys():  # a reply lost on a busy machine is no missing servo
        device = _repeat_ping(probe, spec.baud, id)
        if device is not None:
            answered[id] = device
    imu = _imu_of(robot, spec)
    if imu is not None:
        answered.pop(imu.id, None)  # it is no servo
    servos = tuple(_servo(probe, tools, spec.name, answered[id], joints.get(id)) for id in sorted(answered))
    quality = _LinkQuality()
    delays = _ping_rounds(probe, [servo.id for servo in servos if not servo.trouble], quality)
    missing = tuple(joint for id, joint in joints.items() if id not in answered)
    wanted = range(max(joints) + 1)  # id 1, as from the factory, and those of the robot
    return SerialBusSurvey(
        spec,
        line.port,
        tuple(replace(servo, delay=delays.get(servo.id)) for servo in servos),
        missing,
        _scan_other_rates(line, spec, wanted) if missing else (),
        rate.troubles,
        quality.asked,
        quality.garbled,
        quality.lost,
        None if imu is None else _read_imu(probe, imu),
    )


def _imu_of(robot: RobotFile, spec: BusSpec) -> ImuSpec | None:
    return robot.imu if robot.imu is not None and robot.imu.bus == spec.name else None


def _imu_name(imu: ImuSpec) -> str:
    return f"bus {imu.bus} id {imu.id} (IMU)"


def _read_imu(probe: BusProbe, imu: ImuSpec) -> SurveyedImu:
    first, size = imu.span
    reply = _read(probe, imu.id, first, size)
    force = imu.acceleration
    if reply is None:
        return SurveyedImu(_imu_name(imu), False)
    raw = decoded(reply[0], force.address - first, force.kind, 3)
    return SurveyedImu(_imu_name(imu), True, float(np.linalg.norm((raw - force.zero) * force.lsb)))


class _LinkQuality:
    """Statistics of the pings to the devices that are present."""

    def __init__(self) -> None:
        self.asked = 0
        self.garbled = 0
        self.lost = 0


def _repeat_ping(probe: BusProbe, baud: int, id: int) -> ScannedDevice | None:
    found = _identify(probe, id)
    if found is None:
        return None
    return ScannedDevice(baud, id, found.model, found.model_name, found.firmware, None, None)


def _identify(probe: BusProbe, id: int) -> ServoIdentity | None:
    """Return the identity of a servo, after several attempts; None: none was answered."""
    return next((found for _ in range(TRIES) if (found := probe.identify(id)) is not None), None)


def _servo(
    probe: BusProbe, tools: FamilyTools, bus: str, device: ScannedDevice, joint: JointSpec | None
) -> SurveyedServo:
    """Inspect a servo that answered; where two share an id, no register is read."""
    values: dict[str, int] = {}
    identity = None if device.trouble or device.model is None else _identify(probe, device.id)
    if identity is not None and identity.table is not None:
        demanded = () if joint is None else tuple(joint.registers)
        values = _read_registers(probe, tools, device.id, identity.table, demanded)
    name = device.model_name
    return SurveyedServo(bus, device.id, joint, device.model, name, device.firmware, values, device.trouble)


def _ping_rounds(probe: BusProbe, ids: Sequence[int], quality: _LinkQuality) -> Mapping[int, float]:
    """Return the quickest reply (s) of each servo.

    The pings run in rounds, so that a short machine load does not count against one servo.
    """
    quickest: dict[int, float] = {}
    for _ in range(PINGS):
        for id in ids:
            reply = probe.ping(id)
            quality.asked += 1
            quality.garbled += reply.strays > 0
            quality.lost += reply.data is None and reply.strays == 0
            if reply.data is not None:
                quickest[id] = min(reply.delay, quickest.get(id, reply.delay))
    return quickest


def _read_registers(
    probe: BusProbe, tools: FamilyTools, id: int, table: ServoTable, demanded: Sequence[str]
) -> dict[str, int]:
    """Read the registers that checks compare, by one read of each memory area, without unreadable ones."""
    names = dict.fromkeys((*tools.settings(table), *MORE, *demanded))
    fields = [table[name] for name in names if name in table]
    found: dict[str, int] = {}
    error = 0
    for eeprom in (True, False):
        some = [each for each in fields if each.eeprom is eeprom]
        reply = _read_block(probe, id, some) if some else None
        if reply is not None:
            found.update(reply[0])
            error = reply[1]
    return tools.derive(found, error) if found else {}


def _read_block(
    probe: BusProbe, id: int, fields: Sequence[ServoRegister]
) -> tuple[dict[str, int], int] | None:
    """Return registers and the error byte of the reply."""
    first = min(each.address for each in fields)
    reply = _read(probe, id, first, max(each.end for each in fields) - first)
    if reply is None:
        return None
    data, error = reply
    return {each.key: each.decode(data[each.address - first :]) for each in fields}, error


def _read(probe: BusProbe, id: int, address: int, size: int) -> tuple[bytes, int] | None:
    """Read registers; None: it answers only pings (status return level 0), or with an error."""
    for _ in range(TRIES):
        reply = probe.read(id, address, size)
        if reply.data is not None:
            return reply.data, reply.error
    return None


def _scan_other_rates(
    line: SerialBusInspector, spec: BusSpec, ids: Sequence[int]
) -> tuple[ScannedDevice, ...]:
    """Return the devices that answer at other baud rates; restores the rate of the port afterwards."""

    def open_prober(baud: int) -> PortProber:
        line.transport.set_baud(baud)
        return PortProber(line.transport, line.clock, baud, line.tools.protocol, timer=line.timer_s)

    try:
        rates = list(
            scan(open_prober, [baud for baud in line.tools.protocol.bauds if baud != spec.baud], ids)
        )
    finally:
        line.transport.set_baud(spec.baud)
    return tuple(each for rate in rates for each in rate.found)


# ------------------------------------------------------------------------------------------- daemon


def survey_by_daemon(daemon: DaemonInspector, spec: BusSpec, robot: RobotFile) -> SerialBusSurvey:
    """Survey one bus through the daemon. Raises OperationFailed: not open, or no answer of the daemon."""
    port = daemon.port_of(spec.name)
    joints = {joint.id: joint for joint in robot.joints if joint.bus == spec.name}
    states = {joint["name"]: joint for joint in daemon.joints}
    imu = _imu_of(robot, spec)
    with daemon.open_operator() as client:
        present = scan_bus(client, spec.name)
        servos = tuple(
            _scanned_servo(client, joints[id], present[id], states.get(joints[id].name))
            for id in sorted(joints.keys() & present.keys())
        )
        measured = None if imu is None else _ask_imu(client, imu)
    missing = tuple(joint for id, joint in joints.items() if id not in present)
    return SerialBusSurvey(spec, port, servos, missing, imu=measured)


def _ask_imu(client: Client, imu: ImuSpec) -> SurveyedImu:
    """Return the daemon's last reading of the inertial sensor. Raises OperationFailed."""
    try:
        reading = client.call("Monitor", topics=["state"]).get("imu")
    except ClientError as error:
        raise OperationFailed(f"the daemon does not answer Monitor: {error}") from error
    if reading is None or reading["age_ms"] > SILENT:
        return SurveyedImu(_imu_name(imu), False)
    return SurveyedImu(_imu_name(imu), True, math.hypot(*reading["acceleration"]))


def _scanned_servo(
    client: Client, joint: JointSpec, found: Answer, state: JointMessage | None
) -> SurveyedServo:
    """Complete the scan of one servo by its state and by single reads of registers."""
    number = int(found["model"])
    firmware = int(found.get("firmware") or 0)
    tools = need_tools(joint.type.BUS)
    values = {name: int(value) for name, value in (found.get("settings") or {}).items()}
    # Without settings it answers pings alone.
    if values and number == tools.number_of(joint.type.device):
        table = tools.table_of(joint.type.device)
        if state is not None and state["voltage"] is not None:
            values[MEASURED[0]] = round(10 * state["voltage"])
        if state is not None and state["temperature"] is not None:
            values[MEASURED[1]] = round(state["temperature"])
        for name in dict.fromkeys((*tools.settings(table), *MORE, *joint.registers)):
            if name in table and name not in values and name not in MEASURED:
                value = _ask_register(client, joint, name)
                if value is not None:
                    values[name] = value
    return SurveyedServo(joint.bus, joint.id, joint, number, found.get("model_name"), firmware, values)


def _ask_register(client: Client, joint: JointSpec, name: str) -> int | None:
    """Read one register; None: no answer, or no such register. Raises OperationFailed: not served."""
    try:
        answer = client.call("ReadRegister", bus=joint.bus, id=joint.id, name=name)
    except CallError as error:
        if error.name in ("BusFailed", "NotFound"):
            return None
        raise OperationFailed(f"ReadRegister: {error}") from error
    except ClientError as error:
        raise OperationFailed(f"the daemon does not answer ReadRegister: {error}") from error
    return int(answer["register"]["value"])
