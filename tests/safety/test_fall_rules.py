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
from twind.safety.fall_rules import FallRules
from twind.safety.guard import Guard
from twind.safety.guard_types import GuardDecision, Reaction

TICK = 0.01
OLD = 0.1  # s, an older reading tells no balance
CALM = 0.08  # rad of tilt and its rate over the next tenth of a second: a smaller lean cannot be a fall
REST = 0.5  # rad/s, that a fallen robot may still turn ...
REST_FOR = 0.3  # s ... for so long
UPRIGHT_FOR = 1.0  # s inside all thresholds
HOLD = FallSettings(FallReaction.HOLD)
LEAN = 2 * CALM  # rad: the capture point is looked at
TINY = 1e-6


class Margin:
    """Stand-in for the capture point: a margin that the test chooses, m."""

    def __init__(self) -> None:
        self.value = 0.05
        self.calls: list[str] = []

    def margin(self, position: object, imu: object) -> float:
        self.calls.append("margin")
        return self.value

    def forget(self) -> None:
        self.calls.append("forget")


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


# ------------------------------------------------------------------------------- one reading at a time


class Readings:
    """The rules alone, on readings at times that the test chooses."""

    def __init__(self, settings: FallSettings = HOLD) -> None:
        self.capture = Margin()
        self.rules = FallRules(settings, self.capture)  # type: ignore[arg-type]

    def judge(
        self,
        now: float,
        tilt: float = 0.0,
        rate: float = 0.0,
        *,
        margin: float = 0.05,
        held: bool = True,
        read: float | None = None,
    ) -> list[ReasonCode]:
        """Codes that the reading of time `read` gives; by default it is taken now."""
        self.capture.value = margin
        quaternion = np.array([cos(tilt / 2), 0.0, sin(tilt / 2), 0.0])
        time = now if read is None else read
        self.last = Imu(time, np.array([0.0, rate, 0.0]), np.zeros(3), quaternion)
        measured = replace(reading(time=now), imu=self.last)
        found = self.rules.judge(facts(now=now, measured=measured, torque_expected=held))
        return [one.finding.code for one in found]

    def without(self, now: float, *, held: bool = True) -> list[ReasonCode]:
        """Codes of a tick without a reading."""
        found = self.rules.judge(facts(now=now, measured=reading(time=now), torque_expected=held))
        return [one.finding.code for one in found]


def test_a_robot_may_fall_from_its_first_reading_on() -> None:
    seen = Readings()
    assert seen.judge(1.0, LEAN, margin=-1.0) == []
    assert seen.judge(1.03, LEAN, margin=-1.0) == [ReasonCode.FALLING]


def test_a_capture_point_exactly_at_its_bound_is_no_fall() -> None:
    seen = Readings()
    seen.judge(1.0, LEAN, margin=-HOLD.outside)
    assert seen.judge(2.0, LEAN, margin=-HOLD.outside) == []


def test_a_tilt_exactly_at_its_bound_is_no_fall() -> None:
    seen = Readings(FallSettings(FallReaction.HOLD, tilt=0.0))
    assert seen.judge(1.0) == []
    assert seen.rules.state is FallState.UPRIGHT


def test_a_fall_is_reported_with_how_far_its_capture_point_is_outside() -> None:
    seen = Readings()
    seen.judge(1.0, LEAN, margin=-0.2)
    seen.judge(1.1, LEAN, margin=-0.2)
    [found] = seen.rules.judge(facts(now=1.1, measured=replace(reading(time=1.1), imu=seen.last)))
    assert (found.finding.value, found.finding.bound) == (0.2, HOLD.outside)


def test_a_lean_that_is_calm_is_no_fall_and_its_velocity_is_not_kept() -> None:
    seen = Readings()
    seen.judge(1.0)
    for now, tilt, rate, looked in (
        (1.1, 0.079, 0.0, False),
        (1.2, 0.081, 0.0, True),
        (1.3, 0.0, 0.79, False),
        (1.4, 0.0, 0.81, True),
        (1.5, 0.05, 0.29, False),
        (1.6, 0.05, 0.31, True),
    ):
        seen.capture.calls.clear()
        assert seen.judge(now, tilt, rate) == []
        assert seen.capture.calls == (["margin"] if looked else ["forget"])


def test_the_time_outside_begins_anew_after_a_calm_reading() -> None:
    seen = Readings()
    seen.judge(1.0)
    seen.judge(1.1, LEAN, margin=-1.0)
    seen.judge(1.12, 0.0, margin=-1.0)
    assert seen.judge(1.14, LEAN, margin=-1.0) == []
    assert seen.judge(1.18, LEAN, margin=-1.0) == [ReasonCode.FALLING]


def test_a_reading_is_judged_once_and_its_result_stays_until_the_next() -> None:
    seen = Readings()
    assert seen.judge(1.0, 1.0) == [ReasonCode.FALLING]
    seen.capture.calls.clear()
    assert seen.judge(1.05, 1.0, read=1.0) == [ReasonCode.FALLING]
    assert seen.capture.calls == []
    assert seen.judge(1.06, 1.0, read=1.0, held=False) == []


def test_a_reading_of_a_tenth_of_a_second_ago_still_counts() -> None:
    seen = Readings()
    seen.judge(0.0, 1.0)
    assert seen.judge(0.1, 1.0, read=0.0) == [ReasonCode.FALLING]
    assert seen.judge(0.101, 1.0, read=0.0) == [ReasonCode.DETECTION_LOST]


@pytest.mark.parametrize("between", ["carried", "lost"])
def test_nothing_that_was_found_before_a_robot_was_carried_or_its_imu_lost_counts_afterwards(
    between: str,
) -> None:
    seen = Readings()
    assert seen.judge(1.0, 1.0, margin=-1.0) == [ReasonCode.FALLING]
    if between == "carried":
        assert seen.judge(1.01, 0.0, held=False) == []
    else:
        assert seen.without(1.01) == [ReasonCode.DETECTION_LOST]
    assert seen.capture.calls[-1] == "forget"
    assert seen.judge(1.02, 1.0, read=1.0) == []
    assert seen.judge(1.03, LEAN, margin=-1.0) == [], "it is outside since now"
    assert seen.judge(1.07, LEAN, margin=-1.0) == [ReasonCode.FALLING]


def test_the_rest_of_a_fallen_robot_counts_from_its_last_turn() -> None:
    for rate, state in ((REST, FallState.FALLEN), (REST + TINY, FallState.FALLING)):
        seen = Readings()
        seen.judge(1.0, 1.0, 2.0)
        seen.judge(1.1, 1.5, rate)
        seen.judge(1.4 - TINY, 1.5, rate)
        assert seen.rules.state is FallState.FALLING
        seen.judge(1.4, 1.5, rate)
        assert seen.rules.state is state


@pytest.mark.parametrize(
    ("tilt", "margin", "stands"),
    [(0.0, 0.0, True), (0.0, -TINY, False), (0.3 - TINY, 0.1, True), (0.3 + TINY, 0.1, False)],
)
def test_a_fallen_robot_stands_again_after_a_second_inside_all_thresholds(
    tilt: float, margin: float, stands: bool
) -> None:
    seen = Readings()
    seen.judge(1.0, 1.0, 2.0)
    seen.judge(1.2, tilt, 2.0, margin=margin)
    seen.judge(2.2 - TINY, tilt, 2.0, margin=margin)
    assert seen.rules.state is FallState.FALLING
    seen.judge(2.2, tilt, 2.0, margin=margin)
    assert seen.rules.state is (FallState.UPRIGHT if stands else FallState.FALLING)


def test_a_bound_of_no_tilt_is_met_by_a_robot_without_any() -> None:
    seen = Readings(FallSettings(FallReaction.HOLD, upright=0.0))
    seen.judge(1.0, held=False)
    assert seen.rules.state is FallState.UPRIGHT
    seen.judge(1.1, 1.0)
    seen.judge(1.2, 0.0, 2.0)
    seen.judge(2.3, 0.0, 2.0)
    assert seen.rules.state is FallState.UPRIGHT


@pytest.mark.parametrize(("tilt", "state"), [(0.3 - TINY, FallState.UPRIGHT), (0.3 + TINY, FallState.FALLEN)])
def test_a_robot_without_torque_stands_or_lies_by_its_tilt(tilt: float, state: FallState) -> None:
    seen = Readings()
    seen.judge(1.0, tilt, held=False)
    assert seen.rules.state is state


def test_the_imu_of_a_robot_that_lies_is_missed_too() -> None:
    seen = Readings()
    seen.judge(1.0, 1.0, held=False)
    [lies] = seen.rules.bars
    seen.without(1.1, held=False)
    assert seen.rules.state is FallState.UNKNOWN
    [silent] = seen.rules.bars
    assert "no reading" in silent.message and "no reading" not in lies.message
    assert (silent.code, silent.value, silent.bound) == (ReasonCode.FALLING, None, None)


@pytest.mark.parametrize("unknown", [False, True])
def test_a_robot_is_not_armed_before_its_imu_is_read(unknown: bool) -> None:
    """Nor where its balance was not known before the IMU was lost."""
    seen = Readings()
    if unknown:
        assert seen.judge(1.0, LEAN, margin=nan) == [ReasonCode.DETECTION_LOST]
    seen.without(1.1, held=False)
    assert [finding.code for finding in seen.rules.bars] == [ReasonCode.FALLING]


@given(st.floats(allow_nan=True), st.floats(allow_nan=True))
def test_no_number_of_the_imu_raises(tilt: float, rate: float) -> None:
    robot = Robot()
    robot.capture.value = rate
    with np.errstate(all="ignore"):
        quaternion = np.array([tilt, rate, 0.0, 1.0])
        made = Imu(robot.now + TICK, np.full(3, rate), np.zeros(3), quaternion)
        robot.guard.judge(facts(now=robot.now + TICK, measured=replace(reading(), imu=made)))
    assert isnan(tilt) or isnan(rate) or robot.falls.state is not FallState.UNKNOWN
