"""A printed state is a table of the joints, not the message of the daemon."""

import time

import numpy as np

from twind.robot_client.snapshot import RobotSnapshot
from twind.robot_client.state_message import StateMessage

ROW = {"name": "hip", "position": 0.25, "velocity": 0.0, "effort": None, "goal": 0.3, "torque": True}
ROW |= {"temperature": 31.0, "voltage": 12.0, "age_ms": 4.0}


def test_a_printed_state_is_a_table_and_its_repr_a_line() -> None:
    one = np.array([0.25])
    message = StateMessage(
        time.monotonic(), time.monotonic(), 1, one, one, one, np.array([0.004]), None, [ROW]
    )
    state = RobotSnapshot(("hip",), message)
    head, row = str(state).splitlines()
    assert head.split() == ["joint", "rad", "goal", "rad/s", "N·m", "age", "ms"]
    assert row.split()[:5] == ["hip", "0.250", "0.300", "0.00", "–"]
    assert repr(state).startswith("<RobotSnapshot of 1 joints at ")
    assert "\n" not in repr(state)
