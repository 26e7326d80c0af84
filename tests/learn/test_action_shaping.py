"""Targets of actions: within the limits of the robot file, and followed unaltered by the loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.learn.task.action_shaping import ActionShaper, ActionShaping
from twind.motion.stop_profiles import LimitedFollower, still
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits

TICK = 0.01  # s, of a loop at 100 Hz
ROUNDING = 1e-9


def limits(rng: np.random.Generator, n: int) -> JointLimits:
    """Any joints: wide and narrow, fast and slow."""
    lower = -rng.uniform(0.05, 3.0, n)
    upper = rng.uniform(0.05, 3.0, n)
    velocity = rng.uniform(0.2, 10.0, n)
    acceleration = rng.uniform(2.0, 60.0, n)
    return JointLimits(lower, upper, lower - 0.05, upper + 0.05, velocity, acceleration, np.ones(n))


def actions(rng: np.random.Generator, steps: int, n: int) -> Floats:
    """Bang-bang for a while, noise for a while, held for a while; also beyond what is allowed."""
    held = np.repeat(rng.uniform(-1.5, 1.5, (steps, n)), rng.integers(1, 20), axis=0)[:steps]
    held[: steps // 3] = np.sign(held[: steps // 3])
    return held


def drawn(seed: int) -> tuple[np.random.Generator, JointLimits, Floats]:
    """Random numbers, and limits and a default pose of six joints drawn by them."""
    rng = np.random.default_rng(seed)
    bounds = limits(rng, 6)
    return rng, bounds, rng.uniform(bounds.lower, bounds.upper)


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 1.0), st.floats(0.1, 1.0), st.floats(0.1, 1.0))
@examples(60)
def test_targets_keep_position_velocity_and_acceleration(
    seed: int, smoothing: float, velocity_share: float, acceleration_share: float
) -> None:
    rng, bounds, default = drawn(seed)
    shaping = ActionShaping(
        smoothing=smoothing, velocity_share=velocity_share, acceleration_share=acceleration_share
    )
    shaper = ActionShaper(bounds, default, shaping)
    before = default.copy()
    speed = np.zeros(6)
    for action in actions(rng, 150, 6):
        target, velocity = shaper.step(action)
        assert (target >= bounds.lower - ROUNDING).all() and (target <= bounds.upper + ROUNDING).all()
        assert (np.abs(target - default) <= shaping.reach + ROUNDING).all()
        assert (np.abs(velocity) <= bounds.velocity * velocity_share + ROUNDING).all()
        most = bounds.acceleration * acceleration_share * shaping.period
        assert (np.abs(velocity - speed) <= most + ROUNDING).all()
        np.testing.assert_allclose(target - velocity * shaping.period, before, atol=ROUNDING)
        before = target.copy()
        speed = velocity.copy()


@given(st.integers(0, 2**32 - 1), st.sampled_from([ActionShaping(), ActionShaping(smoothing=1.0)]))
@examples(30)
def test_the_loop_s_follower_goes_exactly_where_the_targets_are(seed: int, shaping: ActionShaping) -> None:
    rng, bounds, default = drawn(seed)
    shaper = ActionShaper(bounds, default, shaping)
    follower = LimitedFollower(still(default), bounds, TICK)
    for action in actions(rng, 150, 6):
        target, velocity = shaper.step(action)
        follower.set_target(target - velocity * shaper.shaping.period, velocity)
        follower.step()
        np.testing.assert_allclose(follower.step().position, target, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 1.0), st.floats(0.1, 1.0), st.integers(1, 3))
@examples(60)
def test_missed_periods_leave_targets_within_the_limits(
    seed: int, smoothing: float, acceleration_share: float, longest: int
) -> None:
    rng, bounds, default = drawn(seed)
    shaping = ActionShaping(smoothing=smoothing, acceleration_share=acceleration_share)
    shaper = ActionShaper(bounds, default, shaping)
    for action in actions(rng, 150, 6):
        shaper.step(action)
        if rng.random() < 0.3:
            shaper.coast(int(rng.integers(1, longest + 1)))
        target = shaper.target
        assert (target >= bounds.lower - ROUNDING).all() and (target <= bounds.upper + ROUNDING).all()
        assert (np.abs(shaper.velocity) <= bounds.velocity + ROUNDING).all()


def test_a_small_step_is_smoothed_with_one_pole() -> None:
    wide = np.full(1, 3.0)
    bounds = JointLimits(-wide, wide, -wide, wide, wide, 10.0 * wide, wide)
    shaper = ActionShaper(bounds, np.zeros(1), ActionShaping(smoothing=0.5))
    goal = 1e-4
    left = [goal - float(shaper.step(np.array([goal / 0.5]))[0][0]) for _ in range(5)]
    np.testing.assert_allclose(left, goal * 0.5 ** np.arange(1, 6), rtol=1e-3)


def test_many_robots_are_shaped_as_each_alone() -> None:
    rng = np.random.default_rng(7)
    bounds = limits(rng, 4)
    default = np.zeros(4)
    together = ActionShaper(bounds, default, ActionShaping(), (3,))
    alone = [ActionShaper(bounds, default, ActionShaping()) for _ in range(3)]
    for _ in range(40):
        action = rng.uniform(-1.0, 1.0, (3, 4))
        target, velocity = together.step(action)
        for row, one in enumerate(alone):
            np.testing.assert_array_equal(target[row], one.step(action[row])[0])
            np.testing.assert_array_equal(velocity[row], one.velocity)
    together.reset(at=[1])
    np.testing.assert_array_equal(together.target[1], default)
    np.testing.assert_array_equal(together.target[0], alone[0].target)


def test_no_action_holds_the_default_pose() -> None:
    rng = np.random.default_rng(8)
    bounds = limits(rng, 4)
    default = np.zeros(4)
    shaper = ActionShaper(bounds, default, ActionShaping())
    target, velocity = shaper.step(np.zeros(4))
    np.testing.assert_array_equal(target, default)
    np.testing.assert_array_equal(velocity, np.zeros(4))


def test_a_start_away_from_the_pose_returns_to_it_within_the_limits() -> None:
    rng = np.random.default_rng(9)
    bounds = limits(rng, 4)
    default = np.zeros(4)
    shaper = ActionShaper(bounds, default, ActionShaping())
    shaper.reset(bounds.upper.copy())
    np.testing.assert_array_equal(shaper.target, bounds.upper)
    for _ in range(1500):
        target, velocity = shaper.step(np.zeros(4))
        assert (np.abs(velocity) <= bounds.velocity).all()
        assert (target <= bounds.upper + ROUNDING).all()
    np.testing.assert_allclose(target, default, atol=1e-6)


def test_an_action_that_is_no_number_gives_no_target() -> None:
    rng = np.random.default_rng(9)
    shaper = ActionShaper(limits(rng, 2), np.zeros(2), ActionShaping())
    assert np.isnan(shaper.step(np.array([np.nan, 0.0]))[0]).tolist() == [True, False]


@pytest.mark.parametrize(
    "wrong",
    [{"smoothing": 1.1}, {"smoothing": 0.0}, {"velocity_share": 1.1}, {"reach": 0.0}, {"margin": -0.1}],
)
def test_figures_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"shares|smoothing|reach|margin"):
        ActionShaping(**wrong)


def test_a_default_pose_outside_the_limits_is_refused_by_its_joint() -> None:
    bounds = limits(np.random.default_rng(1), 3)
    with pytest.raises(ValueError, match="joint 2: default pose 4 rad is outside"):
        ActionShaper(bounds, np.array([0.0, 0.0, 4.0]), ActionShaping())
