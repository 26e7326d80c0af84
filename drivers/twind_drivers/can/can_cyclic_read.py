"""The cyclic reading of a CAN bus: what the next request asks of whom, and the sample that its answers make.

Whoever is commanded answers the command, where his family does; all others are asked. Those who stay silent
are not waited for (`DevicePresence`), but go on being asked: that costs nobody a time-out.

A late answer. It carries no number of its request, so that of the last cycle looks like that of this one.
Whoever missed an answer is a suspect: not heard until three requests in a row brought exactly as many frames
as were asked for, in time. A pile of late answers brings too many or none. What stays possible: an actuator
whose every answer is late by the same whole number of cycles, from one day to the next; its place is then as
old as that, and nothing in the frames tells.
"""

import numpy as np

from twind_drivers.bus import Bools, BusSample, Floats, Ints
from twind_drivers.can.actuator_family import SILENCE
from twind_drivers.can.actuator_group import ActuatorGroup, GroupFeedback, joined
from twind_drivers.can.can_transactor import DEAD, CanTransaction, CanTransactor
from twind_drivers.can.can_units import COUNT, EFFORT
from twind_drivers.can.frame import NOTHING, Frames
from twind_drivers.device_presence import DevicePresence

SURE = 3  # requests in a row, each answered as it should be, after which a suspect is believed
ALERT = np.uint8(0x80)  # of a sample's error byte: the actuator has a fault
KNOCK = 1.0  # s of silence before whoever answers commands alone is knocked at: its own watchdog has run out


class CanCyclicRead:
    """The reading of m actuators.

    `energised` (m,): whose torque is ours. `watched` (m,): who has a watchdog that was read back armed. One
    of these that was not heard for 0.1 s has stopped by itself and may be anywhere, so it is `barred`: no
    command goes to it until it is prepared anew. A dead line bars everybody. `limp` (m,): who never tells his
    torque (CubeMars), and was away so long that he may have begun anew without it.
    """

    def __init__(self, fleet: ActuatorGroup, line: CanTransactor) -> None:
        m = len(fleet)
        self.fleet, self._line = fleet, line
        self.attendance = DevicePresence(m)
        self.energised, self.watched, self.barred, self.limp = (np.zeros(m, np.bool_) for _ in range(4))
        self._mute: Bools = fleet.replies & (fleet.answers == 0)
        self.place: Floats = np.full(m, np.nan)  # rad, where each said that it is, last
        # Sent to those who answer commands alone while nobody commands them; made by the writer.
        self.knock: tuple[Frames, Bools] = (NOTHING, np.zeros(m, np.bool_))
        self.proven: Bools = np.ones(m, np.bool_)  # believed, if it answered
        self._clean = np.full(m, SURE, np.int64)  # requests in a row with exactly its answers
        self._heard_at = np.full(m, -np.inf)
        self._first = np.inf  # s, of the first request
        self.cycle = 0  # how many requests there were
        self._sure = False  # nobody is suspected or parked
        self._everyone: Bools = np.ones(m, np.bool_)
        self._everyone.setflags(write=False)
        self._everybody = CanTransaction(*fleet.question())
        self.nothing = CanTransaction(NOTHING, np.zeros(m, np.int64))

    # --------------------------------------------------------------------------- out

    def next(self, commanded: Bools, now: float) -> CanTransaction:
        """What goes beside the commands of `commanded` (m,)."""
        self._first, self.cycle = min(self._first, now), self.cycle + 1
        silent = ~(commanded & self.fleet.replies)
        if not silent.any():
            return self.nothing
        return self.question(silent, now)

    def question(self, silent: Bools, now: float) -> CanTransaction:
        """Asks at least the actuators `silent` (m,) where they are."""
        if not silent.any():
            return self.nothing
        asked = self._everybody if silent.all() else CanTransaction(*self.fleet.question(silent))
        frames, rows = self.knock
        knocked = rows & silent & ~self.energised
        if not knocked.any() or not now - self._first >= KNOCK:
            return asked
        own = frames if knocked.all() else frames[knocked[self.fleet.commands_to(frames)]]
        return CanTransaction(
            joined([asked.frames, own]), asked.expect + np.where(self.fleet.replies, knocked, 0)
        )

    # --------------------------------------------------------------------------- in

    def sample(self, now: float) -> BusSample:
        """What the answers to the last request say, once the line has ended it. Zero where not heard."""
        line, heard = self._line, self._line.heard
        if line.exact and self._sure and not np.isnan(heard.velocity + heard.position).any():
            believed, asked = self._everyone, self.attendance.asked
            self._whole(heard, now)
        else:
            believed, asked = self._look(heard, now)
        foreign, line.foreign = line.foreign, 0
        efforts = believed & (heard.effort == heard.effort)  # NaN: not told
        known = bool(efforts.any())
        faulty = heard.fault.any()
        return BusSample(
            sent=line.sent,
            received=line.received,
            position=_raw(heard.position, believed, COUNT),
            velocity=_raw(heard.velocity, believed, COUNT),
            effort=_raw(heard.effort, efforts, EFFORT) if known else np.zeros(len(believed), np.int64),
            error=(believed & alert(heard.fault)) * ALERT if faulty else np.zeros(len(believed), np.uint8),
            heard=believed,
            asked=asked,
            discarded=line.strays,
            foreign=foreign,
            effort_told=None if efforts.all() else efforts,
            line=int(line.condition(now)),
        )

    def _whole(self, heard: GroupFeedback, now: float) -> None:
        """The healthy reading: one answer of each, and nobody was suspected or parked before."""
        self.attendance.whole()
        if self.energised.any():
            self._bar(now)
        self.place, self._heard_at[:] = heard.position, now
        self._line.spoke.fill(False)

    def _look(self, heard: GroupFeedback, now: float) -> tuple[Bools, Bools]:
        """Who (m,) is believed, and whom the reading was waited for."""
        expect = self._line.expect
        answered = (expect > 0) & (heard.count >= expect)
        spoke = (heard.count > 0) & ((expect == 0) | ~self.fleet.replies)  # of itself
        there = (answered | spoke) & ~np.isnan(heard.position) & ~np.isnan(heard.velocity)
        self._prove(heard, expect, there)
        believed: Bools = there & self.proven
        self._bar(now)
        self.place = np.where(believed, heard.position, self.place)
        self._heard_at[self._line.spoke | believed] = now
        asked = self._attend(believed, expect > 0, now)
        self._sure = bool(self.proven.all()) and not self.attendance.parked
        return believed, asked

    def _prove(self, heard: GroupFeedback, expect: Ints, there: Bools) -> None:
        """Whose answer (m,) is to this request? Of who has missed one, only after `SURE` clean ones."""
        exact = there & ((heard.count == expect) | ~self.fleet.replies)
        missed = (expect > 0) & ~there
        messy = there & ~exact & (self._clean < SURE)
        self._clean = np.where(missed | messy, 0, np.minimum(self._clean + exact, SURE))
        self.proven = self._clean >= SURE

    def _bar(self, now: float) -> None:
        """Whoever was away for as long as his watchdog, as of before this reading. A late answer is no
        reading, but he who gives one was not away."""
        if now - self._heard_at.min() >= DEAD:
            away = self.energised & (now - self._heard_at >= DEAD)
            self.barred |= away & self.watched
            self.limp |= away & self._mute
        if self._line.dead(now):
            self.barred |= self.energised

    def _attend(self, believed: Bools, could: Bools, now: float) -> Bools:
        """Whom the reading was waited for; from now on those who are there."""
        asked: Bools = self.attendance.asked & (could | believed | (self.fleet.answers > 0))
        heard = self._line.heard.count > 0
        self.attendance.missed(heard, could & self.attendance.asked, now)
        if self.attendance.parked:
            for row in np.flatnonzero(self._line.spoke & ~self.attendance.asked).tolist():
                self.attendance.back(row, now)
        elif could.any() and heard[could].all():
            self.attendance.whole()
        self._line.asked = self.attendance.asked
        self._line.spoke.fill(False)
        return asked

    def note(self, heard: GroupFeedback, now: float) -> Bools:
        """What a rare transaction brought beside its answer; who (m,) of those that are believed told it."""
        told: Bools = (heard.count > 0) & self.proven
        placed = told & ~np.isnan(heard.position)
        self.place = np.where(placed, heard.position, self.place)
        self._heard_at[placed] = now
        return told

    def energise(self, rows: Bools, now: float) -> None:
        """From now on the torque of `rows` (m,) is ours, and their silence is counted from here."""
        self.energised, self.limp = rows.copy(), self.limp & ~rows
        self._heard_at[rows] = np.maximum(self._heard_at[rows], now)


def alert(fault: Ints) -> Bools:
    """Who (m,) has a fault. A lost master is none: its watchdog is for that, and reads as tripped."""
    faulty: Bools = (fault > 0) & (fault != SILENCE)
    return faulty


def _raw(values: Floats, told: Bools, unit: float) -> Ints:
    """Whole raw units (m,); 0 where it was not told."""
    exact = np.rint(values * (1.0 / unit))
    whole: Ints = (exact if told.all() else np.where(told, exact, 0.0)).astype(np.int64)
    return whole
