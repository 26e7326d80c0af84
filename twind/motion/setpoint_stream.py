"""Setpoints of some joints, followed until none has come for too long (STREAM_STALE)."""

from math import inf

import numpy as np

from twind.motion.stop_profiles import LimitedFollower
from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference


class SetpointStream:
    """Stream of setpoints for `joints` (n,), which `follower` pursues."""

    def __init__(self, follower: LimitedFollower, joints: Bools) -> None:
        self.follower = follower
        self.joints = joints
        self._valid_for = 0.0  # s
        self._used_at = inf  # s, the first tick that used the newest setpoint

    def set_target(
        self, joints: Ints, position: Floats, velocity: Floats | None, valid_for: float = inf
    ) -> None:
        """Follow `position` (m,), rad, for `valid_for` s; it moves by itself with `velocity` (m,), rad/s."""
        self.follower.set_joint_targets(joints, position, 0.0 if velocity is None else velocity)
        self._valid_for = valid_for
        self._used_at = inf

    def age(self, now: float) -> float:
        """Return the age of the newest setpoint (s), counted from the first tick that could use it."""
        return 0.0 if self._used_at == inf else now - self._used_at

    def use(self, now: float) -> Finding | None:
        """Begin or continue the age of the newest setpoint; return STREAM_STALE when it is too old."""
        if self._used_at == inf:
            self._used_at = now
        age = now - self._used_at
        if age <= self._valid_for:
            return None
        message = "no newer setpoint: holding"
        return Finding(ReasonCode.STREAM_STALE, value=age, bound=self._valid_for, message=message)


def widened(
    stream: SetpointStream | None, joints: Bools, reference: Reference, limits: JointLimits, period: float
) -> SetpointStream:
    """Return a stream of `joints` (n,) from `reference` on, with the joints and targets of `stream` too."""
    follower = LimitedFollower(reference, limits, period)
    if stream is None:
        return SetpointStream(follower, joints)
    follower.set_target(
        np.where(stream.joints, stream.follower.target, follower.target),
        np.where(stream.joints, stream.follower.drift, 0.0),
    )
    return SetpointStream(follower, joints | stream.joints)
