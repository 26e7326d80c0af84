"""Bounds of FOLLOW_ERR: wider with load and speed, narrower with gain, never below the default."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import limits
from twind.robot.actuator_ratings import ActuatorRatings
from twind.safety.follow_bounds import MOST, FollowBounds, follow_bounds
from twind.safety.guard_types import GuardThresholds

USUAL = GuardThresholds()


def bounds(
    load: float = 0.0,
    *,
    stiffness: float = 10.0,
    lag: float = 0.02,
    speed: float = 2.0,
    effort: float = nan,
    follow: float = nan,
    follow_for: float = nan,
) -> FollowBounds:
    """Bounds of a robot with one joint."""
    given = {"stiffness": stiffness, "lag": lag, "follow": follow, "follow_for": follow_for}
    rated = replace(ActuatorRatings.unknown(1), **{name: np.array([value]) for name, value in given.items()})
    return follow_bounds(rated, limits(1, velocity=speed, effort=effort), np.array([load]), USUAL)


def test_the_lag_is_that_of_the_load_and_that_of_the_speed() -> None:
    found = bounds(1.5, stiffness=10.0, lag=0.05, speed=2.0)
    assert (found.sag[0], found.trail[0], found.lag[0]) == pytest.approx((0.15, 0.1, 0.25))
    # the guard allows 0.03 s of the speed anyway
    assert found.rad[0] == pytest.approx(1.5 * (0.15 + 2.0 * 0.02))
    assert found.rad[0] > USUAL.follow
    assert found.damp[0] - found.rad[0] == pytest.approx(USUAL.follow_damp - USUAL.follow)
    assert found.seconds[0] == USUAL.follow_for


@pytest.mark.parametrize(
    ("load", "stiffness", "lag"),
    [
        (0.1, 10.0, 0.02),
        (nan, 10.0, 0.5),
        (3.0, nan, nan),
        (3.0, 1.0, nan),
        (0.0, 10.0, 0.0),
    ],
)
def test_the_default_stands_for_a_small_lag_and_for_an_unknown_one(
    load: float, stiffness: float, lag: float
) -> None:
    found = bounds(load, stiffness=stiffness, lag=lag)
    assert (found.rad[0], found.damp[0], found.seconds[0]) == (0.2, 0.5, 0.1)


def test_no_bound_is_worked_out_beyond_the_largest_and_the_wanted_one_is_kept() -> None:
    found = bounds(10.0)
    assert found.rad[0] == MOST == 0.5
    assert found.wanted[0] == pytest.approx(1.5)


@pytest.mark.parametrize("follow", [0.05, 0.2, 1.2])
def test_what_the_owner_states_stands_below_the_default_and_beyond_the_largest(follow: float) -> None:
    found = bounds(10.0, follow=follow, follow_for=0.7)
    assert (found.rad[0], found.seconds[0]) == (follow, 0.7)


def test_a_joint_holds_no_more_than_its_actuator_can() -> None:
    assert bounds(100.0, effort=2.0).sag[0] == pytest.approx(0.2)
    assert bounds(-1.0, effort=2.0).sag[0] == pytest.approx(0.1)
    assert np.isnan(bounds(nan, effort=2.0).sag[0])


def test_a_robot_whose_load_is_unknown_has_the_defaults() -> None:
    rated = replace(ActuatorRatings.unknown(2), stiffness=np.full(2, 0.1), lag=np.full(2, 1.0))
    assert follow_bounds(rated, limits(2), None, USUAL).rad.tolist() == [0.2, 0.2]


SIZE = st.floats(0.0, 100.0)
GAIN = st.floats(0.01, 1e4)
LAG = st.floats(0.0, 2.0)
MORE = st.floats(1.0, 10.0)


@given(load=SIZE, stiffness=GAIN, lag=LAG, speed=st.floats(0.0, 30.0), more=MORE)
def test_a_bound_grows_with_load_and_speed_and_falls_with_gain(
    load: float, stiffness: float, lag: float, speed: float, more: float
) -> None:
    least = bounds(load, stiffness=stiffness, lag=lag, speed=speed).rad[0]
    assert USUAL.follow <= least <= MOST
    assert bounds(load * more, stiffness=stiffness, lag=lag, speed=speed).rad[0] >= least
    assert bounds(load, stiffness=stiffness, lag=lag, speed=speed * more).rad[0] >= least
    assert bounds(load, stiffness=stiffness, lag=lag * more, speed=speed).rad[0] >= least
    # a gain acts on torque and speed alike
    assert bounds(load, stiffness=stiffness * more, lag=lag / more, speed=speed).rad[0] <= least


def test_a_larger_default_is_no_smaller_than_itself() -> None:
    calm = replace(USUAL, follow=10.0, follow_damp=10.0)
    rated = replace(ActuatorRatings.unknown(1), stiffness=np.array([1.0]), lag=np.array([0.0]))
    found = follow_bounds(rated, limits(1), np.array([inf]), calm)
    assert (found.rad[0], found.damp[0]) == (10.0, 10.0)
