"""Conditions of an identification that its model records."""

from twind.config.hot_changes import applied
from twind.config.identified_spec import IdentifiedJoint, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.identification.identified_robot import with_p_gains

JOINT = IdentifiedJoint(stiffness_nm_per_rad=ParameterEstimate(5.0, 0.5, 6.0, 1.5))


def test_each_identified_joint_records_the_p_gain_that_its_stiffness_refers_to() -> None:
    plain = load_robot("so101")
    kind = plain.joints[0].type.name
    robot = applied(plain, {f"types.{kind}.gains": {"p": 24, "i": 0, "d": 32}})
    name = plain.names[0]
    found = with_p_gains(robot, {name: JOINT})[name]
    assert found.p_gain == 24.0
    doubled = found.at_gain(48.0).stiffness_nm_per_rad
    assert doubled == ParameterEstimate(10.0, 1.0, 12.0, 3.0)
    assert with_p_gains(plain, {name: JOINT})[name].p_gain == plain.joints[0].type.p_gain
