"""Checks of the doctor that depend on the family of a servo, and those of a family without own ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from twind.config.robot_spec import JointSpec
from twind.doctor.check import DoctorFinding, Severity
from twind.doctor.check_context import CheckContext
from twind_drivers.servo_tools.doctor.register_fix import format_command, offer_fix
from twind_drivers.servo_tools.doctor.serial_bus_survey import (
    SerialBusSurvey,
    SurveyedServo,
    expected_servos,
)
from twind_drivers.servo_tools.family_tools import need_tools

Findings = Iterator[DoctorFinding]
Judge = Callable[[CheckContext, SurveyedServo, JointSpec], Findings]
# Register -> row of a wrong value. Others: REGISTER_DIFFERS.
ROWS_OF = {
    "status_return_level": "STATUS_LEVEL",
    "operating_mode": "OPERATING_MODE",
    "min_position_limit": "OPERATING_MODE",
    "max_position_limit": "OPERATING_MODE",
    "shutdown": "SHUTDOWN_MASK",
    "return_delay_time": "RETURN_DELAY",
}
ALONE = "stop the daemon, then `twindctl doctor --fix`"
# Registers that a daemon does not write, with what to do.
ADVICE = {
    "status_return_level": ALONE,
    "operating_mode": ALONE,
    "lock": "its settings are locked: switch its supply off and on",
}


@dataclass(frozen=True, slots=True)
class ServoJudges:
    """Checks of servos that have a joint and its model, by inspection."""

    models: Sequence[Judge] = ()
    settings: Sequence[Judge] = ()
    limits: Sequence[Judge] = ()
    delays: Sequence[Judge] = ()
    bus: Callable[[CheckContext, SerialBusSurvey], Findings] | None = None


def judges_of(kind: str) -> ServoJudges:
    """Return the checks of a kind of bus: its own, else those of the registers that arming needs."""
    part = need_tools(kind).judges
    if part is not None:
        own: ServoJudges = part.load()
        return own
    return ServoJudges(
        settings=(_demanded("STATUS_LEVEL", "OPERATING_MODE", "REGISTER_DIFFERS"), _unfit),
        limits=(_demanded("SHUTDOWN_MASK"),),
        delays=(_demanded("RETURN_DELAY"),),
    )


def judged(context: CheckContext, choose: Callable[[ServoJudges], Sequence[Judge]]) -> Findings:
    """Run the chosen checks on every servo that has a joint and the joint's model."""
    for survey, servo in expected_servos(context):
        assert servo.joint is not None
        for judge in choose(judges_of(survey.spec.kind)):
            yield from judge(context, servo, servo.joint)


def _demanded(*codes: str) -> Judge:
    """Return the check for registers that hold another value than arming needs, of these rows."""

    def check(context: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Findings:
        for name, wanted in _differing(servo, joint).items():
            code = ROWS_OF.get(name, "REGISTER_DIFFERS")
            if code not in codes:
                continue
            by_daemon = name not in ADVICE
            fixable = name != "lock" and (by_daemon or context.daemon is None)
            yield DoctorFinding(
                code,
                servo.thing,
                f"{name} ({servo.table[name].address}) is {servo.values[name]}",
                f"{wanted}",
                format_command(servo, name, wanted) if by_daemon else "",
                offer_fix(context, servo, name, wanted) if fixable else None,
                advice=ADVICE.get(name, ""),
                severity=Severity.NOTE if name == "lock" else None,
            )

    return check


def _differing(servo: SurveyedServo, joint: JointSpec) -> dict[str, int]:
    """Return the registers with another value than arming needs, and that value."""
    demanded = servo.tools.demanded
    wanted = {} if demanded is None else demanded(joint, servo.table, servo.values)
    return {name: value for name, value in wanted.items() if servo.values.get(name, value) != value}


def _unfit(_: CheckContext, servo: SurveyedServo, joint: JointSpec) -> Findings:
    """Yield what arming refuses beside those registers and an error."""
    if _differing(servo, joint).keys() - {"lock"} or servo.values.get("hardware_error_status"):
        return
    tools = servo.tools
    device = tools.identified(servo.id, joint.type.device, servo.firmware or 0, servo.values)
    for text in joint.type.unfit(joint, device):
        yield DoctorFinding("REGISTER_DIFFERS", servo.thing, text, "what arming accepts")
