"""Joints have one order; names are for the edges, and a wrong one is answered with the right ones."""

import numpy as np
import pytest

from tests.support.two_bus_rig import JOINTS
from twind.robot.joint_map import JointMap

NAMES = ("l_hip_yaw", "l_hip_roll", "l_knee", "r_hip_yaw", "r_knee", "head_pan")
ROBOT = JointMap(NAMES, (), (True,) * 6)


def test_every_name_has_its_place_in_the_order() -> None:
    assert [ROBOT.place(name) for name in NAMES] == list(range(6))
    assert len(ROBOT) == 6


def test_a_misspelt_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(KeyError, match="no joint 'l_kne'; nearest: l_knee, r_knee"):
        ROBOT.place("l_kne")


@pytest.mark.parametrize("name", ["", "xyz", "L_KNEE" * 9])
def test_a_name_like_no_other_is_answered_with_the_first_joints(name: str) -> None:
    with pytest.raises(KeyError, match="the joints are l_hip_yaw, l_hip_roll, l_knee and 3 more"):
        ROBOT.place(name)


def test_every_joint_is_on_exactly_one_bus() -> None:
    places = [int(place) for bus in JOINTS.buses for place in bus.joints]
    assert sorted(places) == list(range(len(JOINTS)))


def test_the_joints_of_a_bus_are_found_by_its_name() -> None:
    found = [JOINTS.on_bus(bus.name) for bus in JOINTS.buses]
    assert [np.flatnonzero(joints).tolist() for joints in found] == [
        sorted(bus.joints.tolist()) for bus in JOINTS.buses
    ]
    assert not JOINTS.on_bus("none").any()
