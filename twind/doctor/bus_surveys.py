"""The buses as surveyed, once for all checks, and findings that many servos share told once."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from twind.config.actuator_types import CAN
from twind.config.robot_spec import BusSpec
from twind.doctor import daemon_survey
from twind.doctor.can_survey import survey_can_line
from twind.doctor.check import (
    CheckNotApplicable,
    CheckUnavailable,
    Devices,
    DoctorFinding,
    Fix,
)
from twind.doctor.check_context import CheckContext
from twind.doctor.serial_survey import survey_port
from twind.doctor.survey import CanSurvey, SerialSurvey, SurveyedServo

T = TypeVar("T")
MANY = 3  # things of one bus with the same complaint; more of them share one finding


def serial(examined: CheckContext) -> Iterator[SerialSurvey]:
    """Every serial bus that can be looked at. NothingThere: there is none; CannotLook after the others."""
    yield from _surveys(examined, lambda spec: spec.kind != CAN, _serial, SerialSurvey)


def can(examined: CheckContext) -> Iterator[CanSurvey]:
    """Every CAN bus that can be looked at. Raises as above."""
    yield from _surveys(examined, lambda spec: spec.kind == CAN, _can, CanSurvey)


def servos(examined: CheckContext) -> Iterator[tuple[SerialSurvey, SurveyedServo]]:
    """Every servo that is a joint's and of the joint's model, with its bus. Raises as above."""
    for survey in serial(examined):
        yield from ((survey, servo) for servo in survey.described_servos if servo.is_expected_model)


def merge_findings(found: Iterable[DoctorFinding]) -> Iterator[DoctorFinding]:
    """The same complaint about more than a few servos of one bus is told once, and mended at once."""
    groups: dict[tuple[str, str, str, str, bool], list[DoctorFinding]] = {}
    for each in found:
        bus = _devices(each).bus
        key = (each.code, bus, each.measured, each.expected, each.fix is None)
        groups.setdefault(key, []).append(each)
    for (_, bus, *_), same in groups.items():
        yield from same if len(same) <= MANY else [_joined(bus, same)]


def _devices(found: DoctorFinding) -> Devices:
    """The devices that a finding is about. Raises TypeError: it is about something else."""
    if not isinstance(found.thing, Devices):
        raise TypeError(f"{found.code}: {found.thing!r} names no devices of a bus")
    return found.thing


def _joined(bus: str, same: list[DoctorFinding]) -> DoctorFinding:
    thing = Devices(bus, [member for each in same for member in _devices(each).members])
    fixes = [each.fix for each in same if each.fix is not None]
    commands = "\n".join(each.command for each in same if each.command)
    # Each does the same to its own device.
    fix = Fix(fixes[0].text, lambda: _all(fixes), thing) if fixes else None
    return replace(same[0], thing=thing, command=commands, fix=fix)


def _all(fixes: Iterable[Fix]) -> None:
    for each in fixes:
        each.do()


def _surveys(
    examined: CheckContext,
    wanted: Callable[[BusSpec], bool],
    look: Callable[[CheckContext, BusSpec], T],
    kind: type[T],
) -> Iterator[T]:
    if examined.sim:
        raise CheckNotApplicable("mode sim opens no bus")
    specs = [spec for spec in examined.need_robot().buses if wanted(spec)]
    if not specs:
        raise CheckNotApplicable
    reasons = []
    for spec in specs:
        if spec.name not in examined.surveys:
            try:
                examined.surveys[spec.name] = look(examined, spec)
            except CheckUnavailable as error:
                examined.surveys[spec.name] = error
        seen = examined.surveys[spec.name]
        if isinstance(seen, kind):
            yield seen
        else:
            reasons.append(str(seen))
    if reasons:
        raise CheckUnavailable("; ".join(dict.fromkeys(reasons)))


def _serial(examined: CheckContext, spec: BusSpec) -> SerialSurvey:
    if examined.daemon is not None:
        return daemon_survey.survey_serial(examined.daemon, spec, examined.need_robot())
    return survey_port(_line(examined.lines, spec), spec, examined.need_robot())


def _can(examined: CheckContext, spec: BusSpec) -> CanSurvey:
    if examined.daemon is not None:
        return daemon_survey.survey_can(examined.daemon, spec, examined.need_robot())
    return survey_can_line(_line(examined.can_lines, spec))


def _line(lines: Mapping[str, T], spec: BusSpec) -> T:
    if spec.name not in lines:
        raise CheckUnavailable(f"bus {spec.name} has no port: name it with --port")
    return lines[spec.name]
