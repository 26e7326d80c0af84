"""Every built-in robot: files without a finding, and motions that nothing refuses."""

from functools import cache

import numpy as np
import pytest

from tests.support.daemon_rig import known_robot
from twind.command_line.trajectory_files import load_motion
from twind.config.robot_file import built_in_robots
from twind.config.robot_report import check_robot
from twind.ctl.offline_check import motions_of, verdict
from twind.robot.trajectory import Trajectory
from twind.twin.binding import Binding, bind
from twind.twin.clearance_survey import survey
from twind.twin.settling_survey import survey_settling

ROBOTS = built_in_robots()
BESIDE_H24 = [name for name in ROBOTS if not name.startswith("h24")]  # tests/robot/test_h24.py has its own


@cache
def bound(name: str) -> Binding:
    return bind(known_robot(name), None)


@cache
def own_motions(name: str) -> dict[str, Trajectory]:
    found, wrong = motions_of(known_robot(name))
    assert wrong == []
    return found


def test_the_gallery_holds_arms_a_head_and_a_quadruped_beside_h24() -> None:
    assert BESIDE_H24 == ["koch", "pan-tilt", "quadruped12", "so101", "so101-leader"]
    assert [len(known_robot(name).joints) for name in BESIDE_H24] == [6, 2, 12, 6, 6]


@pytest.mark.parametrize("name", ROBOTS)
def test_files_have_no_finding_and_the_bus_carries_the_rate(name: str) -> None:
    robot = known_robot(name)
    report = check_robot(robot)
    assert report.errors == ()
    assert survey_settling(bound(name)) == ()


@pytest.mark.parametrize("name", BESIDE_H24)
def test_no_pose_and_no_motion_brings_bodies_near_each_other_or_to_the_floor(name: str) -> None:
    found = survey(bound(name), own_motions(name))
    assert (found.error, found.near) == (None, ())


@pytest.mark.parametrize("name", BESIDE_H24)
def test_own_motions_begin_and_end_at_rest_and_pass_the_gate(name: str) -> None:
    robot = known_robot(name)
    assert own_motions(name)
    for motion, path in own_motions(name).items():
        ends = (path.position - bound(name).rest)[[0, -1]][:, path.commanded]
        assert np.abs(ends).max() < 1e-9, motion
        found = verdict(bound(name), bound(name).rest, load_motion(motion, robot.motions))
        assert found == {"refusals": [], "warnings": [], "changes": []}, motion
