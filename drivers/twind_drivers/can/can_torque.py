"""Torque on and off over CAN, read back. Scripts.

On: in one send the actuators are enabled and commanded without stiffness. Some Damiao firmwares change the
turn at enable; with stiffness such an actuator would run towards a position of another turn. Once it reports
torque and position, it is held. Off: ordered twice, since one frame may be lost, then again until each
actuator reports it.

Torque is reported by feedback. A CubeMars never reports it: the last acknowledged order counts as its torque.
"""

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    Floats,
    GroupWriteBatch,
    NoReply,
    ReadRequest,
    Script,
    WriteRequest,
)
from twind_drivers.can.actuator_family import SILENCE, ValuelessCommand
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.command_frames import CanCommandEncoder
from twind_drivers.can.register_access import STATE

TRIES = 3  # orders before the torque counts as refused or silent
BEATS = 60  # reads of unrequested reports: ODrive's heartbeat comes only ten times a second
# rad that a position may change at enable; a turn of the motor's encoder is more, behind any gear.
MOVED = 0.05


def energise(own: CanCommandEncoder) -> Script[None]:
    """Switch torque on in all but barred actuators, read it back, and hold the aimed goals.

    Raises DeviceRefused, NoReply.
    """
    if own.aim is None:
        raise DeviceRefused(
            own.reader.name, own.reader.ids[0], "torque", "prepare it and write its aim (goal) first"
        )
    state = own.reader.registers
    wanted = ~own.cyclic.barred
    limp = wanted & (state.torque != 1)
    before = np.where(np.isfinite(own.cyclic.place), own.cyclic.place, own.aim * COUNT)
    own.hold(own.aim, soft=limp)
    own.reader.slow.doubt(wanted)
    own.cyclic.energise(wanted, own.line.sent)
    yield GroupWriteBatch(
        (
            own.encode_valueless_command(ValuelessCommand.ENABLE, limp),
            own.order(own.aim, wanted, soft=limp),
        )
    )
    try:
        yield from _wait_for_torque_state(own, True, wanted, before, limp)
    except (DeviceRefused, NoReply):
        own.cut(limp)  # actuators that had torque before keep it: they may carry a load
        yield GroupWriteBatch(
            (
                own.encode_valueless_command(ValuelessCommand.DISABLE, limp),
                own.encode_valueless_command(ValuelessCommand.DISABLE, limp),
            )
        )
        raise
    own.hold(own.aim)
    yield GroupWriteBatch((own.order(own.aim, wanted),))


def release(own: CanCommandEncoder) -> Script[None]:
    """Switch torque off, ordered twice, and read it back. Raises DeviceRefused, NoReply."""
    every_row = np.ones(len(own.lower), np.bool_)
    own.line.goals = None
    own.cyclic.energised = np.zeros(len(own.lower), np.bool_)
    own.reader.slow.doubt(every_row)
    yield GroupWriteBatch(
        (
            own.encode_valueless_command(ValuelessCommand.DISABLE, every_row),
            own.encode_valueless_command(ValuelessCommand.DISABLE, every_row),
        )
    )
    yield from _wait_for_torque_state(own, False, every_row, None, every_row)


def _wait_for_torque_state(
    own: CanCommandEncoder, on: bool, among: Bools, before: Floats | None, soft: Bools
) -> Script[None]:
    """Wait until all `among` (m,) report that their torque is `on`; `before` (m,): earlier positions, rad.

    `soft` (m,): those that are commanded without stiffness until then.
    """
    state = own.reader.registers
    answering = own.fleet.replies
    mute = own.fleet.answers == 0
    spoke = _acknowledged(own)
    for look in range(BEATS):
        own.reader.slow.assume(spoke & mute, on)
        if before is not None:
            _require_turn(own, among, before)
        wrong = among & (state.torque != on)
        if not wrong.any():
            return
        pending = wrong & answering
        if pending.any() and look < TRIES:
            again = own.order(own.aim, pending, soft=soft) if on and own.aim is not None else None
            yield GroupWriteBatch((again,) if again is not None else _off(own, pending))
        elif (wrong & ~answering).any():
            yield ReadRequest(tuple(own.by_id(wrong & ~answering)), STATE, 3)
        else:
            break
        spoke = _acknowledged(own)
    _refuse(own, among & (state.torque != on), on)


def _acknowledged(own: CanCommandEncoder) -> Bools:
    """Return which actuators (m,) answered each order of the last transaction.

    A single late answer does not count.
    """
    line = own.line
    answered: Bools = (line.expect > 0) & (line.heard.count >= line.expect) & own.cyclic.proven
    return answered


def _off(own: CanCommandEncoder, rows: Bools) -> tuple[WriteRequest, ...]:
    """Return the requests that order torque off once more.

    An actuator that has lost its master reports only that, so this fault is cleared before it reports torque.
    """
    lost = rows & (own.reader.registers.fault == SILENCE)
    off = own.encode_valueless_command(ValuelessCommand.DISABLE, rows)
    return (off, *own.clear_faults(lost), off)


def _refuse(own: CanCommandEncoder, wrong: Bools, on: bool) -> None:
    silent = wrong & (own.reader.registers.torque < 0)
    if silent.any():
        raise NoReply(own.reader.name, own.by_id(silent), 0.0, f"torque {'on' if on else 'off'}")
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
