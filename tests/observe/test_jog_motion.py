"""Slow motion of a held button: bounded in speed and step, through every limit of the robot file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.viewer_messages import h24
from twind.exceptions import InvalidInput
from twind.observe.viewing.jog_motion import (
    BEYOND,
    LONGEST_STEP,
    SPEED,
    STOPPING,
    JogRequest,
    jog_speed,
    plan_jog,
)

ROBOT = h24()["robot"]
HERE = {joint["name"]: 0.0 for joint in ROBOT["joints"]}


def test_a_joint_goes_to_just_beyond_its_limit_where_the_gate_refuses() -> None:
    motion = plan_jog(JogRequest("up", "head_yaw"), ROBOT, HERE)
    assert motion.names == ["head_yaw"]
    assert motion.duration == pytest.approx((1.5 + BEYOND) / SPEED)
    positions, velocities = motion.advance(0.02)
    assert positions == pytest.approx([0.02 * SPEED]) and velocities == pytest.approx([SPEED])


def test_a_pose_moves_all_its_joints_at_once_and_ends_at_rest_on_it() -> None:
    pose = dict(HERE, head_yaw=0.1, l_knee=0.4)
    motion = plan_jog(JogRequest("pose", "bow"), ROBOT | {"poses": {"bow": pose}}, HERE)
    while not motion.is_done:
        positions, velocities = motion.advance(0.02)
    assert dict(zip(motion.names, positions, strict=True)) == pytest.approx(pose)
    assert not any(velocities)
    assert motion.duration == pytest.approx(0.4 / SPEED)


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
        (JogRequest("pose", "handstand"), HERE, "no pose 'handstand'; known: rest"),
        (JogRequest("up", "head_yaw"), HERE | {"head_yaw": None}, "head_yaw is not known"),
        (JogRequest("pose", "rest"), dict(ROBOT["poses"]["rest"]), "rest: it is there"),
        (JogRequest("up", "head_yaw"), HERE | {"head_yaw": np.nan}, "head_yaw is not known"),
    ],
)
def test_what_cannot_be_moved_is_refused_by_name(request_: JogRequest, now: dict, why: str) -> None:
    with pytest.raises(InvalidInput, match=why):
        plan_jog(request_, ROBOT, now)
