"""Inspection of a serial bus on its free port: devices, their settings, line quality. Reads only."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind.doctor.bus_probe import BusProbe
from twind.doctor.check import CheckUnavailable
from twind.doctor.serial_bus_inspector import SerialBusInspector
from twind.doctor.survey import (
    EEPROM,
    MAPPED,
    RAM,
    SerialSurvey,
    SurveyedImu,
    SurveyedServo,
    thing_of,
)
from twind_drivers.bus import PortError
from twind_drivers.dynamixel.bus_scan import BAUDS, IDS, ScannedDevice, scan, scan_rate
from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister
from twind_drivers.dynamixel.dynamixel_identification import find_table as table_of
from twind_drivers.dynamixel.prober import Prober
from twind_drivers.dynamixel.register_sensor import decoded

PINGS = 12  # of each servo, for the line's quality and each one's delay
TRIES = 3  # of a read that nobody answers
ENTRIES = 28  # indirect addresses of the first row (e-manual, X series)


def survey_port(
    line: SerialBusInspector, spec: BusSpec, robot: RobotFile, ids: Sequence[int] = IDS
) -> SerialSurvey:
    """Inspect one bus completely; other rates only where a device is missing. Raises CheckUnavailable.

    `ids`: the ids to ping; all of them take about a second at each rate.
    """
    try:
        return _survey(line, spec, robot, ids)
    except PortError as error:
        raise CheckUnavailable(str(error)) from error


def _survey(line: SerialBusInspector, spec: BusSpec, robot: RobotFile, ids: Sequence[int]) -> SerialSurvey:
    rate = scan_rate(line.prober, ids)
    joints = {joint.id: joint for joint in robot.joints if joint.bus == spec.name}
    asker = BusProbe(line.transport, line.clock, spec.baud, timer=_timer(line))
    answered = {each.id: each for each in rate.found}
    for id in joints.keys() - answered.keys():  # a roll call lost on a busy machine is no missing servo
        answer = _repeat_ping(asker, spec.baud, id)
        if answer is not None:
            answered[id] = answer
    imu = robot.imu if robot.imu is not None and robot.imu.bus == spec.name else None
    if imu is not None:
        answered.pop(imu.id, None)  # it is no servo
    servos = tuple(_servo(asker, spec.name, answered[id], joints.get(id)) for id in sorted(answered))
    quality = _LinkQuality()
    delays = _pinged(asker, [servo.id for servo in servos if not servo.trouble], quality)
    servos = tuple(replace(servo, delay=delays.get(servo.id)) for servo in servos)
    missing = tuple(joint for id, joint in joints.items() if id not in answered)
    wanted = range(max(joints) + 1)  # id 1, as from the factory, and those of the robot
    elsewhere = _elsewhere(line, spec, wanted) if missing else ()
    return SerialSurvey(
        spec,
        line.port,
        servos,
        missing,
        elsewhere,
        rate.troubles,
        quality.asked,
        quality.garbled,
        quality.lost,
        None if imu is None else _inertial(asker, imu),
    )


def _inertial(asker: BusProbe, imu: ImuSpec) -> SurveyedImu:
    """Return the present reading of the inertial sensor."""
    first, size = imu.span
    data = _read(asker, imu.id, first, size)
    force = imu.acceleration
    if data is None:
        return SurveyedImu(thing_of(imu), False)
    raw = decoded(data, force.address - first, force.kind, 3)
    return SurveyedImu(thing_of(imu), True, float(np.linalg.norm((raw - force.zero) * force.lsb)))


class _LinkQuality:
    """Statistics of the pings to the devices that are present."""

    def __init__(self) -> None:
        self.asked = self.garbled = self.lost = 0


def _repeat_ping(asker: BusProbe, baud: int, id: int) -> ScannedDevice | None:
    for _ in range(TRIES):
        data = asker.ping(id).data
        if data is not None:
            number = int.from_bytes(data[:2], "little")
            firmware = data[2]
            table = table_of(number, firmware)
            return ScannedDevice(baud, id, number, table.model if table else None, firmware, None, None)
    return None


def _servo(asker: BusProbe, bus: str, answer: ScannedDevice, joint: JointSpec | None) -> SurveyedServo:
    """Inspect a servo that answered; where two share an id, no register is read."""
    values: dict[str, int] = {}
    if not answer.trouble and answer.model is not None and answer.firmware is not None:
        table = table_of(answer.model, answer.firmware)
        demanded = () if joint is None else tuple(joint.registers)
        values = {} if table is None else _values(asker, answer.id, table, demanded)
    name = answer.model_name
    firmware = answer.firmware
    return SurveyedServo(bus, answer.id, joint, answer.model, name, firmware, values, answer.trouble)


def _pinged(asker: BusProbe, ids: Sequence[int], quality: _LinkQuality) -> Mapping[int, float]:
    """Return the quickest answer (s) of each servo.

    The pings run in rounds, so that a short machine load does not count against one servo.
    """
    quickest: dict[int, float] = {}
    for _ in range(PINGS):
        for id in ids:
            heard = asker.ping(id)
            quality.asked += 1
            quality.garbled += heard.strays > 0
            quality.lost += heard.data is None and heard.strays == 0
            if heard.data is not None:
                quickest[id] = min(heard.delay, quickest.get(id, heard.delay))
    return quickest


def _values(asker: BusProbe, id: int, table: ControlTable, demanded: Sequence[str]) -> dict[str, int]:
    """Read the registers that checks compare, by one read of each memory area, without unreadable ones."""
    fields = [table[name] for name in (*EEPROM, *RAM, *demanded) if name in table]
    found: dict[str, int] = {}
    for eeprom in (True, False):
        found.update(_block(asker, id, [each for each in fields if each.eeprom is eeprom]))
    return found | _maps(asker, id, table)


def _block(asker: BusProbe, id: int, fields: Sequence[TableRegister]) -> dict[str, int]:
    if not fields:
        return {}
    first = min(each.address for each in fields)
    end = max(each.end for each in fields)
    data = _read(asker, id, first, end - first)
    if data is None:
        return {}
    return {each.key: each.decode(data[each.address - first :]) for each in fields}


def _maps(asker: BusProbe, id: int, table: ControlTable) -> dict[str, int]:
    """Read the first row of indirect addresses, two bytes each (e-manual, "Indirect Address")."""
    if f"{MAPPED}1" not in table or "indirect_data_1" not in table:
        return {}
    first = table[f"{MAPPED}1"].address
    data = table["indirect_data_1"].address
    entries = min(ENTRIES, (data - first) // 2)
    raw = _read(asker, id, first, 2 * entries)
    if raw is None:
        return {}
    words = (int.from_bytes(raw[2 * place : 2 * place + 2], "little") for place in range(entries))
    return {f"{MAPPED}{place + 1}": word for place, word in enumerate(words)}


def _read(asker: BusProbe, id: int, address: int, size: int) -> bytes | None:
    """Read registers; None: it answers only pings (status return level 0), or with an error."""
    for _ in range(TRIES):
        heard = asker.read(id, address, size)
        if heard.data is not None:
            return heard.data
    return None


def _elsewhere(line: SerialBusInspector, spec: BusSpec, ids: Sequence[int]) -> tuple[ScannedDevice, ...]:
    """Return the devices that answer at the other baud rates; restores the rate of the port afterwards."""
    timer = _timer(line)

    def open_prober(baud: int) -> Prober:
        line.transport.set_baud(baud)
        return Prober(line.transport, line.clock, baud, timer=timer)

    try:
        rates = list(scan(open_prober, [baud for baud in BAUDS if baud != spec.baud], ids))
    finally:
        line.transport.set_baud(spec.baud)
    return tuple(each for rate in rates for each in rate.found)


def _timer(line: SerialBusInspector) -> float:
    return (line.transport.latency_ms or 0) * 1e-3
