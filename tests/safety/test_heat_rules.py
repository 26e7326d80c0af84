"""OVERTEMP: three readings of five make a warm joint, one makes none; slower, lowered, and cool again."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import FINE, LIMITS, PERIOD, TINY, N, codes, facts, joints, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import Guard, GuardDecision, Reaction

SETTLE = Reaction.SETTLE
NONE = Reaction.NONE
RATED = replace(
    ActuatorRatings.unknown(N),
    warm=np.full(N, 60.0),
    hot=np.full(N, 65.0),
    shut=np.full(N, 70.0),
    cool=np.full(N, 55.0),
)


class Watch:
    """A guard on a gantry whose temperatures are read five times a second."""

    def __init__(self, **usual: object) -> None:
        self.guard = Guard(LIMITS, support="gantry", ratings=RATED)
        self.now = 10.0
        self.usual = usual

    def read(self, *celsius: float, dt: float = 0.2, **over: object) -> GuardDecision:
        self.now += dt
        usual = {
            "now": self.now,
            "period": dt,
            "measured": reading(time=self.now),
            "temperature": np.array(celsius),
            "health_time": np.full(N, self.now),
        }
        return self.guard.judge(facts(**(usual | self.usual | over)))

    def row(self, *celsius: float, **over: object) -> list[GuardDecision]:
        """One reading of joint 1 after the other."""
        return [self.read(30.0, each, 30.0, **over) for each in celsius]


def levels(found: list[GuardDecision]) -> list[Finding]:
    """Without what is said of one reading alone, and of the slope."""
    said = [finding for one in found for finding in one.findings if finding.code is ReasonCode.OVERTEMP]
    return [one for one in said if "not used" not in one.message and "°C/s" not in one.message]


@pytest.mark.parametrize(
    ("celsius", "bound", "reaction", "pace"),
    [
        (60.0 - TINY, None, NONE, 1.0),
        (60.0, 60.0, NONE, 1.0),
        (65.0 - TINY, 60.0, NONE, 1.0),
        (65.0, 65.0, NONE, 0.5),
        (70.0 - TINY, 65.0, NONE, 0.5),
        (70.0, 70.0, SETTLE, 1.0),
        (90.0, 70.0, SETTLE, 1.0),
        (255.0, 70.0, SETTLE, 1.0),
        (inf, None, NONE, 1.0),  # no thermometer reads that: OVERTEMP has no reading
        (nan, None, NONE, 1.0),
    ],
)
def test_overtemp_a_warm_joint_is_reported_a_hot_one_slowed_and_a_hotter_one_lowered(
    celsius: float, bound: float | None, reaction: Reaction, pace: float
) -> None:
    watch = Watch()
    found = watch.row(30.0, 30.0, 30.0, celsius, celsius)
    assert levels(found) == []
    assert {one.reaction for one in found} == {NONE}
    last = watch.row(celsius)[0]
    assert (last.reaction, last.latches, last.pace) == (reaction, bool(reaction), pace)
    assert [(one.joint, one.bound) for one in levels([last])] == ([] if bound is None else [(1, bound)])


@pytest.mark.parametrize(
    ("row", "trips"),
    [
        ([80, 80], False),
        ([80, 80, 80], True),
        ([80, 30, 80, 30], False),
        ([80, 30, 80, 30, 80], True),
        ([80, 80, 30, 30, 80], True),
        ([80, 80, 30, 30, 30, 80], False),
    ],
)
def test_overtemp_three_of_five(row: list[float], trips: bool) -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    assert (watch.row(*row)[-1].reaction is SETTLE) is trips


@given(st.lists(st.integers(20, 90), min_size=5, max_size=40))
def test_overtemp_the_vote_is_that_of_an_oracle(row: list[int]) -> None:
    watch = Watch()
    for count, found in enumerate(watch.row(*map(float, row)), 1):
        last = [each for each in row[max(0, count - 5) : count] if each >= 70]
        assert (found.reaction is SETTLE) is (len(last) >= 3)


def test_overtemp_a_reading_counts_once_however_often_it_is_seen() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    watch.row(80.0)
    same = np.full(N, watch.now)
    for _ in range(200):
        found = watch.read(30.0, 80.0, 30.0, dt=PERIOD, health_time=same)
        assert found.reaction is NONE


def test_overtemp_each_joint_counts_its_own_readings() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    for _ in range(4):  # joint 0 is read anew, joint 1 is not
        stamps = joints(watch.now + 0.2, watch.now - 1.0, watch.now + 0.2)
        first = watch.read(30.0, 80.0, 30.0, health_time=stamps)
        watch.read(30.0, 80.0, 30.0, health_time=joints(watch.now + 0.2, stamps[1], watch.now + 0.2))
    assert first.reaction is SETTLE  # three new readings of it by now


def test_overtemp_who_is_not_read_anew_counts_no_more_however_often_the_others_are() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    watch.row(80.0)
    once = watch.now
    for _ in range(9):  # 1.8 s: VOLTAGE tells of who is not read for two
        stamps = joints(watch.now + 0.2, once, watch.now + 0.2)
        assert watch.read(30.0, 80.0, 30.0, health_time=stamps) == FINE


def test_overtemp_who_was_never_read_is_neither_hot_nor_cold() -> None:
    watch = Watch()
    for _ in range(9):
        stamps = joints(watch.now + 0.2, watch.now + 0.2, -inf)
        assert watch.read(30.0, 30.0, 90.0, health_time=stamps) == FINE
        assert watch.guard.bars == ()


def test_overtemp_a_spike_is_reported_and_changes_nothing() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    spike, *after = watch.row(120.0, *[30.0] * 10)
    assert (spike.reaction, spike.pace, spike.latches) == (NONE, 1.0, False)
    (finding,) = spike.findings
    assert (finding.code, finding.joint, finding.value, finding.bound) == (
        ReasonCode.OVERTEMP,
        1,
        120.0,
        40.0,
    )
    assert "not used" in finding.message
    assert after == [FINE] * 10


@pytest.mark.parametrize(("celsius", "reported"), [(40.0, False), (40.0 + TINY, True)])
def test_overtemp_ten_degrees_more_than_the_others_are_a_spike(celsius: float, reported: bool) -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    assert bool(watch.row(celsius)[0].findings) is reported


def test_overtemp_before_there_are_three_readings_nothing_is_compared() -> None:
    assert Watch().row(90.0, 90.0) == [FINE, FINE]
    assert Watch().row(90.0, 90.0, 90.0)[-1].reaction is SETTLE


@pytest.mark.parametrize(
    ("rise", "reported"),
    [(0.0, False), (2.0, False), (2.5, False), (2.6, True), (20.0, True), (-20.0, False)],
)
def test_overtemp_a_rise_of_half_a_degree_per_second_over_five_seconds_is_reported(
    rise: float, reported: bool
) -> None:
    watch = Watch()
    watch.row(*[30.0] * 3)
    found = watch.row(*[30.0 + rise] * 25)
    said = [one for each in found for one in each.findings if "°C/s" in one.message]
    assert bool(said) is reported
    assert {one.reaction for one in found} == {NONE}
    if reported:
        assert (said[0].joint, said[0].bound) == (1, 0.5)
        assert said[0].value == pytest.approx(rise / 5.0, rel=0.05)


def test_overtemp_each_joint_gets_warmer_by_its_own_time() -> None:
    watch = Watch()
    for count in range(32):  # joint 0 is known for three seconds only, when joint 1 is for five
        found = watch.read(nan if count < 10 else 30.0, 30.0 if count < 3 else 33.0, 30.0)
        said = [one for one in found.findings if "°C/s" in one.message]
        assert [one.joint for one in said] == ([1] if count == 27 else [])


@pytest.mark.parametrize("motion", Motion)
@pytest.mark.parametrize("state", [RobotState.ARMED, RobotState.SETTLING, RobotState.FAULT, RobotState.ESTOP])
def test_overtemp_only_a_motion_of_its_own_is_slowed_no_way_down(motion: Motion, state: RobotState) -> None:
    watch = Watch(motion=motion, state=state, setpoint_age=0.0)
    last = watch.row(*[66.0] * 4)[-1]
    moves = motion in (Motion.ACTIVE, Motion.STREAMING) and state is RobotState.ARMED
    assert last.pace == (0.5 if moves else 1.0)


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.MIRROR}])
def test_overtemp_without_our_torque_is_only_reported_and_prevents_arming(over: dict[str, object]) -> None:
    watch = Watch(**over)
    found = watch.row(*[75.0] * 4)
    assert {(one.reaction, one.latches, one.pace) for one in found} == {(NONE, False, 1.0)}
    assert [one.bound for one in levels(found)] == [70.0]
    assert [one.code for one in watch.guard.bars] == [ReasonCode.OVERTEMP]


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.MIRROR}])
def test_overtemp_what_we_do_not_hold_is_not_slowed(over: dict[str, object]) -> None:
    last = Watch(**over).row(*[66.0] * 4)[-1]
    assert (last.pace, last.reaction) == (1.0, NONE)


def test_overtemp_who_got_that_hot_keeps_all_from_arming_until_it_is_cool() -> None:
    watch = Watch(torque_expected=False)
    watch.row(*[69.0] * 5)
    assert watch.guard.bars == ()
    watch.row(*[70.0] * 3)
    for celsius in (70.0, 66.0, 61.0, 58.0, 55.0):
        watch.row(*[celsius] * 3)
        assert [(one.code, one.joint) for one in watch.guard.bars] == [(ReasonCode.OVERTEMP, 1)]
    watch.row(*[54.0] * 3)
    assert watch.guard.bars == ()
    watch.row(*[66.0] * 3)  # warm again, but never that hot
    assert watch.guard.bars == ()


def test_overtemp_what_lasts_is_reacted_to_in_every_tick() -> None:
    watch = Watch()
    watch.row(*[80.0] * 4)
    same = np.full(N, watch.now)
    for _ in range(10):
        assert watch.read(30.0, 80.0, 30.0, dt=PERIOD, health_time=same).reaction is SETTLE


@pytest.mark.parametrize("before", [30.0, 62.0], ids=["cool", "warm"])
def test_overtemp_what_is_read_oftener_is_counted_five_times_a_second(before: float) -> None:
    watch = Watch()
    watch.row(*[before] * 5)
    found = [watch.read(30.0, 80.0, 30.0, dt=PERIOD) for _ in range(60)]
    assert [one.reaction for one in found[:38]] == [NONE] * 38
    assert SETTLE in {one.reaction for one in found}


def test_overtemp_of_readings_a_little_oftener_every_second_one_is_counted() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    found = [watch.read(30.0, 80.0, 30.0, dt=0.19) for _ in range(6)]
    assert [one.reaction for one in found] == [NONE] * 5 + [SETTLE]


def test_overtemp_a_time_that_stands_still_is_one_reading() -> None:
    watch = Watch()
    watch.row(*[30.0] * 5)
    watch.row(80.0)
    for count in range(1, 9):
        stamps = np.full(N, watch.now + 1e-3 * count)
        assert watch.read(30.0, 80.0, 30.0, dt=0.0, period=PERIOD, health_time=stamps) == FINE


@pytest.mark.parametrize("before", [30.0, 62.0], ids=["cool", "warm"])
def test_overtemp_a_look_that_found_nothing_new_puts_off_no_reading(before: float) -> None:
    watch = Watch()
    watch.row(*[before] * 5)
    for count in range(3):
        same = np.full(N, watch.now)
        watch.read(30.0, 30.0, 30.0, dt=0.2, health_time=same)
        last = watch.read(30.0, 80.0, 30.0, dt=0.1)
        assert (last.reaction is SETTLE) is (count == 2)


def test_without_ratings_no_joint_is_too_hot() -> None:
    guard = Guard(LIMITS)
    for tick in range(10):
        now = 10.0 + 0.2 * tick
        usual = {"now": now, "period": 0.2, "measured": reading(time=now), "health_time": np.full(N, now)}
        assert codes(guard.judge(facts(**usual, temperature=joints(200.0, 200.0, 200.0)))) == []
