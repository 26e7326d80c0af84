"""Checks of CAN buses and their actuators. Each looks at the surveys and the robot file."""

from collections.abc import Iterator

from twind.config.actuator_types import CanType
from twind.config.robot_spec import JointSpec
from twind.doctor.bus_surveys import can, merge_findings
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.survey import CanSurvey, SurveyedCanActuator, device_of

# What registers say of the frames' ranges, in thousandths -> key of the robot file, unit.
RANGES = {
    "position_range": ("position_rad", "rad"),
    "velocity_range": ("velocity_rad_s", "rad/s"),
    "torque_range": ("torque_nm", "N·m"),
}
ROUNDING = 1  # thousandths
# Family -> register of its mode, and the value in which it takes the daemon's commands.
MODES = {"damiao": ("mode", 1), "robstride": ("run_mode", 0)}


def bus(examined: CheckContext) -> Iterator[DoctorFinding]:
    """CAN_SILENT, CAN_CONTROLLER, CAN_MASTER, CAN_FOREIGN, CAN_MISSING."""
    for survey in can(examined):
        thing = f"bus {survey.spec.name} ({survey.port})"
        if survey.condition:
            yield DoctorFinding("CAN_CONTROLLER", thing, survey.condition)
        if survey.masters:
            yield DoctorFinding(
                "CAN_MASTER", thing, f"{survey.masters} commands of somebody else in a moment", "none"
            )
        if survey.strangers:
            yield DoctorFinding(
                "CAN_FOREIGN", thing, f"{survey.strangers} frames of unknown ids in a moment", "none"
            )
        if survey.missing and not survey.nodes:
            yield DoctorFinding(
                "CAN_SILENT", thing, f"none of {len(survey.missing)} actuators answers", "all of them"
            )
        else:
            yield from merge_findings(
                DoctorFinding("CAN_MISSING", device_of(each), "no answer") for each in survey.missing
            )


def nodes(examined: CheckContext) -> Iterator[DoctorFinding]:
    """CAN_TWICE, CAN_RANGE, CAN_MODE, CAN_FAULT, CAN_VOLTAGE_LOW."""
    for survey in can(examined):
        yield from merge_findings(_nodes(survey))


def _nodes(survey: CanSurvey) -> Iterator[DoctorFinding]:
    for node in survey.nodes:
        if node.twice:
            yield DoctorFinding("CAN_TWICE", node.thing, "more answers come than were asked for", "one")
            continue
        yield from _ranges(node)
        yield from _mode(node)
        if node.faults:
            yield DoctorFinding("CAN_FAULT", node.thing, ", ".join(node.faults), "no fault")
        volts = node.values.get("bus_voltage")
        least = node.joint.type.supply.warn
        if volts is not None and volts * 1e-3 <= least:
            yield DoctorFinding(
                "CAN_VOLTAGE_LOW", node.thing, f"{volts * 1e-3:.1f} V", f"above {least:.1f} V"
            )


def _ranges(node: SurveyedCanActuator) -> Iterator[DoctorFinding]:
    kind = _kind(node.joint)
    for name, (key, unit) in RANGES.items():
        value = node.values.get(name)
        described = getattr(kind.ranges, key)
        if value is not None and abs(value - round(1e3 * described)) > ROUNDING:
            expected = f"{described:g} {unit}, `ranges.{key}` of type {kind.name}"
            yield DoctorFinding("CAN_RANGE", node.thing, f"{name} is {value / 1e3:g} {unit}", expected)


def _mode(node: SurveyedCanActuator) -> Iterator[DoctorFinding]:
    name, wanted = MODES.get(_kind(node.joint).family, ("", 0))
    value = node.values.get(name)
    if value is not None and value != wanted:
        how = f"twindctl register write {node.bus} {node.joint.id} {name} {wanted}"
        yield DoctorFinding("CAN_MODE", node.thing, f"{name} is {value}", f"{wanted}", how)


def torque(examined: CheckContext) -> Iterator[DoctorFinding]:
    """CAN_TORQUE_ON, CAN_WATCHDOG_OFF, CAN_WATCHDOG_UNVERIFIED."""
    armed = examined.daemon is not None and bool(examined.daemon.status["armed"])
    for survey in can(examined):
        yield from merge_findings(_torque(survey, armed=armed))


def _torque(survey: CanSurvey, *, armed: bool) -> Iterator[DoctorFinding]:
    for node in survey.nodes:
        if node.torque == 1 and not armed:
            yield DoctorFinding("CAN_TORQUE_ON", node.thing, "torque is on", "off", "twindctl disarm")
        if node.torque == 1 and node.values.get("timeout") == 0:
            yield DoctorFinding(
                "CAN_WATCHDOG_OFF", node.thing, "timeout is 0, off", "100 ms while torque is on"
            )
        kind = _kind(node.joint)
        if not kind.watched:
            yield DoctorFinding(
                "CAN_WATCHDOG_UNVERIFIED", node.thing, "`watchdog: unverified` in the robot file"
            )


def _kind(joint: JointSpec) -> CanType:
    assert isinstance(joint.type, CanType)
    return joint.type
