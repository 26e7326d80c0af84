"""Setpoints beyond what a joint may do are followed late, and the stream reports by how much."""

from math import inf, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import at_rest, limits
from twind.motion.setpoint_stream import LATE, SetpointStream, widened
from twind.robot.finding import Finding, ReasonCode

PERIOD = 0.01
LIMITS = limits(2)  # 4 rad/s, 20 rad/s²
ONE = np.array([True, False])


def stream(speed: float = 4.0, acceleration: float = 20.0) -> SetpointStream:
    bounds = limits(2, velocity=speed, acceleration=acceleration)
    return widened(None, ONE, at_rest(np.zeros(2)), bounds, PERIOD)


def sine(
    given: SetpointStream, amplitude: float, rate: float, *, every: int = 1, share: float = 1.0
) -> tuple[list[Finding], float]:
    """Two seconds of a sine as positions alone; the findings of the replies, and the largest lag."""
    found = []
    worst = place = 0.0
    for k in range(200):
        if k % every == 0:
            found += given.behind()[1]
            place = amplitude * (1.0 - sin(2.0 * pi * (rate * k * PERIOD + 0.25)))
            given.set_target(np.array([0]), np.array([place]), None, 0.1)
        given.use(k * PERIOD)
        worst = max(worst, abs(place - float(given.follower.step(share).position[0])))
    return found, worst


@pytest.mark.parametrize("every", [1, 2, 5])
def test_setpoints_within_the_limits_are_not_late(every: int) -> None:
    found, worst = sine(stream(), 0.1, 1.5, every=every)
    assert found == []
    assert worst < 0.06  # the way to stop, and what passes between two setpoints


def test_setpoints_beyond_the_velocity_limit_are_reported_with_how_far_behind() -> None:
    found, worst = sine(stream(acceleration=200.0), 0.5, 2.5)
    assert worst > 0.2
    assert ReasonCode.VEL_LIMIT in {one.code for one in found}
    assert {one.joint for one in found} == {0}
    fast = [one for one in found if one.code is ReasonCode.VEL_LIMIT]
    assert {one.bound for one in fast} == {4.0}
    assert max(one.value or 0.0 for one in fast) == pytest.approx(5.0 * pi * 0.5, rel=0.05)


def test_setpoints_beyond_the_acceleration_limit_are_reported_as_that() -> None:
    found, worst = sine(stream(), 0.05, 5.0)
    assert worst > 0.06
    assert {(one.code, one.joint) for one in found} == {(ReasonCode.ACC_LIMIT, 0)}


def test_a_stream_whose_joint_does_not_follow_is_reported_as_that() -> None:
    given = stream()
    given.follower.fence = (np.full(2, -0.1), np.full(2, 0.1))
    given.set_target(np.array([0]), np.array([0.5]), None, 1.0)
    for k in range(30):
        given.use(k * PERIOD)
        given.follower.step()
    behind, [finding] = given.behind()
    assert behind.tolist() == pytest.approx([0.4, 0.0])
    assert (finding.code, finding.joint) == (ReasonCode.LEAD_LIMIT, 0)


def late(given: SetpointStream, place: float, ticks: int = 0) -> list[Finding]:
    """Findings of a setpoint at `place`, sent so many ticks after one at 0, once a tick used it."""
    for _ in range(ticks):
        given.use(0.0)
    given.set_target(np.array([0]), np.array([place]), None, 1.0)
    given.use(0.0)
    return list(given.behind()[1])


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_hundredth_of_a_radian_behind_is_not_late(side: float) -> None:
    assert late(stream(), side * 0.0099) == []
    assert len(late(stream(), side * 0.0101)) == 1


def test_a_setpoint_at_the_velocity_limit_is_late_for_its_acceleration() -> None:
    [finding] = late(stream(), 0.04)  # in one tick: 4 rad/s
    assert (finding.code, finding.bound) == (ReasonCode.ACC_LIMIT, 20.0)
    [finding] = late(stream(), 0.041)
    assert (finding.code, finding.bound) == (ReasonCode.VEL_LIMIT, 4.0)
    assert finding.value == pytest.approx(4.1)


def test_a_stream_that_was_not_late_has_asked_for_no_speed_yet() -> None:
    given = stream(speed=0.5, acceleration=0.1)
    assert late(given, 0.0) == []
    [finding] = late(given, 0.02, ticks=9)  # 0.2 rad/s
    assert (finding.code, finding.bound) == (ReasonCode.ACC_LIMIT, 0.1)


def test_a_setpoint_is_stale_once_its_time_has_passed() -> None:
    given = stream()
    given.set_target(np.array([0]), np.array([0.1]), None, 0.5)
    assert given.use(3.0) is None
    assert given.use(3.5) is None
    found = given.use(3.75)
    assert found is not None
    assert (found.code, found.value, found.bound) == (ReasonCode.STREAM_STALE, 0.75, 0.5)


def test_a_stream_without_a_setpoint_is_stale() -> None:
    given = stream()
    given.use(3.0)
    assert given.use(3.01) is not None


def test_a_slowed_stream_reports_the_speed_that_it_may_have() -> None:
    found, _ = sine(stream(acceleration=200.0), 0.3, 1.0, share=0.25)
    assert {one.code for one in found} == {ReasonCode.VEL_LIMIT}
    assert {one.bound for one in found} == {1.0}


def test_before_a_tick_has_used_a_setpoint_nothing_is_known_of_it() -> None:
    given = stream()
    given.set_target(np.array([0]), np.array([1.5]), None, 0.1)
    assert given.behind()[1] == ()
    given.use(1.0)
    given.follower.step()
    behind, (found,) = given.behind()
    assert (found.code, found.value) == (ReasonCode.VEL_LIMIT, pytest.approx(150.0))
    assert behind == pytest.approx([1.5, 0.0], abs=0.01)


def test_joints_of_no_setpoint_are_never_late() -> None:
    given = stream()
    given.follower.set_target(np.array([0.0, 1.0]), np.zeros(2))
    given.use(1.0)
    given.follower.step()
    assert given.behind()[1] == ()


def test_setpoints_with_their_velocity_are_followed_without_a_lag() -> None:
    given = stream()
    found = []
    for k in range(100):
        found += given.behind()[1]
        place = 0.3 * (1.0 - sin(2.0 * pi * (k * PERIOD + 0.25)))
        speed = -0.6 * pi * sin(2.0 * pi * (k * PERIOD + 0.5))
        given.set_target(np.array([0]), np.array([place]), np.array([speed]), 0.1)
        given.use(k * PERIOD)
        given.follower.step()
    assert found == []


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=30), st.floats(0.1, 1.0))
def test_who_is_not_reported_is_where_it_was_sent_or_can_stop_there(
    places: list[float], share: float
) -> None:
    given = stream()
    for k, place in enumerate(places):
        given.set_target(np.array([0]), np.array([place]), None, inf)
        given.use(k * PERIOD)
        last = given.follower.step(share)
        away = abs(place - last.position[0])
        stops = float(last.velocity[0] ** 2) / (2.0 * LIMITS.acceleration[0])
        behind, found = given.behind()
        assert behind[0] == pytest.approx(away)
        if away > stops + LATE:
            assert found
        elif found:
            assert np.sign(last.velocity[0]) != np.sign(place - last.position[0])
