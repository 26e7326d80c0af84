"""The robot that the loop controls: its description in force, its latest states, and its last goal.

Loop's process.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np

from twind.loop.tick.bound_robot import BoundRobot
from twind.motion.gravity_compensation import GravityCompensation
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits
from twind.robot.joint_map import JointMap
from twind.robot.joint_state import JointState
from twind.twin.collision_lookahead import CollisionLookahead
from twind.twin.torque_observer import ExternalTorqueObserver


@dataclass(frozen=True, slots=True)
class RobotInForce:
    """Description of a robot in joint order, as it is in force. A reload replaces it whole."""

    bound: BoundRobot  # source of the values below
    joints: JointMap
    limits: JointLimits
    ratings: ActuatorRatings
    rest: Floats  # rad, (n,)
    support: str
    period: float  # s, of a tick

    @classmethod
    def of(cls, bound: BoundRobot, period: float) -> RobotInForce:
        """Return the description of a bound robot for ticks of `period` s."""
        binding = bound.binding
        support = bound.file.support
        rest = np.array(binding.rest)
        return cls(bound, binding.joint_map, binding.limits, binding.ratings, rest, support, period)


class ControlledRobot:
    """Description in force, states of this tick, and the last goal that left."""

    def __init__(
        self,
        description: RobotInForce,
        outlook: CollisionLookahead | None,
        simulated: JointState,
        compensation: GravityCompensation | None = None,
        observer: ExternalTorqueObserver | None = None,
    ) -> None:
        """`outlook`: None where no two bodies can collide; `simulated`: where the simulation begins.

        `compensation`: None where goals have no offset; `observer`: None without an identified model.
        """
        self.description = description
        self.outlook = outlook
        self.compensation = compensation
        self.observer = observer
        self.measured = _never_read(len(description.joints), simulated.time)
        self.simulated = simulated
        self.written: Floats | None = None  # the last goal that was sent, rad (n,)
        self.untouched = True  # no motion was accepted yet

    def restart(self, written: Floats | None) -> None:
        """Set the last goal that was sent (n,), rad, from which commands go on without an offset."""
        self.written = written
        if self.compensation is not None:
            self.compensation.reset()

    @property
    def commanded(self) -> Floats | None:
        """The last goal that was sent, without its offset against gravity, rad (n,)."""
        if self.compensation is None or self.written is None:
            return self.written
        commanded: Floats = self.written - self.compensation.offset(self.written)
        return commanded

    @property
    def bound(self) -> BoundRobot:
        """Robot file, calibration and model."""
        return self.description.bound

    @property
    def joints(self) -> JointMap:
        """Joints, and their place on the buses."""
        return self.description.joints

    @property
    def limits(self) -> JointLimits:
        """Limits in force."""
        return self.description.limits

    @property
    def rest(self) -> Floats:
        """Rest pose (n,), rad."""
        return self.description.rest

    @property
    def support(self) -> str:
        """Support of the robot: fixed, gantry or free; any other value counts as free."""
        return self.description.support

    @property
    def carried(self) -> bool:
        """True where the robot falls no further than its own arms: support fixed or gantry."""
        return self.description.support in ("fixed", "gantry")

    @property
    def period(self) -> float:
        """Duration of a tick, s."""
        return self.description.period


def _never_read(count: int, now: float) -> JointState:
    """Return the state of joints that have not been read since `now` (s)."""
    unknown = np.full(count, nan)
    never = np.full(count, np.inf)
    return JointState(now, unknown, unknown.copy(), unknown.copy(), never, np.zeros(count, np.bool_), nan)
