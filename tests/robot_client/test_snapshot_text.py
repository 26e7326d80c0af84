"""A printed state is a table of the joints, not the message of the daemon; a wrong joint name is answered."""

import time

import numpy as np
import pytest

from twind.robot_client.snapshot import RobotSnapshot
from twind.robot_client.state_message import StateMessage

ROW = {"name": "hip", "position": 0.25, "velocity": 0.0, "effort": None, "goal": 0.3, "torque": True}
ROW |= {"temperature": 31.0, "voltage": 12.0, "age_ms": 4.0}


def snapshot() -> RobotSnapshot:
    one = np.array([0.25])
    message = StateMessage(
        time.monotonic(), time.monotonic(), 1, one, one, one, np.array([0.004]), None, [ROW]
    )
    return RobotSnapshot(("hip",), message)


def test_an_unknown_joint_of_a_state_is_answered_with_the_near_names() -> None:
    joints = snapshot().joints
    with pytest.raises(KeyError, match="no joint 'hop'; nearest: hip"):
        joints["hop"]
    assert joints["hip"].position == 0.25 and "hop" not in joints and joints.get("hop") is None


def test_a_printed_state_is_a_table_and_its_repr_a_line() -> None:
    state = snapshot()
    head, row = str(state).splitlines()
    assert head.split() == ["joint", "rad", "goal", "rad/s", "N·m", "age", "ms"]
    assert row.split()[:5] == ["hip", "0.250", "0.300", "0.00", "–"]
    assert repr(state).startswith("<RobotSnapshot of 1 joints at ")
    assert "\n" not in repr(state)
