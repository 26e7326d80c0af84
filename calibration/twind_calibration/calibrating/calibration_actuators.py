"""The actuators of a robot file, in joint order: what each is called, where it is, how far it should go."""

from dataclasses import dataclass

from twind.config.counts import rad_per_tick, turn_start
from twind.config.robot_spec import JointSpec, RobotFile


@dataclass(frozen=True, slots=True)
class CalibrationActuator:
    """One actuator. Angles (rad) are after its sign and ratio: of its joint, if none is between."""

    name: str  # of the actuator: the joint's, unless a transmission is between them
    joint: JointSpec
    lower: float  # rad, as described
    upper: float
    is_open: bool = False  # nobody knows its limits yet: its travel is measured, not compared

    @property
    def range(self) -> float:
        """Rad that it should go from end to end."""
        return self.joint.reach

    @property
    def rad_per_tick(self) -> float:
        """Signed."""
        return rad_per_tick(self.joint)

    @property
    def start(self) -> int:
        """The first count of the turn that its encoder wakes up in, without a homing offset."""
        return turn_start(self.joint.type)

    def ticks(self, radians: float) -> int:
        """So many as that angle is, rounded, without sign."""
        return round(abs(radians / self.rad_per_tick))


def slots(robot: RobotFile) -> tuple[CalibrationActuator, ...]:
    """Every actuator, in joint order."""
    return tuple(
        CalibrationActuator(
            joint.actuator, joint, *joint.span, is_open=f"joints.{joint.name}.limits_rad" in robot.todo
        )
        for joint in robot.joints
    )
