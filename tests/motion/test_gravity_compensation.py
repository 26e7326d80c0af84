"""Offsets against gravity: bounded, never a step, gone where they are not wanted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import limits
from twind.motion.gravity_compensation import FASTEST, FOLLOW_SHARE, RAMP, GravityCompensation
from twind.motion.stop_profiles import LimitedFollower
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.trajectory import Reference

PERIOD = 0.01
JOINTS = 3
MOST = np.array([0.1, 0.1, 0.0])
LIMITS = limits(JOINTS)
REACH = LIMITS.velocity * PERIOD
STIFFNESS = np.array([20.0, np.nan, 20.0])
RATED = replace(ActuatorRatings.unknown(JOINTS), stiffness=STIFFNESS)
FOLLOW = MOST / FOLLOW_SHARE
ACCELERATION = float(LIMITS.acceleration[0])
LONG = 600  # ticks after which nothing changes, also at the bound of an offset
SETTLED = 150  # ticks in which an offset arrives, besides the ramp


def load(pose: Floats) -> Floats:
    """Torque of an arm that is level at 0, N·m."""
    return 1.5 * np.cos(pose)


def at(pose: Floats) -> Reference:
    return Reference(pose, np.zeros(JOINTS), np.zeros(JOINTS))


def held(compensation: GravityCompensation, pose: Floats, ticks: int, *, active: bool = True) -> list[Floats]:
    """Return the goals of these ticks, each of which leaves."""
    written = pose
    goals = []
    for _ in range(ticks):
        written = compensation.compensate(at(pose), written, LIMITS, PERIOD, active=active).position
        goals.append(written)
    return goals


def test_a_held_pose_gets_its_sag_and_loses_it_within_the_ramp() -> None:
    compensation = GravityCompensation(load, RATED, FOLLOW)
    pose = np.zeros(JOINTS)
    ticks = round(RAMP / PERIOD) + SETTLED
    written = held(compensation, pose, ticks)[-1]
    assert written == pytest.approx([0.075, 0.0, 0.0])
    for _ in range(ticks):
        written = compensation.compensate(at(pose), written, LIMITS, PERIOD, active=False).position
    assert np.array_equal(written, pose)


@given(
    st.lists(
        st.tuples(st.floats(-1.0, 1.0), st.booleans(), st.booleans(), st.integers(1, 40)),
        min_size=1,
        max_size=12,
    )
)
def test_goals_with_offset_keep_limits_steps_and_bounds(legs: list[tuple[float, bool, bool, int]]) -> None:
    compensation = GravityCompensation(load, RATED, FOLLOW)
    pose = np.zeros(JOINTS)
    written = pose.copy()
    for speed, active, leaves, ticks in legs:
        for _ in range(ticks):
            pose = np.clip(pose + speed * REACH, LIMITS.lower, LIMITS.upper)
            goal = compensation.compensate(at(pose), written, LIMITS, PERIOD, active=active).position
            assert (np.abs(goal - pose) <= MOST + 1e-12).all()
            assert (goal >= LIMITS.lower - 1e-12).all()
            assert (goal <= LIMITS.upper + 1e-12).all()
            assert (np.abs(goal - written) <= REACH + 1e-12).all()
            written = goal if leaves else written
            pose = written - compensation.offset(written)  # where commands go on


@given(
    st.lists(
        st.tuples(st.floats(-2.5, 2.5), st.floats(-3.0, 3.0), st.booleans(), st.integers(1, 60)),
        min_size=1,
        max_size=12,
    )
)
def test_a_goal_that_keeps_acceleration_and_limits_keeps_them_with_its_offset(
    legs: list[tuple[float, float, bool, int]],
) -> None:
    """Targets beyond the limits, and loads that jump."""
    weight = np.zeros(JOINTS)
    compensation = GravityCompensation(lambda pose: weight * np.cos(pose), RATED, FOLLOW)
    executor = LimitedFollower(at(np.zeros(JOINTS)), LIMITS, PERIOD)
    written = before = np.zeros(JOINTS)
    for target, torque, active, ticks in legs:
        weight[:] = torque
        compensation.limit(RATED, FOLLOW)  # the load of the same pose is another one
        executor.set_target(np.full(JOINTS, target), np.zeros(JOINTS))
        for _ in range(ticks):
            pose = executor.step().position
            goal = compensation.compensate(at(pose), written, LIMITS, PERIOD, active=active).position
            assert (np.abs(goal - pose) <= MOST + 1e-9).all()
            assert (goal >= LIMITS.lower - 1e-9).all() and (goal <= LIMITS.upper + 1e-9).all()
            assert (np.abs(goal - written) <= REACH + 1e-9).all()
            assert (np.abs(goal - 2.0 * written + before) <= ACCELERATION * PERIOD**2 + 1e-9).all()
            before = written
            written = goal


def test_a_step_that_is_too_long_stays_too_long() -> None:
    compensation = GravityCompensation(load, RATED, FOLLOW)
    written = held(compensation, np.zeros(JOINTS), 200)[-1]
    far = np.full(JOINTS, -3.0) * REACH
    goal = compensation.compensate(at(far), written, LIMITS, PERIOD, active=True).position
    assert np.abs(goal - written) == pytest.approx(3.0 * REACH)


def test_a_goal_that_did_not_leave_changes_no_offset() -> None:
    compensation = GravityCompensation(load, RATED, FOLLOW)
    written = held(compensation, np.zeros(JOINTS), 20)[-1]
    before = compensation.offset(written).copy()
    compensation.compensate(at(np.zeros(JOINTS)), written, LIMITS, PERIOD, active=True)
    assert np.array_equal(compensation.offset(written), before)


def test_an_unknown_torque_fades_the_offset_out_slowly() -> None:
    torque = np.ones(JOINTS)
    compensation = GravityCompensation(lambda pose: torque.copy(), RATED, FOLLOW)
    written = held(compensation, np.zeros(JOINTS), 200)[-1]
    torque[:] = np.nan
    compensation.limit(RATED, FOLLOW)
    goals = [written]
    for _ in range(SETTLED):
        goals.append(
            compensation.compensate(at(np.zeros(JOINTS)), goals[-1], LIMITS, PERIOD, active=True).position
        )
    steps = -np.diff(goals, axis=0)
    assert np.array_equal(goals[-1], np.zeros(JOINTS))
    assert (steps >= 0.0).all() and steps.max() <= FASTEST * PERIOD + 1e-12
    assert np.abs(np.diff(steps, axis=0)).max() <= ACCELERATION * PERIOD**2 * (1.0 + 1e-9)


def test_a_goal_outside_its_limits_gets_no_offset_outwards() -> None:
    compensation = GravityCompensation(load, RATED, FOLLOW)
    above = replace(LIMITS, upper=np.full(JOINTS, -0.01))
    pose = np.zeros(JOINTS)
    written = pose
    for _ in range(50):
        written = compensation.compensate(at(pose), written, above, PERIOD, active=True).position
    assert np.array_equal(written, pose)


def test_other_gains_lead_to_the_offset_of_a_start_with_them_without_a_step() -> None:
    """Stiffness without a P gain is NaN, as `bind` makes it: the offset fades out, and comes back with it."""
    compensation = GravityCompensation(load, RATED, FOLLOW)
    pose = np.zeros(JOINTS)
    written = held(compensation, pose, LONG)[-1]
    for factor, follow in ((np.nan, FOLLOW), (1.0, FOLLOW), (2.0, FOLLOW / 2.0), (0.25, 3.0 * FOLLOW)):
        rated = replace(RATED, stiffness=factor * STIFFNESS)
        compensation.limit(rated, follow)
        for _ in range(LONG):
            goal = compensation.compensate(at(pose), written, LIMITS, PERIOD, active=True).position
            assert (np.abs(goal - written) <= FASTEST * PERIOD + 1e-12).all()
            written = goal
        assert np.array_equal(written, held(GravityCompensation(load, rated, follow), pose, LONG)[-1])
