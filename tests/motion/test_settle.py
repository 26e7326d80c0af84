from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.gate_rig import ask, at_rest, codes, limits
from twind.exceptions import InvalidInput
from twind.motion.settle import settle
from twind.motion.stop_profiles import stopping_point
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference

n = 3
places = st.lists(st.floats(-2.0, 2.0), min_size=n, max_size=n).map(np.array)
speeds = st.lists(st.floats(-3.0, 3.0), min_size=n, max_size=n).map(np.array)


def test_a_large_move_takes_a_second_or_more_and_a_small_one_a_moment() -> None:
    assert settle(at_rest([0.0, 0.0]), np.array([0.2, 0.0]), limits()).time.tolist() == [1.0]
    assert settle(at_rest([0.0, 0.0]), np.array([0.05, 0.0]), limits()).time.tolist() == [0.25]
    assert settle(at_rest([0.5, 0.5]), np.array([0.5, 0.5]), limits()).time.tolist() == [0.25]
    assert settle(at_rest([0.0, 0.0]), np.array([0.1, 0.0]), limits()).time.tolist() == [0.25]
    assert settle(at_rest([0.0, 0.0]), np.array([0.101, 0.0]), limits()).time.tolist() == [1.0]


def test_half_the_limits_are_used_when_there_is_time_for_it() -> None:
    slow = limits(1, velocity=1.0)
    way = settle(at_rest([-0.8]), np.array([0.2]), slow)
    assert way.time[-1] == pytest.approx(1.875 / 0.5)
    assert settle(at_rest([-1.5]), np.array([1.5]), slow).time[-1] == pytest.approx(1.875 * 3.0 / 0.95)
    assert settle(at_rest([-0.8]), np.array([0.2]), slow, 2.5).time[-1] == pytest.approx(2.5)
    assert settle(at_rest([-0.8]), np.array([0.7]), slow).time[-1] == 4.0
    weak = limits(1, velocity=100.0, acceleration=1.0)
    assert settle(at_rest([0.0]), np.array([1.0]), weak).time[-1] == pytest.approx(
        (10 / 3**0.5 / 0.5) ** 0.5, 1e-4
    )


def test_settling_takes_longer_than_requested_where_the_limits_require_it() -> None:
    crawling = limits(1, velocity=0.2)
    assert settle(at_rest([-1.0]), np.array([1.0]), crawling).time[-1] == pytest.approx(1.875 * 2.0 / 0.19)


def test_a_rest_pose_on_the_hard_limit_is_approached_slowly_enough_to_brake() -> None:
    edge = limits(1, hard_upper=2.0)
    way = settle(at_rest([0.0]), np.array([2.0]), edge, 1.0)
    assert way.time[-1] > 1.0
    assert codes(ask(way, edge, at_rest([0.0]))) == set()


def braking_used(start: float, end: float, lasts: float, limit: JointLimits) -> float:
    """The largest share of the speed that the brake rule allows on a quintic, towards the limit ahead."""
    u = 1.0 - np.geomspace(1e-5, 0.999, 20001)
    place = start + (end - start) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    speed = abs(end - start) * 30.0 * (u * (1.0 - u)) ** 2 / lasts
    room = limit.hard_upper[0] - place if end > start else place - limit.hard_lower[0]
    braking = np.sqrt(2.0 * limit.acceleration[0] * np.maximum(room, 0.0)) - 0.2
    return float((speed / np.maximum(0.05, braking)).max())


@pytest.mark.parametrize("acceleration", [2.0, 7.0, 20.0, 60.0, 1e4])
@pytest.mark.parametrize("end", [0.3, -0.5, 0.8, -1.3, 2.0])
def test_a_way_to_a_hard_limit_is_stretched_by_tenths_until_it_brakes_in_time(
    end: float, acceleration: float
) -> None:
    edge = limits(1, velocity=500.0, acceleration=acceleration, hard_upper=abs(end), hard_lower=-abs(end))
    lasts = float(settle(at_rest([0.0]), np.array([end]), edge, 0.001).time[-1])
    assert 0.95 / 1.1 < braking_used(0.0, end, lasts, edge) < 0.972


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


def test_each_joint_brakes_to_its_own_instant_and_twenty_points_lead_to_rest() -> None:
    moving = Reference(np.zeros(4), np.array([2.0, 0.0, -1.0, 1.0]), np.zeros(4))
    way = settle(moving, np.ones(4), limits(4))
    assert way.time[:2].tolist() == pytest.approx([0.055, 0.105])
    assert len(way.time) == 2 + 20
    assert way.velocity is not None
    assert way.velocity[1].tolist() == [0.0] * 4
    assert way.position[1, 1] == 0.0


def test_a_joint_that_cannot_brake_is_refused() -> None:
    with pytest.raises(InvalidInput, match="joint 1 cannot brake"):
        settle(at_rest([0.0, 0.0]), np.zeros(2), replace(limits(), acceleration=np.array([20.0, 0.0])))


@pytest.mark.parametrize("infinite", [np.inf, -np.inf])
def test_a_velocity_that_is_no_number_counts_as_standing(infinite: float) -> None:
    unknown = Reference(np.zeros(2), np.array([np.nan, infinite]), np.zeros(2))
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
