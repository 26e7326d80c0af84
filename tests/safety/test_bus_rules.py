"""BUS_ERRORS, FOREIGN_TRAFFIC, TX_BACKLOG: dense around every threshold, each bus by itself."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.guard_rig import LIMITS, PERIOD, codes, facts, reading
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import BusTraffic, Guard, GuardDecision, Reaction

GOOD = BusTraffic(asked=True, answered=True)
BAD = BusTraffic(asked=True, bad=True, answered=True)
NOT_ASKED = BusTraffic()
FULL = BusTraffic(full=1)
DISARMED = {"torque_expected": False, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}
MIRROR = {"mode": Mode.MIRROR, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}


def foreign(count: int) -> BusTraffic:
    return BusTraffic(asked=True, answered=True, foreign=count)


class Watch:
    """A guard of two buses, tick by tick; `told` what it said."""

    def __init__(self, period: float = PERIOD) -> None:
        self.guard = Guard(LIMITS, buses=("left", "right"))
        self.now = 10.0
        self.period = period
        self.told: list[ReasonCode] = []

    def see(self, left: BusTraffic, right: BusTraffic = GOOD, **over: object) -> GuardDecision:
        self.now += self.period
        given = {"now": self.now, "measured": reading(time=self.now), "period": self.period} | over
        judgement = self.guard.judge(facts(traffic=(left, right), **given))
        self.told += codes(judgement)
        return judgement

    def all(self, row: Sequence[BusTraffic], **over: object) -> list[GuardDecision]:
        return [self.see(each, **over) for each in row]


# ----------------------------------------------------------------------------------------------- BUS_ERRORS


def test_a_healthy_bus_gives_no_finding() -> None:
    watch = Watch()
    assert all(judgement == GuardDecision() for judgement in watch.all([GOOD] * 300))


@pytest.mark.parametrize("rate", [100.0, 200.0, 500.0, 1000.0])
def test_bus_errors_of_five_percent_in_a_second_are_reported_and_of_twenty_hold(rate: float) -> None:
    watch = Watch(1.0 / rate)
    warn = round(0.05 * rate)
    most = round(0.2 * rate)
    for count in range(1, most + 1):
        judgement = watch.see(BAD)
        watch.see(GOOD)  # never two in a row
        assert judgement.reaction is (Reaction.HOLD if count >= most else Reaction.NONE)
        assert not judgement.latches
        assert (ReasonCode.BUS_ERRORS in watch.told) == (count >= warn)


def test_bus_errors_what_is_just_a_second_ago_is_over() -> None:
    watch = Watch(0.125)  # exact in binary
    found = watch.all([BAD, GOOD, BAD, GOOD, BAD, GOOD, GOOD, GOOD, GOOD])
    assert [one.reaction for one in found] == [Reaction.NONE] * 4 + [Reaction.HOLD] * 4 + [Reaction.NONE]


@pytest.mark.parametrize("rate", [8.0, 10.0, 12.5])
def test_bus_errors_at_low_rates_less_than_three_bad_ones_hold_nothing(rate: float) -> None:
    watch = Watch(1.0 / rate)
    found = watch.all([BAD, GOOD] * 3)
    assert [one.reaction for one in found[:4]] == [Reaction.NONE] * 4
    assert found[4].reaction is Reaction.HOLD


def test_bus_errors_in_a_row_are_reset_while_a_bus_is_absent() -> None:
    watch = Watch()
    watch.all([BAD] * 19)
    watch.all([NOT_ASKED] * 102)
    assert [(one.reaction, one.latches) for one in watch.all([BAD] * 2)] == [(Reaction.NONE, False)] * 2
    watch = Watch(0.001)
    watch.all([BAD] * 19)
    watch.all([NOT_ASKED] * 1002)
    assert [one.reaction for one in watch.all([BAD] * 5)] == [Reaction.NONE] * 4 + [Reaction.HOLD]


def test_bus_errors_who_would_hold_at_once_does_not_arm() -> None:
    watch = Watch()
    watch.all([BAD] * 4, **DISARMED)
    assert not watch.guard.bars
    for _ in range(20):
        watch.see(BAD, **DISARMED)
        assert [one.code for one in watch.guard.bars] == [ReasonCode.BUS_ERRORS]
    watch.all([GOOD] * 79, **DISARMED)  # no longer in a row, but 20 % of a second
    assert watch.guard.bars
    watch.all([GOOD] * 4, **DISARMED)
    assert not watch.guard.bars


@examples(15)
@given(st.floats(0.002, 0.01), st.integers(0, 30))
def test_bus_errors_what_is_a_second_ago_does_not_count_any_more(period: float, extra: int) -> None:
    watch = Watch(period)
    watch.all([BAD, GOOD] * 12)
    judgements = watch.all([GOOD] * (int(1.0 / period) + 2 + extra))
    assert judgements[-1] == GuardDecision()


@pytest.mark.parametrize(
    ("count", "reaction", "latches"),
    [
        (4, Reaction.NONE, False),
        (5, Reaction.HOLD, False),
        (19, Reaction.HOLD, False),
        (20, Reaction.HOLD, True),
    ],
)
def test_bus_errors_bad_ones_in_a_row_hold_and_latch(count: int, reaction: Reaction, latches: bool) -> None:
    watch = Watch(0.001)  # 20 of them are 2 % of a second: the share alone does not hold
    last = watch.all([BAD] * count)[-1]
    assert (last.reaction, last.latches) == (reaction, latches)


def test_bus_errors_the_fault_leaves_torque_and_names_the_bus() -> None:
    watch = Watch()
    judgement = [watch.see(GOOD, BAD) for _ in range(20)][-1]
    assert (judgement.reaction, judgement.latches, codes(judgement)) == (
        Reaction.HOLD,
        True,
        [ReasonCode.BUS_ERRORS],
    )
    assert "bus right" in judgement.findings[0].message
    assert (judgement.findings[0].value, judgement.findings[0].bound) == (20.0, 20.0)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ([BAD, GOOD] * 5, "bus left: 5 % of the exchanges of the last second failed (bound 5 %); on a robot"),
        (
            [BAD, GOOD] * 20,
            "bus left: 20 % of the exchanges of the last second failed (bound 20 %); on a robot",
        ),
        ([GOOD] + [BAD] * 20, "bus left: 20 exchanges in a row failed (bound 20); on a robot check wiring"),
    ],
)
def test_bus_errors_message_names_bus_value_bound_and_remedy(row: list[BusTraffic], message: str) -> None:
    watch = Watch()
    finding = [finding for judgement in watch.all(row) for finding in judgement.findings][-1]
    assert finding.message.startswith(message)


@pytest.mark.parametrize("left_out", [False, True])
def test_the_traffic_of_a_new_tick_keeps_only_the_state_of_the_line(left_out: bool) -> None:
    traffic = BusTraffic(True, True, True, 3, 4, not left_out, 2)
    traffic.reset(left_out=left_out)
    assert traffic == BusTraffic(left_out=left_out, line=2)


def test_bus_errors_one_good_exchange_ends_a_row_and_a_tick_without_question_does_not() -> None:
    watch = Watch(0.001)
    watch.all([BAD] * 4)
    assert watch.see(NOT_ASKED).reaction is Reaction.NONE
    assert watch.see(BAD).reaction is Reaction.HOLD
    watch.all([GOOD] * 2)
    assert [one.reaction for one in watch.all([BAD] * 5)] == [Reaction.NONE] * 4 + [Reaction.HOLD]


def test_bus_errors_of_two_buses_are_not_summed_and_both_are_reported() -> None:
    watch = Watch()
    for _ in range(5):
        watch.see(BAD, GOOD)
        watch.see(GOOD, BAD)
    assert watch.told == [ReasonCode.BUS_ERRORS] * 2
    for _ in range(14):
        assert watch.see(BAD, GOOD).reaction is Reaction.NONE
        assert watch.see(GOOD, BAD).reaction is Reaction.NONE


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_bus_errors_are_only_reported_without_our_torque(over: dict[str, object]) -> None:
    watch = Watch()
    assert {(one.reaction, one.latches) for one in watch.all([BAD] * 100, **over)} == {(Reaction.NONE, False)}
    assert ReasonCode.BUS_ERRORS in watch.told


# -------------------------------------------------------------------------------------------- FOREIGN_TRAFFIC


@pytest.mark.parametrize(("row", "stops"), [
    ([1, 1], False), ([1, 1, 1], True), ([2], False), ([3], True), ([2, 0, 0, 1], True),
    ([1] + [0] * 100 + [1] + [0] * 100 + [1], False),
    ([1] + [0] * 101 + [3], True), ([2] + [0] * 98 + [1], True), ([2] + [0] * 100 + [1], False),
])  # fmt: skip
def test_foreign_traffic_three_foreign_packets_in_a_second_inhibit(row: list[int], stops: bool) -> None:
    watch = Watch()
    last = watch.all([foreign(count) for count in row])[-1]
    assert (last.reaction is Reaction.INHIBIT, last.latches) == (stops, stops)
    assert [finding.bound for finding in last.findings] == ([3.0] if stops else [])


def test_foreign_traffic_what_is_just_a_second_ago_is_over() -> None:
    watch = Watch(0.125)  # exact in binary
    last = watch.all([foreign(count) for count in [2, 0, 0, 0, 0, 0, 0, 0, 1]])[-1]
    assert last.reaction is Reaction.NONE


def test_foreign_traffic_under_a_latched_fault_inhibits_latches_and_names_the_bus() -> None:
    watch = Watch()
    found = [
        watch.see(foreign(3), state=RobotState.FAULT),
        watch.see(GOOD, foreign(3), state=RobotState.FAULT),
    ]
    assert [(one.reaction, one.latches) for one in found] == [(Reaction.INHIBIT, True)] * 2
    assert ["left" in found[0].findings[0].message, "right" in found[1].findings[0].message] == [True] * 2


def test_foreign_traffic_while_arming_too() -> None:
    watch = Watch()
    over = DISARMED | {"state": RobotState.ARMING, "torque_settled": False}
    assert watch.see(foreign(3), **over).reaction is Reaction.INHIBIT
    assert [one.code for one in watch.guard.bars] == [ReasonCode.FOREIGN_TRAFFIC]


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_foreign_traffic_without_our_torque_is_reported_and_prevents_arming_for_a_second(
    over: dict[str, object],
) -> None:
    watch = Watch()
    judgement = watch.see(foreign(3), **over)
    assert (judgement.reaction, codes(judgement)) == (Reaction.NONE, [ReasonCode.FOREIGN_TRAFFIC])
    assert [finding.code for finding in watch.guard.bars] == [ReasonCode.FOREIGN_TRAFFIC]
    watch.all([GOOD] * 98, **over)
    assert watch.guard.bars
    watch.all([GOOD] * 4, **over)
    assert not watch.guard.bars


def test_foreign_traffic_an_inhibited_robot_is_not_inhibited_again_and_again() -> None:
    watch = Watch()
    assert watch.see(foreign(3)).reaction is Reaction.INHIBIT
    over = {"state": RobotState.INHIBITED, "goal": None, "motion": Motion.IDLE}
    assert {judgement.reaction for judgement in watch.all([NOT_ASKED] * 50, **over)} == {Reaction.NONE}


# ----------------------------------------------------------------------------------------------- TX_BACKLOG


def test_tx_backlog_three_full_ones_in_a_row_are_a_fault_that_holds() -> None:
    watch = Watch()
    found = watch.all([FULL] * 3)
    assert [(one.reaction, one.latches) for one in found[:2]] == [(Reaction.NONE, False)] * 2
    told = [(one.value, one.bound) for each in found for one in each.findings]
    assert told == [(1.0, 1.0), (3.0, 3.0)]
    assert (found[2].reaction, found[2].latches, codes(found[2])) == (
        Reaction.HOLD,
        True,
        [ReasonCode.TX_BACKLOG],
    )
    assert "bus left" in found[2].findings[0].message


def test_tx_backlog_an_answer_ends_a_row_and_a_tick_without_one_does_not() -> None:
    watch = Watch()
    silent = BusTraffic(asked=True, bad=True)  # sent after the port was emptied, and never heard of
    assert watch.all([FULL, silent, FULL, silent, FULL])[-1].latches
    watch = Watch()
    assert not any(one.latches for one in watch.all([FULL, FULL, GOOD] * 10))


def test_tx_backlog_an_answer_in_a_tick_that_was_full_too_proves_nothing() -> None:
    watch = Watch()
    assert watch.all([BusTraffic(asked=True, answered=True, full=1)] * 3)[-1].latches


def test_tx_backlog_both_packets_of_a_tick_count() -> None:
    watch = Watch()
    assert [one.latches for one in watch.all([BusTraffic(full=2), FULL])] == [False, True]


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_tx_backlog_is_only_reported_without_our_torque(over: dict[str, object]) -> None:
    watch = Watch()
    assert {(one.reaction, one.latches) for one in watch.all([FULL] * 9, **over)} == {(Reaction.NONE, False)}
    assert ReasonCode.TX_BACKLOG in watch.told
