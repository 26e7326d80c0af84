from dataclasses import replace
from math import inf, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import at_rest, limits
from twind.exceptions import InvalidInput
from twind.motion.settle import settle
from twind.motion.stop_profiles import CompliantFollower, LimitedFollower, StopRamp, still, stopping_point
from twind.robot.trajectory import Reference

PERIOD = 0.01
# rad/s, of the gate's brake rule (BRAKE_DISTANCE)
FLOOR = 0.05
MARGIN = 0.2


def moving(position: list[float], velocity: list[float]) -> Reference:
    n = len(position)
    return Reference(np.array(position), np.array(velocity), np.zeros(n))


def test_still_cannot_be_written_to_and_does_not_follow_its_source() -> None:
    source = np.array([1.0, 2.0])
    reference = still(source)
    source[0] = 5.0
    assert reference.position.tolist() == [1.0, 2.0]
    assert not reference.position.flags.writeable
    assert reference.velocity.tolist() == [0.0, 0.0]


# ------------------------------------------------------------------------------------------------ ramp


def test_a_ramp_from_standstill_is_a_hold() -> None:
    ramp = StopRamp(at_rest([0.3, -0.2]), limits(), PERIOD)
    assert ramp.resting
    assert ramp.duration == 0.0
    for _ in range(3):
        assert ramp.step().position.tolist() == [0.3, -0.2]


def test_each_joint_brakes_with_its_own_limit_and_rests_when_it_has_stopped() -> None:
    limit = limits(acceleration=np.array([10.0, 40.0]))
    ramp = StopRamp(moving([0.0, 0.0], [2.0, -2.0]), limit, PERIOD)
    assert ramp.duration == pytest.approx(0.2)
    middle = ramp.reference_at(0.1)
    assert middle.velocity.tolist() == pytest.approx([1.0, 0.0])
    assert middle.acceleration.tolist() == [-10.0, 0.0]
    assert middle.position.tolist() == pytest.approx([0.15, -0.05])
    assert ramp.reference_at(inf).position.tolist() == pytest.approx([0.2, -0.05])


def test_ramp_ahead_predicts_the_position_without_advancing_the_ramp() -> None:
    ramp = StopRamp(moving([0.0], [1.0]), limits(1), PERIOD)
    told = [ramp.ahead(PERIOD * k).position[0] for k in range(1, 8)]
    assert told == pytest.approx([ramp.step().position[0] for _ in range(7)], abs=1e-15)


@pytest.mark.parametrize("unknown", [np.nan, inf, -inf])
def test_a_velocity_that_is_no_number_stops_on_the_spot(unknown: float) -> None:
    reference = moving([0.4, 0.4], [unknown, 1.0])
    ramp = StopRamp(reference, limits(), PERIOD)
    assert ramp.step().position[0] == 0.4
    assert stopping_point(reference, limits().acceleration)[0] == 0.4


@given(
    hard=st.floats(0.1, 3.0),
    share=st.floats(0.0, 1.0),
    fast=st.floats(0.0, 1.0),
    acceleration=st.floats(1.0, 60.0),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_a_joint_within_the_braking_rule_stops_before_the_hard_limit(
    hard: float, share: float, fast: float, acceleration: float, side: float
) -> None:
    distance = share * 2.0 * hard  # to the limit that the joint moves towards
    allowed = max(FLOOR, sqrt(2.0 * acceleration * distance) - MARGIN)
    limit = limits(1, acceleration=acceleration, hard_lower=-hard, hard_upper=hard)
    ramp = StopRamp(moving([side * (hard - distance)], [side * fast * allowed]), limit, PERIOD)
    outermost = max(
        side * ramp.reference_at(t).position[0] for t in np.linspace(0.0, ramp.duration + 0.01, 50)
    )
    creep = FLOOR**2 / (2.0 * acceleration)  # the speed that the rule always allows, even on the limit
    assert outermost <= hard + (creep if allowed == FLOOR else 0.0) + 1e-12
    assert ramp.reference_at(inf).velocity[0] == 0.0


# -------------------------------------------------------------------------------------------- follower


def steps(follower: LimitedFollower, count: int) -> list[Reference]:
    return [follower.step() for _ in range(count)]


def test_without_an_aim_the_follower_brakes_to_a_hold() -> None:
    track = steps(LimitedFollower(moving([0.0], [1.0]), limits(1), PERIOD), 30)
    assert track[-1].position[0] == pytest.approx(0.025, abs=1e-9)
    assert track[-1].velocity[0] == pytest.approx(0.0, abs=1e-9)


def test_the_follower_arrives_without_overshoot_and_then_rests() -> None:
    follower = LimitedFollower(at_rest([0.0]), limits(1), PERIOD)
    follower.set_target(np.array([1.0]), np.zeros(1))
    assert not follower.resting
    track = [reference.position[0] for reference in steps(follower, 60)]
    assert max(track) <= 1.0 + 1e-12
    assert track[-1] == pytest.approx(1.0, abs=1e-12)
    assert follower.resting
    assert track.index(track[-1]) * PERIOD <= 0.55  # 0.45 s is the least with 4 rad/s and 20 rad/s²


def test_a_target_that_moves_is_followed_at_its_speed_and_not_past_the_limits() -> None:
    follower = LimitedFollower(at_rest([0.0]), limits(1), PERIOD)
    follower.set_target(np.array([0.0]), np.array([0.5]))
    track = steps(follower, 100)
    assert track[-1].velocity[0] == pytest.approx(0.5, abs=1e-6)
    assert track[-1].position[0] == pytest.approx(0.5, abs=0.01)
    assert not follower.resting
    assert max(reference.position[0] for reference in steps(follower, 400)) <= 2.0


def test_follower_ahead_predicts_the_position_without_advancing_the_follower() -> None:
    follower = LimitedFollower(moving([0.0], [0.7]), limits(1), PERIOD)
    follower.set_target(np.array([-0.5]), np.array([0.1]))
    steps(follower, 7)
    told = follower.ahead(20 * PERIOD)
    assert told.position[0] == pytest.approx(steps(follower, 20)[-1].position[0], abs=1e-12)
    assert follower.ahead(0.0).position[0] == follower.ahead(0.0).position[0]


@given(
    start=st.floats(-2.0, 2.0),
    aims=st.lists(
        st.tuples(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0), st.integers(1, 40)), min_size=1, max_size=6
    ),
    speed=st.floats(0.1, 8.0),
    acceleration=st.floats(2.0, 60.0),
)
def test_the_follower_never_exceeds_a_limit_for_any_targets(
    start: float, aims: list[tuple[float, float, int]], speed: float, acceleration: float
) -> None:
    limit = limits(1, velocity=speed, acceleration=acceleration)
    follower = LimitedFollower(at_rest([start]), limit, PERIOD)
    track = [at_rest([start])]
    for target, drift, count in aims:
        follower.set_target(np.array([target]), np.array([drift]))
        track += steps(follower, count)
    position = np.array([reference.position[0] for reference in track])
    velocity = np.array([reference.velocity[0] for reference in track])
    assert np.abs(np.diff(position)).max() <= speed * PERIOD + 1e-12
    assert np.abs(np.diff(velocity)).max() <= acceleration * PERIOD + 1e-9
    assert position.min() >= -2.0 - 1e-9
    assert position.max() <= 2.0 + 1e-9
    assert np.diff(position) == pytest.approx(velocity[1:] * PERIOD, abs=1e-12)
    acceleration = np.array([reference.acceleration[0] for reference in track[1:]])
    assert np.diff(velocity) == pytest.approx(acceleration * PERIOD, abs=1e-12)


def test_from_outside_its_limits_the_follower_only_comes_in() -> None:
    follower = LimitedFollower(at_rest([2.03]), limits(1), PERIOD)
    follower.set_target(np.array([2.04]), np.zeros(1))
    assert steps(follower, 5)[-1].position[0] <= 2.03
    follower.set_target(np.array([1.0]), np.zeros(1))
    assert steps(follower, 100)[-1].position[0] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_follower_stops_at_its_fence_and_goes_on_when_that_is_gone(side: float) -> None:
    follower = LimitedFollower(at_rest([0.0]), limits(1), PERIOD)
    follower.set_target(np.array([side]), np.zeros(1))
    follower.fence = (np.array([-0.6]), np.array([0.4]))
    end = 0.4 if side > 0.0 else -0.6
    assert steps(follower, 100)[-1].position[0] == pytest.approx(end, abs=1e-9)
    follower.fence = None
    assert steps(follower, 100)[-1].position[0] == pytest.approx(side, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_fence_widens_no_position_limit(side: float) -> None:
    follower = LimitedFollower(at_rest([0.0]), limits(1), PERIOD)
    follower.fence = (np.array([-9.0]), np.array([9.0]))
    follower.set_target(np.array([side * 9.0]), np.zeros(1))
    assert steps(follower, 200)[-1].position[0] == pytest.approx(2.0 * side, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_joint_beyond_its_fence_is_not_pulled_back_and_comes_in_by_itself(side: float) -> None:
    follower = LimitedFollower(at_rest([side]), limits(1), PERIOD)
    follower.fence = (np.array([-0.5]), np.array([0.5]))
    follower.set_target(np.array([side]), np.zeros(1))
    assert steps(follower, 50)[-1].position[0] == side
    follower.set_target(np.array([0.0]), np.zeros(1))
    assert steps(follower, 100)[-1].position[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("target", "kept"), [(-0.6, True), (-0.5, False), (0.0, False), (0.3, False), (0.4, True), (np.nan, True)]
)
def test_a_fence_keeps_a_joint_from_a_target_beyond_it(target: float, kept: bool) -> None:
    follower = LimitedFollower(at_rest([0.0, 0.0]), limits(2), PERIOD)
    follower.set_target(np.array([9.0, target]), np.zeros(2))
    assert follower.is_fenced(1) is False
    follower.fence = (np.array([-0.5, -0.5]), np.array([9.5, 0.3]))
    assert bool(follower.is_fenced(1)) is kept
    assert not follower.is_fenced(0)


@pytest.mark.parametrize("acceleration", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("ramp", [StopRamp, LimitedFollower, CompliantFollower])
def test_a_ramp_that_would_never_end_is_refused_where_it_is_made(ramp: Any, acceleration: float) -> None:
    fine = limits(3)
    slack = fine.acceleration.copy()
    slack[1] = acceleration
    start = still(np.zeros(3))
    with pytest.raises(InvalidInput, match="joint 1 cannot brake"):
        ramp(start, replace(fine, acceleration=slack), 0.01)
    assert ramp(start, fine, 0.01).resting


@pytest.mark.parametrize("acceleration", [0.0, -1.0, np.nan])
def test_a_way_to_the_rest_pose_that_could_not_brake_is_refused(acceleration: float) -> None:
    slack = np.array([acceleration, 20.0])
    with pytest.raises(InvalidInput, match="joint 0 cannot brake"):
        settle(still(np.zeros(2)), np.ones(2) * 0.5, limits(2, acceleration=slack))
