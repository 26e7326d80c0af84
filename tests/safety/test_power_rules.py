"""OVERCURRENT and VOLTAGE: dense around every threshold; two readings make a low supply, one makes none."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from tests.support.guard_rig import FINE, LIMITS, PERIOD, TINY, N, codes, facts, joints, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.guard import Guard, GuardDecision, GuardThresholds, Reaction
from twind.safety.power_rules import VoltageRules

HOLD = Reaction.HOLD
SETTLE = Reaction.SETTLE
DAMP = Reaction.DAMP
NONE = Reaction.NONE
RATED = replace(
    ActuatorRatings.unknown(N),
    low_warn=np.full(N, 11.1),
    low_settle=np.full(N, 10.5),
    low_fault=np.full(N, 10.0),
    high_warn=np.full(N, 14.8),
    continuous=np.array([0.35, 0.35, 1.0]),
)

MUTE = replace(
    RATED,
    low_warn=np.array([11.1, 11.1, -inf]),
    low_settle=np.array([10.5, 10.5, -inf]),
    low_fault=np.array([10.0, 10.0, -inf]),
    high_warn=np.array([14.8, 14.8, inf]),
)


class Watch:
    """A guard on a gantry, tick by tick."""

    def __init__(self, **usual: object) -> None:
        self.guard = Guard(LIMITS, support="gantry", ratings=RATED)
        self.now = 10.0
        self.usual = usual

    def tick(self, dt: float = PERIOD, **over: object) -> GuardDecision:
        self.now += dt
        given = {"now": self.now, "period": dt, "measured": reading(time=self.now)}
        return self.guard.judge(facts(**(given | self.usual | over)))

    def load(self, value: float, ticks: int, **over: object) -> list[GuardDecision]:
        """Joint 2, which bears its whole limit for ever, and so is told of for its current alone."""
        return [self.tick(load=joints(0.0, 0.0, value), **over) for _ in range(ticks)]


# ------------------------------------------------------------------------------------------- OVERCURRENT


@pytest.mark.parametrize(("load", "ticks", "reaction", "bound"), [
    (0.8 - TINY, 500, NONE, None), (0.8, 49, NONE, None), (0.8, 51, NONE, 0.8),
    (0.95 - TINY, 900, NONE, 0.8), (0.95, 95, NONE, 0.8), (0.95, 110, HOLD, 0.95),
    (1.0, 110, HOLD, 0.95), (0.95, 195, HOLD, 0.95), (0.95, 210, DAMP, 0.95),
])  # fmt: skip
def test_overcurrent_near_the_current_limit_for_too_long(
    load: float, ticks: int, reaction: Reaction, bound: float | None
) -> None:
    found = Watch().load(load, ticks)
    last = found[-1]
    assert (last.reaction, last.latches) == (reaction, bool(reaction))
    assert last.here == ((2,) if reaction else ())
    said = [finding for one in found for finding in one.findings]
    assert {one.code for one in said} == ({ReasonCode.OVERCURRENT} if bound else set())
    if bound:
        assert (said[-1].joint, said[-1].value, said[-1].bound) == (2, load, bound)


def test_overcurrent_a_moment_below_begins_anew() -> None:
    watch = Watch()
    for _ in range(5):
        assert all(one == FINE for one in watch.load(1.0, 45))
        watch.load(0.5, 6)


def test_overcurrent_between_the_bounds_the_harder_begins_anew() -> None:
    watch = Watch()
    for _ in range(4):
        assert {one.reaction for one in watch.load(1.0, 90) + watch.load(0.85, 5)} == {NONE}


@pytest.mark.parametrize("load", [nan, inf])
def test_overcurrent_an_unknown_load_is_not_checked_and_hides_no_other(load: float) -> None:
    watch = Watch()
    for _ in range(110):
        last = watch.tick(load=joints(load, 0.0, 1.0))
    assert [finding.joint for finding in last.findings] == [2]


def test_overcurrent_while_all_is_well_it_looks_every_fifty_milliseconds() -> None:
    watch = Watch()
    watch.tick(load=joints(0.0, 0.9, 0.0))
    peaks = [0.0 if tick % 5 == 4 else 0.9 for tick in range(400)]  # at 100 Hz every fifth tick is a look
    assert all(watch.tick(load=joints(0.0, peak, 0.0)) == FINE for peak in peaks)


def test_overcurrent_it_is_damped_after_twice_the_time_whatever_that_is() -> None:
    watch = Watch()
    watch.guard = Guard(LIMITS, GuardThresholds(load_hold_for=0.25), support="gantry", ratings=RATED)
    found = [one.reaction for one in watch.load(1.0, 60)]
    assert (found.index(HOLD), found.index(DAMP)) == (25, 50)


def test_overcurrent_all_may_be_loaded_at_once() -> None:
    watch = Watch()
    watch.guard = Guard(LIMITS, support="gantry", ratings=replace(RATED, continuous=np.ones(N)))
    assert [watch.tick(load=np.ones(N)) for _ in range(110)][-1].here == (0, 1, 2)


def test_overcurrent_right_at_each_bound_it_counts_and_a_long_rest_is_no_credit() -> None:
    """0.75 of the current limit, of which 0.5 is borne: 5/64 s in each quarter of a second, exactly."""
    bounds = GuardThresholds(tired_warn=10 / 64, tired_hold=20 / 64, tired_settle=40 / 64)
    watch = Watch()
    watch.guard = Guard(LIMITS, bounds, support="gantry", ratings=replace(RATED, continuous=np.full(N, 0.5)))
    assert all(watch.tick(0.25, load=np.zeros(N)) == FINE for _ in range(100))
    found = [watch.tick(0.25, load=joints(0.0, 0.75, 0.0)) for _ in range(8)]
    assert [bool(one.findings) for one in found[:2]] == [False, True]
    assert [one.reaction for one in found] == [NONE] * 3 + [HOLD] * 4 + [SETTLE]
    rest = {"load": np.zeros(N), "torque_expected": False}  # 4/64 s less in each quarter
    bars = [bool(watch.tick(0.25, **rest) and watch.guard.bars) for _ in range(6)]
    assert bars == [True] * 5 + [False]


def test_overcurrent_without_loads_gives_no_finding() -> None:
    watch = Watch(load=None)
    assert all(watch.tick() == FINE for _ in range(300))


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.MIRROR}])
def test_overcurrent_without_our_torque_gives_no_finding(over: dict[str, object]) -> None:
    assert all(one == FINE for one in Watch(**over).load(1.0, 300))


def test_overcurrent_on_the_way_down_it_is_latched_and_not_held_but_still_damped() -> None:
    watch = Watch(state=RobotState.SETTLING, torque_settled=False)
    found = watch.load(1.0, 110)[-1]
    assert (found.reaction, found.latches) == (NONE, True)
    assert watch.load(1.0, 110)[-1].reaction is DAMP


def tire(load: float, seconds: float) -> list[GuardDecision]:
    """Joint 1, which bears 0.35 for ever."""
    watch = Watch()
    return [watch.tick(load=joints(0.0, load, 0.0)) for _ in range(round(seconds / PERIOD))]


@pytest.mark.parametrize("load", [0.41, 0.5, 0.6, 0.79])
def test_overcurrent_what_tires_is_the_square_beyond_what_is_borne(load: float) -> None:
    rate = load**2 - 0.35**2  # a second
    for amount, reaction, bound in ((0.25, NONE, 0.25), (0.5, HOLD, 0.5), (0.8, SETTLE, 0.8)):
        # a look, and a tick
        before = (amount - 0.001) / rate - 0.06
        after = amount / rate + 0.07
        short = tire(load, before)
        full = tire(load, after)
        assert bound not in [finding.bound for one in short for finding in one.findings]
        said = [finding for one in full for finding in one.findings]
        assert (said[-1].code, said[-1].joint, said[-1].bound) == (ReasonCode.OVERCURRENT, 1, bound)
        assert said[-1].value == pytest.approx(amount, abs=0.05)
        assert (full[-1].reaction, full[-1].latches) == (reaction, bool(reaction))


@pytest.mark.parametrize(("load", "here"), [(0.36, (1,)), (0.35, ()), (0.0, ())])
def test_overcurrent_who_is_tired_is_held_where_it_is_while_it_pushes(
    load: float, here: tuple[int, ...]
) -> None:
    watch = Watch()
    while not watch.tick(load=joints(0.0, 0.79, 0.0)).reaction:
        assert watch.now < 20.0
    found = watch.tick(load=joints(0.0, load, 0.0))
    assert (found.reaction, found.here) == (HOLD, here)


@pytest.mark.parametrize(("load", "reaction"), [(0.5, HOLD), (0.2, NONE)])
def test_overcurrent_under_a_latch_only_who_still_pushes_is_held_where_it_is(
    load: float, reaction: Reaction
) -> None:
    watch = Watch()
    while not watch.tick(load=joints(0.0, 0.79, 0.0)).reaction:
        assert watch.now < 20.0
    assert watch.tick(load=joints(0.0, load, 0.0), state=RobotState.FAULT).reaction is reaction


def test_overcurrent_all_may_be_tired_at_once() -> None:
    watch = Watch()
    watch.guard = Guard(LIMITS, support="gantry", ratings=replace(RATED, continuous=np.full(N, 0.35)))
    while not watch.tick(load=np.full(N, 0.79)).reaction:
        assert watch.now < 20.0
    found = watch.tick(load=np.full(N, 0.3))
    assert (found.reaction, [one.joint for one in found.causes]) == (HOLD, list(range(N)))


@pytest.mark.parametrize("load", [0.0, 0.2, 0.35])
def test_overcurrent_what_is_borne_is_borne_for_ever(load: float) -> None:
    watch = Watch()
    assert all(watch.tick(0.5, load=joints(load, load, load)) == FINE for _ in range(2_000))


def test_overcurrent_a_rest_undoes_it_also_with_torque_off() -> None:
    watch = Watch()
    rate = 0.6**2 - 0.35**2
    for over in ({}, {"torque_expected": False}):
        for _ in range(3):
            for _ in range(round(0.2 / rate / 0.05)):
                assert watch.tick(0.05, load=joints(0.0, 0.6, 0.0)) == FINE
            for _ in range(round(0.25 / 0.35**2 / 0.05)):
                assert watch.tick(0.05, load=joints(0.0, 0.0, 0.0), **over) == FINE


def test_overcurrent_a_late_tick_does_not_exhaust_a_joint_at_once() -> None:
    watch = Watch(torque_expected=False)
    watch.tick(load=joints(0.0, 0.9, 0.0))
    watch.tick(60.0, load=joints(0.0, 0.9, 0.0))
    watch.usual = {}
    found = watch.tick(load=joints(0.0, 0.0, 0.0))
    assert found.reaction is NONE
    most = 0.5 * (0.9**2 - 0.35**2)  # of half a second: told
    assert [(one.value, one.bound) for one in found.findings] == [(pytest.approx(most, abs=0.002), 0.25)]


def test_overcurrent_load_before_an_arming_does_not_count_after_it() -> None:
    watch = Watch()
    assert watch.load(1.0, 90)[-1].reaction is NONE
    watch.load(1.0, 300, torque_expected=False)
    assert {one.reaction for one in watch.load(1.0, 90)} == {NONE}
    assert watch.load(1.0, 20)[-1].reaction is HOLD


def test_overcurrent_who_is_tired_is_not_armed_before_it_has_rested() -> None:
    watch = Watch()
    while not watch.tick(load=joints(0.0, 0.79, 0.0)).reaction:
        assert watch.now < 20.0
    watch.usual = {"torque_expected": False}
    assert not watch.tick(load=joints(0.0, 0.79, 0.0)).reaction
    for _ in range(20):
        rested = watch.tick(load=joints(0.0, 0.35, 0.0))
        assert [(one.code, one.joint, one.bound) for one in watch.guard.bars] == [
            (ReasonCode.OVERCURRENT, 1, 0.5)
        ]
        assert (rested.reaction, rested.latches, rested.findings) == (NONE, False, ())  # told once before
    for _ in range(round(0.25 / 0.35**2 / PERIOD)):
        last = watch.tick(load=joints(0.0, nan, 0.0))
    assert (last, watch.guard.bars) == (FINE, ())
    watch.usual = {}
    assert all(not watch.tick(load=joints(0.0, 0.2, 0.0)).reaction for _ in range(100))


# ------------------------------------------------------------------------------------------- VOLTAGE


class Supply(Watch):
    """Supplies as they are read five times a second."""

    def volts(self, *volts: float, dt: float = 0.2, **over: object) -> GuardDecision:
        """All joints read anew."""
        read = np.full(N, self.now + dt)
        return self.tick(dt, voltage=np.array(volts), health_time=read, **over)


def twice(volts: list[float], **usual: object) -> GuardDecision:
    watch = Supply(**usual)
    assert watch.volts(12.0, 12.0, 12.0) == FINE
    first = watch.volts(*volts)
    assert first.reaction is NONE
    return watch.volts(*volts)


@pytest.mark.parametrize(("volts", "bound", "reaction"), [
    (14.8, None, NONE), (12.0, None, NONE), (11.1 + TINY, None, NONE),
    (11.1, 11.1, NONE), (10.6, 11.1, NONE), (10.5 + TINY, 11.1, NONE),
    (10.5, 10.5, SETTLE), (10.1, 10.5, SETTLE), (10.0 + TINY, 10.5, SETTLE),
    (10.0, 10.0, DAMP), (5.0, 10.0, DAMP), (0.0, 10.0, DAMP),
    (-1.0, 10.0, DAMP), (nan, 10.0, DAMP), (-inf, 10.0, DAMP),
])  # fmt: skip
def test_voltage_a_low_supply_is_reported_then_lowers_then_damps(
    volts: float, bound: float | None, reaction: Reaction
) -> None:
    found = twice([12.0, volts, 12.0])
    assert (found.reaction, found.latches) == (reaction, bool(reaction))
    if bound is None:
        assert found == FINE
    else:
        (finding,) = found.findings
        exactly = pytest.approx(bound, rel=0.0, abs=1e-12)
        assert (finding.code, finding.joint, finding.bound) == (ReasonCode.VOLTAGE, 1, exactly)


def test_voltage_a_bound_counts_though_a_milder_one_is_not_known() -> None:
    ratings = replace(ActuatorRatings.unknown(N), low_settle=np.full(N, 10.5))
    watch = Supply()
    watch.guard = Guard(LIMITS, support="gantry", ratings=ratings)
    assert watch.volts(12.0, 12.0, 12.0) == FINE
    watch.volts(10.0, 12.0, 12.0)
    assert watch.volts(10.0, 12.0, 12.0).reaction is SETTLE


def test_voltage_the_register_s_own_steps_are_on_the_bound() -> None:
    for raw, reaction in ((111, NONE), (105, SETTLE), (100, DAMP)):
        assert twice([12.0, raw * 0.1, 12.0]).reaction is reaction
        assert codes(twice([12.0, raw * 0.1, 12.0])) == [ReasonCode.VOLTAGE]


@pytest.mark.parametrize(
    ("volts", "reported"), [(14.8, False), (148 * 0.1, False), (14.9, True), (30.0, True), (inf, True)]
)
def test_voltage_an_overvoltage_is_reported_at_once_and_has_no_reaction(volts: float, reported: bool) -> None:
    found = Supply().volts(12.0, 12.0, volts)
    assert (found.reaction, found.latches) == (NONE, False)
    assert [(one.code, one.joint) for one in found.findings] == (
        [(ReasonCode.VOLTAGE, 2)] if reported else []
    )
    assert all(one.bound == pytest.approx(14.8, rel=0.0, abs=1e-12) for one in found.findings)


def test_voltage_an_overvoltage_of_all_is_reported_for_the_highest() -> None:
    assert [one.joint for one in Supply().volts(15.0, 30.0, 16.0).findings] == [1]


def test_voltage_an_undervoltage_of_all_is_reported_for_the_lowest() -> None:
    found = twice([10.4, 9.0, 9.9])
    assert [(one.joint, one.value, one.bound) for one in found.findings] == [(1, 9.0, pytest.approx(10.0))]


def test_voltage_a_supply_that_is_no_number_is_the_lowest_of_all() -> None:
    assert [one.joint for one in twice([0.5, nan, 9.0]).findings] == [1]


def test_voltage_who_was_never_read_has_no_supply() -> None:
    watch = Supply()
    for _ in range(9):
        read = joints(watch.now + 0.2, watch.now + 0.2, -inf)
        assert watch.tick(0.2, voltage=joints(12.0, 12.0, 30.0), health_time=read) == FINE


@pytest.mark.parametrize("count", [1, 2, 24])
def test_voltage_of_any_number_of_joints(count: int) -> None:
    low = {"low_warn": np.full(count, 11.1), "low_settle": np.full(count, 10.5)}
    rated = replace(ActuatorRatings.unknown(count), **low)
    rules = VoltageRules(rated, GuardThresholds())
    for now in (10.0, 10.2):
        read = {"now": now, "health_time": np.full(count, now), "voltage": np.full(count, 10.2)}
        found = list(rules.judge(facts(**read)))
    assert [(one.reaction, one.finding.joint) for one in found] == [(SETTLE, 0)]


def test_voltage_one_low_reading_between_good_ones_is_none() -> None:
    watch = Supply()
    for _ in range(20):
        assert watch.volts(9.0, 12.0, 12.0) == FINE
        assert watch.volts(12.0, 12.0, 12.0) == FINE


@pytest.mark.parametrize(
    ("apart", "reaction"), [(0.05, NONE), (0.1 - 1e-6, NONE), (0.1, SETTLE), (0.15, SETTLE)]
)
def test_voltage_two_servos_that_agree_a_tenth_of_a_second_apart_are_enough(
    apart: float, reaction: Reaction
) -> None:
    """On a bus that sags, each slice of servos is read at its own time."""
    watch = Supply()
    start = watch.now
    read = joints(start, start, start)
    assert watch.tick(0.01, voltage=joints(12.0, 12.0, 12.0), health_time=read) == FINE
    one = joints(start + 0.1, start, start)
    two = joints(start + 0.1, start + 0.1 + apart, start)
    assert watch.tick(0.1, voltage=joints(10.4, 12.0, 12.0), health_time=one).reaction is NONE
    assert watch.tick(apart, voltage=joints(10.4, 10.3, 12.0), health_time=two).reaction is reaction


@pytest.mark.parametrize(("rounds", "reaction"), [(1, SETTLE), (8, SETTLE), (11, NONE), (100, NONE)])
def test_voltage_an_old_low_reading_confirms_no_new_one(rounds: int, reaction: Reaction) -> None:
    """One reads low once and is read no more; the others are read on, and then one of them is low, once."""
    watch = Supply()
    assert watch.volts(12.0, 12.0, 12.0) == FINE
    assert watch.volts(10.4, 12.0, 12.0).reaction is NONE
    silent = watch.now
    for turn in range(rounds):
        read = joints(silent, watch.now + 0.2, watch.now + 0.2)
        volts = joints(10.4, 10.4 if turn == rounds - 1 else 12.0, 12.0)
        last = watch.tick(0.2, voltage=volts, health_time=read)
    assert last.reaction is reaction


def test_voltage_a_worse_level_is_reported_again_and_a_better_one_ends_it() -> None:
    watch = Supply()
    told = [watch.volts(volts, 12.0, 12.0) for volts in (11.0, 11.0, 10.4, 10.4, 9.9, 9.9, 12.0)]
    assert [one.reaction for one in told] == [NONE, NONE, NONE, SETTLE, SETTLE, DAMP, NONE]
    assert [len(one.findings) for one in told[:2]] == [0, 1]


@pytest.mark.parametrize("dt", [PERIOD, 0.5])
def test_voltage_what_lasts_is_reacted_to_in_every_tick(dt: float) -> None:
    """Also when it is not read for 5 s: no newer reading says otherwise."""
    watch = Supply()
    for _ in range(3):
        watch.volts(10.4, 12.0, 12.0)
    same = {"voltage": joints(10.4, 12.0, 12.0), "health_time": np.full(N, watch.now)}
    assert {watch.tick(dt, **same).reaction for _ in range(10)} == {SETTLE}


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.MIRROR}, {"mode": Mode.SIM}])
def test_voltage_without_our_torque_is_neither_checked_nor_counted(
    over: dict[str, object],
) -> None:
    watch = Supply()
    watch.volts(9.0, 12.0, 12.0)
    for _ in range(5):
        assert watch.volts(9.0, 12.0, 12.0, **over) == FINE
    assert watch.volts(9.0, 12.0, 12.0) == FINE
    assert watch.volts(9.0, 12.0, 12.0).reaction is DAMP


def test_voltage_a_supply_unknown_for_long_is_reported() -> None:
    watch = Supply()
    for _ in range(5):
        watch.volts(12.0, 12.0, 12.0)
    gone = {"voltage": joints(nan, 12.0, 12.0)}
    told = []
    for _ in range(30):
        read = joints(-inf, watch.now + 0.1, watch.now + 0.1)
        found = watch.tick(0.1, health_time=read, **gone)
        assert found.reaction is NONE
        told += [(one.code, one.joint, one.bound) for one in found.findings]
    assert told == [(ReasonCode.VOLTAGE, 0, 2.0)]


@pytest.mark.parametrize(("age", "reported"), [(2.0, False), (2.0 + TINY, True), (inf, True), (nan, True)])
def test_voltage_old_readings_are_reported(age: float, reported: bool) -> None:
    watch = Supply()
    for _ in range(15):
        watch.volts(12.0, 12.0, 12.0)
    read = joints(watch.now + 0.2, watch.now + 0.2 - age, watch.now + 0.2)
    found = watch.tick(0.2, health_time=read, voltage=joints(12.0, 12.0, 12.0))
    assert [one.joint for one in found.findings] == ([1] if reported else [])
    assert found.reaction is NONE


def test_voltage_while_all_is_well_the_age_of_the_readings_is_checked_once_in_a_look() -> None:
    """Times that are exact in binary: a look is four ticks, and two seconds are 128."""
    watch = Supply(health_time=np.full(N, 10.0))
    watch.guard = Guard(LIMITS, GuardThresholds(look=1 / 16), support="gantry", ratings=RATED)
    found = [codes(watch.tick(1 / 64)) for _ in range(140)]
    assert found == [[]] * 132 + [[ReasonCode.VOLTAGE]] + [[]] * 7  # at 128 it is not yet too old


def test_voltage_what_was_not_read_before_the_arming_has_two_seconds_to_be_read() -> None:
    watch = Supply(health_time=np.full(N, 1.0))
    assert [codes(watch.tick(0.5)) for _ in range(6)] == [[]] * 5 + [[ReasonCode.VOLTAGE]]


def test_voltage_a_second_arming_has_two_seconds_again() -> None:
    watch = Supply(health_time=np.full(N, 1.0))
    watch.tick(0.5)
    watch.tick(5.0, torque_expected=False)
    assert [codes(watch.tick(0.5)) for _ in range(6)] == [[]] * 5 + [[ReasonCode.VOLTAGE]]


def test_voltage_the_last_reading_before_an_arming_counts_as_its_first() -> None:
    watch = Supply()
    watch.volts(9.0, 12.0, 12.0)
    same = {"voltage": joints(9.0, 12.0, 12.0), "health_time": np.full(N, watch.now)}
    watch.tick(torque_expected=False, **same)
    assert watch.tick(**same) == FINE
    assert watch.volts(9.0, 12.0, 12.0).reaction is DAMP


def test_without_ratings_no_supply_is_too_low() -> None:
    guard = Guard(LIMITS)
    for tick in range(5):
        now = 10.0 + tick * 0.2
        given = {"now": now, "period": 0.2, "measured": reading(time=now), "health_time": np.full(N, now)}
        assert guard.judge(facts(**given, voltage=joints(0.0, 3.0, 60.0))) == FINE


def test_voltage_a_joint_without_bounds_is_not_checked_and_others_are() -> None:
    """CAN actuators of the MIT family tell no voltage; those beside them are judged as ever."""
    watch = Supply()
    watch.guard = Guard(LIMITS, support="gantry", ratings=MUTE)
    assert all(watch.volts(12.0, 12.0, nan) == FINE for _ in range(10))
    for _ in range(2):
        last = watch.volts(12.0, 10.0, nan)
    assert (last.reaction, {finding.joint for finding in last.findings}) == (DAMP, {1})


def test_voltage_a_supply_that_has_only_an_upper_bound_is_judged_by_it() -> None:
    watch = Supply()
    watch.guard = Guard(LIMITS, support="gantry", ratings=replace(MUTE, high_warn=RATED.high_warn))
    assert all(watch.volts(12.0, 12.0, 14.8) == FINE for _ in range(3))
    (told,) = watch.volts(12.0, 12.0, 15.0).findings
    assert (told.code, told.joint, told.value) == (ReasonCode.VOLTAGE, 2, 15.0)
