"""Answers of the daemon become messages of a recording."""

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.sample_recordings import CLOCKS, JOINTS, event, joint, state, status
from twind.client.clock_pair import STEP, ClockPair
from twind.observe.writing.record_encoder import RecordEncoder, RecordLine, note, shifted
from twind.observe.writing.record_schemas import ROS, json_schemas
from twind.protocol import CONTROL, load
from twind.ros import IMU, JOINT_STATE, JOINT_TRAJECTORY, decode, stamp


def encoded_lines(*answers: dict[str, Any], mode: str = "live") -> list[RecordLine]:
    scribe = RecordEncoder(JOINTS, CLOCKS, mode)
    return [line for answer in answers for line in scribe.take(answer)]


def test_a_state_is_what_was_measured_the_goals_and_the_simulation_all_of_one_moment() -> None:
    lines = encoded_lines(state(101.5, goal=0.25, simulated=-0.5))
    assert [line.topic for line in lines] == [
        "/hw/joint_states",
        "/hw/joint_commands",
        "/sim/joint_states",
        "/twind/joints",
    ]
    assert {line.time_ns for line in lines} == {CLOCKS.wall_ns + 1_500_000_000}
    messages = [decode(JOINT_STATE, line.data) for line in lines[:3]]
    assert messages[0]["position"] == [math.sin(101.5), math.sin(102.5)]
    assert messages[0]["velocity"] == [0.5, 0.5] and all(math.isnan(each) for each in messages[0]["effort"])
    assert [each["position"] for each in messages[1:]] == [[0.25, 0.25], [-0.5, -0.5]]
    for line, message in zip(lines[:3], messages, strict=True):
        assert message["name"] == list(JOINTS) and message["header"]["stamp"] == stamp(line.time_ns)


def test_a_state_without_positions_has_no_ros_message_and_an_unknown_joint_is_nan() -> None:
    nothing = {"topic": "state", "time": 1.0, "joints": [joint(name, None) for name in JOINTS]}
    assert [line.topic for line in encoded_lines(nothing)] == ["/twind/joints"]
    half = {"topic": "state", "time": 1.0, "joints": [joint("hip", 1.0), joint("knee", None, velocity=None)]}
    message = decode(JOINT_STATE, encoded_lines(half)[0].data)
    assert message["position"][0] == 1.0 and math.isnan(message["position"][1])
    assert math.isnan(message["velocity"][1])


def test_in_sim_there_is_no_robot_that_was_measured() -> None:
    live = "/hw/joint_states"
    assert live not in [line.topic for line in encoded_lines(state(1.0), mode="sim")]
    switched = encoded_lines(status(1.0, "sim"), state(1.1), status(1.2, "mirror"), state(1.3))
    assert [line.time_ns for line in switched if line.topic == live] == [CLOCKS.wall(1.3)]


def test_a_reading_is_of_the_mode_that_it_names_before_any_status_reports_it() -> None:
    live = "/hw/joint_states"
    assert live not in [line.topic for line in encoded_lines(state(1.0) | {"mode": "sim"}, mode="live")]
    assert live in [line.topic for line in encoded_lines(state(1.0) | {"mode": "live"}, mode="sim")]


def test_slow_joint_values_are_recorded_twice_a_second() -> None:
    lines = encoded_lines(*(state(100.0 + place / 100.0) for place in range(300)))
    assert len([line for line in lines if line.topic == "/twind/joints"]) == 6


def test_an_annotated_event_carries_its_annotation() -> None:
    plain, marked = encoded_lines(event(1.0, "ESTOP"), event(2.0, "NOTE", {"kind": "note", "text": "x"}))
    assert plain.mark is None and marked.mark == {"kind": "note", "text": "x"}
    assert json.loads(marked.data)["annotation"] == marked.mark


def test_a_trajectory_is_stamped_with_its_start_and_named_by_its_frame() -> None:
    point = {"positions": [0.1], "velocities": [0.0], "time_from_start": 0.3}
    path = {"joint_names": ["knee"], "points": [point], "start_in": 0.5}
    answer = {
        "topic": "trajectories",
        "time": 102.0,
        "accepted": {"id": "7f", "holder": "x", "trajectory": path},
    }
    (line,) = encoded_lines(answer)
    message = decode(JOINT_TRAJECTORY, line.data)
    assert message["header"] == {"stamp": stamp(CLOCKS.wall(102.5)), "frame_id": "7f"}
    (kept,) = message["points"]
    assert kept["positions"] == [0.1] and kept["velocities"] == [0.0] and kept["accelerations"] == []
    assert kept["time_from_start"] == {"sec": 0, "nanosec": 300_000_000}


@pytest.mark.parametrize("by", [-(10**19), 10**19])
def test_a_clock_that_is_centuries_off_makes_a_stamp_at_the_end_of_what_there_is(by: int) -> None:
    (line, *_) = RecordEncoder(JOINTS, CLOCKS).take(state(100.0))
    found = decode(JOINT_STATE, shifted(line, by).data)["header"]["stamp"]
    assert found["sec"] == (0 if by < 0 else (1 << 31) - 1)


def test_every_topic_has_a_type_or_a_schema_with_the_fields_of_the_interface() -> None:
    schemas = {topic: json.loads(text) for topic, text in json_schemas().items()}
    assert not schemas.keys() & ROS.keys()
    types: Any = load(CONTROL).types
    assert schemas["/twind/status"]["properties"].keys() == types["Status"].fields.keys()
    assert schemas["/twind/events"]["properties"].keys() == types["Event"].fields.keys()
    hop = schemas["/twind/latency"]["properties"]["hops"]["items"]["properties"]
    assert hop.keys() == types["Latency"].fields.keys() and hop["violations"] == {"type": "integer"}
    assert all(schema["type"] == "object" for schema in schemas.values())


@given(st.floats(0, 1e7), st.integers(0, 1 << 61), st.integers(-(10**12), 10**12))
def test_a_clock_that_was_set_is_a_step_and_one_that_runs_on_is_none(
    later: float, wall: int, jump: int
) -> None:
    began = ClockPair(1000.0, wall)
    now = ClockPair(1000.0 + later, began.wall(1000.0 + later) + jump)
    assert began.step(now) == (jump if abs(jump) > STEP else 0)


def test_a_note_is_of_the_moment_it_was_made() -> None:
    line = note(CLOCKS, 101.0, "clock_step", wall_ns=5, monotonic=101.0)
    assert line.time_ns == CLOCKS.wall_ns + 10**9
    assert json.loads(line.data) == {"kind": "clock_step", "wall_ns": 5, "monotonic": 101.0}


def imu_state(time: float, age: float) -> dict[str, Any]:
    numbers = {"gyro": [0.1, 0.2, 0.3], "acceleration": [1.0, 2.0, 9.0], "quaternion": [0.5, -0.5, 0.5, -0.5]}
    return state(time) | {"imu": numbers | {"age_ms": age}}


def test_an_imu_reading_becomes_a_ros_imu_message_in_ros_order() -> None:
    (line,) = [line for line in encoded_lines(imu_state(101.5, 2.0)) if line.topic == "/imu"]
    message = decode(IMU, line.data)
    assert message["header"] == {"stamp": stamp(line.time_ns), "frame_id": "base"}
    assert message["angular_velocity"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert message["linear_acceleration"] == {"x": 1.0, "y": 2.0, "z": 9.0}
    assert message["orientation"] == {"w": 0.5, "x": -0.5, "y": 0.5, "z": -0.5}
    assert not any(message["orientation_covariance"])


def test_a_silent_imu_is_not_written_again_with_a_new_stamp() -> None:
    lines = encoded_lines(
        *(imu_state(100.0 + tick / 100, 10.0 * tick + 0.3 * (tick % 2)) for tick in range(50))
    )
    assert len([line for line in lines if line.topic == "/imu"]) == 1
    assert not [line for line in encoded_lines(state(100.0)) if line.topic == "/imu"]
