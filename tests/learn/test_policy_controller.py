"""The controller: what it sends, and all that makes it hold or end."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from tests.support.policy_world import CARD, PERIOD, POSE, World
from twind.exceptions import InvalidInput
from twind.learn.policy.policy_controller import (
    PATIENCE,
    NoSetpoint,
    PolicyEnd,
    PolicySetpoint,
)
from twind.learn.task.action_shaping import ActionShaper
from twind.learn.task.observation_layout import ObservationLayout
from twind.robot_client.state_message import STALE


@pytest.fixture
def world() -> World:
    return World()


def test_the_sent_setpoint_equals_the_shaper_output_in_simulation(world: World) -> None:
    shaper = ActionShaper(CARD.limits, POSE, CARD.shaping)
    for step in range(60):
        world.action = np.float32([np.sin(0.2 * step), -1.0])
        world.step()
        target, velocity = shaper.step(world.action)
        assert (world.sent[-1].velocity == velocity).all()
        assert np.allclose(world.sent[-1].position + velocity * PERIOD, target, atol=1e-12)


def test_a_policy_that_gives_no_action_ends_the_drive(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_observation: np.ndarray) -> np.ndarray:
        raise InvalidInput("its inference failed")

    world.step()
    monkeypatch.setattr(world, "act", fail)
    end = world.step()
    assert isinstance(end, PolicyEnd) and "its inference failed" in end.reason
    assert len(world.sent) == 1


def test_nothing_jumps_at_the_start(world: World) -> None:
    world.action = np.float32([1.0, -1.0])
    world.step()
    assert np.abs(world.sent[0].position - POSE).max() < 1e-12
    assert np.abs(world.sent[0].velocity).max() <= 20.0 * PERIOD


def test_the_observation_is_of_the_last_action_the_last_target_and_the_phase(world: World) -> None:
    world.action = np.float32([0.5, -0.25])
    world.step()
    world.step()
    at = ObservationLayout(CARD.joints).places
    assert world.seen[at["action"]].tolist() == [0.5, -0.25]
    np.testing.assert_allclose(world.seen[at["phase"]], [1.0, 0.0, -1.0, 0.0], atol=1e-6)
    assert np.allclose(
        world.seen[at["position"]], world.goal * 0 + world.sent[0].velocity * PERIOD, atol=1e-6
    )


@pytest.mark.parametrize("old", [STALE + 0.001, 1.0, nan, -0.01])
def test_an_old_state_holds(world: World, old: float) -> None:
    world.step()
    assert isinstance(world.step(old), NoSetpoint) and "old" in str(world.controller.holding)


@pytest.mark.parametrize(
    ("age", "message"),
    [
        (0.2, "the IMU was read 200 ms ago, bound 50 ms"),
        (398.4, "the IMU is silent for 398 s: its cable and power"),
        (np.inf, "the IMU has not been read yet"),
        (np.nan, "the IMU gave no numbers"),
    ],
)
def test_a_stale_imu_gives_a_message_with_its_age(world: World, age: float, message: str) -> None:
    now = world.state_message()
    assert now.inertial is not None
    assert replace(now, inertial=replace(now.inertial, age=age)).stale(now.time, STALE, ("a", "b")) == message


def test_no_state_at_all_holds(world: World) -> None:
    assert isinstance(world.controller.step(None, world.now), NoSetpoint)


def test_a_lasting_hold_is_the_end(world: World) -> None:
    done = [world.step(STALE + 0.01) for _ in range(round(PATIENCE / PERIOD) + 3)]
    assert isinstance(done[0], NoSetpoint) and isinstance(done[-1], PolicyEnd)
    assert world.controller.figures.holds == 1


@pytest.mark.parametrize("action", [[nan, 0.0], [0.0, 1.001], [0.0, -np.inf]])
def test_an_action_that_is_none_holds(world: World, action: list[float]) -> None:
    world.action = np.float32(action)
    done = world.step()
    assert isinstance(done, NoSetpoint) and "action of" in done.reason and not world.sent
    assert isinstance([world.step() for _ in range(60)][-1], PolicyEnd)


def test_a_reading_that_is_not_finite_holds_and_is_named(world: World) -> None:
    world.gyro = nan
    done = world.step()
    assert isinstance(done, NoSetpoint) and "gyro.x" in done.reason


def test_a_late_action_holds(world: World) -> None:
    world.takes = 0.51 * PERIOD
    done = world.step()
    assert isinstance(done, NoSetpoint) and "late" in done.reason and not world.sent
    assert world.controller.figures.too_late == 1


def test_how_long_it_held_is_counted_over_all_holds(world: World) -> None:
    for number in range(1, 3):
        for _ in range(4):
            assert isinstance(world.step(STALE + 0.01), NoSetpoint)
        world.step()
        assert isinstance(world.step(), PolicySetpoint)  # five periods after the first that it held
        assert world.controller.figures.holds == number
        assert world.controller.figures.held == pytest.approx(number * 5 * PERIOD)


def test_the_policy_resumes_from_the_resting_pose(world: World) -> None:
    world.action = np.float32([1.0, 0.0])
    for _ in range(5):
        world.step()
    assert isinstance(world.step(STALE + 0.01), NoSetpoint)
    assert isinstance(world.step(), NoSetpoint)  # whether it rests is not known yet
    back = world.step()
    assert isinstance(back, PolicySetpoint) and world.controller.holding is None
    assert np.abs(back.position - world.goal + back.velocity * PERIOD).max() < 1e-12
    assert np.abs(back.velocity).max() <= 20.0 * PERIOD


def test_a_repeated_state_does_not_count_as_rest(world: World) -> None:
    world.action = np.float32([1.0, 0.0])
    for _ in range(15):
        world.step()
    world.takes = 0.51 * PERIOD
    assert isinstance(world.step(), NoSetpoint)
    world.takes, moving = 0.0, world.state_message()
    for _ in range(2):  # the stream stalls: fresh enough, and nothing new
        world.now += 0.01
        assert isinstance(world.controller.step(moving, world.now), NoSetpoint)
    near = replace(moving, sequence=moving.sequence + 1, time=moving.time + 0.001)
    assert isinstance(world.controller.step(near, world.now), NoSetpoint)  # too soon after it to tell
    on = replace(moving, sequence=moving.sequence + 2, time=moving.time + 0.02, goal=moving.goal + 0.03)
    assert isinstance(world.controller.step(on, world.now), NoSetpoint)  # it moves
    still = replace(on, sequence=on.sequence + 2, time=on.time + 0.02)
    world.now = still.time
    assert isinstance(world.controller.step(still, world.now), PolicySetpoint)


def test_after_a_missed_period_it_goes_on_from_where_the_loop_has_gone_meanwhile(world: World) -> None:
    world.action = np.float32([1.0, 0.0])
    for _ in range(10):
        world.step()
    last = world.sent[-1]
    world.controller.record_missed_periods(1, lapsed=False)
    assert isinstance(world.step(), PolicySetpoint) and world.controller.figures.holds == 0
    assert last.velocity[0] > 0.2
    np.testing.assert_allclose(
        world.sent[-1].position, last.position + 2 * PERIOD * last.velocity, atol=1e-12
    )


def test_missed_periods_carry_no_target_beyond_its_limits(world: World) -> None:
    world.action = np.float32([1.0, -1.0])
    for _ in range(10):
        world.step()
    world.controller.record_missed_periods(50, lapsed=False)
    shaper = world.controller.shaper
    assert (shaper.target <= shaper.upper + 1e-9).all() and (shaper.target >= shaper.lower - 1e-9).all()
    assert not shaper.velocity.any()


def test_so_many_missed_periods_that_the_setpoint_lapsed_are_a_hold(world: World) -> None:
    world.action = np.float32([1.0, 0.0])
    for _ in range(10):
        world.step()
    world.controller.record_missed_periods(3, lapsed=True)
    assert world.controller.figures.holds == 1 and "3 periods were missed" in str(world.controller.holding)
    world.goal = world.goal + 0.02  # where the loop has braked
    assert isinstance(world.step(), NoSetpoint)
    back = world.step()
    assert isinstance(back, PolicySetpoint)
    assert np.abs(back.position - world.goal + back.velocity * PERIOD).max() < 1e-12


def test_a_robot_out_of_reach_is_the_end(world: World) -> None:
    world.step(STALE + 0.01)
    world.goal = POSE + 0.6
    done = [world.step(), world.step(), world.step()]
    assert isinstance(done[-1], PolicyEnd) and "out of the policy's reach" in done[-1].reason


def test_an_unknown_goal_prevents_resumption(world: World) -> None:
    world.step(STALE + 0.01)
    world.goal = np.array([nan, 0.0])
    found = replace(world.state_message(), position=POSE)
    assert all(isinstance(world.controller.step(found, world.now), NoSetpoint) for _ in range(3))


def test_a_fallen_robot_ends_the_policy(world: World) -> None:
    world.step()
    world.lies = True
    assert isinstance(world.step(), PolicyEnd)
