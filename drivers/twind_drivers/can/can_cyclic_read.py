"""Cyclic reading of a CAN bus: the content of the next request, and the sample from its answers.

A commanded actuator answers the command, where its family does so; all others are requested separately.
Silent actuators are not waited for (`DevicePresence`), but further requested: that costs no time-out.

Late answers: an answer has no number of its request, so that of the last cycle has the form of one of this.
An actuator that missed an answer is suspect. It is not believed until three requests in a row brought exactly
the requested number of frames, in time. A pile of late answers brings too many or none. One case stays
possible: an actuator whose every answer suddenly is late by the same whole number of cycles. Its position is
then as old as that, and nothing in the frames shows it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twind_drivers.bus import Bools, BusSample, Floats, Ints
from twind_drivers.can.actuator_family import SILENCE
from twind_drivers.can.actuator_group import ActuatorGroup, GroupFeedback, joined
from twind_drivers.can.can_transaction import CanTransaction
from twind_drivers.can.can_transactor import DEAD, CanTransactor
from twind_drivers.can.can_units import COUNT, EFFORT
from twind_drivers.device_presence import DevicePresence
from twind_drivers.ports.frame import NOTHING, Frames

SURE = 3  # requests in a row with exactly their replies that clear a suspect; fewer could all be late ones
ALERT = np.uint8(0x80)  # of a sample's error byte: the actuator has a fault
# s of silence before an actuator that replies only to commands gets a soft one: its watchdog has run out then
KNOCK = 1.0


@dataclass(frozen=True, slots=True, weakref_slot=True)
class SoftPoll:
    """Commands without stiffness to the actuators `rows` (m,), which reply to nothing else."""

    frames: Frames
    rows: Bools


class CanCyclicRead:
    """Cyclic reading of m actuators.

    `energised` (m,): actuators whose torque this bus controls. `watched` (m,): actuators whose watchdog was
    read back armed. Such an actuator that is silent for 0.1 s has stopped by itself and may be anywhere. It
    is then `barred`: no command goes to it until it is prepared anew. A dead line bars all. `limp` (m,):
    actuators that never report torque (CubeMars) and were silent long enough to have restarted without it.
    """

    def __init__(self, fleet: ActuatorGroup, line: CanTransactor) -> None:
        m = len(fleet)
        self.fleet = fleet
        self._line = line
        self.attendance = DevicePresence(m)
        self.energised, self.watched, self.barred, self.limp = (np.zeros(m, np.bool_) for _ in range(4))
        self._mute: Bools = fleet.replies & (fleet.answers == 0)
        self.place: Floats = np.full(m, np.nan)  # (m,) rad, last reported positions
        # Sent to actuators that reply only to commands, while none commands them. Its writer owns it: without
        # one (mode mirror) nothing may leave that an actuator obeys.
        self.knock: Callable[[], SoftPoll | None] = lambda: None
        self.proven: Bools = np.ones(m, np.bool_)  # (m,) replies of these are believed
        self._clean = np.full(m, SURE, np.int64)  # (m,) requests in a row with exactly their replies
        self._received_at = np.full(m, -np.inf)
        self.silent: Bools | None = None  # (m,) silent for 0.1 s before the last reading; None: nobody
        self._first = np.inf  # s, of the first request
        self.cycle = 0  # number of requests
        self._sure = False  # no actuator is suspect, so none is parked
        self._everyone: Bools = np.ones(m, np.bool_)
        self._everyone.setflags(write=False)
        self._request_all = CanTransaction(*fleet.make_position_request())
        self.nothing = CanTransaction(NOTHING, np.zeros(m, np.int64))

    # --------------------------------------------------------------------------- out

    def next(self, commanded: Bools, now: float) -> CanTransaction:
        """Return the request that goes beside the commands of `commanded` (m,)."""
        self._first = min(self._first, now)
        self.cycle = self.cycle + 1
        return self.make_cyclic_request(~(commanded & self.fleet.replies), now)

    def make_cyclic_request(self, silent: Bools, now: float) -> CanTransaction:
        """Return a request for the positions of at least the actuators `silent` (m,)."""
        if not silent.any():
            return self.nothing
        request = (
            self._request_all if silent.all() else CanTransaction(*self.fleet.make_position_request(silent))
        )
        knock = self.knock()
        if knock is None or not now - self._first >= KNOCK:
            return request
        knocked = knock.rows & silent & ~self.energised
        if not knocked.any():  # in each tick of an armed robot with other actuators that are read
            return request
        own = knock.frames[knocked[self.fleet.commanded_rows(knock.frames)]]
        return CanTransaction(joined([request.frames, own]), request.expect + knocked)

    # --------------------------------------------------------------------------- in

    def sample(self, now: float) -> BusSample:
        """Build the sample from the answers to the last, ended request. Zero where no answer is believed."""
        line = self._line
        feedback = self._line.heard
        if line.exact and self._sure and not np.isnan(feedback.velocity + feedback.position).any():
            believed = self._everyone
            waited = self.attendance.asked
            self._take_complete_reading(feedback, now)
        else:
            believed, waited = self._look(feedback, now)
        foreign = line.foreign
        line.foreign = 0
        efforts = believed & (feedback.effort == feedback.effort)  # NaN: not reported
        known = bool(efforts.any())
        faulty = feedback.fault.any()
        return BusSample(
            sent=line.sent,
            received=line.received,
            position=_raw(feedback.position, believed, COUNT),
            velocity=_raw(feedback.velocity, believed, COUNT),
            effort=_raw(feedback.effort, efforts, EFFORT) if known else np.zeros(len(believed), np.int64),
            error=(believed & alert(feedback.fault)) * ALERT if faulty else np.zeros(len(believed), np.uint8),
            heard=believed,
            asked=waited,
            discarded=line.strays,
            foreign=foreign,
            effort_told=None if efforts.all() else efforts,
            line=int(line.condition(now)),
        )

    def _take_complete_reading(self, feedback: GroupFeedback, now: float) -> None:
        """Update the state after a healthy reading: one answer of each, none suspect or parked before."""
        if self.energised.any():
            self._bar(now)
        self.place = feedback.position
        self._received_at[:] = now
        self._line.spoke.fill(False)

    def _look(self, feedback: GroupFeedback, now: float) -> tuple[Bools, Bools]:
        """Return the actuators (m,) whose answer is believed, and those that the reading waited for."""
        expect = self._line.expect
        self._line.spoke |= feedback.count > 0  # those of an exact transaction are not in it
        complete = (feedback.count >= expect) | ~self.fleet.replies
        there = complete & ~np.isnan(feedback.position) & ~np.isnan(feedback.velocity)
        self._prove(feedback, expect, there)
        believed: Bools = there & self.proven
        self._bar(now)
        self.place = np.where(believed, feedback.position, self.place)
        self._received_at[self._line.spoke] = now
        waited = self._attend(expect > 0, now)
        self._sure = bool(self.proven.all())
        return believed, waited

    def _prove(self, feedback: GroupFeedback, expect: Ints, there: Bools) -> None:
        """Update which actuators (m,) are proven, i.e. answer the present request.

        After a missed answer an actuator is proven only by `SURE` clean requests in a row.
        """
        exact = there & ((feedback.count == expect) | ~self.fleet.replies)
        missed = (expect > 0) & ~there
        messy = there & ~exact & (self._clean < SURE)
        self._clean = np.where(missed | messy, 0, np.minimum(self._clean + exact, SURE))
        self.proven = self._clean >= SURE

    def _bar(self, now: float) -> None:
        """Bar each actuator that was silent for its watchdog time before this reading.

        A late answer is no reading, but its sender does not count as silent.
        """
        self.silent = None
        if now - self._received_at.min() >= DEAD:
            self.silent = now - self._received_at >= DEAD
            away = self.energised & self.silent
            self.barred |= away & self.watched
            self.limp |= away & self._mute
        if self._line.dead(now):
            self.barred |= self.energised

    def _attend(self, could: Bools, now: float) -> Bools:
        """Return the actuators (m,) that this reading waited for; update the presence for the next one."""
        waited: Bools = self.attendance.asked & (could | (self.fleet.answers > 0))
        replied = self._line.heard.count > 0
        self.attendance.record_missing_reply(replied, could & self.attendance.asked, now)
        if self.attendance.parked:
            for row in np.flatnonzero(self._line.spoke & ~self.attendance.asked).tolist():
                self.attendance.back(row, now)
        self._line.asked = self.attendance.asked
        self._line.spoke.fill(False)
        return waited

    def note(self, feedback: GroupFeedback, now: float) -> Bools:
        """Take the feedback of a rare transaction; return the actuators (m,) with proven replies."""
        fresh: Bools = (feedback.count > 0) & self.proven
        placed = fresh & ~np.isnan(feedback.position)
        self.place = np.where(placed, feedback.position, self.place)
        self._received_at[placed] = now
        return fresh

    def energise(self, rows: Bools, now: float) -> None:
        """Mark the torque of `rows` (m,) as controlled by this bus; their silence counts from now on."""
        self.energised = rows.copy()
        self.limp = self.limp & ~rows
        self._received_at[rows] = np.maximum(self._received_at[rows], now)


def alert(fault: Ints) -> Bools:
    """Return which actuators (m,) have a fault.

    A lost master does not count: the watchdog handles it, and it reads as tripped.
    """
    faulty: Bools = (fault > 0) & (fault != SILENCE)
    return faulty


def _raw(values: Floats, reported: Bools, unit: float) -> Ints:
    """Return whole raw units (m,); 0 where the value is unknown."""
    exact = np.rint(values * (1.0 / unit))
    whole: Ints = (exact if reported.all() else np.where(reported, exact, 0.0)).astype(np.int64)
    return whole
