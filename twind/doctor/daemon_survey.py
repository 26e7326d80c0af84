"""Inspection of buses through the running daemon: its report on each joint, and registers.

Uses reading methods alone. The scan of the daemon delivers most registers. The others are read one by one,
each in the spare time of a tick, so that the loop keeps its rate: seconds for a whole robot.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from twind.client import CallError, Client, ClientError
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind.doctor.check import CheckUnavailable
from twind.doctor.daemon_inspector import DaemonInspector
from twind.doctor.survey import (
    EEPROM,
    MAPPED,
    RAM,
    CanSurvey,
    SerialSurvey,
    SurveyedCanActuator,
    SurveyedImu,
    SurveyedServo,
    is_queried,
    thing_of,
)
from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.dynamixel_identification import find_table as table_of

SILENT = 1000.0  # ms, of an IMU: one that is silent is asked at least once a second
PATIENCE = 65.0  # s for one answer: a scan of a slow bus
TOLD = {"pmax_milli": "position_range", "vmax_milli": "velocity_range", "tmax_milli": "torque_range"}
MEASURED = ("present_input_voltage", "present_temperature")
TORQUE = {True: 1, False: 0, None: -1}
Told = Mapping[str, Any]
T = TypeVar("T")


def operator(daemon: DaemonInspector) -> Client:
    """Open a connection that may read registers. Raises CheckUnavailable: this user is no operator."""
    client = Client(Path(daemon.path).parent, timeout=PATIENCE)
    try:
        client.connect()
    except ClientError as error:
        raise CheckUnavailable(f"registers are read by operators alone: {error}") from error
    return client


def survey_serial(daemon: DaemonInspector, spec: BusSpec, robot: RobotFile) -> SerialSurvey:
    """Inspect one serial bus. Raises CheckUnavailable: it is not open, or the daemon does not answer."""
    port, servos, missing = _bus(daemon, spec, robot, _servo)
    imu = robot.imu if robot.imu is not None and robot.imu.bus == spec.name else None
    found = tuple(sorted(servos, key=lambda servo: servo.id))
    return SerialSurvey(spec, port, found, missing, imu=None if imu is None else _inertial(daemon, imu))


def _inertial(daemon: DaemonInspector, imu: ImuSpec) -> SurveyedImu:
    """Return the daemon's last reading of the inertial sensor. Raises CheckUnavailable."""
    with operator(daemon) as client:
        try:
            told = client.call("Monitor", topics=["state"]).get("imu")
        except ClientError as error:
            raise CheckUnavailable(f"the daemon does not answer Monitor: {error}") from error
    if told is None or told["age_ms"] > SILENT:
        return SurveyedImu(thing_of(imu), False)
    return SurveyedImu(thing_of(imu), True, math.hypot(*told["acceleration"]))


def survey_can(daemon: DaemonInspector, spec: BusSpec, robot: RobotFile) -> CanSurvey:
    """Inspect one CAN bus. Raises CheckUnavailable as `survey_serial` does."""
    port, nodes, missing = _bus(daemon, spec, robot, _node)
    return CanSurvey(spec, port, nodes, tuple(filter(is_queried, missing)))


def _bus(
    daemon: DaemonInspector,
    spec: BusSpec,
    robot: RobotFile,
    look: Callable[[Client, JointSpec, Told, Told], T],
) -> tuple[str, tuple[T, ...], tuple[JointSpec, ...]]:
    """Return the port of a bus, its joints that answer, and those that do not."""
    port = _open(daemon, spec)
    joints = [joint for joint in robot.joints if joint.bus == spec.name]
    told = {joint["name"]: joint for joint in daemon.joints}
    with operator(daemon) as client:
        present = _scan(client, spec.name)
        found = tuple(
            look(client, joint, present[joint.id], told.get(joint.name, {}))
            for joint in joints
            if joint.id in present
        )
    return port, found, tuple(joint for joint in joints if joint.id not in present)


def _open(daemon: DaemonInspector, spec: BusSpec) -> str:
    for bus in daemon.status["buses"]:
        if bus["name"] == spec.name:
            return str(bus["port"])
    raise CheckUnavailable(f"the daemon has no bus {spec.name}: it runs with another robot file")


def _scan(client: Client, bus: str) -> dict[int, Told]:
    """Return the scan of the daemon, by id: the devices that answer among the ids that the daemon knows.

    Empty where all are silent. Raises CheckUnavailable: the bus failed otherwise, or the daemon does not
    answer.
    """
    try:
        return {int(found["id"]): found for found in client.stream("Scan", bus=bus)}
    except CallError as error:
        if error.name == "BusFailed" and error.parameters.get("silent"):
            return {}
        raise CheckUnavailable(f"bus {bus}: {error}") from error
    except ClientError as error:
        raise CheckUnavailable(f"the daemon does not answer Scan: {error}") from error


def _servo(client: Client, joint: JointSpec, found: Told, told: Told) -> SurveyedServo:
    number = int(found["model"])
    firmware = int(found.get("firmware") or 0)
    table = table_of(number, firmware)
    values = {name: int(value) for name, value in (found.get("settings") or {}).items()}
    if (
        table is not None and values
    ):  # who has no settings answers pings alone: nothing more can be read of it
        values |= _present(told) | _values(client, joint, table, values)
    return SurveyedServo(joint.bus, joint.id, joint, number, found.get("model_name"), firmware, values)


def _present(told: Told) -> dict[str, int]:
    """Return the values that the daemon reads continuously, in the counts of the register."""
    found = {
        "present_input_voltage": (told.get("voltage"), 10),
        "present_temperature": (told.get("temperature"), 1),
    }
    return {name: round(value * counts) for name, (value, counts) in found.items() if value is not None}


def _values(
    client: Client, joint: JointSpec, table: ControlTable, known: Mapping[str, int]
) -> dict[str, int]:
    """Read the registers that the scan lacks; of the indirect address map its first entry alone."""
    found: dict[str, int] = {}
    for name in (*EEPROM, *RAM, *joint.registers, f"{MAPPED}1"):
        if name in table and name not in known and name not in MEASURED:
            value = _register(client, joint, name)
            if value is not None:
                found[name] = value
    return found


def _register(client: Client, joint: JointSpec, name: str) -> int | None:
    """Read one register; None: no answer, or no such register. Raises CheckUnavailable: not served."""
    try:
        answer = client.call("ReadRegister", bus=joint.bus, id=joint.id, name=name)
    except CallError as error:
        if error.name in ("BusFailed", "NotFound"):
            return None
        raise CheckUnavailable(f"ReadRegister: {error}") from error
    except ClientError as error:
        raise CheckUnavailable(f"the daemon does not answer ReadRegister: {error}") from error
    return int(answer["register"]["value"])


def _node(_: Client, joint: JointSpec, found: Told, told: Told) -> SurveyedCanActuator:
    """Build the state of a CAN device from scan and status: a CAN bus has little time beside its cycle."""
    settings = {name: int(value) for name, value in (found.get("settings") or {}).items()}
    values = {TOLD.get(name, name): value for name, value in settings.items()}
    if told.get("voltage") is not None:
        values["bus_voltage"] = round(1e3 * told["voltage"])
    faults = tuple(name.replace("_", " ") for name in told.get("faults") or () if name != "alert")
    return SurveyedCanActuator(joint.bus, joint, values, TORQUE[told.get("torque")], faults)
