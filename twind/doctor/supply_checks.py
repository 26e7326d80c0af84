"""Checks of the servos' supply voltage: against the bounds of each type, and among servos of one type."""

from collections.abc import Iterator, Mapping
from statistics import median

from twind.config.actuator_types import TypeSpec
from twind.config.supply_limits import SupplyLimits, usual_supply
from twind.doctor.bus_surveys import merge_findings, serial
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.survey import SurveyedServo

DROP = 0.6  # V that a servo at rest may be below the others of its model; a sensor's step is 0.1 V
OTHERS = 3  # servos of a model on one bus that one servo is compared with, at least


def supply(examined: CheckContext) -> Iterator[DoctorFinding]:
    """VOLTAGE_LOW, VOLTAGE_HIGH, VOLTAGE_BOUNDS, VOLTAGE_DROP."""
    for survey in serial(examined):
        volts = {
            servo: servo.values["present_input_voltage"] / 10
            for servo in survey.described_servos
            if servo.is_expected_model and servo.values.get("present_input_voltage")
        }
        yield from _drops(survey.spec.name, volts)
        yield from merge_findings(found for servo, each in volts.items() for found in _volts(servo, each))


def _drops(bus: str, volts: Mapping[SurveyedServo, float]) -> Iterator[DoctorFinding]:
    """Servos below the others of their model and bounds: one bus can have models of 5 V and of 12 V."""
    groups: dict[tuple[str, SupplyLimits], list[SurveyedServo]] = {}
    for servo in volts:
        kind = _type(servo)
        groups.setdefault((kind.device, kind.supply), []).append(servo)
    for (device, bounds), same in groups.items():
        usual = median(volts[servo] for servo in same)
        low = [servo for servo in same if len(same) > OTHERS and usual - volts[servo] >= DROP - 1e-9]
        if low and usual <= _most(device, bounds):  # above it the others are wrong: VOLTAGE_HIGH
            measured = ", ".join(f"id {servo.id} {volts[servo]:.1f} V" for servo in low)
            expected = f"within {DROP:.1f} V of the other {device}, which measure {usual:.1f} V"
            yield DoctorFinding("VOLTAGE_DROP", f"bus {bus}", measured, expected)


def _volts(servo: SurveyedServo, volts: float) -> Iterator[DoctorFinding]:
    """Against the bounds of the type (the model's where the robot file has none) and the limits (34, 32)."""
    kind = _type(servo)
    least = max(kind.supply.warn, servo.values.get("min_voltage_limit", 0) / 10)
    most = min(kind.supply.high, servo.values.get("max_voltage_limit", 1000) / 10)
    if least >= (rated := min(most, _most(kind.device, kind.supply))):
        expected = f"a lower bound below {rated:.1f} V, the most that it may get"
        yield DoctorFinding(
            "VOLTAGE_BOUNDS", servo.thing, f"{volts:.1f} V, to be above {least:.1f} V", expected
        )
    elif volts <= least:
        yield DoctorFinding(
            "VOLTAGE_LOW", servo.thing, f"{volts:.1f} V", f"above {least:.1f} V, {most:.1f} V at most"
        )
    elif volts > most:
        yield DoctorFinding(
            "VOLTAGE_HIGH", servo.thing, f"{volts:.1f} V", f"{most:.1f} V or less, above {least:.1f} V"
        )


def _most(device: str, bounds: SupplyLimits) -> float:
    """The highest voltage (V) that the robot file and the model's rated range both allow."""
    return min(bounds.high, usual_supply(device).high)


def _type(servo: SurveyedServo) -> TypeSpec:
    assert servo.joint is not None
    return servo.joint.type
