import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.gate_rig import ask, at_rest, codes, limits
from twind.motion.settle import settle
from twind.motion.stop_profiles import stopping_point
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference

n = 3
places = st.lists(st.floats(-2.0, 2.0), min_size=n, max_size=n).map(np.array)
speeds = st.lists(st.floats(-3.0, 3.0), min_size=n, max_size=n).map(np.array)


def test_a_large_move_takes_a_second_or_more_and_a_small_one_a_moment() -> None:
    assert settle(at_rest([0.0, 0.0]), np.array([0.2, 0.0]), limits()).time.tolist() == [1.0]
    assert settle(at_rest([0.0, 0.0]), np.array([0.05, 0.0]), limits()).time.tolist() == [0.25]
    assert settle(at_rest([0.5, 0.5]), np.array([0.5, 0.5]), limits()).time.tolist() == [0.25]


def test_half_the_limits_are_used_when_there_is_time_for_it() -> None:
    slow = limits(1, velocity=1.0)
    way = settle(at_rest([-0.8]), np.array([0.2]), slow)
    assert way.time[-1] == pytest.approx(1.875 / 0.5)
    assert settle(at_rest([-1.5]), np.array([1.5]), slow).time[-1] == pytest.approx(1.875 * 3.0 / 0.95)
    assert settle(at_rest([-0.8]), np.array([0.2]), slow, 2.5).time[-1] == pytest.approx(2.5)


def test_settling_takes_longer_than_requested_where_the_limits_require_it() -> None:
    crawling = limits(1, velocity=0.2)
    assert settle(at_rest([-1.0]), np.array([1.0]), crawling).time[-1] == pytest.approx(1.875 * 2.0 / 0.19)


def test_a_rest_pose_on_the_hard_limit_is_approached_slowly_enough_to_brake() -> None:
    edge = limits(1, hard_upper=2.0)
    way = settle(at_rest([0.0]), np.array([2.0]), edge, 1.0)
    assert way.time[-1] > 1.0
    assert codes(ask(way, edge, at_rest([0.0]))) == set()


@examples(60)
@given(
    places,
    places,
    st.floats(0.3, 8.0),
    st.floats(2.0, 50.0),
    st.sampled_from([0.05, 0.0]),
    st.floats(0.5, 4.0),
)
def test_the_way_to_rest_passes_the_gate(
    start: np.ndarray, rest: np.ndarray, speed: float, acceleration: float, beyond: float, seconds: float
) -> None:
    limit = limits(
        n, velocity=speed, acceleration=acceleration, hard_lower=-2.0 - beyond, hard_upper=2.0 + beyond
    )
    way = settle(at_rest(start), rest, limit, seconds)
    judged = ask(way, limit, at_rest(start))
    assert judged.verdict.refusals == ()
    assert (way.position[-1] == rest).all()


@examples(60)
@given(places, speeds, places, st.floats(3.0, 8.0), st.floats(5.0, 50.0), st.floats(0.5, 4.0))
def test_a_moving_robot_brakes_first_and_its_way_passes_the_gate_too(
    start: np.ndarray,
    velocity: np.ndarray,
    rest: np.ndarray,
    speed: float,
    acceleration: float,
    seconds: float,
) -> None:
    limit = limits(n, velocity=speed, acceleration=acceleration)
    moving = Reference(start, velocity, np.zeros(n))
    assume((np.abs(stopping_point(moving, 0.9 * limit.acceleration) + 0.003 * velocity) <= 2.0).all())
    room = np.where(velocity > 0.0, 2.05 - start, start + 2.05)
    assume((np.abs(velocity) <= np.sqrt(2.0 * acceleration * room) - 0.2).all())
    assume((np.abs(velocity) > 0.01).any())
    way = settle(moving, rest, limit, seconds)
    judged = ask(way, limit, moving)
    assert judged.verdict.refusals == ()
    assert (way.position[-1] == rest).all()
    assert way.velocity is not None
    assert (way.velocity[-1] == 0.0).all()


def test_braking_joints_stop_close_to_where_the_limit_lets_them() -> None:
    moving = Reference(np.zeros(2), np.array([2.0, -1.0]), np.zeros(2))
    way = settle(moving, np.array([1.0, 1.0]), limits())
    curve = interpolate(way, moving)
    furthest = min(curve.sample(t).position[1] for t in np.linspace(0.0, 0.3, 300))
    assert furthest == pytest.approx(-0.025, abs=0.004)
    assert (way.time[1:] - way.time[:-1]).min() >= 0.004


def test_a_velocity_that_is_no_number_counts_as_standing() -> None:
    unknown = Reference(np.zeros(2), np.array([np.nan, np.inf]), np.zeros(2))
    assert settle(unknown, np.array([0.2, 0.0]), limits()).time.tolist() == [1.0]


def test_a_velocity_that_is_gone_within_rounding_counts_as_standing() -> None:
    nearly = Reference(np.zeros(2), np.array([2e-9, 0.0]), np.zeros(2))
    assert settle(nearly, np.array([0.2, 0.0]), limits(acceleration=1000.0)).time.tolist() == [1.0]


def test_a_robot_that_brakes_onto_its_rest_pose_gets_points_apart_in_time() -> None:
    """With no time left for a way that has no length."""
    moving = Reference(np.zeros(1), np.array([1.0]), np.zeros(1))
    braked = settle(moving, np.zeros(1), limits(1)).position[0]
    way = settle(moving, braked, limits(1), 0.01)
    assert (np.diff(way.time) > 0.0).all()
    assert way.time[-1] == pytest.approx(way.time[0] + 0.005)
