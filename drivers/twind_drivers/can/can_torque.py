"""Torque on and off over CAN, read back. Scripts.

On: enabled, and in the same send commanded without stiffness, so that an actuator that changes its turn as it
is enabled (known of some Damiao firmwares) does not run after a place of another turn; once it has said that
its torque is on and where it is, it is held. Off: ordered twice, then again until each says so.

What an actuator says of its torque comes with feedback. A CubeMars never says it: its torque counts as what
it was ordered last and acknowledged.
"""

import numpy as np

from twind_drivers.bus import (
    Bools,
    BurstWriteRequest,
    DeviceRefused,
    Floats,
    NoReply,
    ReadRequest,
    Script,
    WriteRequest,
)
from twind_drivers.can.actuator_family import SILENCE, ValuelessCommand
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.command_frames import CanCommandEncoder
from twind_drivers.can.register_access import STATE

TRIES = 3  # orders that must be acknowledged
BEATS = 60  # looks at what is told unasked, ten times a second (ODrive's heartbeat)
# rad that a place may differ after enabling. A turn of an encoder before the gear is a part of one here.
MOVED = 0.05


def energise(own: CanCommandEncoder) -> Script[None]:
    """Torque on and read back, held where it was aimed. Raises DeviceRefused, NoReply."""
    if own.aim is None:
        raise DeviceRefused(own.reader.name, own.reader.ids[0], "torque", "prepare and aim come first")
    state = own.reader.registers
    everybody = np.ones(len(own.lower), np.bool_)
    limp = state.torque != 1
    before = np.where(np.isfinite(own.cyclic.place), own.cyclic.place, own.aim * COUNT)
    own.hold(own.aim, soft=bool(limp.any()))
    own.reader.slow.doubt(everybody)
    own.cyclic.energise(everybody, own.line.sent)
    yield BurstWriteRequest(
        (
            own.encode_valueless_command(ValuelessCommand.ENABLE, limp),
            own.order(own.aim, limp, soft=True),
            own.order(own.aim, ~limp),
        )
    )
    try:
        yield from _wait_for_torque_state(own, True, before)
    except (DeviceRefused, NoReply):
        own.cut(limp)  # who had torque before keeps it: he may carry a load
        yield BurstWriteRequest(
            (
                own.encode_valueless_command(ValuelessCommand.DISABLE, limp),
                own.encode_valueless_command(ValuelessCommand.DISABLE, limp),
            )
        )
        raise
    own.hold(own.aim)
    yield BurstWriteRequest((own.order(own.aim, everybody),))


def release(own: CanCommandEncoder) -> Script[None]:
    """Torque off, ordered twice, and read back. Raises DeviceRefused, NoReply."""
    everybody = np.ones(len(own.lower), np.bool_)
    own.line.goals = None
    own.cyclic.energised = np.zeros(len(own.lower), np.bool_)
    own.reader.slow.doubt(everybody)
    yield BurstWriteRequest(
        (
            own.encode_valueless_command(ValuelessCommand.DISABLE, everybody),
            own.encode_valueless_command(ValuelessCommand.DISABLE, everybody),
        )
    )
    yield from _wait_for_torque_state(own, False, None)


def _wait_for_torque_state(own: CanCommandEncoder, on: bool, before: Floats | None) -> Script[None]:
    """Wait until all report that their torque is `on`. `before` (m,): their earlier positions, rad."""
    state = own.reader.registers
    answering = own.fleet.replies
    mute = own.fleet.answers == 0
    spoke = _acknowledged(own)
    for look in range(BEATS):
        own.reader.slow.assume(spoke & mute, on)
        if before is not None:
            _require_turn(own, before)
        wrong = state.torque != on
        if not wrong.any():
            return
        asked = wrong & answering
        if asked.any() and look < TRIES:
            again = own.order(own.aim, asked, soft=True) if on and own.aim is not None else None
            yield BurstWriteRequest((again,) if again is not None else _off(own, asked))
        elif (wrong & ~answering).any():
            yield ReadRequest(tuple(own.by_id(wrong & ~answering)), STATE, 3)
        else:
            break
        spoke = _acknowledged(own)
    _refuse(own, state.torque != on, on)


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


def _require_turn(own: CanCommandEncoder, before: Floats) -> None:
    moved = np.abs(own.cyclic.place - before)
    if (moved > MOVED).any():
        row = int(np.nanargmax(moved))
        reason = (
            f"said {before[row]:.3f} rad before torque and {own.cyclic.place[row]:.3f} rad with it: its turn "
            "changed; torque is off again. Identify, calibrate its zero anew if it stays so"
        )
        raise DeviceRefused(own.reader.name, own.reader.ids[row], "position at torque-on", reason)
