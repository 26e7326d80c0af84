"""Torque on and off over CAN, read back. Scripts.

On: in one send the actuators are enabled and commanded without stiffness. Some Damiao firmwares change the
turn at enable; with stiffness such an actuator would run towards a position of another turn. Once it reports
torque and position, it is held. Off: ordered twice, since one frame may be lost. Either is ordered again to
actuators that do not report it.

Torque is reported by feedback. A CubeMars never reports it: the last acknowledged order counts as its torque.
"""

from collections.abc import Callable
from itertools import count

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    Floats,
    GroupWriteBatch,
    NoReply,
    ReadRequest,
    Request,
    Script,
)
from twind_drivers.can.actuator_family import SILENCE, ValuelessCommand
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.command_frames import CanCommandEncoder
from twind_drivers.can.register_access import STATE

TRIES = 3  # orders before the torque counts as refused or silent
BEATS = 60  # reads of unrequested reports: ODrive's heartbeat comes only ten times a second
AGAIN = 12  # reads between two further orders of torque off, more than the time of a heartbeat
# rad that a position may change at enable; a turn of the motor's encoder is more, behind any gear.
MOVED = 0.05


def energise(own: CanCommandEncoder) -> Script[None]:
    """Switch torque on in all but barred actuators, read it back, and hold the aimed goals.

    Raises DeviceRefused, NoReply.
    """
    aim = own.aim
    if aim is None:
        raise DeviceRefused(
            own.reader.name, own.reader.ids[0], "torque", "prepare it and write its aim (goal) first"
        )
    state = own.reader.registers
    wanted = ~own.cyclic.barred
    limp = wanted & (state.torque != 1)
    before = np.where(np.isfinite(own.cyclic.place), own.cyclic.place, aim * COUNT)
    own.hold(aim, soft=limp)
    own.reader.slow.doubt(wanted)
    own.cyclic.energise(wanted, own.line.sent)

    def enable(rows: Bools) -> GroupWriteBatch:
        """Both orders to `rows` (m,): of two frames the actuator may have missed the first alone."""
        return GroupWriteBatch(
            (
                own.encode_valueless_command(ValuelessCommand.ENABLE, rows & limp),
                own.order(aim, rows, soft=limp),
            )
        )

    try:
        yield from _order_until_reported(own, True, wanted, before, enable(wanted), enable)
    except (DeviceRefused, NoReply):
        own.cut(limp)  # those that had torque before keep it: they may carry a load. The caller commands them
        own.reader.slow.doubt(limp)  # one that never reports torque must not count as holding
        off = own.encode_valueless_command(ValuelessCommand.DISABLE, limp)
        yield GroupWriteBatch((off, off))
        _assume_ordered(own, False)
        raise
    own.hold(aim)
    yield GroupWriteBatch((own.order(aim, wanted),))


def release(own: CanCommandEncoder) -> Script[None]:
    """Switch torque off, ordered twice, and read it back. Raises DeviceRefused, NoReply."""
    every_row = np.ones(len(own.lower), np.bool_)
    own.line.goals = None
    own.cyclic.energised = np.zeros(len(own.lower), np.bool_)
    own.reader.slow.doubt(every_row)
    off = own.encode_valueless_command(ValuelessCommand.DISABLE, every_row)
    yield from _order_until_reported(
        own, False, every_row, None, GroupWriteBatch((off, off)), lambda rows: _off(own, rows)
    )


def _order_until_reported(
    own: CanCommandEncoder,
    on: bool,
    among: Bools,
    before: Floats | None,
    first: GroupWriteBatch,
    again: Callable[[Bools], GroupWriteBatch],
) -> Script[None]:
    """Order torque until all `among` (m,) report that it is `on`; `before` (m,): earlier positions, rad.

    `again` makes the orders after the `first` one, to those (m,) that do not report it. Actuators that answer
    no order are read instead; while they are, torque off is ordered again to all that do not report it.
    """
    state = own.reader.registers
    answering = own.fleet.replies
    request: Request = first
    waited = 0.0
    for look in count():
        reply = yield request
        waited += reply.waited
        _assume_ordered(own, on)
        if before is not None:
            _require_turn(own, among, before)
        wrong = among & (state.torque != on)
        pending = wrong & answering
        read = wrong & ~answering
        if pending.any() and look < TRIES:
            request = again(pending)
        elif not read.any() or look == BEATS:
            break
        elif not on and look % AGAIN == AGAIN - 1:
            request = again(wrong)
        else:
            request = ReadRequest(tuple(own.by_id(read)), STATE, 3)
    if wrong.any():
        _refuse(own, wrong, on, waited)


def _assume_ordered(own: CanCommandEncoder, on: bool) -> None:
    """Set the torque of actuators that never report it and answered each order of the last transaction.

    A single late answer does not count.
    """
    line = own.line
    answered = (line.expect > 0) & (line.heard.count >= line.expect) & own.cyclic.proven
    own.reader.slow.assume(answered & (own.fleet.answers == 0), on)


def _off(own: CanCommandEncoder, rows: Bools) -> GroupWriteBatch:
    """Return the requests that order torque off once more.

    An actuator that has lost its master reports only that, so this fault is cleared before it reports torque.
    """
    lost = rows & (own.reader.registers.fault == SILENCE)
    off = own.encode_valueless_command(ValuelessCommand.DISABLE, rows)
    return GroupWriteBatch((off, *own.clear_faults(lost), off))


def _refuse(own: CanCommandEncoder, wrong: Bools, on: bool, waited: float) -> None:
    silent = wrong & (own.reader.registers.torque < 0)
    if silent.any():
        raise NoReply(own.reader.name, own.by_id(silent), waited, f"torque {'on' if on else 'off'}")
    reason = f"ordered {'on' if on else 'off'}, reads {'off' if on else 'on'}"
    raise DeviceRefused(own.reader.name, own.by_id(wrong)[0], "torque", reason)


def _require_turn(own: CanCommandEncoder, among: Bools, before: Floats) -> None:
    moved = np.where(among, np.abs(own.cyclic.place - before), 0.0)
    if (moved > MOVED).any():
        row = int(np.nanargmax(moved))
        reason = (
            f"was at {before[row]:.3f} rad before torque and is at {own.cyclic.place[row]:.3f} rad with it: "
            "its turn changed; torque is off again. Identify, calibrate its zero anew if it stays so"
        )
        raise DeviceRefused(own.reader.name, own.reader.ids[row], "position at torque-on", reason)
