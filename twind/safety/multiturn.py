"""Whole turns of an actuator after power-up. Pure.

A count gives the angle within a turn; power-off loses the number of turns (field devices with one absolute
turn). Exactly one of the count and its neighbours a turn away lies in the band around the travel. That one
must lie in the travel, and no other, else arming is refused. A travel of more than a turn may have such
places in its middle. Elsewhere a `StatedPlace` determines the turn. Once it is known, a joint keeps it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Bools, Ints
from twind.robot.finding import Finding, ReasonCode
from twind.robot.measured_travel import MeasuredTravel

STATED_NEAR = 8  # part of a turn by which a joint may stand from where an operator states it
_BY_HAND = "move it into its travel by hand with torque off, or calibrate anew"
_SETTLE = "`twindctl calibrate turn`: by its endstop, or by a known pose"
_REBOOT = "switch its power off and on"


@dataclass(frozen=True, slots=True)
class StatedPlace:
    """Place of a joint as another source than its travel gives it, such as an operator."""

    count: int  # calibrated ticks
    near: int  # ticks that the joint may stand from it; less than half a turn
    source: str  # in words, for messages

    def shift(self, raw: int, whole: int) -> int:
        """Return the whole turns, in ticks, that bring a count as read nearest to this place."""
        return whole * round((self.count - raw) / whole)

    def contradiction(self, joint: int, raw: int, whole: int) -> Finding | None:
        """Return a finding where the joint stands too far from this place on every turn."""
        count = raw + self.shift(raw, whole)
        if abs(count - self.count) <= self.near:
            return None
        text = (
            f"stands at {count}, a turn of {whole} aside, and not within {self.near} of {self.count}, where "
            f"{self.source} puts it"
        )
        return Finding(ReasonCode.CALIB_MISMATCH, joint, value=count, bound=self.count, message=text)


def chosen(raw: Ints, turns: MeasuredTravel) -> Ints:
    """Return the whole turns (n,), in ticks, that bring counts as read into their bands; 0: no band."""
    whole = np.where(turns.known, turns.whole, 1)
    shift: Ints = np.where(turns.known, -((raw - turns.band) // whole) * whole, 0)
    return shift


def inside(count: Ints, turns: MeasuredTravel) -> Bools:
    """Mark joints (n,) whose calibrated count is in their travel, or beyond it by at most `turns.slack`.

    The slack is how far a limp joint may hang beyond the travel. Joints without a travel are marked too.
    """
    within = (count >= turns.first - turns.slack) & (count <= turns.last + turns.slack)
    return within | ~turns.known


def fits_twice(raw: Ints, turns: MeasuredTravel) -> Bools:
    """Mark joints (n,) that could stand on more than one turn of their travel, as counts alone go."""
    count = raw + chosen(raw, turns)
    another = (count - turns.whole >= turns.first - turns.room) | (
        count + turns.whole <= turns.last + turns.room
    )
    return another & turns.known


def unfit(
    raw: Ints, shift: Ints, turns: MeasuredTravel, energised: Bools, placed: Bools | None = None
) -> Sequence[Finding]:
    """Return a finding for each joint whose turn is ambiguous, or not commandable, on the turn chosen.

    `shift` (n,): the turns chosen, in ticks. `energised` (n,): with torque on. `placed` (n,): a `StatedPlace`
    determined the turn; None: of no joint.
    """
    count = raw + shift
    wide = turns.falls & (turns.last - turns.first >= turns.whole)
    another = fits_twice(raw, turns) if placed is None else fits_twice(raw, turns) & ~placed
    low = turns.lower - shift
    high = turns.upper - shift
    beyond = np.where(turns.falls, shift != 0, (low < turns.least) | (high > turns.most))
    found = []
    for joint in np.flatnonzero(turns.known & (wide | another | ~inside(count, turns) | beyond)).tolist():
        row = _TurnRow(joint, int(raw[joint]), int(shift[joint]), turns)
        if wide[joint]:
            found.append(row.wide())
        elif not inside(count, turns)[joint]:
            found.append(row.lost())
        elif another[joint]:
            found.append(row.another())
        else:
            found.append(row.beyond(on=bool(energised[joint])))
    return found


def outside_travel(raw: Ints, shift: Ints, turns: MeasuredTravel, located: Bools) -> Sequence[Finding]:
    """Return a finding for each `located` (n,) joint that has left its travel since its turn was chosen."""
    outside = np.flatnonzero(located & ~inside(raw + shift, turns)).tolist()
    return [_TurnRow(joint, int(raw[joint]), int(shift[joint]), turns).outside() for joint in outside]


def expected(raw: Ints, turns: MeasuredTravel) -> Ints:
    """Return what readings (n,) become at torque-on: a device that knows only one turn reads that one."""
    whole = np.where(turns.falls, turns.whole, 1)
    anew: Ints = np.where(turns.falls, turns.begin + (raw - turns.begin) % whole, raw)
    return anew


class _TurnRow:
    """Turn data of one joint, from which its findings are made. Values and bounds are ticks."""

    def __init__(self, joint: int, raw: int, shift: int, turns: MeasuredTravel) -> None:
        self.joint = joint
        self.raw = raw
        self.shift = shift
        self.count = raw + shift
        self.whole = int(turns.whole[joint])
        self.low = int(turns.first[joint] - turns.slack[joint])
        self.high = int(turns.last[joint] + turns.slack[joint])
        self.least = int(turns.least[joint])
        self.most = int(turns.most[joint])
        self.falls = bool(turns.falls[joint])
        one = turns.last[joint] - turns.first[joint] + 2 * turns.room[joint] < 2 * self.whole - 1
        self.middle = "move it to its middle by hand with torque off, or " if one else ""
        self.goals = (int(turns.lower[joint]), int(turns.upper[joint]))

    def lost(self) -> Finding:
        bound = self.low if self.count < self.low else self.high
        text = (
            f"reads {self.raw}: neither that nor a turn beside it is in its travel "
            f"{self.low}..{self.high}: zero lost? find out why, {_BY_HAND}"
        )
        return self._finding(self.count, bound, text)

    def outside(self) -> Finding:
        bound = self.low if self.count < self.low else self.high
        text = (
            f"stands at {self.count}: out of its travel {self.low}..{self.high}, in which it was identified; "
            f"{_BY_HAND}"
        )
        return self._finding(self.count, bound, text)

    def wide(self) -> Finding:
        span = self.high - self.low
        text = (
            f"its travel of {span} ticks is {self.whole} or more, with a turn of {self.whole}: it can only "
            "be driven in a mode of several turns, with a smaller ratio, or narrower stops"
        )
        return self._finding(span, self.whole, text)

    def another(self) -> Finding:
        other = self.count - self.whole if self.count - self.whole >= self.low else self.count + self.whole
        text = (
            f"{self.count} and {other}, a turn away, both fit its travel {self.low}..{self.high}: its "
            f"turn is unknown: {self.middle}{_SETTLE}"
        )
        return self._finding(self.count, other, text)

    def beyond(self, *, on: bool) -> Finding:
        turns = self.shift // self.whole
        first, last = (goal - self.shift for goal in self.goals)
        if self.falls:
            limp = "switch its torque off (`twindctl disarm`), then " if on else ""
            text = (
                f"reads {self.raw}, {turns:+d} turns from where it was calibrated: turned by hand with its "
                "power on? Position mode covers one turn only: "
                f"{limp}{_REBOOT} (it starts on its one turn), or turn it back by hand"
            )
            return self._finding(self.raw, self.count, text)
        text = (
            f"reads {self.raw}, {turns:+d} turns from where it was calibrated; its goals there, "
            f"{first}..{last}, are outside {self.least}..{self.most}, its range:  {_REBOOT}"
        )
        out_low = first < self.least
        return self._finding(first if out_low else last, self.least if out_low else self.most, text)

    def _finding(self, value: int, bound: int, text: str) -> Finding:
        return Finding(
            ReasonCode.CALIB_MISMATCH, self.joint, value=float(value), bound=float(bound), message=text
        )
