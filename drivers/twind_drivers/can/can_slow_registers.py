"""Slow registers of each actuator: from feedback, and from registers read in turn.

Torque, fault and temperature come with the readings. Watchdog and supply voltage are registers where a family
has them, read in turn: all watchdogs, slice by slice, then one slice of voltages.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from twind_drivers.bus import Bools, ReadRequest, SlowRegisterValues
from twind_drivers.can.actuator_family import SILENCE, ActuatorFamily, FamilyRegister
from twind_drivers.can.actuator_group import ActuatorGroup, GroupFeedback
from twind_drivers.can.register_access import decode

VOLTAGE = "bus_voltage"  # the register's name in every family that has it
# value of `watchdog` after it ran out; largest value (ms) before
TRIPPED = 255
LONGEST = 254


@dataclass(frozen=True, slots=True)
class PolledRegister:
    """Register that is read in turn, with its rows."""

    parameter: FamilyRegister
    rows: tuple[int, ...]

    def slices(self, ids: Sequence[int], size: int) -> list[ReadRequest]:
        """Return reads of at most `size` actuators each."""
        parts = (self.rows[first : first + size] for first in range(0, len(self.rows), size))
        return [ReadRequest(tuple(ids[row] for row in part), self.parameter.address, 4) for part in parts]


class CanSlowRegisters:
    """Slow registers of m actuators, each group with the time of its reading.

    `watchdog` is in ms, 1 to 254 (longer ones too), 0 off. It is 255 where the actuator reports a lost master
    or is `barred`, since it has been silent for as long. -1: its family cannot report it. `tick` is always
    unknown. `status_time`: the older of feedback and the watchdog's register, where there is one.
    `health_time`: of temperature and voltage where the actuator reports them, else of its feedback: values
    that never come must not count as stale.
    """

    def __init__(self, fleet: ActuatorGroup) -> None:
        m = len(fleet)
        self._state: SlowRegisterValues = SlowRegisterValues.unknown(m)
        self._barred: Bools | None = np.zeros(m, np.bool_)  # None: `_state` is up to date
        self._fleet = fleet
        self._period = np.full(m, -1, np.int16)  # of the watchdog's register
        self._lost = np.zeros(m, np.bool_)  # (m,) reports a lost master
        self._mute = np.zeros(m, np.bool_)  # (m,) never reports torque: the last acknowledged order counts
        self._state_time, self._watch_time, self._heat_time, self._volt_time = np.full((4, m), -inf)
        self._watch = _watched(fleet, lambda family: family.watchdog)
        self._volts = _watched(fleet, lambda family: family.parameters.get(VOLTAGE))
        self._watch_time[~_rows(self._watch, m)] = inf  # a value that never comes is never stale
        self._reports_volts = _rows(self._volts, m)
        self.schedule(len(fleet), turns=1)

    @property
    def registers(self) -> SlowRegisterValues:
        """Values as last reported; the same object every time."""
        if self._barred is not None:
            self._settle(self._barred)
            self._barred = None
            self._state.version += 1
        return self._state

    # --------------------------------------------------------------------------- schedule

    def schedule(self, size: int, *, turns: int) -> None:
        """Schedule slices of at most `size` actuators round robin, one round in `turns`.

        Slices are few and long, and some turns are empty: the cost of a slice hardly grows with its frames.
        """
        ids = self._fleet.ids
        status: list[ReadRequest | None] = [read for each in self._watch for read in each.slices(ids, size)]
        self._health = [read for each in self._volts for read in each.slices(ids, size)]
        wanted = [*status, None] if self._health else status
        self._slots: list[ReadRequest | None] = [None] * max(turns, len(wanted))
        for number, read in enumerate(status):
            self._slots[number * len(self._slots) // len(wanted)] = read
        self._healthy = len(status) * len(self._slots) // len(wanted) if self._health else -1
        self._turn = self._slot = 0

    def next(self) -> ReadRequest | None:
        """Return the next slice; None: no request in this turn."""
        if not self._slots:
            return None
        slot = self._slot
        self._slot = (self._slot + 1) % len(self._slots)
        if slot != self._healthy:
            return self._slots[slot]
        turn = self._turn
        self._turn = (self._turn + 1) % len(self._health)
        return self._health[turn]

    # --------------------------------------------------------------------------- updates

    def update_from_feedback(self, feedback: GroupFeedback, rows: Bools, barred: Bools, time: float) -> None:
        """Store the feedback of `rows` (m,). `barred` (m,): actuators that get no commands."""
        state = self._state
        complete = bool(rows.all())
        reported = feedback.enabled >= 0
        faulty = feedback.fault >= 0
        if complete and reported.all() and faulty.all():
            state.torque[:] = feedback.enabled
            state.fault[:] = feedback.fault
            self._state_time[:] = time
        else:
            reported = rows & reported
            faulty = rows & faulty
            np.copyto(state.torque, feedback.enabled, where=reported, casting="unsafe")
            np.copyto(state.fault, feedback.fault, where=faulty, casting="unsafe")
            self._state_time[(reported | (rows & self._mute)) & faulty] = time
        if feedback.fault.any() or self._lost.any():
            self._lost[faulty] = feedback.fault[faulty] & SILENCE != 0
        for source, store, when in (
            (feedback.temperature, state.temperature, self._heat_time),
            (feedback.voltage, state.voltage, self._volt_time),
        ):
            known = source == source  # NaN: not reported
            if not known.any():
                continue
            if complete and known.all():
                store[:] = source
                when[:] = time
            else:
                known &= rows
                store[known] = source[known]
                when[known] = time
        self._barred = barred

    def update_from_replies(self, feedback: GroupFeedback, rows: Bools, barred: Bools, time: float) -> None:
        """Store the register replies of `rows` (m,)."""
        for row, address, data, written in feedback.answers:
            family, _ = self._fleet.family_of_row(row)
            if written or not rows[row]:
                continue
            if family.watchdog is not None and address == family.watchdog.address:
                self._period[row] = _milliseconds(decode(family.watchdog, data) * family.watchdog.unit)
                self._watch_time[row] = time
            volts = family.parameters.get(VOLTAGE)
            if volts is not None and address == volts.address:
                self._state.voltage[row] = decode(volts, data) * volts.unit
                self._volt_time[row] = time
        self._barred = barred

    def doubt(self, rows: Bools) -> None:
        """Set the torque of `rows` (m,) to unknown: an earlier reading must not pass for the new state."""
        self._state.expire_torque(rows)

    def expire_faults(self, rows: Bools) -> None:
        """Set the faults of `rows` (m,), which are silent, to unknown.

        A power cycle ends them; answers to reads of a position (RobStride) do not show that.
        """
        if (self._state.fault[rows] >= 0).any():
            self._state.fault[rows] = -1
            self._state.version += 1

    def assume(self, rows: Bools, on: bool) -> None:
        """Set the torque of `rows` (m,), which acknowledged an order and never report it (CubeMars)."""
        self._mute |= rows
        self._state.torque[rows] = on
        self._state.version += 1

    def forget(self, row: int) -> None:
        """Reset the values of a restarted actuator to unknown."""
        state = self._state
        for store in (state.torque, state.fault, self._period):
            store[row] = -1
        state.voltage[row] = state.temperature[row] = np.nan
        for when in (self._state_time, self._heat_time, self._volt_time):
            when[row] = -inf
        if self._watch_time[row] < inf:
            self._watch_time[row] = -inf
        self._lost[row] = False
        self._barred = np.zeros(len(self._lost), np.bool_)

    def _settle(self, barred: Bools) -> None:
        state = self._state
        np.copyto(state.watchdog, self._period)
        tripped = self._lost | barred
        if tripped.any():
            state.watchdog[tripped] = TRIPPED
        np.minimum(self._state_time, self._watch_time, out=state.status_time)
        heat = np.where(self._heat_time > -inf, self._heat_time, inf)
        volts = np.where(self._reports_volts | (self._volt_time > -inf), self._volt_time, inf)
        np.minimum(heat, volts, out=heat)
        np.copyto(state.health_time, heat)
        reported = heat < inf
        if not reported.all():
            np.copyto(state.health_time, self._state_time, where=~reported)


def _watched(
    fleet: ActuatorGroup, of: Callable[[ActuatorFamily], FamilyRegister | None]
) -> list[PolledRegister]:
    found = [(of(family), rows) for family, rows in fleet.families]
    return [PolledRegister(each, tuple(rows.tolist())) for each, rows in found if each is not None]


def _rows(watched: Sequence[PolledRegister], m: int) -> Bools:
    rows = np.zeros(m, np.bool_)
    for each in watched:
        rows[list(each.rows)] = True
    return rows


def _milliseconds(seconds: float) -> int:
    return 0 if seconds == 0 else min(LONGEST, max(1, round(seconds * 1e3)))
