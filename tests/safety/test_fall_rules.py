"""FALLING: dense around each threshold; a robot without torque may lie as it likes."""

from dataclasses import replace
from math import cos, isnan, nan, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import LIMITS, facts, reading
from twind.robot.fall_settings import FallReaction, FallSettings, FallState
from twind.robot.finding import ReasonCode
from twind.robot.joint_state import Imu
from twind.robot.modes import RobotState
from twind.safety.fall_rules import CALM, OLD, REST, REST_FOR, UPRIGHT_FOR, FallRules
from twind.safety.guard import Guard
from twind.safety.guard_types import GuardDecision, Reaction

TICK = 0.01
HOLD = FallSettings(FallReaction.HOLD)
LEAN = 2 * CALM  # rad: the capture point is looked at
TINY = 1e-6


class Margin:
    """Stand-in for the capture point: a margin that the test chooses, m."""

    def __init__(self) -> None:
        self.value = 0.05

    def margin(self, position: object, imu: object) -> float:
        return self.value

    def forget(self) -> None: ...


class Robot:
    """A guard with fall detection, and time that passes tick by tick."""

    def __init__(self, settings: FallSettings = HOLD) -> None:
        self.capture = Margin()
        self.falls = FallRules(settings, self.capture)  # type: ignore[arg-type]
        self.guard = Guard(LIMITS, falls=self.falls)
        self.now = 10.0
        self.state = RobotState.ARMED
        self.step()

    def step(
        self, tilt: float = 0.0, rate: float = 0.0, *, held: bool = True, age: float = 0.0, imu: bool = True
    ) -> GuardDecision:
        """One tick with this reading of the IMU."""
        self.now += TICK
        state = reading(time=self.now)
        if imu:
            quaternion = np.array([cos(tilt / 2), 0.0, sin(tilt / 2), 0.0])
            made = Imu(self.now - age, np.array([0.0, rate, 0.0]), np.zeros(3), quaternion)
            state = replace(state, imu=made)
        read = np.full(3, self.now)
        decision = self.guard.judge(
            facts(now=self.now, state=self.state, measured=state, torque_expected=held, status_time=read)
        )
        if decision.latches:
            self.state = RobotState.FAULT
        return decision

    def steps(self, seconds: float, tilt: float = 0.0, rate: float = 0.0) -> list[GuardDecision]:
        return [self.step(tilt, rate) for _ in range(round(seconds / TICK))]


def fell(decision: GuardDecision) -> bool:
    return ReasonCode.FALLING in {finding.code for finding in (*decision.findings, *decision.causes)}


@pytest.mark.parametrize(("margin", "falls"), [(-0.03 - TINY, True), (-0.03 + TINY, False), (nan, False)])
def test_a_capture_point_outside_for_a_while_is_a_fall(margin: float, falls: bool) -> None:
    robot = Robot()
    robot.capture.value = margin
    before = robot.steps(HOLD.seconds, LEAN)
    assert not any(map(fell, before))
    assert fell(robot.step(LEAN)) == falls
    state = FallState.UNKNOWN if isnan(margin) else FallState.UPRIGHT
    assert robot.falls.state is (FallState.FALLING if falls else state)


def test_an_unknown_capture_point_is_reported_while_the_robot_leans() -> None:
    robot = Robot()
    robot.capture.value = nan
    assert not robot.step(0.0).findings
    assert [finding.code for finding in robot.step(LEAN).findings] == [ReasonCode.DETECTION_LOST]
    robot.capture.value = 0.05
    robot.step(LEAN)
    assert robot.falls.state is FallState.UPRIGHT


def test_a_fallen_robot_does_not_stand_before_its_capture_point_is_known() -> None:
    robot = Robot()
    robot.step(1.0)
    robot.capture.value = nan
    robot.steps(2 * UPRIGHT_FOR)
    assert robot.falls.state is not FallState.UPRIGHT


def test_a_silent_imu_is_reported_once_under_torque_only() -> None:
    robot = Robot()
    codes = [finding.code for _ in range(50) for finding in robot.step(imu=False).findings]
    assert codes == [ReasonCode.DETECTION_LOST]
    assert not robot.step(imu=False, held=False).findings


def test_a_capture_point_that_returns_in_time_is_none() -> None:
    robot = Robot()
    for _ in range(5):
        robot.capture.value = -0.1
        robot.steps(HOLD.seconds, LEAN)
        robot.capture.value = 0.0
        robot.step(LEAN)
    assert robot.falls.state is FallState.UPRIGHT


@pytest.mark.parametrize(("tilt", "falls"), [(HOLD.tilt - TINY, False), (HOLD.tilt + TINY, True)])
def test_a_large_tilt_is_a_fall_even_where_the_capture_point_is_unknown(tilt: float, falls: bool) -> None:
    robot = Robot()
    robot.capture.value = nan
    decision = robot.step(tilt)
    assert fell(decision) == falls
    if falls:
        assert (decision.findings[0].value, decision.findings[0].bound) == (pytest.approx(tilt), HOLD.tilt)


@pytest.mark.parametrize(
    ("reaction", "expected"),
    [
        (FallReaction.HOLD, Reaction.HOLD),
        (FallReaction.SOFT, Reaction.DAMP),
        (FallReaction.FOLD, Reaction.SETTLE),
    ],
)
def test_the_reaction_is_the_one_of_the_file_and_latches(reaction: FallReaction, expected: Reaction) -> None:
    robot = Robot(FallSettings(reaction))
    decision = robot.step(1.0)
    assert decision.latches
    assert decision.reaction is expected


def test_a_fallen_robot_is_reported_once_more_and_stands_again_after_a_while() -> None:
    robot = Robot()
    robot.step(1.0, 2.0)
    assert not any(decision.findings for decision in robot.steps(0.5, 1.5, REST + TINY))
    assert robot.falls.state is FallState.FALLING
    resting = robot.steps(REST_FOR + 2 * TICK, 1.5)
    assert [finding.bound for decision in resting for finding in decision.findings] == [HOLD.upright]
    assert robot.falls.state is FallState.FALLEN
    robot.steps(UPRIGHT_FOR - TICK)
    assert robot.falls.state is FallState.FALLEN
    robot.steps(2 * TICK)
    assert robot.falls.state is FallState.UPRIGHT


@given(st.lists(st.floats(0.0, 3.1), min_size=1, max_size=20))
def test_without_torque_no_tilt_is_an_event_and_only_an_upright_robot_is_armed(tilts: list[float]) -> None:
    robot = Robot()
    for tilt in tilts:
        decision = robot.step(tilt, 5.0, held=False)
        assert not decision.findings
        assert bool(robot.guard.bars) == (tilt > HOLD.upright)


def test_an_imu_that_is_silent_ends_detection_and_refuses_arming() -> None:
    robot = Robot()
    assert not fell(robot.step(2.0, age=OLD + TINY))
    assert robot.falls.state is FallState.UNKNOWN
    assert [finding.code for finding in robot.guard.bars] == [ReasonCode.FALLING]
    robot.step(imu=False, held=False)
    assert robot.falls.state is FallState.UNKNOWN
    robot.step()
    assert robot.falls.state is FallState.UPRIGHT
    assert robot.guard.bars == ()


@given(st.floats(allow_nan=True), st.floats(allow_nan=True))
def test_no_number_of_the_imu_raises(tilt: float, rate: float) -> None:
    robot = Robot()
    robot.capture.value = rate
    with np.errstate(all="ignore"):
        quaternion = np.array([tilt, rate, 0.0, 1.0])
        made = Imu(robot.now + TICK, np.full(3, rate), np.zeros(3), quaternion)
        robot.guard.judge(facts(now=robot.now + TICK, measured=replace(reading(), imu=made)))
    assert isnan(tilt) or isnan(rate) or robot.falls.state is not FallState.UNKNOWN
