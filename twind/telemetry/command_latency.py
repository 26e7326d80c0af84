"""The way of a command, hop by hop: called, taken by the loop, judged, written, moved. Pure; times are s.

A figure is given for what happened, once, and for nothing else: a command that was refused has no `written`,
one that was replaced or ended before its first goal left neither, a joint that never moved no `moved`.

`moved` is the time from the first goal that asks a joint for a visible move to the reading that shows it. It
is looked for where the joint stood still, since what moved already says nothing of when it was told.
"""

from dataclasses import dataclass
from math import nan

import numpy as np

from twind.robot.arrays import Bools, Floats, some
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.telemetry.timing_monitor import TimingMonitor

VISIBLE = 0.005  # rad: a few counts of a servo, more than an encoder's noise
STILL = 0.05  # rad/s, of reference and reading: counts as standing (as END_NOT_AT_REST)
PATIENCE = 1.0  # s: a joint that has not moved by then is not looked at any longer
STREAM = ""  # the name of every setpoint


@dataclass(frozen=True, slots=True)
class StartedCommand:
    """A command that the loop has begun with."""

    received: float  # when it was called, NaN unknown
    taken: float
    bound: float | None  # for its figures: a long path is long judged, and not late. None: the threshold


@dataclass(frozen=True, slots=True, eq=False)
class _PendingCommand:
    """A command that the next goal follows; arrays (n,)."""

    id: str
    taken: StartedCommand
    judged: float
    joints: Bools  # that are commanded and were meant to stand
    begin: Floats  # rad, the reference before it


@dataclass(frozen=True, slots=True)
class _MoveRequest:
    """Visible move of one joint that a goal commands."""

    joint: int
    forward: bool
    at: float


@dataclass(slots=True, eq=False)
class _MotionOnsetWatch:
    """Joints that stand and were written to, and which of them is commanded to move."""

    joints: Bools
    begin: Floats  # rad, the reference
    place: Floats  # rad, where they were
    since: float  # s
    asked: _MoveRequest | None = None


class CommandLatencyTracer:
    """The command hops of one loop. One command at a time is followed to the end of its way."""

    def __init__(self, health: TimingMonitor) -> None:
        self._health = health
        self._accepted: _PendingCommand | None = None
        self._watch: _MotionOnsetWatch | None = None

    def take(self, received: float | None, now: float, bound: float | None = None) -> StartedCommand:
        """Register a command that the loop begins with. `received`: time of the call, s; None: not known."""
        received = nan if received is None else received
        self._health.hop("received", now - received, now, bound)
        return StartedCommand(received, now, bound)

    def judge(self, taken: StartedCommand, now: float) -> None:
        """Record the time until the verdict on a command."""
        self._health.hop("gated", now - taken.taken, now, taken.bound)

    def accept(self, taken: StartedCommand, id: str, joints: Bools, before: Reference, now: float) -> None:
        """The goals to come follow it: `joints` (n,) are commanded, `before` is what it begins from."""
        standing = joints & (np.abs(before.velocity) <= STILL)
        self._accepted = _PendingCommand(id, taken, now, standing, before.position)

    def end(self, id: str) -> None:
        """Drop a command that ended or was replaced: if none of its goals has left yet, none will."""
        if self._accepted is not None and self._accepted.id == id:
            self._accepted = None

    def write(self, goal: Floats, at: float, state: JointState) -> None:
        """A goal (n,) left; `state` is what was known of whom it went to before."""
        accepted = self._accepted
        if accepted is not None:
            self._accepted = None
            taken = accepted.taken
            self._health.hop("written", at - accepted.judged, at)
            self._health.hop("command", at - taken.received, at, taken.bound)
            if accepted.id != STREAM or self._watch is None:  # of a stream not every goal is a new one
                still = accepted.joints & (np.abs(state.velocity) <= STILL) & state.heard
                self._watch = (
                    _MotionOnsetWatch(still, accepted.begin, state.position, at) if some(still) else None
                )
        if self._watch is not None:
            self._aim(self._watch, goal, at, state)

    def silence(self) -> None:
        """End the watch: no goal left, so the cause of a move from now on is not known."""
        self._watch = None

    def forget(self) -> None:
        """Whoever moved, it is another one from now on."""
        self._accepted = self._watch = None

    def look(self, state: JointState, at: float) -> None:
        """A reading of whom the goals go to, true `at` that time."""
        watch = self._watch
        if watch is None or watch.asked is None:
            return
        asked = watch.asked
        if _gone(state.position - watch.place, asked):
            self._health.hop("moved", at - asked.at, at)
            self._watch = None
        elif at - asked.at > PATIENCE:
            self._watch = None

    def _aim(self, watch: _MotionOnsetWatch, goal: Floats, at: float, state: JointState) -> None:
        """Choose the joint that this goal moves visibly. Ends the watch once the goal leads back or
        `PATIENCE` s have passed."""
        way = goal - watch.begin
        if watch.asked is not None:
            if not _gone(way, watch.asked):
                self._watch = None
            return
        far = np.where(watch.joints, np.abs(way), 0.0)
        joint = int(far.argmax())
        if far[joint] >= VISIBLE:
            watch.asked = _MoveRequest(joint, bool(way[joint] >= VISIBLE), at)
            if _gone(state.position - watch.place, watch.asked):  # before it was asked: by something else
                self._watch = None
        elif at - watch.since > PATIENCE:
            self._watch = None


def _gone(way: Floats, asked: _MoveRequest) -> bool:
    """Check that the way (n,), rad, contains the visible move that was commanded."""
    one = float(way[asked.joint])
    return (one if asked.forward else -one) >= VISIBLE
