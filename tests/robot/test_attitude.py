"""The tilt of a body from gyro and accelerometer, against rotations worked out by another route."""

from math import acos, cos, degrees, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.robot.arrays import Floats
from twind.robot.attitude import UPRIGHT, Attitude, Quaternion, conjugate, matrix, product, unit, up

G = 9.80665  # m/s²
GAP = 0.2  # s, from which on the tilt is taken anew
BIAS = 0.1  # rad/s, the largest that is corrected
STEP = 0.01  # s
ANGLES = st.floats(-pi, pi)


def turn(axis: Floats, angle: float) -> Floats:
    """Rodrigues' formula: shares nothing with quaternions."""
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + sin(angle) * skew + (1 - cos(angle)) * skew @ skew


def pose(roll: float, pitch: float, yaw: float) -> Floats:
    """The body's axes in the world (3, 3)."""
    x, y, z = np.eye(3)
    return turn(z, yaw) @ turn(y, pitch) @ turn(x, roll)


def astray(quaternion: Quaternion, stands: Floats) -> float:
    """Angle (rad) between where up is and where the quaternion has it: the tilt, whatever the heading."""
    return acos(float(np.clip(np.array(up(quaternion)) @ stands.T @ [0, 0, 1], -1, 1)))


def fed(
    filter: Attitude, stands: Floats, seconds: float, *, since: float = 0.0, gyro: Floats | None = None
) -> Attitude:
    """A body at rest there, and what its gyro makes of that."""
    told = np.zeros(3) if gyro is None else gyro
    for step in range(round(seconds / STEP)):
        filter.update(told, G * stands.T @ [0.0, 0.0, 1.0], since + step * STEP)
    return filter


@given(ANGLES, st.floats(-1.5, 1.5), ANGLES)
def test_a_constant_tilt_is_known_from_the_first_reading(roll: float, pitch: float, yaw: float) -> None:
    stands = pose(roll, pitch, yaw)
    assert astray(fed(Attitude(), stands, STEP).quaternion, stands) < 1e-6


@examples(20)
@given(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))
def test_a_wrong_initial_tilt_converges_to_the_true_one(roll: float, pitch: float) -> None:
    """It was told another one, and no gyro told that the body turned: 10 time constants later it is right."""
    filter = fed(Attitude(), pose(0.5, -0.4, 0.0), 0.1)
    stands = pose(roll, pitch, 0.0)
    fed(filter, stands, 30.0, since=0.1)
    assert astray(filter.quaternion, stands) < radians(1.0)


@examples(10)
@given(st.tuples(*[st.floats(-0.05, 0.05)] * 3), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_the_drift_of_the_tilt_is_bounded_and_the_bias_learnt(
    bias: tuple[float, float, float], roll: float, pitch: float
) -> None:
    """A gyro that tells 3 degrees a second at rest: without correction a minute would be half a turn."""
    stands = pose(roll, pitch, 0.3)
    filter = Attitude()
    worst = 0.0
    for part in range(60):
        fed(filter, stands, 1.0, since=float(part), gyro=np.array(bias))
        worst = max(worst, astray(filter.quaternion, stands))
    assert worst < 1.5 * float(np.linalg.norm(bias)) + 1e-6, "bias over pull, rad"
    assert astray(filter.quaternion, stands) < radians(0.05)


def test_a_bias_beyond_belief_is_not_learnt() -> None:
    filter = fed(Attitude(), np.eye(3), 120.0, gyro=np.array([1.0, 0.0, 0.0]))
    assert filter.bias == pytest.approx((BIAS, 0.0, 0.0))


@examples(20)
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_a_turn_is_followed_by_the_gyro_alone(rate: tuple[float, float, float]) -> None:
    """The accelerometer says nothing (free fall): 1 s at a constant rate is one rotation about its axis."""
    filter = fed(Attitude(), np.eye(3), STEP)
    for step in range(100):
        filter.update(np.array(rate), np.zeros(3), (step + 1) * STEP)
    speed = float(np.linalg.norm(rate))
    wanted = turn(np.array(rate), speed) if speed > 0 else np.eye(3)
    assert matrix(filter.quaternion) == pytest.approx(wanted, abs=1e-6)


def test_yaw_is_the_integral_of_the_gyro() -> None:
    filter = fed(Attitude(), np.eye(3), 2.0, gyro=np.array([0.0, 0.0, 0.5]))
    forward = matrix(filter.quaternion) @ [1.0, 0.0, 0.0]
    assert degrees(np.arctan2(forward[1], forward[0])) == pytest.approx(degrees(0.5 * (2.0 - STEP)), abs=0.1)


def test_a_short_sideways_acceleration_does_not_change_the_tilt() -> None:
    """A push of 5 m/s² sideways for 0.3 s leaves the tilt where the gyro has it."""
    filter = fed(Attitude(), np.eye(3), 1.0)
    for step in range(30):
        filter.update(np.zeros(3), np.array([8.0, 0.0, G]), 1.0 + step * STEP)
    assert astray(filter.quaternion, np.eye(3)) < radians(0.01)


@examples(30)
@given(
    st.tuples(ANGLES, st.floats(-1.4, 1.4), ANGLES),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    st.sampled_from([(1.0, 1.0), (1.1, 0.5), (0.95, 0.75), (1.19, 0.05), (0.79, 0.0), (1.3, 0.0)]),
)
def test_the_accelerometer_pulls_the_tilt_within_a_second_and_the_bias_within_ten(
    stood: tuple[float, float, float], off: tuple[float, float, float], trusted: tuple[float, float]
) -> None:
    """One reading of 0.1 s: by that share of the angle, and less the farther its size is from one g."""
    size, sure = trusted
    stands, seems = pose(*stood), pose(*(one + other for one, other in zip(stood, off, strict=True)))
    filter = fed(Attitude(), stands, STEP)
    before = matrix(filter.quaternion)
    gravity = seems.T @ [0.0, 0.0, 1.0]
    error = np.cross(gravity, before.T @ [0.0, 0.0, 1.0])
    assert filter.update(np.zeros(3), size * G * gravity, 0.1) == filter.quaternion
    assert filter.bias == pytest.approx((-0.1 * sure * 0.1 * error).tolist(), abs=1e-12)
    rate = 1.0 * sure * error - filter.bias
    speed = float(np.linalg.norm(rate))
    wanted = before @ turn(rate, 0.1 * speed) if speed > 0.0 else before
    assert matrix(filter.quaternion) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("size", "known"), [(0.79, False), (0.81, True), (1.19, True), (1.21, False)])
def test_a_fifth_of_g_off_is_no_direction_of_gravity(size: float, known: bool) -> None:
    filter = Attitude()
    found = filter.update(np.zeros(3), np.array([0.0, size * G, 0.0]), 0.0)
    assert (found is not None) == known
    assert found is None or up(found) == pytest.approx((0.0, 1.0, 0.0))


@pytest.mark.parametrize(("later", "anew"), [(GAP, False), (GAP + 0.01, True)])
def test_a_gap_is_longer_than_a_fifth_of_a_second(later: float, anew: bool) -> None:
    stands = pose(0.0, 0.7, 0.0)
    filter = Attitude()
    filter.update(np.zeros(3), np.array([0.0, 0.0, G]), 0.0)
    filter.update(np.zeros(3), G * stands.T @ [0.0, 0.0, 1.0], later)
    assert (astray(filter.quaternion, stands) < 1e-6) == anew


def test_after_a_gap_the_tilt_is_taken_anew_and_the_heading_kept() -> None:
    filter = fed(Attitude(), pose(0.0, 0.0, 0.0), 2.0, gyro=np.array([0.0, 0.0, 0.5]))
    before = matrix(filter.quaternion)[:, 0]
    stands = pose(0.0, 0.7, 0.0)
    fed(filter, stands, STEP, since=2.0 + 2 * GAP)
    assert astray(filter.quaternion, stands) < 1e-6
    after = matrix(filter.quaternion)[:, 0]
    assert np.arctan2(after[1], after[0]) == pytest.approx(np.arctan2(before[1], before[0]), abs=1e-6)


@pytest.mark.parametrize("force", [(0.3, 0.0, 0.05), (0.0, 0.0, 0.0), (9.0, 0.0, G), (0.0, 0.0, 3.0 * G)])
def test_at_first_and_after_a_gap_there_is_no_attitude_until_it_feels_one_g(force: tuple[float, ...]) -> None:
    """A body that falls, is pushed or lands is not taken for one that lies as its accelerometer has it."""
    filter = Attitude()
    for step in range(10):
        assert filter.update(np.zeros(3), np.array(force), step * STEP) is None
    stands = pose(0.0, 0.4, 0.0)
    fed(filter, stands, STEP, since=0.1)
    assert astray(filter.quaternion, stands) < 1e-6
    for step in range(10):
        assert filter.update(np.zeros(3), np.array(force), 0.1 + 2 * GAP + step * STEP) is None
    assert filter.update(np.zeros(3), np.array(force), 0.2) is None, "of no later time"
    same = 0.1 + 2 * GAP + 9 * STEP
    assert filter.update(np.zeros(3), np.array([0.0, 0.0, G]), same) is None, "nor of the same"
    fed(filter, np.eye(3), STEP, since=1.0)
    assert astray(filter.quaternion, np.eye(3)) < 1e-6


@pytest.mark.parametrize("force", [(0.0, 0.0, -G), (0.0, -G, 0.0), (-G, 0.0, 0.0)])
def test_head_down_is_a_tilt_as_any_other(force: tuple[float, float, float]) -> None:
    filter = Attitude()
    filter.update(np.zeros(3), np.array(force), 0.0)
    assert np.array(up(filter.quaternion)) == pytest.approx(np.array(force) / G, abs=1e-9)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_body_that_was_turned_over_in_a_gap_is_head_down(axis: int, sign: float) -> None:
    force = sign * G * np.eye(3)[axis]
    filter = Attitude()
    filter.update(np.zeros(3), force, 0.0)
    filter.update(np.zeros(3), -force, 1.0)
    assert np.array(up(filter.quaternion)) == pytest.approx(-force / G, abs=1e-9)


def test_a_first_reading_that_is_not_finite_gives_no_attitude() -> None:
    assert Attitude().update(np.full(3, np.nan), np.array([0.0, 0.0, G]), 0.0) is None


@pytest.mark.parametrize("broken", [(0.0, 0.0, 0.0, 0.0), (np.inf, 0.0, 0.0, 1.0), (1.0, np.nan, 0.0, 0.0)])
def test_what_has_no_length_is_scaled_to_upright(broken: Quaternion) -> None:
    assert unit(broken) == UPRIGHT


@pytest.mark.parametrize(
    ("gyro", "force"), [((np.nan, 0, 0), (0, 0, G)), ((0, 0, 0), (np.inf, 0, G)), ((0, 0, 0), (0, 0, 0))]
)
def test_an_invalid_reading_does_not_change_the_attitude(
    gyro: tuple[float, ...], force: tuple[float, ...]
) -> None:
    filter = fed(Attitude(), pose(0.3, 0.2, 0.0), 1.0)
    before = filter.quaternion
    filter.update(np.array(gyro, float), np.array(force, float), 2.0 if force[2] else 1.0)
    assert np.array(filter.quaternion) == pytest.approx(before, abs=1e-12)
    fed(filter, pose(0.3, 0.2, 0.0), 0.05, since=1.01)
    assert np.isfinite(filter.quaternion).all()


def test_a_reading_of_no_later_time_changes_nothing() -> None:
    filter = fed(Attitude(), np.eye(3), 1.0)
    before = filter.quaternion
    assert filter.update(np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, G]), 0.5) == before


@given(ANGLES, ANGLES, ANGLES)
def test_there_and_back_is_upright(roll: float, pitch: float, yaw: float) -> None:
    half = [(cos(a / 2), sin(a / 2)) for a in (roll, pitch, yaw)]
    one = product((half[2][0], 0.0, 0.0, half[2][1]), (half[1][0], 0.0, half[1][1], 0.0))
    one = product(one, (half[0][0], half[0][1], 0.0, 0.0))
    assert matrix(one) == pytest.approx(pose(roll, pitch, yaw), abs=1e-9)
    assert np.array(product(one, conjugate(one))) == pytest.approx(UPRIGHT, abs=1e-12)
