"""The offline check of a trajectory: the daemon's parts, at the rate of the robot."""

from dataclasses import replace

import pytest

from twind.config.robot_file import load_robot
from twind.ctl.offline_check import verdict
from twind.twin.binding import bind


@pytest.mark.parametrize(("rate_hz", "refused"), [(100.0, []), (20.0, ["POS_LIMIT"])])
def test_the_run_up_to_a_first_point_lasts_whole_ticks_of_the_robot(
    rate_hz: float, refused: list[str]
) -> None:
    """It goes back by a tenth of its time at the speed of the point: here 10 or 50 microradians."""
    binding = bind(replace(load_robot("h24"), rate_hz=rate_hz), None)
    joint = binding.joint_map.names.index("head_yaw")
    position = binding.rest.copy()
    position[joint] = first = float(binding.limits.lower[joint]) + 3e-5
    points = [
        {"positions": [first + 1e-6], "velocities": [0.01], "time_from_start": 0.0},
        {"positions": [first + 1e-4], "velocities": [0.0], "time_from_start": 0.02},
        {"positions": [first + 1e-4], "velocities": [0.0], "time_from_start": 1.0},
    ]
    found = verdict(binding, position, {"joint_names": ["head_yaw"], "points": points})
    assert [each["code"] for each in found["refusals"]] == refused
