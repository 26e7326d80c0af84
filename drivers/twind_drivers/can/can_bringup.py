"""Preparation for torque over CAN, each step read back; and damping. Scripts.

Modes are read, never written: an actuator may restart in another one. The watchdog is in RAM and lost with
the power, so it is written before each torque-on.
"""

from collections.abc import Mapping, Sequence
from itertools import count
from math import ceil

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    Floats,
    GroupWriteBatch,
    Ints,
    NoReply,
    ReadRequest,
    Script,
    WriteRequest,
)
from twind_drivers.can.actuator_family import FamilyRegister
from twind_drivers.can.command_frames import CanCommandEncoder
from twind_drivers.can.register_access import STATE, decode, encode, read_register

WATCHDOG = 0.1  # s without a command after which an actuator releases by itself; none: it holds for ever ...
DUE = 2  # ... commands due in that time, so that one lost command does not release the joint
MODES = ("mode", "run_mode")  # registers of the commands that an actuator accepts
LIMIT = "torque_limit"
TRIES = 3  # requests before NoReply: one lost frame is no missing actuator
BEATS = 0.3  # s, of ODrive's heartbeat, ten times a second; shorter than the hold of other buses meanwhile
UNWATCHED = (
    "ids {}: no watchdog that can be read back over this bus: without one set in the vendor's tool they "
    "hold their last command for ever when this daemon dies"
)


def prepare(
    own: CanCommandEncoder, ticks: Ints, required: Bools, limits: Floats, among: Bools | None = None
) -> Script[None]:
    """Read the modes; hold and clear faults in one send; write limits, watchdogs, gains.

    `required` (m,): actuators that must have a watchdog. `limits` (m,), N·m, NaN none. `among` (m,): the
    actuators to prepare, None: all; the others are barred.

    NoReply is raised after all other actuators are prepared: a robot can be lowered without the silent ones.
    A silent actuator keeps its state: soft if it was soft, without commands if it was barred.
    """
    there = np.ones(len(ticks), np.bool_) if among is None else among.copy()
    own.cyclic.barred = own.cyclic.barred | ~there
    own.order(ticks, there)  # raises WireRangeError before any frame leaves
    own.aim = ticks.copy()
    soft = own.soft.copy()
    barred = own.cyclic.barred.copy()
    silent = None
    while there.any():
        try:
            yield from _prepared(own, ticks, required, limits, there)
            break
        except NoReply as error:
            silent = error.joined(silent)
            there = there & ~own.rows(dict.fromkeys(error.ids))
            own.soft |= soft & ~there
            own.cyclic.barred = own.cyclic.barred | (barred & ~there)
    if silent is not None:
        raise silent.with_traceback(None)


def _prepared(
    own: CanCommandEncoder, ticks: Ints, required: Bools, limits: Floats, there: Bools
) -> Script[None]:
    """Run all steps of `prepare` on the actuators `there` (m,) alone."""
    yield from _require_modes(own, there)
    own.soft &= ~there
    own.cyclic.barred = own.cyclic.barred & ~there
    yield from _clear_faults(own, ticks, there)
    yield from _limit(own, np.where(there, limits, np.nan))
    own.hold(ticks)  # commands from here on, else the watchdog armed next would run out at once
    watched = yield from _watch(own, required, there)
    own.cyclic.watched = np.where(there, watched, own.cyclic.watched)
    if any(len(family.gains(own.kp[rows], own.kd[rows])) for family, rows in own.fleet.families):
        gains = own.gains(there)
        yield GroupWriteBatch((gains, gains))  # no actuator reports them, and one frame may be lost
    own.hold(ticks)


def damp(own: CanCommandEncoder, ticks: Ints) -> Script[tuple[int, ...]]:
    """Command no stiffness and more damping from now on; return the ids without acknowledgement."""
    every_row = np.ones(len(ticks), np.bool_)
    own.soft = every_row.copy()
    own.line.goals = None
    soft = own.order(ticks, every_row)
    missing = set(own.reader.ids)
    for _ in range(TRIES):
        reply = yield GroupWriteBatch((own.gains(every_row), soft))
        missing -= {id for id in reply.data if own.fleet.replies[own.fleet.row(id)]}
        if not missing:
            break
    return tuple(sorted(missing))


# --------------------------------------------------------------------------------------------- steps


def _require_modes(own: CanCommandEncoder, there: Bools) -> Script[None]:
    for family, rows in own.fleet.families:
        for name in MODES:
            if name not in family.identity:
                continue
            parameter = family.parameters[name]
            requested = [own.fleet.ids[row] for row in rows if there[row]]
            found = yield from collect(own, requested, parameter)
            for id in requested:
                mode = family.operating_mode({name: decode(parameter, found[id])})
                if mode != 1:
                    reason = (
                        f"is {mode}, needs 1: it takes no commands of this bus; set it in the vendor's tool"
                    )
                    raise DeviceRefused(own.reader.name, id, name, reason)


def _clear_faults(own: CanCommandEncoder, ticks: Ints, there: Bools) -> Script[None]:
    state = own.reader.registers
    faulty = there & (state.fault > 0)
    yield GroupWriteBatch((own.order(ticks, there), *own.clear_faults(faulty)))
    replied = np.zeros(len(there), np.bool_)
    waited = 0.0
    for look in count():
        left = faulty & (state.fault > 0)
        if not left.any():
            return
        # One that acknowledges nothing reports its faults by its heartbeat alone, some reads later.
        beats = ceil(BEATS * own.reader.rate_hz) if (left & ~own.fleet.replies).any() else 0
        if look >= max(TRIES, beats):
            break
        own.hold(ticks)  # others may carry a load, and their watchdogs run
        reply = yield ReadRequest(tuple(own.by_id(left)), STATE, 3)
        replied = replied | own.rows(reply.data)
        waited = waited + reply.waited
    if (left & ~replied).any():
        raise NoReply(own.reader.name, own.by_id(left & ~replied), waited, "read of its faults")
    row = int(np.argmax(left))
    reason = (
        f"fault bits {int(state.fault[row]):#x} stay though cleared: find the cause, switch it off and on"
    )
    raise DeviceRefused(own.reader.name, own.reader.ids[row], "fault", reason)


def _watch(own: CanCommandEncoder, required: Bools, there: Bools) -> Script[Bools]:
    """Arm the watchdogs of the actuators `there` (m,) and read them back; return those (m,) that have one.

    Raises NoReply, and DeviceRefused where one is required and missing.
    """
    watched = np.zeros(len(required), np.bool_)
    for family, rows in own.fleet.families:
        if family.watchdog is not None:
            _require_rate(own, family.ids[0])
            ticks = encode(family.watchdog, round(WATCHDOG / family.watchdog.unit))
            own_there = [row for row in rows.tolist() if there[row]]
            yield from write_and_read_back(
                own, {own.reader.ids[row]: ticks for row in own_there}, family.watchdog
            )
            watched[own_there] = True
    without = np.flatnonzero(there & required & ~watched)
    if len(without):
        row = int(without[0])
        family, _ = own.fleet.family_of_row(row)
        reason = (
            f"{family.name} has none that could be read back: allow it in the robot file, or do not drive it"
        )
        raise DeviceRefused(own.reader.name, own.reader.ids[row], "watchdog", reason)
    if (there & ~watched).any():
        _warn(own, UNWATCHED.format(own.by_id(there & ~watched)))
    return watched


def _require_rate(own: CanCommandEncoder, id: int) -> None:
    rate = own.reader.rate_hz
    if rate * WATCHDOG < DUE:
        reason = (
            f"runs out after {WATCHDOG} s, and at {rate:g} Hz a command comes every {1.0 / rate:.3f} s: "
            f"{DUE / WATCHDOG:g} Hz are needed"
        )
        raise DeviceRefused(own.reader.name, id, "watchdog", reason)


def _warn(own: CanCommandEncoder, text: str) -> None:
    channel = own.reader.channel
    if text not in channel.warning:
        channel.warning = "; ".join(part for part in (channel.warning, text) if part)


def _limit(own: CanCommandEncoder, limits: Floats) -> Script[None]:
    """Write the torque limits that read otherwise: one that holds is not set under torque for nothing."""
    for family, rows in own.fleet.families:
        parameter = family.parameters.get(LIMIT)
        if parameter is None:
            continue
        data = {
            own.reader.ids[row]: encode(parameter, float(limits[row]))
            for row in rows.tolist()
            if np.isfinite(limits[row])
        }
        found = yield from collect(own, list(data), parameter)
        data = {id: each for id, each in data.items() if found[id] != each}
        if data:
            yield from write_and_read_back(own, data, parameter)


# --------------------------------------------------------------------------------------------- registers


def collect(
    own: CanCommandEncoder, ids: Sequence[int], parameter: FamilyRegister
) -> Script[dict[int, bytes]]:
    """Read one register of several actuators of a family, some at once.

    Raises NoReply naming the silent ones.
    """
    found, waited = yield from read_register(ids, parameter, own.reader.at_once, TRIES)
    silent = [id for id in ids if id not in found]
    if silent:
        raise NoReply(own.reader.name, silent, waited, f"read of {parameter.name}")
    return found


def write_and_read_back(
    own: CanCommandEncoder, data: Mapping[int, bytes], parameter: FamilyRegister
) -> Script[None]:
    """Write one register of several actuators of a family and read it back; lost writes are repeated.

    Raises DeviceRefused for the first that reads otherwise, NoReply.
    """
    ids = list(data)
    size = own.reader.at_once
    left = dict(data)
    for _ in range(TRIES):
        wanted = list(left)
        for first in range(0, len(wanted), size):
            yield WriteRequest({id: left[id] for id in wanted[first : first + size]}, parameter.address)
        found = yield from collect(own, wanted, parameter)
        left = {id: each for id, each in left.items() if found[id] != each}
        if not left:
            return
    id = next(each for each in ids if each in left)
    reason = f"wrote {decode(parameter, left[id]):g}, reads {decode(parameter, found[id]):g}"
    raise DeviceRefused(own.reader.name, id, parameter.name, reason)
