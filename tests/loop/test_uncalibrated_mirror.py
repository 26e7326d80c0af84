"""A mirror of a robot that nobody has calibrated: its readings may be whole turns beyond every limit."""

import numpy as np

from tests.support.daemon_rig import MakeRig
from twind.loop.tick.bound_robot import BoundRobot
from twind.robot.modes import Mode
from twind.twin.binding import bind
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth

WOUND = ("head_yaw", "l_shoulder_yaw", "r_hip_yaw", "l_ankle_roll", "r_knee")


def test_the_simulation_begins_inside_the_limits_and_stays_sound(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR, truth=RobotGroundTruth(dict.fromkeys(WOUND, JointGroundTruth(turns=3))))
    rig.loop.close()
    rig.one = BoundRobot(rig.robot, None, bind(rig.robot, None))
    rig.loop = rig.born(Mode.MIRROR)
    rig.connect()
    rig.seconds(1.0)
    loop = rig.loop
    limits = rig.loop.robot.limits
    beyond = np.abs(
        loop.robot.measured.position - np.clip(loop.robot.measured.position, limits.lower, limits.upper)
    )
    assert beyond.max() > 15.0
    assert loop.parts.twin.resets == 0
    assert (loop.robot.simulated.position > limits.hard_lower - 0.05).all()
    assert (loop.robot.simulated.position < limits.hard_upper + 0.05).all()
