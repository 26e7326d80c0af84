"""Executor of accepted trajectories, setpoints and stops: computes the reference of each tick.

Semantics of `joint_trajectory_controller`: replacement blends from the running reference without a step,
joints that a goal does not name keep their old path, a future start waits while the old path goes on. Judges
nothing: all input has passed the gate.
"""

from collections.abc import Callable, Sequence
from math import inf, isfinite

import numpy as np

from twind.motion.goal_conditions import GoalOutcome, GoalTolerances, off, without_past
from twind.motion.limp_joints import LimpJoints
from twind.motion.motion_layers import MotionLayer, ScheduledGoal, begun, choose, displaced, overlay, without
from twind.motion.predicted_path import LookaheadPlan
from twind.motion.setpoint_stream import SetpointStream, widened
from twind.motion.stop_profiles import CompliantFollower, LimitedFollower, StopRamp, still
from twind.motion.time_scaling import Stretch
from twind.robot.arrays import Bools, Floats, Ints, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.joint_state import JointState
from twind.robot.modes import Motion
from twind.robot.trajectory import Reference, Trajectory

__all__ = ["GoalOutcome", "GoalTolerances", "TrajectoryExecutor"]


class TrajectoryExecutor:
    """Executor on its own time, which advances by one period per `goal()`.

    A late or missed tick re-times the motion; it never catches up and never jumps (LOOP_LATE). Starts fall on
    ticks: a start time is rounded to the nearest one.
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        # limits: replaced at rest only
        self.limits = limits
        self._period = period
        self._tick = 0
        self._pace = 1.0
        self.slowed_by: tuple[ReasonCode, ...] = ()  # reasons of the pace, for reports
        self.fence: tuple[Floats, Floats] | None = None  # rad, (n,) each: streamed goals go no further
        self._reference: Reference | None = None
        self._floor: StopRamp | LimitedFollower | None = None  # motion of the joints that no layer decides
        self.layers: list[MotionLayer] = []  # begun, oldest first; no joint is in two
        self._running: MotionLayer | None = None  # the newest, while its goal has not ended
        self._pending: list[ScheduledGoal] = []  # by start
        self.stream: SetpointStream | None = None
        self._ended: list[GoalOutcome] = []
        self._yielding: CompliantFollower | None = None  # while `yield_to` is called
        self.limp: LimpJoints | None = None  # of the coming tick: they decide before any motion

    # ------------------------------------------------------------------------------- what is

    @property
    def motion(self) -> Motion:
        """Motion of the joints; a goal that waits for its start counts as active."""
        if self._reference is None:
            return Motion.IDLE
        if self.stream is not None:
            return Motion.STREAMING
        return Motion.ACTIVE if self.layers or self._pending else Motion.HOLDING

    @property
    def reference(self) -> Reference | None:
        """The last commanded reference; None while idle."""
        return self._reference

    @property
    def pace(self) -> float:
        """Share of their own speed that motions may have, 0..1; NaN is 0. A stop is never slowed.

        A running motion reaches it as fast as each joint's acceleration allows.
        """
        return self._pace

    @pace.setter
    def pace(self, share: float) -> None:
        self._pace = min(share, 1.0) if share > 0.0 else 0.0

    @property
    def slowed(self) -> bool:
        """True while motions are, or still are, slower than accepted."""
        return self._pace < 1.0 or not all(layer.pace.even for layer in self.layers)

    @property
    def waiting(self) -> int:
        """Number of accepted goals whose start has not come."""
        return len(self._pending)

    def setpoint_age(self, now: float) -> float | None:
        """Age of the newest setpoint (s), counted from the first tick that could use it; None: no stream."""
        return None if self.stream is None else self.stream.age(now)

    def progress(self) -> tuple[str, float] | None:
        """Return the id and the share done, 0..1, of the goal that runs or waits."""
        if self._running is not None:
            return self._running.goal.id, self._running.fraction(self._tick)
        return (self._pending[0].id, 0.0) if self._pending else None

    @property
    def stretch(self) -> Stretch | None:
        """Duration of the goal that runs, and the time it lost so far; None: none runs."""
        return None if self._running is None else self._running.stretch

    def outcomes(self) -> list[GoalOutcome]:
        """Return the goals that ended since the last call."""
        ended = self._ended
        self._ended = []
        return ended

    def ahead(self, start_in: float) -> Reference:
        """Return the reference `start_in` s from now, at which a goal of that time begins.

        Motions count as unslowed from now on. Raises ValueError while idle.
        """
        if self._reference is None or self._floor is None:
            raise ValueError("idle: nothing holds, so there is no reference ahead")
        until = self._start(start_in)
        if until <= self._tick:
            return self._reference
        layers = self.layers
        for goal in self._pending:
            if goal.start < until:
                new = begun(goal, self._predict(layers, goal.start), self.limits, self._period)
                layers = [*without(layers, new.joints), new]
        return self._predict(layers, until)

    @property
    def plan(self) -> LookaheadPlan | None:
        """Basis of the coming ticks; None while idle."""
        if self._reference is None or self._floor is None:
            return None
        now = self._reference
        layers = tuple(self.layers)
        stream = self.stream
        changing = self.slowed or stream is not None or self.limp is not None
        now = now if self.limp is None else self.limp.hold(now, now)
        return LookaheadPlan(now, self._floor, layers, self._tick, changing, stream, self._pace)

    # ------------------------------------------------------------------------------- what to do

    def begin(self, position: Floats) -> None:
        """Hold at `position` (n,), rad, from rest; goals under way end as aborted.

        Raises ValueError for NaN.
        """
        if not np.isfinite(position).all():
            joint = int(np.argmin(np.isfinite(position)))
            raise ValueError(f"cannot hold joint {joint} at {position[joint]}: not a finite position")
        self._end_all("aborted", ())
        self._rest(still(position))

    def idle(self) -> None:
        """Stop to hold; goals under way end as aborted."""
        self._end_all("aborted", ())
        self._reference = None
        self._floor = None

    def submit(
        self,
        id: str,
        path: Trajectory,
        *,
        start_in: float = 0.0,
        tolerances: GoalTolerances | None = None,
        goal_time: float | None = None,
    ) -> Finding | None:
        """Follow `path` from its start on; return None, or the reason why that is impossible.

        A start in the past drops the waypoints that are past. Goals that were to begin at or after this one
        are replaced; one that runs is replaced when this one begins.
        """
        if self._reference is None:
            return Finding(ReasonCode.NOT_ARMED, message="the robot does not hold: arm first")
        if not len(path.time):
            return Finding(ReasonCode.EMPTY, message="a trajectory without points")
        if not start_in < inf:
            return Finding(ReasonCode.TOO_DISTANT, value=start_in, message="a start that never comes")
        left = without_past(path, start_in)
        if isinstance(left, Finding):
            return left
        start = self._start(start_in)
        if self.stream is not None and start > self._tick:
            return Finding(ReasonCode.BUSY, message="setpoints arrive: a later start cannot be foreseen")
        if self.slowed and start > self._tick:
            return Finding(ReasonCode.BUSY, message="the motion is slowed: a later start cannot be foreseen")
        for goal in [goal for goal in self._pending if goal.start >= start]:
            self._pending.remove(goal)
            self._end(goal, "replaced")
        foreseen = self.ahead(start_in).position if start > self._tick else None
        self._pending.append(ScheduledGoal(id, left, start, tolerances, goal_time, foreseen))
        return None

    def setpoint(
        self, joints: Ints, position: Floats, velocity: Floats | None, valid_for: float
    ) -> Finding | None:
        """Follow `position` (m,), rad, of `joints`; hold when `valid_for` s have passed without another.

        Goals under way are replaced; joints that the stream does not name keep their path. Returns None, or
        the reason against it.
        """
        if self._reference is None:
            return Finding(ReasonCode.NOT_ARMED, message="the robot does not hold: arm first")
        if not np.isfinite([*position, *(() if velocity is None else velocity), valid_for]).all():
            return Finding(ReasonCode.NONFINITE, message="a setpoint must be finite")
        self._end_goals("replaced", ())
        new = np.zeros(len(self._reference.position), np.bool_)
        new[joints] = True
        stream = self.stream
        if stream is None or (new & ~stream.joints).any():
            self.stream = stream = widened(stream, new, self._reference, self.limits, self._period)
            self.layers = without(self.layers, stream.joints)
        stream.set_target(joints, position, velocity, valid_for)
        return None

    def stop(self, phase: str = "cancelled", findings: Sequence[Finding] = ()) -> None:
        """Brake with the gate's acceleration limit, then hold. Goals under way end as `phase`."""
        moving = bool(self.layers) or self.stream is not None or isinstance(self._floor, LimitedFollower)
        self._end_all(phase, findings)
        if moving and self._reference is not None:
            self._floor = StopRamp(self._reference, self.limits, self._period)

    def give_in(self, joints: Sequence[int], place: Floats, findings: Sequence[Finding] = ()) -> None:
        """Brake; hold `joints` at `place` (n,), rad, the others as commanded (OUT_OF_LIMIT, FOLLOW_ERR).

        Called again, a joint on its way goes on to its earlier place.
        """
        if self._reference is None:
            return
        named = np.zeros(len(place), np.bool_)
        named[list(joints)] = True
        busy = self.layers or self._pending or self.stream is not None
        under_way = self._floor if isinstance(self._floor, CompliantFollower) and not busy else None
        if under_way is not None:
            under_way.aim_at(named & ~under_way.joints, place)
            return
        self._end_all("aborted", findings)
        self._floor = floor = CompliantFollower(self._reference, self.limits, self._period)
        floor.aim_at(named, place)

    def yield_to(self, place: Floats, speed: float) -> None:
        """Follow the present `place` (n,), rad, no faster than `speed` rad/s: goals that yield (DAMP)."""
        if self._reference is None:
            return
        if self._yielding is None or self._floor is not self._yielding:
            self._end_all("aborted", ())
            self._yielding = CompliantFollower(self._reference, self.limits, self._period, speed=speed)
            self._floor = self._yielding
        self._yielding.aim_at(np.isfinite(place), place)

    # ------------------------------------------------------------------------------- once per tick

    def goal(self, now: float, missed: int = 0) -> Reference | None:
        """Return the reference of the next tick; None while idle.

        `now` (s): of this tick. `missed`: ticks that did not occur just before it.
        """
        if self._reference is None or self._floor is None:
            return None
        while self._pending and self._pending[0].start <= self._tick:  # one ends a stream, also a stale one
            self._begin(self._pending.pop(0), self._reference)
        stale = None if self.stream is None else self.stream.use(now)
        if stale is not None:
            self.stop()
            self._ended.append(GoalOutcome("", "aborted", (stale,)))
        self._keep_time(missed)
        self._tick += 1
        reference = self._next(self._floor)
        if self.limp is not None:
            reference = self.limp.follow(reference, self._reference, self.limits, self._period)
        if not isfinite(float(reference.position @ reference.position)):
            self._end_all("aborted", (Finding(ReasonCode.INTERNAL, message="the reference is not finite"),))
            self._floor = StopRamp(self._reference, self.limits, self._period)
            reference = self._floor.step()
        self._reference = reference
        self._settle_down(reference)
        return reference

    def observe(self, state: JointState, goals: Callable[[Floats], Floats] = lambda place: place) -> None:
        """Judge the running goal by measured positions: path and goal tolerances.

        `goals`: returns the nearest goals (n,), rad, to a place that their devices take.
        """
        layer = self._running
        reference = self._reference
        if layer is None or reference is None or layer.goal.tolerances is None:
            return
        error = np.abs(reference.position - state.position)
        t = layer.elapsed(self._tick)
        duration = layer.curve.duration
        tolerances = layer.goal.tolerances
        if t < duration:
            out = layer.outside(error, tolerances.path)
            if some(out):
                self._give_up(ReasonCode.PATH_TOLERANCE, out, error, tolerances.path, goals(state.position))
            return
        out = layer.outside(error, tolerances.goal) | layer.outside(np.abs(state.velocity), tolerances.speed)
        if not some(out):
            self._end(layer.goal, "succeeded", layer=layer)
            self._running = None
        elif layer.goal.goal_time and t > duration + layer.goal.goal_time:
            self._give_up(ReasonCode.GOAL_TOLERANCE, out, error, tolerances.goal, goals(state.position))

    # ------------------------------------------------------------------------------- inside

    def _start(self, start_in: float) -> int:
        return self._tick + max(0, round(start_in / self._period))

    def _predict(self, layers: Sequence[MotionLayer], tick: int) -> Reference:
        assert self._floor is not None  # `ahead` has checked both
        assert self._reference is not None
        reference = overlay(self._floor.ahead((tick - self._tick) * self._period), layers, tick)
        return reference if self.limp is None else self.limp.hold(reference, self._reference)

    def _begin(self, goal: ScheduledGoal, reference: Reference) -> None:
        """Start a goal: it takes its joints over, and the goal that ran is replaced.

        A goal that was judged from another place, because the motion before it was slowed since, ends here.
        """
        finding = displaced(goal, reference)
        if finding is not None:
            self._end(goal, "aborted", (finding,))
            return
        if self.stream is not None:  # a stream has no old path: joints it leaves behind brake
            self.stream = None
            self._floor = StopRamp(reference, self.limits, self._period)
        layer = begun(goal, reference, self.limits, self._period)
        self.layers = [*without(self.layers, layer.joints), layer]
        if self._running is not None:
            self._end(self._running.goal, "replaced", layer=self._running)
        self._running = layer

    def _keep_time(self, missed: int) -> None:
        """Count the ticks that were missed before this one, and advance the time of each motion."""
        for layer in self.layers:
            if missed > 0:
                layer.miss(self._tick, missed)
            layer.keep_pace(self._tick, self._pace, self.slowed_by, self.limits)

    def _next(self, floor: StopRamp | LimitedFollower) -> Reference:
        if len(self.layers) == 1 and self.layers[0].whole:  # a stream takes its joints out of the layers
            return self.layers[0].reference_at(self._tick)
        reference = floor.step()
        if self.layers:
            reference = overlay(reference, self.layers, self._tick)
        if self.stream is not None:
            self.stream.follower.fence = self.fence
            reference = choose(self.stream.joints, self.stream.follower.step(self._pace), reference)
        return reference

    def _settle_down(self, reference: Reference) -> None:
        """End what has arrived: the goal without tolerances, then the layers, then the follower."""
        layer = self._running
        tick = self._tick
        if layer is not None and layer.is_finished(tick) and not layer.goal.judged_at_end:
            self._end(layer.goal, "succeeded", layer=layer)
            self._running = None
        if self.layers and self._running is None and all(layer.is_finished(tick) for layer in self.layers):
            self.layers = []
            self._floor = StopRamp(reference, self.limits, self._period)
        if isinstance(self._floor, LimitedFollower) and self._floor.resting:
            self._rest(still(reference.position))

    def _rest(self, reference: Reference) -> None:
        self._reference = reference
        self._floor = StopRamp(reference, self.limits, self._period)

    def _give_up(self, code: ReasonCode, out: Bools, error: Floats, bound: Floats, place: Floats) -> None:
        """Abort: brake; hold blocked joints at their `place` (FOLLOW_ERR), the others as commanded."""
        assert self._running is not None  # `observe` has checked it
        findings = off(code, out, error, bound, self._running.elapsed(self._tick))
        self.give_in(np.flatnonzero(out).tolist(), place, findings)

    def _end_all(self, phase: str, findings: Sequence[Finding]) -> None:
        self._end_goals(phase, findings)
        self.layers = []
        self.stream = None

    def _end_goals(self, phase: str, findings: Sequence[Finding]) -> None:
        if self._running is not None:
            self._end(self._running.goal, phase, findings, self._running)
            self._running = None
        for goal in self._pending:
            self._end(goal, phase, findings)
        self._pending.clear()

    def _end(
        self,
        goal: ScheduledGoal,
        phase: str,
        findings: Sequence[Finding] = (),
        layer: MotionLayer | None = None,
    ) -> None:
        done = (0.0, None) if layer is None else (layer.fraction(self._tick), layer.stretch)
        self._ended.append(GoalOutcome(goal.id, phase, tuple(findings), *done))
