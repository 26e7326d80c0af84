"""Messages of the robot's state for ROS: fresh values alone, stamped with the time of their reading."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tests.support.picture_messages import NAMES, joint, joints
from twind.bridge.ros.robot_model_messages import SHAPES, RobotModelMessages
from twind.bridge.ros.ros_endpoints import (
    ACCEPTED,
    DYNAMIC_JOINTS,
    HW_JOINTS,
    INERTIAL,
    JOINTS,
    MIRRORED_JOINTS,
    MOVING_FRAMES,
    SIM_JOINTS,
    SIM_TIME,
    RosTopic,
)
from twind.bridge.ros.ros_state_messages import Message, RosStateMessages
from twind.client.clock_pair import SECOND, ClockPair
from twind.ros import JOINT_STATE, JOINT_TRAJECTORY, decode, stamp
from twind.ros.joint_state_message import LAST

CLOCKS = ClockPair(100.0, 1_795_000_000_000_000_000)
STORE = get_typestore(Stores.ROS2_JAZZY)


def state(rows: list[dict[str, Any]], time: float = 101.0, mode: str = "live", **more: Any) -> dict[str, Any]:
    return {"topic": "state", "time": time, "dropped": 0, "joints": rows, "mode": mode, **more}


def decoded_messages(messages: list[Message]) -> dict[RosTopic, dict[str, Any]]:
    assert len({topic for topic, _ in messages}) == len(messages)
    return {topic: decode(topic.kind, data) for topic, data in messages}


def bridged(connected: bool, mode: str) -> RosStateMessages:
    speech = RosStateMessages()
    speech.status({"mode": mode, "hw_connected": connected})
    return speech


def test_a_joint_without_a_fresh_reading_is_in_no_message() -> None:
    rows = joints(l_knee={"heard": False, "age_ms": 40.0}, head_yaw={"position": None})
    found = decoded_messages(bridged(True, "live").state(state(rows), CLOCKS))
    measured = found[HW_JOINTS]
    assert set(NAMES) - set(measured["name"]) == {"l_knee", "head_yaw"}
    assert measured == found[JOINTS]
    rows_by_name = {row["name"]: row for row in rows}
    assert measured["position"] == [rows_by_name[name]["position"] for name in measured["name"]]


@given(st.lists(st.booleans(), min_size=24, max_size=24), st.floats(0.0, 30.0))
def test_fresh_joints_are_published_with_the_stamp_of_the_newest_reading(
    fresh: list[bool], age: float
) -> None:
    rows = [
        joint(name, place, heard=told, age_ms=age)
        for place, (name, told) in enumerate(zip(NAMES, fresh, strict=True))
    ]
    found = decoded_messages(bridged(True, "live").state(state(rows), CLOCKS))
    assert (HW_JOINTS in found) == any(fresh)
    if any(fresh):
        assert found[HW_JOINTS]["name"] == [name for name, told in zip(NAMES, fresh, strict=True) if told]
        assert found[HW_JOINTS]["header"]["stamp"] == stamp(CLOCKS.wall(101.0 - age / 1e3))


@pytest.mark.parametrize("connected", [False, True])
@pytest.mark.parametrize(
    ("mode", "simulated"), [("sim", SIM_JOINTS), ("mirror", MIRRORED_JOINTS), ("live", SIM_JOINTS)]
)
def test_each_mode_publishes_simulated_and_measured_joints_on_separate_topics(
    mode: str, simulated: RosTopic, connected: bool
) -> None:
    rows = joints() if connected or mode == "sim" else joints(**{name: {"heard": False} for name in NAMES})
    found = decoded_messages(bridged(connected, mode).state(state(rows, mode=mode), CLOCKS))
    assert {SIM_JOINTS, MIRRORED_JOINTS} & set(found) == {simulated}
    assert (HW_JOINTS in found) == (connected and mode != "sim")
    if mode == "live":  # a simulation never passes for a robot that moves
        assert found.get(JOINTS) == found.get(HW_JOINTS)
    else:
        assert found[JOINTS] == found[HW_JOINTS if HW_JOINTS in found else simulated]


def test_the_mode_of_a_state_message_is_that_of_its_reading() -> None:
    speech = bridged(True, "live")
    assert HW_JOINTS not in decoded_messages(speech.state(state(joints(), mode="sim"), CLOCKS))
    assert MIRRORED_JOINTS in decoded_messages(speech.state(state(joints(), mode="mirror"), CLOCKS))
    older = state(joints())
    del older["mode"]  # a daemon that does not say it
    assert HW_JOINTS in decoded_messages(speech.state(older, CLOCKS))


def test_an_unknown_value_is_nan_and_a_column_without_values_is_empty() -> None:
    rows = [joint("a", 0, effort=None), joint("b", 1, velocity=None, effort=None)]
    measured = decoded_messages(bridged(True, "live").state(state(rows), CLOCKS))[HW_JOINTS]
    assert measured["effort"] == []
    assert measured["velocity"][0] == 0.25 and math.isnan(measured["velocity"][1])


def test_dynamic_joint_states_have_each_interface_with_a_value() -> None:
    rows = joints(l_knee={"temperature": None, "voltage": None, "effort": None})
    found = decoded_messages(bridged(True, "live").state(state(rows), CLOCKS))
    dynamic = found[DYNAMIC_JOINTS]
    assert dynamic["header"] == found[JOINTS]["header"]
    assert dynamic["joint_names"] == list(NAMES)
    by_name = dict(zip(NAMES, dynamic["interface_values"], strict=True))
    assert by_name["head_yaw"] == {
        "interface_names": ["position", "velocity", "effort", "temperature", "voltage"],
        "values": [0.0, 0.25, -0.5, 41.0, 11.9],
    }
    assert [math.isnan(each) for each in by_name["l_knee"]["values"]] == [False, False, True, True, True]
    simulated = decoded_messages(bridged(True, "sim").state(state(rows, mode="sim"), CLOCKS))[DYNAMIC_JOINTS]
    assert simulated["interface_values"][0]["interface_names"] == ["position"]


def test_the_clock_is_published_in_sim_alone_with_the_stamp_of_the_joints() -> None:
    found = decoded_messages(bridged(True, "sim").state(state(joints(), mode="sim"), CLOCKS))
    assert found[SIM_TIME]["clock"] == found[JOINTS]["header"]["stamp"]
    for mode in ("mirror", "live"):
        messages = bridged(True, mode).state(state(joints(), mode=mode), CLOCKS)
        assert SIM_TIME not in decoded_messages(messages)


def test_transforms_are_those_of_the_joints_that_answered() -> None:
    speech = bridged(True, "live")
    rows = joints(l_knee={"heard": False})
    assert MOVING_FRAMES not in decoded_messages(speech.state(state(rows), CLOCKS))
    table = [
        {"parent": "base", "child": name, "position": [0.0, 0.0, 1.0], "rotation": [1.0, 0.0, 0.0, 0.0]}
        | {"kind": "revolute", "axis": [0.0, 0.0, 1.0], "leader": name, "multiplier": 1.0, "offset": 0.0}
        for name in NAMES
    ]
    speech.description = RobotModelMessages("", table)
    found = decoded_messages(speech.state(state(rows), CLOCKS))
    transforms = found[MOVING_FRAMES]["transforms"]
    assert [each["child_frame_id"] for each in transforms] == found[JOINTS]["name"]
    assert {each["header"]["stamp"]["nanosec"] for each in transforms} == {
        found[JOINTS]["header"]["stamp"]["nanosec"]
    }
    turns = [2.0 * math.atan2(*(each["transform"]["rotation"][key] for key in "zw")) for each in transforms]
    assert turns == pytest.approx(found[JOINTS]["position"])


def test_rosbags_reads_the_same() -> None:
    (data,) = (
        data for topic, data in bridged(True, "live").state(state(joints()), CLOCKS) if topic is JOINTS
    )
    read: Any = STORE.deserialize_cdr(data, JOINT_STATE)
    assert read.name == list(NAMES) and read.position.tolist() == [row["position"] for row in joints()]


def test_a_clock_that_is_set_is_seen_in_the_next_stamp() -> None:
    speech = bridged(True, "live")
    day = 86_400 * SECOND
    first = decoded_messages(speech.state(state(joints()), CLOCKS))[JOINTS]["header"]["stamp"]
    other = ClockPair(CLOCKS.monotonic, CLOCKS.wall_ns - day)
    second = decoded_messages(speech.state(state(joints(), time=101.01), other))[JOINTS]["header"]["stamp"]
    assert first["sec"] - second["sec"] in (86_399, 86_400)


@pytest.mark.parametrize("wall", [-5 * SECOND, 2 * LAST])
def test_a_clock_beyond_all_stamps_is_the_first_or_the_last_stamp(wall: int) -> None:
    message = decoded_messages(bridged(True, "live").state(state(joints()), ClockPair(101.0, wall)))[JOINTS]
    assert message["header"]["stamp"] == stamp(min(max(wall, 0), LAST))


def test_an_imu_reading_is_published_once_with_its_own_stamp() -> None:
    speech = bridged(True, "live")
    imu = {"gyro": [1.0, 2.0, 3.0], "acceleration": [0.0, 0.0, 9.81], "quaternion": [1.0, 0.0, 0.0, 0.0]}
    first = decoded_messages(speech.state(state([], imu=imu | {"age_ms": 4.0}), CLOCKS))[INERTIAL]
    assert first["header"]["stamp"] == stamp(CLOCKS.wall(100.996))
    assert first["angular_velocity"] == {"x": 1.0, "y": 2.0, "z": 3.0} and first["orientation"]["w"] == 1.0
    assert INERTIAL not in decoded_messages(
        speech.state(state([], time=101.01, imu=imu | {"age_ms": 14.0}), CLOCKS)
    )
    assert INERTIAL in decoded_messages(
        speech.state(state([], time=101.02, imu=imu | {"age_ms": 4.0}), CLOCKS)
    )


def test_an_accepted_trajectory_is_published_with_its_start_as_stamp() -> None:
    points = [{"positions": [0.5], "velocities": [0.0], "time_from_start": 1.5}]
    path = {"joint_names": ["l_knee"], "points": points, "start_in": 2.0}
    answer = {"topic": "trajectories", "time": 101.0, "accepted": {"id": "x1", "trajectory": path}}
    ((topic, data),) = RosStateMessages().accepted(answer, CLOCKS)
    message = decode(JOINT_TRAJECTORY, data)
    assert topic is ACCEPTED and message["header"] == {"stamp": stamp(CLOCKS.wall(103.0)), "frame_id": "x1"}
    assert message["points"][0]["time_from_start"] == stamp(1_500_000_000)


def test_a_bus_that_loses_answers_costs_no_memory() -> None:
    speech = bridged(True, "live")
    for number in range(4 * SHAPES):
        rows = [joint(name, place, heard=bool(number >> place & 1)) for place, name in enumerate(NAMES[:8])]
        speech.state(state(rows), CLOCKS)
    assert len(speech.prepared) <= SHAPES
