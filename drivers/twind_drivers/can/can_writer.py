"""Writer of a CAN bus: goals, torque, registers. Exists in live only.

Every command frame is checked by its own bytes before it leaves (WIRE_CLAMP): actuators of this bus,
positions inside their bounds.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    Floats,
    GroupWriteBatch,
    Ints,
    NoReply,
    Order,
    ReadRequest,
    RebootRequest,
    Script,
    WriteRequest,
)
from twind_drivers.can import can_bringup, can_torque
from twind_drivers.can.actuator_family import ValuelessCommand
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.command_frames import CanCommandEncoder
from twind_drivers.can.register_access import STATE, encode, ordering, parameter_of, part
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.single_device import SingleDeviceControl

TRIES = 3  # sends of a goal before NoReply: one lost frame is no missing actuator
RESTART = 200  # reads until a restarted actuator replies: 2 s at 100 Hz
# Registers that `write` refuses, with the reason: other paths own them, or the device would be lost.
ELSEWHERE = {
    "timeout": "its watchdog is armed by preparing for torque",
    "mode": "it would not take the commands of this bus",
    "run_mode": "it would not take the commands of this bus",
    "master_id": "it would answer under another id than this bus has",
    "esc_id": "it would take commands on another id than this bus has",
    "can_rate": "it would answer at another bitrate than this bus has",
    "torque_limit": "it is set by preparing for torque, from the robot file",
}


class CanWriter:
    """Writer to the bus of `reader`. Arrays are in the order of its ids, goals in counts (`can_units.py`).

    The goal of an actuator cannot be read back: `write_goals` and `read_goals` deal with goals sent and
    acknowledged.
    """

    def __init__(
        self,
        reader: CanReader,
        *,
        lower: Ints,
        upper: Ints,
        kp: Floats,
        kd: Floats,
        torque_limits: Floats | None = None,
        watchdog: Sequence[bool] | None = None,
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): range of goals. `kp`, `kd` (m,): N·m/rad and N·m·s/rad.

        `torque_limits` (m,), N·m, NaN: none. They are written where a family has such a register; elsewhere
        the actuator has no such limit. `watchdog` (m,), None: all. True: it must be armed and read back
        before torque. False: where that is impossible, the port's `warning` reports it.

        Raises ValueError for values of the wrong shape, crossed bounds, a gain outside its field.
        """
        m = len(reader.ids)
        self._reader = reader
        self._name = reader.name
        self._own = CanCommandEncoder(reader, lower, upper, kp, kd)
        limits = np.full(m, np.nan) if torque_limits is None else np.asarray(torque_limits, np.float64)
        required = np.ones(m, np.bool_) if watchdog is None else np.asarray(watchdog, np.bool_)
        if limits.shape != (m,) or required.shape != (m,):
            raise ValueError(
                f"{self._name}: {limits.shape} limits, {required.shape} policies for {m} actuators"
            )
        self._limits = limits
        self._required = required
        reader.channel.drive(self)

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of goals (m,), counts, and drop pending goals. Raises ValueError."""
        self._own.set_goal_limits(lower, upper)

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) of the next `request`. Raises WireRangeError, ValueError; then nothing is pending."""
        self._own.goals(ticks)

    def cut(self) -> None:
        """Switch torque off on all devices, twice, in the next send of any kind.

        Goals given before it are not sent. Twice, since one frame may be lost.
        """
        self._own.cut()

    def clear(self) -> None:
        """Drop pending goals and holds. A pending cut stays: torque off is never refused."""
        self._own.line.goals = None

    # --------------------------------------------------------------------------- the rare path

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it.

        Raises PortError, WireRangeError, TypeError; DeviceRefused for an order that a family lacks.
        """
        if not isinstance(order, WriteRequest | GroupWriteBatch | RebootRequest):
            raise TypeError(f"{self._name}: a writer does not read: {order}")
        try:
            exchange = ordering(self._own.fleet, order)
        except (ValueError, KeyError) as error:
            raise DeviceRefused(self._name, -1, "order", str(error)) from None
        self._own.check.judge(exchange.frames)
        self._reader.start(order, exchange, now)

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Prepare actuators for torque; `among` (m,): these alone, None: all; the others are barred.

        Reads the modes. Commands `ticks` (m,) and clears faults in one send, so that an actuator whose fault
        goes does not follow an old goal. Writes limits and watchdogs and reads them back. Sends gains where
        commands do not carry them (ODrive, which does not report them). Then a hold at `ticks` is repeated
        until goals come, at most half a second: without commands the armed watchdogs would run out.

        Raises WireRangeError; DeviceRefused, also for a loop too slow for watchdogs; NoReply after all other
        actuators are prepared.
        """
        return can_bringup.prepare(self._own, ticks, self._required, self._limits, among)

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Command `ticks` (m,), acknowledged where a family does that. Raises NoReply, WireRangeError."""
        own = self._own
        own.hold(ticks)
        own.aim = ticks.copy()
        silent = ~own.cyclic.barred
        waited = 0.0
        for _ in range(TRIES):
            reply = yield GroupWriteBatch((own.order(ticks, silent),))
            waited += reply.waited
            silent &= ~own.rows(reply.data)
            mute = silent & ~own.fleet.replies
            if mute.any():  # sends no acknowledgement: only its presence can be checked
                reply = yield ReadRequest(tuple(own.by_id(mute)), STATE, 3)
                silent &= ~own.rows(reply.data)
            if not silent.any():
                return
        raise NoReply(self._name, own.by_id(silent), waited, "goal")

    def read_goals(self) -> Script[Ints]:
        """Return the last goals (m,) sent, in counts. Raises NoReply if none was sent to an actuator."""
        yield from ()
        line = self._own.line
        missing = ~line.commanded & ~self._own.cyclic.barred
        if missing.any():
            raise NoReply(self._name, self._own.by_id(missing), 0.0, "goal: none was sent")
        return line.left.copy()

    def torque(self, on: bool) -> Script[None]:
        """Switch torque off in all actuators, ordered twice, or on in all but barred ones; read it back.

        Raises DeviceRefused, NoReply.

        On: without stiffness until each reports its position; a changed turn ends it (`can_torque`).
        """
        return can_torque.energise(self._own) if on else can_torque.release(self._own)

    def damp(self) -> Script[tuple[int, ...]]:
        """Set stiffness 0 and double damping in each command until `prepare`.

        Returns the ids without acknowledgement.
        """
        return can_bringup.damp(self._own, self._own.here())

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> SingleDeviceControl:
        """Raise ValueError: CAN actuators are not driven alone."""
        raise ValueError(f"{self._name}: id {id}: a CAN actuator is not driven against a stop here")

    def end_single_device(self) -> None:
        """Do nothing: all actuators are always commanded."""

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Write one register in RAM by name and read it back; a float in thousandths of its unit.

        Raises NoReply, DeviceRefused, KeyError (lists similar names), ValueError (range, read-only, not
        here).
        """
        own = self._own
        row = own.fleet.row(id)
        parameter = parameter_of(own.fleet, row, name)
        if parameter.name in ELSEWHERE:
            raise ValueError(f"{parameter.name} is not written here: {ELSEWHERE[parameter.name]}")
        data = encode(parameter, part(parameter, value))
        own.fleet.write(row, parameter, data)
        yield from can_bringup.write_and_read_back(own, {id: data}, parameter)
        return (yield from self._reader.read(id, parameter.name))

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one actuator and wait until it replies. Its RAM is not restored: `prepare` writes it anew.

        Raises DeviceRefused while its torque is on (unless `shut_down`), and where its family has no restart.
        """
        own = self._own
        row = own.fleet.row(id)
        try:
            own.fleet.encode_valueless_command(row, ValuelessCommand.REBOOT)
        except ValueError as error:
            raise DeviceRefused(self._name, id, "restart", f"{error}: switch its power off and on") from None
        if self._reader.registers.torque[row] == 1 and not shut_down:
            raise DeviceRefused(
                self._name, id, "restart", "its torque is on: it carries a load; disarm first"
            )
        yield RebootRequest(id)
        self._reader.slow.forget(row)
        waited = 0.0
        for _ in range(RESTART):
            reply = yield ReadRequest((id,), STATE, 3)
            waited += reply.waited
            if id in reply.data:
                return RestartResult()
        raise NoReply(self._name, [id], waited, "restart")
