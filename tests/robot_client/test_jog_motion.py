"""Slow motion of a held button: bounded in speed and step, through every limit of the robot file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.viewer_messages import h24
from twind.exceptions import InvalidInput
from twind.robot_client.jog_motion import (
    BEYOND,
    LONGEST_STEP,
    SPEED,
    STOPPING,
    JogMotion,
    JogRequest,
    jog_speed,
    joints_of,
    known_positions,
    plan_jog,
)

ROBOT = h24()["robot"]
HERE = {joint["name"]: 0.0 for joint in ROBOT["joints"]}


def test_a_joint_goes_to_just_beyond_its_limit_where_the_gate_refuses() -> None:
    motion = plan_jog(JogRequest("up", "head_yaw"), ROBOT, HERE)
    assert motion.names == ["head_yaw"]
    assert motion.target == pytest.approx([1.5 + BEYOND])
    positions, velocities = motion.advance(0.02)
    assert positions == pytest.approx([0.02 * SPEED]) and velocities == pytest.approx([SPEED])


def test_a_pose_moves_all_its_joints_at_once_and_ends_at_rest_on_it() -> None:
    pose = dict(HERE, head_yaw=0.1, l_knee=0.4)
    motion = plan_jog(JogRequest("pose", "bow"), ROBOT | {"poses": {"bow": pose}}, HERE)
    steps = 0
    while not motion.is_done:
        before = dict(zip(motion.names, motion.position.tolist(), strict=True))
        positions, velocities = motion.advance(0.02)
        steps += 1
    assert dict(zip(motion.names, positions, strict=True)) == pytest.approx(pose)
    assert not any(velocities)
    assert steps == pytest.approx(0.4 / SPEED / 0.02, abs=1.0)
    assert pose["head_yaw"] - before["head_yaw"] == pytest.approx(0.25 * (pose["l_knee"] - before["l_knee"]))


def test_a_slider_leads_its_joint_to_wherever_it_is_moved() -> None:
    motion = plan_jog(JogRequest("to", "head_yaw", 0.1), ROBOT, HERE)
    motion.advance(0.02)
    motion.target[:] = -0.1
    assert motion.advance(0.04) == ([pytest.approx(-0.02 * SPEED)], [-SPEED])
    motion.target[:] = motion.position
    assert motion.advance(0.02)[1] == [0.0]


def test_joints_that_are_steered_go_to_their_limits_and_no_faster_than_a_jog() -> None:
    joints = joints_of(ROBOT)
    start = known_positions(["head_yaw", "l_knee"], HERE | {"head_yaw": 1.49, "l_knee": 0.5})
    motion = JogMotion(["head_yaw", "l_knee"], start, start, np.zeros(2))
    motion.steer({"head_yaw": 9.0}, joints)
    positions, velocities = motion.advance(0.04)
    assert positions == pytest.approx([1.49 + 0.04 * SPEED, 0.5]) and velocities == [SPEED, 0.0]
    positions, velocities = motion.advance(0.04)
    assert positions == [1.5, 0.5] and velocities == [0.0, 0.0]
    motion.steer({"l_knee": -0.1}, joints)
    positions, velocities = motion.advance(0.02)
    assert positions == pytest.approx([1.5, 0.498]) and velocities == [0.0, -0.1]
    motion.steer({}, joints)
    assert motion.advance(0.02)[1] == [0.0, 0.0]


@given(st.lists(st.floats(-1.0, 10.0), max_size=50))
def test_no_setpoint_is_further_than_the_longest_step_from_the_one_before(waits: list[float]) -> None:
    motion = plan_jog(JogRequest("down", "l_knee"), ROBOT, HERE | {"l_knee": 1.0})
    last = 1.0
    for wait in waits:
        (position,), (velocity,) = motion.advance(wait)
        assert 0.0 <= last - position <= SPEED * LONGEST_STEP + 1e-12
        assert abs(velocity) <= SPEED
        last = position


def test_a_joint_with_low_limits_is_slower_so_that_it_stops_as_soon() -> None:
    limits = {"velocity_limit": 4.0, "acceleration_limit": 1.0}
    assert jog_speed(limits) == pytest.approx(STOPPING)
    assert jog_speed(limits | {"velocity_limit": 0.1}) == pytest.approx(0.025)
    assert jog_speed({"velocity_limit": 4.0, "acceleration_limit": 20.0}) == SPEED


@pytest.mark.parametrize(
    ("request_", "now", "why"),
    [
        (JogRequest("up", "tail"), HERE, "no button"),
        (JogRequest("sideways", "head_yaw"), HERE, "no button"),
        (JogRequest("to", "head_yaw"), HERE, "no button"),
        (JogRequest("pose", "handstand"), HERE, "no pose 'handstand'; known: rest"),
        (JogRequest("up", "head_yaw"), HERE | {"head_yaw": None}, "head_yaw is not known"),
        (JogRequest("pose", "rest"), dict(ROBOT["poses"]["rest"]), "rest: it is there"),
        (JogRequest("up", "head_yaw"), HERE | {"head_yaw": np.nan}, "head_yaw is not known"),
    ],
)
def test_what_cannot_be_moved_is_refused_by_name(request_: JogRequest, now: dict, why: str) -> None:
    with pytest.raises(InvalidInput, match=why):
        plan_jog(request_, ROBOT, now)
