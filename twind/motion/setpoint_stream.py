"""Setpoints of some joints, followed until none has come for too long (STREAM_STALE)."""

from math import inf

import numpy as np

from twind.motion.stop_profiles import LimitedFollower
from twind.robot.arrays import Bools, Floats, Ints, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference

LATE = 0.01  # rad behind its setpoint, beyond the way to stop, from which a joint is reported


class SetpointStream:
    """Stream of setpoints for `joints` (n,), which `follower` pursues."""

    def __init__(self, follower: LimitedFollower, joints: Bools) -> None:
        self.follower = follower
        self.joints = joints
        self._valid_for = 0.0  # s
        self._used_at = inf  # s, the first tick that used the newest setpoint
        # (n,) each: of the newest setpoint of each joint; inf: none that a tick has used and still counts
        self._joint_valid_for, self._joint_used_at = np.full((2, len(joints)), inf)
        self._named = np.zeros(len(joints), np.bool_)  # by setpoints that no tick has used yet
        self._base = follower.target.copy()  # rad, (n,), the setpoint of `_ticks` ticks ago
        self._ticks = 1
        # rad/s, (n,): from that setpoint to the newest one, and the most of it since a joint is late
        self._asked, self._fastest = np.zeros((2, len(joints)))

    def set_target(
        self, joints: Ints, position: Floats, velocity: Floats | None, valid_for: float = inf
    ) -> None:
        """Follow `position` (m,), rad, for `valid_for` s; it moves by itself with `velocity` (m,), rad/s."""
        self.follower.set_joint_targets(joints, position, 0.0 if velocity is None else velocity)
        self._named[joints] = True
        self._joint_valid_for[joints] = valid_for
        if self._ticks:
            target = self.follower.target
            self._asked = np.abs(target - self._base) / (self._ticks * self.follower.period)
            self._base = target.copy()
            self._ticks = 0
        self._valid_for = valid_for
        self._used_at = inf

    def continue_ages(self, other: "SetpointStream") -> None:
        """Count the setpoints of `other`, which this stream takes the place of, on from their ages."""
        self._joint_valid_for = other._joint_valid_for.copy()
        self._joint_used_at = other._joint_used_at.copy()
        self._named = other._named.copy()

    def behind(self) -> tuple[Floats, tuple[Finding, ...]]:
        """Return how far joints (n,) are behind the newest setpoint, rad, and a finding for each late one.

        LEAD_LIMIT: its joint does not follow. VEL_LIMIT: its setpoints were too fast since it is late, else
        ACC_LIMIT. Before the first tick that
        uses the setpoint nothing is late.
        """
        behind, stopping, fastest = self.follower.lag()
        late = self.joints & (behind > stopping + LATE) & (self._used_at < inf)
        self._fastest = np.where(late, np.maximum(self._fastest, self._asked), 0.0)
        found = []
        for joint in np.flatnonzero(late).tolist():
            asked = float(self._fastest[joint])
            bound = float(fastest[joint])
            message = f"followed late: {behind[joint]:.3g} rad behind the setpoint before"
            if self.follower.is_fenced(joint):
                finding = Finding(
                    ReasonCode.LEAD_LIMIT, joint, message=f"{message}: its joint does not follow"
                )
            elif asked > bound:
                finding = Finding(ReasonCode.VEL_LIMIT, joint, value=asked, bound=bound, message=message)
            else:
                most = float(self.follower.acceleration[joint])
                finding = Finding(ReasonCode.ACC_LIMIT, joint, bound=most, message=message)
            found.append(finding)
        return behind, tuple(found)

    def age(self, now: float) -> float:
        """Return the age of the newest setpoint (s), counted from the first tick that could use it."""
        return 0.0 if self._used_at == inf else now - self._used_at

    def use(self, now: float) -> Finding | None:
        """Begin or continue the age of the newest setpoint; return STREAM_STALE when it is too old.

        A joint whose own setpoint is too old, as newer ones name others, brakes and holds.
        """
        if self._used_at == inf:
            self._used_at = now
            self._joint_used_at[self._named] = now
            self._named[:] = False
        self._ticks += 1
        age = now - self._used_at
        if age <= self._valid_for:
            left = now - self._joint_used_at > self._joint_valid_for
            if some(left):
                self.follower.halt(left)
                self._joint_used_at[left] = inf
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
    wide = SetpointStream(follower, joints | stream.joints)
    wide.continue_ages(stream)
    return wide
