"""Predicted path of a motion for the look-ahead of a tick, at many times at once. Pure.

For a trajectory it is the trajectory. For a setpoint stream it is one step towards the target and then the
way to rest: the next setpoint is unknown, and the robot must be able to stop without it.
"""

from dataclasses import dataclass

import numpy as np

from twind.motion.motion_layers import MotionLayer, choose, overlay
from twind.motion.setpoint_stream import SetpointStream, widened
from twind.robot.arrays import Floats, Ints
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Spline
from twind.robot.trajectory import Reference


def braking(reference: Reference, limits: JointLimits, times: Floats) -> Floats:
    """Return positions (k, n), rad, at `times` (k,) s after all joints have begun to brake.

    Each brakes with its acceleration limit.
    """
    speed = np.nan_to_num(reference.velocity, posinf=0.0, neginf=0.0)
    t = np.minimum(times[:, None], np.abs(speed) / limits.acceleration)
    way: Floats = reference.position + t * (speed - 0.5 * np.copysign(limits.acceleration, speed) * t)
    return way


def along(curve: Spline, times: Floats) -> Floats:
    """Return positions (k, n) of a curve at `times` (k,) s from its start; its end after it."""
    if not len(curve.coefficients):
        return np.repeat(curve.end[None], len(times), axis=0)
    t = np.clip(times, curve.time[0], curve.time[-1])
    segment = np.clip(np.searchsorted(curve.time, t, side="right") - 1, 0, len(curve.coefficients) - 1)
    rows = curve.coefficients[segment]  # (k, degree + 1, n)
    s = (t - curve.time[segment])[:, None]
    position = rows[:, -1]
    for power in range(rows.shape[1] - 2, -1, -1):
        position = position * s + rows[:, power]
    return np.where((times >= curve.time[-1])[:, None], curve.end, position)


@dataclass(frozen=True, slots=True)
class LookaheadPlan:
    """State of the executor that the coming ticks follow from."""

    reference: Reference  # of this tick
    floor: object  # motion of the joints that no layer decides
    layers: tuple[MotionLayer, ...]
    tick: int
    changing: bool  # changes with every tick, even without a command
    stream: SetpointStream | None
    pace: float  # of the stream

    @property
    def way(self) -> tuple[object, ...]:
        """Identity of the path: while it compares equal, only time has gone on along it."""
        return (self.tick if self.changing else None, self.floor, *self.layers)

    def course(self, limits: JointLimits, times: Floats) -> Floats:
        """Return the positions (k, n), rad, at `times` (k,) s from now, without goals that wait.

        A stream, and the older paths beside it, make one step, and then come to rest.
        """
        if self.stream is not None:
            step = self.stream.follower.onwards(self.pace)
            return braking(choose(self.stream.joints, step, self._onwards), limits, times)
        way = braking(self.reference, limits, times)
        for layer in self.layers:
            there = along(layer.curve, layer.elapsed(self.tick) + times)
            way = there if layer.whole else np.where(layer.joints, there, way)
        return way

    def halting(
        self,
        joints: Ints,
        position: Floats,
        velocity: Floats | None,
        limits: JointLimits,
        period: float,
        times: Floats,
    ) -> Floats:
        """Return the positions (k, n), rad, if a setpoint (m,) of `joints` were accepted.

        The motion makes one step towards the setpoint, and then comes to rest.
        """
        moved = np.zeros(len(self.reference.position), np.bool_)
        moved[joints] = True
        stream = widened(self.stream, moved, self.reference, limits, period)
        stream.set_target(joints, position, velocity)
        return braking(choose(stream.joints, stream.follower.step(self.pace), self._onwards), limits, times)

    @property
    def _onwards(self) -> Reference:
        """The reference of the next tick, but for a stream: the motion could not brake from this one."""
        return overlay(self.reference, self.layers, self.tick + 1)
