"""A JointTrajectory of ROS becomes a trajectory of the daemon, or is refused with the reason."""

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.ros_trajectory_messages import NOW, command, point
from twind.bridge.ros.ros_commands import MORE
from twind.bridge.ros.ros_trajectory import (
    AHEAD,
    FRAME,
    FRONT,
    LONGEST,
    NUMBERS,
    POINTS,
    CommandHeader,
    heading,
    trajectory,
)
from twind.client import Refused
from twind.front.front_server import LIMITS
from twind.ros import stamp
from twind.ros.cdr import CdrReader
from twind.ros.joint_state_message import SECOND

DAY = 86_400 * SECOND


def code_of(data: bytes) -> str:
    with pytest.raises(Refused) as refused:
        trajectory(data, NOW)
    return str(refused.value.findings[0]["code"])


def test_stamp_zero_is_now_and_empty_columns_are_left_out() -> None:
    found = trajectory(command(point(1.0), point(2.0, velocities=[0.25])), NOW)
    first = {"positions": [0.5], "time_from_start": 1.0}
    second = {"positions": [0.5], "velocities": [0.25], "time_from_start": 2.0}
    assert found == {"joint_names": ["l_knee"], "points": [first, second], "start_in": 0.0}


def test_a_future_stamp_waits_and_one_too_far_ahead_names_the_clock() -> None:
    assert trajectory(command(point(1.0), when=NOW + 2 * SECOND), NOW)["start_in"] == 2.0
    assert code_of(command(point(1.0), when=NOW + round(AHEAD * SECOND) + 1)) == "TOO_DISTANT"
    with pytest.raises(Refused, match=r"86400.000 s ahead of the robot's clock.*stamp 0 means now"):
        trajectory(command(point(1.0), when=NOW + DAY), NOW)


def test_past_points_of_a_past_stamp_are_dropped_and_a_fully_past_command_is_refused() -> None:
    points = [point(1.0, [0.1]), point(2.0, [0.2]), point(3.0, [0.3])]
    found = trajectory(command(*points, when=NOW - 2 * SECOND), NOW)
    assert found["start_in"] == 0.0
    assert found["points"] == [{"positions": [0.3], "time_from_start": 1.0}]
    assert code_of(command(*points, when=NOW - 3 * SECOND)) == "CMD_EXPIRED"
    with pytest.raises(Refused, match=r"86397\.000 s in the past"):
        trajectory(command(*points, when=NOW - DAY), NOW)


@given(
    st.lists(st.integers(1, 5 * SECOND), min_size=1, max_size=6, unique=True).map(sorted),
    st.integers(0, 6 * SECOND),
)
def test_remaining_points_of_a_past_command_keep_their_own_times(times: list[int], late: int) -> None:
    points = [point(0.0) | {"time_from_start": stamp(time)} for time in times]
    try:
        found = trajectory(command(*points, when=NOW - late), NOW)
    except Refused:
        assert times[-1] <= late
        return
    left = [time for time in times if time > late]
    assert [each["time_from_start"] for each in found["points"]] == pytest.approx(
        [(time - late) / SECOND for time in left], abs=1e-6
    )


def test_a_past_command_with_unordered_times_is_refused() -> None:
    assert code_of(command(point(2.0), point(1.0), when=NOW - SECOND)) == "TIME_ORDER"
    assert code_of(command(point(-1.0), point(5.0), when=NOW - SECOND)) == "TIME_ORDER"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("column", ["positions", "velocities", "accelerations"])
def test_a_number_that_is_none_is_named(column: str, value: float) -> None:
    row = {"positions": [0.1, 0.2], column: [0.0, value]}
    with pytest.raises(Refused, match=rf"r_knee, point 1: {column} is {value}"):
        trajectory(command(point(1.0, [0.1, 0.2]), point(2.0, **row), joints=("l_knee", "r_knee")), NOW)


def test_efforts_are_refused_and_not_dropped_in_silence() -> None:
    assert code_of(command(point(1.0, effort=[1.0]))) == "BAD_SHAPE"


def test_bytes_that_are_no_command_are_refused_with_what_is_wrong() -> None:
    whole = command(point(1.0), joints=("l_knee", "r_knee"))
    for end in range(len(whole)):
        assert code_of(whole[:end]) == "BAD_SCHEMA"


@given(st.binary(max_size=200))
def test_no_bytes_break_it(data: bytes) -> None:
    for each in (data, b"\x00\x01\x00\x00" + data):
        assert heading(each) is None or isinstance(heading(each), CommandHeader)
        with contextlib.suppress(Refused):
            trajectory(each, NOW)


def test_a_command_too_large_for_the_socket_is_refused_before_it_is_decoded() -> None:
    assert code_of(bytes(LONGEST + 1)) == "FRAME_TOO_LARGE"
    wide = [point(float(place), [0.1] * 80) for place in range(2000)]
    data = command(*wide)
    assert len(data) <= LONGEST
    assert code_of(data) == "FRAME_TOO_LARGE"


def test_the_heading_is_read_without_the_rest() -> None:
    data = command(point(1.0), when=NOW, joints=("a", "b"), frame="mine")
    head = heading(data)
    assert head == CommandHeader(*divmod(NOW, SECOND), "mine", ("a", "b")) and head.time_ns == NOW
    assert heading(data[:20]) is None
    assert heading(data[:30]) == CommandHeader(*divmod(NOW, SECOND), "mine")


def test_the_header_of_a_command_is_read_without_decoding_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    read = list[str]()
    text = CdrReader.text
    monkeypatch.setattr(CdrReader, "text", lambda source: (read.append(""), text(source))[1])
    many = command(point(1.0), joints=[""] * 500_000, frame="mine", when=NOW)
    assert heading(many) == CommandHeader(*divmod(NOW, SECOND), "mine")
    assert len(read) <= FRONT // 4
    read.clear()
    assert code_of(many[:LONGEST]) == "FRAME_TOO_LARGE" and len(read) <= FRONT // 4
    assert heading(command(joints=["a" * 1_000_000], frame="mine")) == CommandHeader(frame="mine")
    assert heading(command(frame="x" * 5000)) == CommandHeader(0, 0, "x" * FRAME, ("l_knee",))
    assert heading(command(frame="x" * 1_000_000)) is None


def test_empty_points_beyond_the_gate_limit_are_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    many = command(*[point(place / 1000.0, []) for place in range(POINTS + 1)])
    monkeypatch.setattr("twind.bridge.ros.ros_trajectory.decode", None)
    assert code_of(many) == "FRAME_TOO_LARGE"


def test_names_that_grow_as_json_are_refused_before_the_socket_would_hang_up() -> None:
    assert code_of(command(point(1.0), joints=["\x01" * 1_000_000])) == "FRAME_TOO_LARGE"


def test_the_longest_that_passes_is_one_that_the_socket_takes() -> None:
    row = [-2.2250738585072014e-308] * (NUMBERS // POINTS)
    names = ["\x01" * 100] * 150
    points = [point(1e6 + place + 0.123456789, row) for place in range(POINTS)]
    asked = trajectory(command(*points, joints=names), NOW)
    assert len(json.dumps(asked)) + MORE < LIMITS["operator"]
