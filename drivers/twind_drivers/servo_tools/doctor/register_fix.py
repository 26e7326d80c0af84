"""Write of one register of one servo with read-back: through the running daemon, or on the free port.

It is offered only while the robot is disarmed and the torque of that servo is off. Both are checked again
before the write. Only `Fix.do` creates a writer.
"""

from pathlib import Path

from twind.client import Client
from twind.command_line.verb import Rejected, write_register
from twind.doctor.check import Fix
from twind.doctor.check_context import CheckContext
from twind.doctor.inspectors import DaemonInspector
from twind_drivers.servo_tools.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.servo_tools.doctor.serial_bus_survey import SurveyedServo
from twind_drivers.servo_tools.family_tools import ServoLocation
from twind_drivers.servo_tools.servo_configurator import ServoConfigurator


def format_command(servo: SurveyedServo, register: str, value: int) -> str:
    """Return the shell command of the write; the daemon must be in live, with torque off."""
    return f"twindctl register write {servo.bus} {servo.id} {register} {value}"


def offer_fix(context: CheckContext, servo: SurveyedServo, name: str, value: int) -> Fix | None:
    """Return the fix that writes `value`; None: it is not offered.

    Reasons: torque is on or unknown, the robot is armed, the daemon may not write, or the robot file
    demands another value.
    """
    if servo.values.get("torque_enable") != 0 or name not in servo.values:
        return None
    if servo.joint is not None and servo.joint.registers.get(name, value) != value:
        return None
    text = f"{name} := {value} (is {servo.values[name]})"
    daemon = context.daemon
    line = context.lines.get(servo.bus)
    if daemon is not None:
        if not daemon.is_live or daemon.status["armed"] or daemon.status["inherited"]:
            return None
        return Fix(text, lambda: _by_daemon(daemon, servo, name, value), servo.thing)
    if line is None:
        return None
    return Fix(text, lambda: _alone(line, servo, name, value), servo.thing)


def _by_daemon(daemon: DaemonInspector, servo: SurveyedServo, name: str, value: int) -> None:
    """Write through the daemon, which refuses while any servo has torque. Raises ClientError."""
    with Client(Path(daemon.path).parent) as client:
        write_register(client, bus=servo.bus, id=servo.id, name=name, value=value)


def _alone(line: SerialBusInspector, servo: SurveyedServo, name: str, value: int) -> None:
    """Write on the free port.

    Raises OperationFailed: another program has the port; PortError; Rejected: another servo answers, none
    answers, torque is on, the servo refused, or the read-back differs.
    """
    line.close()  # opening it checks the holders again
    try:
        assert servo.model is not None
        place = ServoLocation(servo.id, line.baud)
        hand = ServoConfigurator(line.open_writer, line.tools, servo.model, servo.table, place)
        _require_same(hand, servo)
        if hand.read(["torque_enable"])["torque_enable"]:
            raise Rejected(f"{servo.thing}: torque is on by now: nothing was written")
        servo.table[name].check(value)
        with hand.unlocked():
            hand.write(name, value)
    except ValueError as error:
        raise Rejected(str(error)) from error
    finally:
        line.close()


def _require_same(hand: ServoConfigurator, servo: SurveyedServo) -> None:
    """Raise Rejected where another servo answers than before: minutes may have passed."""
    found = hand.identity() or hand.identity()  # one lost packet is not a missing servo
    if found is None:
        raise Rejected(f"{servo.thing}: it does not answer any more: nothing was written")
    if (found.model, found.firmware) != (servo.model, servo.firmware):
        now = f"model {found.model}, firmware {found.firmware}"
        then = f"model {servo.model}, firmware {servo.firmware}"
        raise Rejected(
            f"{servo.thing}: another servo is there by now ({now}; was {then}): nothing was written"
        )
