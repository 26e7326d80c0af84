"""Writing one register of one servo, read back: through the running daemon, or alone on the free port.

Offered only while nobody is armed and that servo's torque is off, which is looked at again before the write.
The half that writes exists only inside `Fix.do`.
"""

from pathlib import Path

import numpy as np

from twind.client import Client
from twind.command_line.verb import Rejected, write_register
from twind_calibration.doctor.bus_probe import PATIENCE, BusProbe
from twind_calibration.doctor.check import Fix
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.daemon_inspector import DaemonInspector
from twind_calibration.doctor.serial_bus_inspector import SerialBusInspector
from twind_calibration.doctor.survey import SurveyedServo
from twind_drivers.bus import BusError, PortError
from twind_drivers.clock import Clock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.prober import LONGEST_DELAY
from twind_drivers.dynamixel.serial_port import SerialTransport
from twind_drivers.run_script import perform


def command(servo: SurveyedServo, register: str, value: int) -> str:
    """What a person types for it; the daemon must be in live, with torque off."""
    return f"twindctl register write {servo.bus} {servo.id} {register} {value}"


def register(examined: CheckContext, servo: SurveyedServo, name: str, value: int) -> Fix | None:
    """Writes `value`; None: not now (torque on or not known, somebody armed, the daemon may not write), or
    never: the robot file demands another."""
    if servo.values.get("torque_enable") != 0 or name not in servo.values:
        return None
    if servo.joint is not None and servo.joint.registers.get(name, value) != value:
        return None
    text = f"{name} := {value} (is {servo.values[name]})"
    daemon = examined.daemon
    line = examined.lines.get(servo.bus)
    if daemon is not None:
        if not daemon.is_live or daemon.status["armed"] or daemon.status["inherited"]:
            return None
        return Fix(text, lambda: _by_daemon(daemon, servo, name, value), servo.thing)
    if line is None:
        return None
    return Fix(text, lambda: _alone(line, servo, name, value), servo.thing)


def _by_daemon(daemon: DaemonInspector, servo: SurveyedServo, name: str, value: int) -> None:
    """Raises ClientError with the daemon's reason; it refuses while anybody has torque."""
    with Client(Path(daemon.path).parent) as client:
        write_register(client, bus=servo.bus, id=servo.id, name=name, value=value)


def _alone(line: SerialBusInspector, servo: SurveyedServo, name: str, value: int) -> None:
    """Raises CannotLook: somebody has the port by now; PortError; Rejected: another servo is there, torque is
    on by now, it does not answer, it refused, it reads otherwise."""
    line.close()  # so that opening it looks anew at who has it
    try:
        _require_same(line, servo)
        _write(line.transport, line, servo, name, value, line.clock)
    except PortError:
        raise
    except (BusError, ValueError) as error:
        raise Rejected(str(error)) from error
    finally:
        line.close()


def _require_same(line: SerialBusInspector, servo: SurveyedServo) -> None:
    """Raises Rejected where another than the one that was looked at answers: minutes may have gone by."""
    asker = BusProbe(line.transport, line.clock, line.baud, timer=(line.transport.latency_ms or 0) * 1e-3)
    heard = asker.ping(servo.id)
    if heard.data is None:  # one lost packet is not a missing servo
        heard = asker.ping(servo.id)
    if heard.data is None:
        raise Rejected(f"{servo.thing}: it does not answer any more: nothing was written")
    model = int.from_bytes(heard.data[:2], "little")
    firmware = heard.data[2]
    if (model, firmware) != (servo.model, servo.firmware):
        now = f"model {model}, firmware {firmware}"
        then = f"model {servo.model}, firmware {servo.firmware}"
        raise Rejected(
            f"{servo.thing}: another servo is there by now ({now}; was {then}): nothing was written"
        )


def _write(
    transport: SerialTransport,
    line: SerialBusInspector,
    servo: SurveyedServo,
    name: str,
    value: int,
    clock: Clock,
) -> None:
    assert servo.model is not None
    timer = (transport.latency_ms or 0) * 1e-3
    reader = DynamixelReader(
        servo.bus,
        transport,
        [servo.id],
        [servo.model],
        baud=line.baud,
        return_delay_us=LONGEST_DELAY * 1e6,
        slack=PATIENCE + timer,
    )
    if perform(reader, reader.read(servo.id, "torque_enable"), clock).value:
        raise Rejected(f"{servo.thing}: torque is on by now: nothing was written")
    centre = reader.table(servo.id).facts.centre or 0
    only = np.array([centre])  # no goal is ever sent; the writer wants to know what would be allowed
    writer = DynamixelWriter(reader, lower=only, upper=only, gains=[(0, 0, 0)])
    perform(reader, writer.write(servo.id, name, value), clock, writer)
