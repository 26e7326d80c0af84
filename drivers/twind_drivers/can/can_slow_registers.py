"""The slowly changing state of each actuator: what feedback tells of it by itself, and what must be asked.

Torque, fault and temperature come with the readings. Watchdog and supply voltage are registers where a family
has them, asked in turn: all watchdogs, slice by slice, then one slice of voltages.
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
# ms: what a watchdog reads as after it ran out, and at most before
TRIPPED = 255
LONGEST = 254


@dataclass(frozen=True, slots=True)
class PolledRegister:
    """A register that is read in turn: of which rows, and how many fit into one slice."""

    parameter: FamilyRegister
    rows: tuple[int, ...]

    def slices(self, ids: Sequence[int], size: int) -> list[ReadRequest]:
        """Reads of at most `size` actuators each."""
        parts = (self.rows[first : first + size] for first in range(0, len(self.rows), size))
        return [ReadRequest(tuple(ids[row] for row in part), self.parameter.address, 4) for part in parts]


class CanSlowRegisters:
    """State of m actuators, each group with the time of its reading.

    `watchdog` is in ms, 1 to 254 (longer ones too), 0 off, 255 where the actuator says that it lost its
    master, or is `barred`: it has not been heard for as long. -1: its family cannot tell. `tick` is never
    known. `status_time`: of the older of feedback and, where there is one, the watchdog's register.
    `health_time`: of temperature and voltage, of those that the actuator tells at all; of its feedback where
    it tells neither: nobody waits for what never comes.
    """

    def __init__(self, fleet: ActuatorGroup) -> None:
        m = len(fleet)
        self._state: SlowRegisterValues = SlowRegisterValues.unknown(m)
        self._barred: Bools | None = np.zeros(m, np.bool_)  # None: what follows from them is settled
        self._fleet = fleet
        self._period = np.full(m, -1, np.int16)  # of the watchdog's register
        self._lost = np.zeros(m, np.bool_)  # says that it lost its master
        self._mute = np.zeros(m, np.bool_)  # does not tell its torque: that is what it was ordered last
        self._state_time, self._watch_time, self._heat_time, self._volt_time = np.full((4, m), -inf)
        self._watch = _watched(fleet, lambda family: family.watchdog)
        self._volts = _watched(fleet, lambda family: family.parameters.get(VOLTAGE))
        self._watch_time[~_rows(self._watch, m)] = inf  # what is not told is never old
        self._tells_volts = _rows(self._volts, m)
        self.schedule(len(fleet), turns=1)

    @property
    def registers(self) -> SlowRegisterValues:
        """All of it, as of what was told last; the same object every time."""
        if self._barred is not None:
            self._settle(self._barred)
            self._barred = None
        return self._state

    # --------------------------------------------------------------------------- whose turn it is

    def schedule(self, size: int, *, turns: int) -> None:
        """From now on slices of at most `size` actuators come round robin, a round in so many `turns`.

        Slices are few and long, and turns are left out: what one costs hardly grows with its frames.
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
        """The slice whose turn it is; None: nothing need be asked in this turn."""
        if not self._slots:
            return None
        slot = self._slot
        self._slot = (self._slot + 1) % len(self._slots)
        if slot != self._healthy:
            return self._slots[slot]
        turn = self._turn
        self._turn = (self._turn + 1) % len(self._health)
        return self._health[turn]

    # --------------------------------------------------------------------------- what was told

    def update_from_feedback(self, heard: GroupFeedback, rows: Bools, barred: Bools, time: float) -> None:
        """Keep what feedback says of `rows` (m,). `barred` (m,): who gets no commands any more."""
        state = self._state
        everybody = bool(rows.all())
        told = heard.enabled >= 0
        faulty = heard.fault >= 0
        if everybody and told.all() and faulty.all():
            state.torque[:] = heard.enabled
            state.fault[:] = heard.fault
            self._state_time[:] = time
        else:
            told = rows & told
            faulty = rows & faulty
            np.copyto(state.torque, heard.enabled, where=told, casting="unsafe")
            np.copyto(state.fault, heard.fault, where=faulty, casting="unsafe")
            self._state_time[(told | (rows & self._mute)) & faulty] = time
        if heard.fault.any() or self._lost.any():
            self._lost[faulty] = heard.fault[faulty] & SILENCE != 0
        for source, store, when in (
            (heard.temperature, state.temperature, self._heat_time),
            (heard.voltage, state.voltage, self._volt_time),
        ):
            says = source == source  # NaN: not told
            if not says.any():
                continue
            if everybody and says.all():
                store[:] = source
                when[:] = time
            else:
                says &= rows
                store[says] = source[says]
                when[says] = time
        self._barred = barred

    def update_from_replies(self, heard: GroupFeedback, rows: Bools, barred: Bools, time: float) -> None:
        """Keep what register answers of `rows` (m,) say."""
        for row, address, data, written in heard.answers:
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
        """What was read of the torque of `rows` (m,) says nothing of it any more."""
        self._state.torque[rows] = -1

    def assume(self, rows: Bools, on: bool) -> None:
        """`rows` (m,) acknowledged an order of torque, and do not tell what it is (CubeMars)."""
        self._mute |= rows
        self._state.torque[rows] = on

    def forget(self, row: int) -> None:
        """An actuator that restarted: what was read of it no longer holds."""
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
        volts = np.where(self._tells_volts | (self._volt_time > -inf), self._volt_time, inf)
        np.minimum(heat, volts, out=heat)
        np.copyto(state.health_time, heat)
        tells = heat < inf
        if not tells.all():
            np.copyto(state.health_time, self._state_time, where=~tells)


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
