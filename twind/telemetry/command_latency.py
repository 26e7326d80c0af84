"""Latency of a command, hop by hop: received, taken, judged, written, moved. Pure; times are s.

A figure is recorded once, for a hop that happened. A refused command has no `written`, nor has one that ended
before its first goal left. A joint that never moved has no `moved`.

`moved` is the time from the first goal that commands a visible move of a joint to the reading that shows it.
It is measured only from rest: the move of a joint that already moves has no clear start.
"""

from dataclasses import dataclass
from math import nan

import numpy as np

from twind.robot.arrays import Bools, Floats, some
from twind.robot.joint_state import JointState
from twind.robot.trajectory import Reference
from twind.telemetry.timing_monitor import TimingMonitor

VISIBLE = 0.005  # rad: a few counts of a servo, more than an encoder's noise
STILL = 0.05  # rad/s, of reference and reading: counts as standing (as END_NOT_AT_REST)
PATIENCE = 1.0  # s: after that a joint that has not moved is no longer watched
STREAM = ""  # the name of every setpoint


@dataclass(frozen=True, slots=True)
class StartedCommand:
    """Command that the loop has begun with."""

    received: float  # s, time of the call, NaN unknown
    taken: float
    # bound of its figures: a long path takes long to judge, and is not late. None: the threshold
    bound: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _PendingCommand:
    """Command that the next goal follows; arrays (n,)."""

    id: str
    taken: StartedCommand
    judged: float
    joints: Bools  # commanded joints whose reference stands
    begin: Floats  # rad, the reference before it


@dataclass(frozen=True, slots=True)
class _MoveRequest:
    """Visible move of one joint that a goal commands."""

    joint: int
    forward: bool
    at: float


@dataclass(slots=True, eq=False)
class _MotionOnsetWatch:
    """Joints at rest that get goals, and the one that is commanded to move."""

    joints: Bools
    begin: Floats  # rad, the reference
    place: Floats  # rad, their positions
    since: float  # s
    asked: _MoveRequest | None = None


class CommandLatencyTracer:
    """Tracer of the command hops of one loop. One command at a time is traced to its end."""

    def __init__(self, health: TimingMonitor) -> None:
        self._health = health
        self._accepted: _PendingCommand | None = None
        self._watch: _MotionOnsetWatch | None = None

    def take(self, received: float | None, now: float, bound: float | None = None) -> StartedCommand:
        """Register a command that the loop begins with. `received`: time of the call, s; None: unknown."""
        received = nan if received is None else received
        self._health.hop("received", now - received, now, bound)
        return StartedCommand(received, now, bound)

    def judge(self, taken: StartedCommand, now: float) -> None:
        """Record the time until the verdict on a command."""
        self._health.hop("gated", now - taken.taken, now, taken.bound)

    def accept(self, taken: StartedCommand, id: str, joints: Bools, before: Reference, now: float) -> None:
        """Note that the next goals follow a command: `joints` (n,) move, from the reference `before`."""
        standing = joints & (np.abs(before.velocity) <= STILL)
        self._accepted = _PendingCommand(id, taken, now, standing, before.position)

    def end(self, id: str) -> None:
        """Drop a command that ended or was replaced: if none of its goals has left yet, none will."""
        if self._accepted is not None and self._accepted.id == id:
            self._accepted = None

    def write(self, goal: Floats, at: float, state: JointState) -> None:
        """Note that a goal (n,), rad, was sent `at` (s); `state` is the last known joint state before."""
        accepted = self._accepted
        if accepted is not None:
            self._accepted = None
            taken = accepted.taken
            self._health.hop("written", at - accepted.judged, at)
            self._health.hop("command", at - taken.received, at, taken.bound)
            if accepted.id != STREAM or self._watch is None:  # not every goal of a stream is a new one
                still = accepted.joints & (np.abs(state.velocity) <= STILL) & state.heard
                self._watch = (
                    _MotionOnsetWatch(still, accepted.begin, state.position, at) if some(still) else None
                )
        if self._watch is not None:
            self._aim(self._watch, goal, at, state)

    def silence(self) -> None:
        """End the watch: no goal left, so the cause of a move from now on is unknown."""
        self._watch = None

    def forget(self) -> None:
        """Drop the command under way: another target follows commands from now on."""
        self._accepted = self._watch = None

    def look(self, state: JointState, at: float) -> None:
        """Process a reading of the target of commands, true `at` that time (s)."""
        watch = self._watch
        if watch is None or watch.asked is None:
            return
        request = watch.asked
        if _gone(state.position - watch.place, request):
            self._health.hop("moved", at - request.at, at)
            self._watch = None
        elif at - request.at > PATIENCE:
            self._watch = None

    def _aim(self, watch: _MotionOnsetWatch, goal: Floats, at: float, state: JointState) -> None:
        """Choose the joint that this goal moves visibly.

        Ends the watch once the goal leads back or `PATIENCE` s have passed.
        """
        way = goal - watch.begin
        if watch.asked is not None:
            if not _gone(way, watch.asked):
                self._watch = None
            return
        far = np.where(watch.joints, np.abs(way), 0.0)
        joint = int(far.argmax())
        if far[joint] >= VISIBLE:
            watch.asked = _MoveRequest(joint, bool(way[joint] >= VISIBLE), at)
            if _gone(state.position - watch.place, watch.asked):  # before it was commanded: by another cause
                self._watch = None
        elif at - watch.since > PATIENCE:
            self._watch = None


def _gone(way: Floats, request: _MoveRequest) -> bool:
    """Check that the way (n,), rad, contains the visible move that was commanded."""
    travelled = float(way[request.joint])
    return (travelled if request.forward else -travelled) >= VISIBLE
