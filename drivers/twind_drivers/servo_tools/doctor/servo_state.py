"""Subject: state of servos. Errors, heat, torque, watchdogs, and supply voltage within each type's bounds.

Rows that CAN actuators share are here; their checks are in `can_bus.py`.
"""

from collections.abc import Iterator, Mapping
from statistics import median

from twind.config.actuator_types import TypeSpec
from twind.config.supply_limits import SupplyLimits
from twind.doctor.check import SUPPORT, Check, DoctorFinding, Severity, merge_findings
from twind.doctor.check_context import CheckContext, Inspection, is_armed
from twind_drivers.servo_tools.doctor.register_fix import format_command, offer_fix
from twind_drivers.servo_tools.doctor.serial_bus_survey import SurveyedServo, expected_servos, serial_surveys
from twind_drivers.servo_tools.doctor.servo_settings import SERVOS
from twind_drivers.servo_tools.family_tools import need_tools

DROP = 0.6  # V that a servo at rest may be below the others of its model; a sensor's step is 0.1 V
OTHERS = 3  # servos of a model on one bus that one servo is compared with, at least
TRIPPED = 255  # value of a bus watchdog that has expired

ROWS = (
    Check(
        "VOLTAGE_LOW",
        "the supply is low",
        "devices grow weak, then restart during motion",
        "measure with a meter at the device, compare with its page; charge the battery, use thicker cables "
        "or a stronger supply of equal voltage",
        Severity.WARNING,
        caution="never feed a device above the rated voltage of its model, nor raise a supply that other "
        "models share",
    ),
    Check(
        "VOLTAGE_HIGH",
        "the supply is high",
        "too much voltage damages servos",
        "disarm, switch the supply off; use one of the right voltage",
        Severity.FAULT,
        caution=SUPPORT,
    ),
    Check(
        "VOLTAGE_DROP",
        "servos get less voltage than others on this bus",
        "thin cable or bad connector: these servos restart first",
        "measure the voltage at the first of them; if low, check the cables before it; feed long chains at "
        "both ends",
        Severity.WARNING,
        caution="do not raise the supply: the others would get too much",
        explains=("VOLTAGE_LOW",),
    ),
    Check(
        "SERVO_ERROR",
        "a device reports an error, or is hot",
        "it has no torque until a restart, or will shut down; after an encoder error its position is unknown",
        "let it cool, remove the load, check supply and connectors; then `twindctl reboot BUS ID`; CAN: "
        "`twindctl reset`, else power off and on",
        Severity.FAULT,
        caution="support the joint: without torque it falls; find the cause first, or it fails again; "
        "after an encoder error compare its position with the joint before you arm",
    ),
    Check(
        "TORQUE_ON",
        "torque is on without arming or without a watchdog",
        "an ended program left it on: it heats, obeys the next goal, and does not stop if its program dies",
        "stand by: `twindctl arm` takes it over and sets the watchdog, `twindctl disarm` lowers the robot",
        Severity.WARNING,
        caution=SUPPORT,
    ),
    Check(
        "WATCHDOG_TRIPPED",
        "the bus watchdog tripped with torque on",
        "it holds and accepts no goals: its master died or stalled",
        "`twindctl disarm` lowers it, then `twindctl reset`",
        Severity.FAULT,
        caution=SUPPORT,
    ),
    Check(
        "WATCHDOG_LEFT",
        "a bus watchdog is set",
        "arming sets it; until then goals of other programs fail (error 4)",
        "`twindctl register write BUS ID bus_watchdog 0`, torque off",
        Severity.NOTE,
        caution="disarming leaves it set; if another program set it, end that program first: "
        "it relies on it to stop",
    ),
)


def check_state(context: CheckContext) -> Iterator[DoctorFinding]:
    """SERVO_ERROR, TORQUE_ON, WATCHDOG_TRIPPED, WATCHDOG_LEFT."""
    armed = is_armed(context)
    servos = [servo for _, servo in expected_servos(context)]
    yield from merge_findings(found for servo in servos for found in _state(context, servo, armed=armed))


def _state(context: CheckContext, servo: SurveyedServo, *, armed: bool) -> Iterator[DoctorFinding]:
    assert servo.joint is not None
    torque = servo.values.get("torque_enable") == 1
    bits = servo.values.get("hardware_error_status", 0)
    for bit, (name, advice) in servo.tools.errors.items():
        if bits >> bit & 1:
            reboots = servo.tools.reboots and not torque  # it would release the joint
            command = f"twindctl reboot {servo.bus} {servo.id}" if reboots else ""
            held = "hardware_error_status" in servo.table
            where = (
                f"hardware error ({servo.table['hardware_error_status'].address})" if held else "error byte"
            )
            text = f"{where} is {bits}: {name}"
            yield DoctorFinding("SERVO_ERROR", servo.thing, text, "0", command, advice=advice)
    warm = servo.values.get("present_temperature")
    bound = servo.joint.type.heat.warn
    if warm is not None and warm >= bound:
        advice = "let it rest; look for weight in the rest pose or an obstacle"
        expected = f"below {bound:g} degC"
        yield DoctorFinding(
            "SERVO_ERROR", servo.thing, f"{warm} degC", expected, advice=advice, severity=Severity.WARNING
        )
    yield from _torque(context, servo, torque=torque, armed=armed)


def _torque(
    context: CheckContext, servo: SurveyedServo, *, torque: bool, armed: bool
) -> Iterator[DoctorFinding]:
    watchdog = servo.values.get("bus_watchdog")
    off = torque and watchdog == 0
    if torque and (off or not armed):
        text = "torque is on" + ("; bus watchdog (98) is 0" if off else "")
        expected = "off, or armed" + ("" if watchdog is None else " with a watchdog of 5, 100 ms")
        yield DoctorFinding("TORQUE_ON", servo.thing, text, expected, "" if armed else "twindctl disarm")
    if torque and watchdog == TRIPPED:
        text = f"bus watchdog (98) is {watchdog}"
        yield DoctorFinding("WATCHDOG_TRIPPED", servo.thing, text, "5, 100 ms, while torque is on")
    elif watchdog and not torque and not (context.daemon and context.daemon.is_live):
        # A disarm leaves it set and arming sets it anew: it hinders only programs other than a live daemon.
        time = ", tripped" if watchdog == TRIPPED else f", {20 * watchdog} ms"
        yield DoctorFinding(
            "WATCHDOG_LEFT",
            servo.thing,
            f"bus watchdog (98) is {watchdog}{time}",
            "0 while torque is off",
            format_command(servo, "bus_watchdog", 0),
            offer_fix(context, servo, "bus_watchdog", 0),
        )


def check_supply(context: CheckContext) -> Iterator[DoctorFinding]:
    """VOLTAGE_LOW, VOLTAGE_HIGH, VOLTAGE_DROP, and REGISTER_DIFFERS for bounds that exclude each other."""
    for survey in serial_surveys(context):
        volts = {
            servo: servo.values["present_input_voltage"] / 10
            for servo in survey.described_servos
            if servo.is_expected_model and servo.values.get("present_input_voltage")
        }
        yield from _drops(survey.spec.name, volts)
        yield from merge_findings(found for servo, each in volts.items() for found in _volts(servo, each))


def _drops(bus: str, volts: Mapping[SurveyedServo, float]) -> Iterator[DoctorFinding]:
    """Compare servos of one model and bounds: one bus can have models of 5 V and of 12 V."""
    groups: dict[tuple[str, str, SupplyLimits], list[SurveyedServo]] = {}
    for servo in volts:
        kind = _type(servo)
        groups.setdefault((kind.BUS, kind.device, kind.supply), []).append(servo)
    for (kind_of_bus, device, bounds), same in groups.items():
        usual = median(volts[servo] for servo in same)
        low = [servo for servo in same if len(same) > OTHERS and usual - volts[servo] >= DROP - 1e-9]
        if low and usual <= _most(kind_of_bus, device, bounds):  # above it the others are wrong: VOLTAGE_HIGH
            text = ", ".join(f"id {servo.id} {volts[servo]:.1f} V" for servo in low)
            expected = f"within {DROP:.1f} V of the other {device}, which measure {usual:.1f} V"
            yield DoctorFinding("VOLTAGE_DROP", f"bus {bus}", text, expected)


def _volts(servo: SurveyedServo, volts: float) -> Iterator[DoctorFinding]:
    """Compare with the bounds of the type and the limits of the servo (34, 32)."""
    kind = _type(servo)
    least = max(kind.supply.warn, servo.values.get("min_voltage_limit", 0) / 10)
    most = min(kind.supply.high, servo.values.get("max_voltage_limit", 1000) / 10)
    rated = min(most, _most(kind.BUS, kind.device, kind.supply))
    if least >= rated:
        text = f"{volts:.1f} V, to be above {least:.1f} V"
        expected = f"a lower bound below {rated:.1f} V, the most that it may get"
        advice = (
            "no supply fits these bounds: leave it as it is; correct `supply` of its type, or "
            "min_voltage_limit, max_voltage_limit, by the model's page"
        )
        yield DoctorFinding("REGISTER_DIFFERS", servo.thing, text, expected, advice=advice)
    elif volts <= least:
        expected = f"above {least:.1f} V, {most:.1f} V at most"
        yield DoctorFinding("VOLTAGE_LOW", servo.thing, f"{volts:.1f} V", expected)
    elif volts > most:
        expected = f"{most:.1f} V or less, above {least:.1f} V"
        yield DoctorFinding("VOLTAGE_HIGH", servo.thing, f"{volts:.1f} V", expected)


def _most(kind: str, device: str, bounds: SupplyLimits) -> float:
    """Return the highest voltage (V) that the robot file and the model's rated range both allow."""
    return min(bounds.high, need_tools(kind).supply(device).high)


def _type(servo: SurveyedServo) -> TypeSpec:
    assert servo.joint is not None
    return servo.joint.type


CHECKS = (
    Inspection(SERVOS, ("VOLTAGE_LOW", "VOLTAGE_HIGH", "REGISTER_DIFFERS", "VOLTAGE_DROP"), check_supply),
    Inspection(SERVOS, ("SERVO_ERROR", "TORQUE_ON", "WATCHDOG_TRIPPED", "WATCHDOG_LEFT"), check_state),
)
