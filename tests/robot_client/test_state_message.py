"""States of the robot: rows in joint order, NaN for unknown values, and which are too old to act on."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twind.robot_client.state_message import STALE, StateMessage, decode_state_message

JOINTS = ("hip", "knee")
IMU = {"gyro": [0.1, 0.2, 0.3], "acceleration": [0, 0, 9.8], "quaternion": [1, 0, 0, 0], "age_ms": 4.0}


def answer(**changed: Any) -> dict[str, Any]:
    rows = [
        {"name": name, "position": at, "velocity": 0.5, "goal": at, "age_ms": 3.0}
        for at, name in enumerate(JOINTS)
    ]
    return {"time": 10.0, "sequence": 7, "joints": rows, "imu": IMU} | changed


def state(**changed: Any) -> StateMessage:
    return decode_state_message(answer(**changed), 10.001, JOINTS)


def test_a_state_is_rows_in_joint_order() -> None:
    found = state()
    assert found.position.tolist() == [0.0, 1.0] and found.age.tolist() == [0.003, 0.003]
    assert found.inertial is not None and found.inertial.gyro.tolist() == [0.1, 0.2, 0.3]
    assert found.stale(10.005, STALE, JOINTS) is None


def test_other_joints_are_an_error() -> None:
    with pytest.raises(ValueError, match="other joints"):
        decode_state_message(answer(), 10.0, ("knee", "hip"))


def test_an_unknown_value_is_nan_and_infinitely_old() -> None:
    rows = answer()["joints"]
    rows[1] |= {"position": None, "age_ms": None}
    found = state(joints=rows)
    assert np.isnan(found.position[1]) and found.age[1] == np.inf


@pytest.mark.parametrize(
    ("changed", "now", "message"),
    [
        ({}, 9.999 + STALE, "hip was read 52 ms ago, bound 50 ms"),
        ({}, 10.0 + STALE + 0.001, "the state is 51 ms old"),
        ({}, 9.99, "the state is -10 ms old"),
        ({}, float("nan"), "the state is"),
        ({"imu": None}, 10.0, "no IMU"),
        ({"imu": IMU | {"age_ms": 60.0}}, 10.0, "the IMU was read 60 ms ago"),
        ({"imu": IMU | {"age_ms": None}}, 10.0, "the IMU has not been read yet"),
        ({"imu": IMU | {"gyro": [0.1, None, 0.0]}}, 10.0, "the IMU"),
        ({"imu": IMU | {"gyro": [0.1]}}, 10.0, "no IMU"),
        ({"imu": IMU | {"quaternion": [0, 0, 0, 0]}}, 10.0, "size 0.00"),
        ({"imu": IMU | {"quaternion": [2, 0, 0, 0]}}, 10.0, "size 2.00"),
    ],
)
def test_a_stale_or_unknown_value_is_reported(changed: dict[str, Any], now: float, message: str) -> None:
    assert message in str(state(**changed).stale(now, STALE, JOINTS))


@pytest.mark.parametrize("row", ["position", "velocity", "age"])
def test_an_unknown_joint_value_names_its_joint(row: str) -> None:
    found = state()
    values = getattr(found, row).copy()
    values[1] = np.nan
    said = replace(found, **{row: values}).stale(10.005, STALE, JOINTS)
    assert said.startswith("knee gave no numbers")
