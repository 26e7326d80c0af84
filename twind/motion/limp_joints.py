"""Joints without torque in the reference: they are where a hand takes them. Pure."""

from dataclasses import dataclass

from twind.motion.motion_layers import choose
from twind.motion.stop_profiles import CompliantFollower, still
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference


@dataclass(frozen=True, slots=True, eq=False)
class LimpJoints:
    """The limp `joints` (n,) and where they are, `place` (n,), rad."""

    joints: Bools
    place: Floats

    def follow(self, base: Reference, before: Reference, limits: JointLimits, period: float) -> Reference:
        """Return `base` with these joints one period on from `before` towards their place.

        Within speed, acceleration and hard limits.
        """
        follower = CompliantFollower(before, limits, period)
        follower.aim_at(self.joints, self.place)
        return choose(self.joints, follower.step(), base)

    def hold(self, base: Reference, here: Reference) -> Reference:
        """Return `base` with these joints at rest where they are in `here`: no path moves them on."""
        return choose(self.joints, still(here.position), base)
