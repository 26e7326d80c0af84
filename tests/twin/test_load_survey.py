"""Largest torque at rest: near that of the worst pose, the same each time, unknown without bodies."""

from dataclasses import replace

import numpy as np

from tests.support.daemon_rig import known_binding
from twind.twin.dynamics import Dynamics
from twind.twin.load_survey import worst_load


def test_no_pose_of_the_robot_file_needs_more_and_the_result_repeats() -> None:
    binding = known_binding("h24").binding
    found = worst_load(binding)
    for pose in binding.robot.poses.values():
        held = np.abs(Dynamics(binding).at_rest(np.array([pose[name] for name in binding.robot.names])))
        assert (held <= found).all()
    assert np.array_equal(found, worst_load(binding))


def test_the_load_of_an_outstretched_arm_is_found() -> None:
    binding = known_binding("h24").binding
    names = binding.robot.names
    place = names.index("l_shoulder_pitch")
    out = np.zeros(len(names))
    out[place] = np.pi / 2
    straight = abs(Dynamics(binding).at_rest(out)[place])
    assert 0.9 * straight < worst_load(binding)[place] < 1.2 * straight


def test_a_robot_without_bodies_has_no_known_load() -> None:
    binding = known_binding("h24").binding
    robot = binding.robot
    gate = replace(robot.gate, collision=replace(robot.gate.collision, bodiless=True))
    assert np.isnan(worst_load(replace(binding, robot=replace(robot, gate=gate)))).all()
