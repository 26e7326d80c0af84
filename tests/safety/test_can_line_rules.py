"""State of a CAN bus (CAN_BUS_STATE): dense around 100 ms, in every state, each bus by itself."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.guard_rig import FINE, LIMITS, PERIOD, codes, facts, reading
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import BusTraffic, Guard, GuardDecision, Reaction

ACTIVE = 0
PASSIVE = 1
OFF = 2
SERIAL = BusTraffic(asked=True, answered=True)
NOBODY = BusTraffic(asked=True)
FULL = BusTraffic(full=1)
NOT_ASKED = BusTraffic()
DISARMED = {"torque_expected": False, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}
ARMING = DISARMED | {"state": RobotState.ARMING, "torque_settled": False}
MIRROR = {"mode": Mode.MIRROR, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}


def line(state: int) -> BusTraffic:
    return BusTraffic(asked=True, answered=True, line=state)


class Watch:
    """A guard of a serial bus and two CAN buses, tick by tick."""

    def __init__(self, period: float = PERIOD, support: str = "gantry") -> None:
        can = {"arm": [1], "leg": [2]}
        self.guard = Guard(LIMITS, buses=("spine", "arm", "leg"), can=can, support=support)
        self.now = 10.0
        self.period = period
        self.told: list[ReasonCode] = []

    def see(
        self, arm: BusTraffic, leg: BusTraffic | None = None, spine: BusTraffic = SERIAL, **over: object
    ) -> GuardDecision:
        self.now += self.period
        given = {"now": self.now, "measured": reading(time=self.now), "period": self.period} | over
        traffic = (spine, arm, leg if leg is not None else line(ACTIVE))
        judgement = self.guard.judge(facts(traffic=traffic, **given))
        self.told += codes(judgement)
        return judgement

    def all(self, row: Sequence[BusTraffic], **over: object) -> list[GuardDecision]:
        return [self.see(each, **over) for each in row]


# ----------------------------------------------------------------------------------------------- the line


def test_can_bus_state_an_active_line_gives_no_finding() -> None:
    assert all(judgement == FINE for judgement in Watch().all([line(ACTIVE)] * 200))


@pytest.mark.parametrize("over", [{}, ARMING, DISARMED, MIRROR])
def test_can_bus_state_a_passive_line_is_reported_once_and_changes_nothing(over: dict[str, object]) -> None:
    watch = Watch()
    first, *later = watch.all([line(PASSIVE)] * 300, **over)
    assert codes(first) == [ReasonCode.CAN_BUS_STATE]
    assert (first.reaction, first.latches, first.gone) == (Reaction.NONE, False, ())
    assert (first.findings[0].value, first.findings[0].bound) == (1.0, 1.0)
    for word in ("CAN bus arm", "termination", "bit rate", "wiring"):
        assert word in first.findings[0].message
    assert later == [FINE] * 299
    assert not watch.guard.bars


@pytest.mark.parametrize("over", [{}, ARMING, {"state": RobotState.SETTLING}, {"state": RobotState.ESTOP}])
def test_can_bus_state_a_line_that_is_off_is_a_fault_at_once_while_torque_is_or_comes_on(
    over: dict[str, object],
) -> None:
    watch = Watch()
    judgement = watch.see(line(OFF), **over)
    assert (judgement.latches, judgement.gone) == (True, (1,))
    assert codes(judgement) == [ReasonCode.CAN_BUS_STATE]
    assert (judgement.findings[0].value, judgement.findings[0].bound) == (2.0, 2.0)
    for word in ("CAN bus arm", "off the wire", "power", "termination", "disarm, reset, arm"):
        assert word in judgement.findings[0].message
    assert [one.code for one in watch.guard.bars] == [ReasonCode.CAN_BUS_STATE]


@pytest.mark.parametrize(("support", "reaction"), [
    ("fixed", Reaction.HOLD), ("gantry", Reaction.HOLD), ("free", Reaction.SETTLE), ("?", Reaction.SETTLE),
])  # fmt: skip
def test_can_bus_state_the_others_hold_or_are_lowered_by_support(support: str, reaction: Reaction) -> None:
    assert Watch(support=support).see(line(OFF)).reaction is reaction
    silent = Watch(support=support).all([NOBODY] * 10)
    assert silent[-1].reaction is reaction


@pytest.mark.parametrize("state", [RobotState.SETTLING, RobotState.FAULT, RobotState.ESTOP])
def test_can_bus_state_a_robot_on_its_way_down_goes_on(state: RobotState) -> None:
    assert Watch().see(line(OFF), state=state).reaction is Reaction.NONE


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_can_bus_state_without_our_torque_is_reported_and_prevents_arming_while_it_lasts(
    over: dict[str, object],
) -> None:
    watch = Watch()
    judgement = watch.see(line(OFF), **over)
    assert (judgement.reaction, judgement.latches, judgement.gone) == (Reaction.NONE, False, ())
    assert codes(judgement) == [ReasonCode.CAN_BUS_STATE]
    assert watch.see(line(OFF), **over) == FINE
    assert [one.code for one in watch.guard.bars] == [ReasonCode.CAN_BUS_STATE]
    watch.see(line(ACTIVE), **over)
    assert not watch.guard.bars


def test_can_bus_state_of_a_bus_already_left_out_is_reported_and_has_no_new_reaction() -> None:
    watch = Watch()
    for gone in (
        BusTraffic(asked=True, answered=True, line=OFF, left_out=True),
        BusTraffic(asked=True, left_out=True),
    ):
        found = watch.all([gone] * 30)
        assert not any(one.gone or one.latches or one.reaction for one in found)
    assert watch.told == [ReasonCode.CAN_BUS_STATE]
    found = watch.all([BusTraffic(asked=True, left_out=True)] * 9 + [NOBODY] * 10)
    assert [bool(one.gone) for one in found] == [False] * 18 + [True]
    watch.see(BusTraffic(asked=True, line=OFF, left_out=True))
    assert [one.code for one in watch.guard.bars if one.code is ReasonCode.CAN_BUS_STATE]


def test_can_bus_state_a_passive_line_that_turns_off_is_reported_again() -> None:
    watch = Watch()
    watch.all([line(PASSIVE)] * 5 + [line(OFF)], **DISARMED)
    assert watch.told == [ReasonCode.CAN_BUS_STATE] * 2
    assert watch.all([line(PASSIVE), line(OFF)])[-1].latches


def test_can_bus_state_what_is_worse_than_off_is_off() -> None:
    assert Watch().see(line(3)).gone == (1,)
    assert Watch().see(BusTraffic(asked=True, line=OFF)).findings[0].value == 2.0


def test_can_bus_state_each_bus_is_judged_by_itself() -> None:
    watch = Watch()
    judgement = watch.see(line(PASSIVE), line(OFF))
    assert judgement.gone == (2,)
    assert len(codes(judgement)) == 1  # what is latched, alone
    assert "CAN bus leg" in judgement.findings[0].message
    assert Watch().see(line(OFF), line(OFF)).gone == (1, 2)


def test_can_bus_state_a_serial_bus_has_no_line() -> None:
    watch = Watch()
    for _ in range(4):
        assert watch.see(line(ACTIVE), spine=BusTraffic(asked=True, answered=True, line=OFF)) == FINE
    for _ in range(15):
        watch.see(line(ACTIVE), spine=NOBODY)
    assert watch.told == []


def test_can_bus_state_a_guard_without_can_buses_gives_no_finding() -> None:
    guard = Guard(LIMITS, buses=("arm",))
    assert guard.judge(facts(traffic=(line(OFF),))) == FINE


# ----------------------------------------------------------------------------------------------- silence


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 500.0, 1000.0])
@pytest.mark.parametrize("lost", [NOBODY, FULL])
def test_can_bus_state_a_bus_without_replies_for_100_ms_counts_as_lost(rate: float, lost: BusTraffic) -> None:
    watch = Watch(1.0 / rate)
    most = round(0.1 * rate)
    found = watch.all([lost] * most)
    assert [bool(one.gone) for one in found] == [False] * (most - 1) + [True]
    last = next(one for one in found[-1].findings if one.code is ReasonCode.CAN_BUS_STATE)
    assert (last.value, last.bound) == (pytest.approx(0.1), 0.1)
    assert "without a reply of any node" in last.message
    assert found[-1].latches


@pytest.mark.parametrize(
    ("rate", "count"), [(10.0, 3), (20.0, 3), (25.0, 3), (30.0, 3), (32.0, 4), (40.0, 4)]
)
def test_can_bus_state_at_low_rates_less_than_three_lost_answers_are_no_silence(
    rate: float, count: int
) -> None:
    found = Watch(1.0 / rate).all([NOBODY] * count)
    assert [bool(one.gone) for one in found] == [False] * (count - 1) + [True]


@pytest.mark.parametrize("between", [line(ACTIVE), line(PASSIVE), NOT_ASKED])
def test_can_bus_state_one_answer_or_a_bus_that_is_not_asked_begins_anew(between: BusTraffic) -> None:
    watch = Watch()
    watch.all([NOBODY] * 9 + [between])
    assert not any(one.gone for one in watch.all([NOBODY] * 9))
    assert watch.see(NOBODY).gone == (1,)


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_can_bus_state_missing_replies_without_our_torque_do_not_count_as_lost(
    over: dict[str, object],
) -> None:
    watch = Watch()
    watch.all([NOBODY] * 50, **over)
    assert ReasonCode.CAN_BUS_STATE not in watch.told
    assert not any(one.gone for one in watch.all([NOBODY] * 9))
    assert watch.see(NOBODY).gone == (1,)


def test_can_bus_state_missing_replies_on_an_off_line_are_reported_only_as_off() -> None:
    watch = Watch()
    found = watch.all([BusTraffic(asked=True, line=OFF)] * 15)
    assert all(one.gone == (1,) for one in found)
    lasting = [one for one in watch.guard.bars if one.code is ReasonCode.CAN_BUS_STATE]
    assert [(one.value, one.bound) for one in lasting] == [(2.0, 2.0)]
    silent = watch.all([BusTraffic(asked=True, line=PASSIVE)])[-1]
    assert silent.gone == (1,)


@given(st.lists(st.sampled_from([NOBODY, FULL, NOT_ASKED, line(ACTIVE)]), max_size=60))
def test_can_bus_state_gone_is_exactly_ten_lost_in_a_row(row: list[BusTraffic]) -> None:
    count = 0
    for traffic, judgement in zip(row, Watch().all(row), strict=True):
        count = count + 1 if traffic in (NOBODY, FULL) else 0
        assert (judgement.gone == (1,)) == (count >= 10)
