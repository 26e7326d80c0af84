"""SERVO_ALERT and SERVO_REBOOTED: alerts at once, and clocks that tell a restart from a wrap."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.guard_rig import FINE, LIMITS, N, codes, facts
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.device_rules import words
from twind.safety.guard import BusTraffic, Guard, GuardDecision, Reaction
from twind_drivers.can import actuator_family

CLOCK = 32768  # ms, e-manual: Realtime Tick (120)
DISARMED = {"torque_expected": False, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}
ARMING = DISARMED | {"state": RobotState.ARMING, "torque_settled": False}
MIRROR = {"mode": Mode.MIRROR, "motion": Motion.IDLE, "goal": None, "state": RobotState.CONNECTED}
SIM = {"mode": Mode.SIM, "motion": Motion.IDLE, "goal": None, "state": RobotState.DISCONNECTED}


def at(joint: int, value: int, usual: int = 0, kind: type = np.uint8) -> np.ndarray:
    row = np.full(N, usual, kind)
    row[joint] = value
    return row


def guard(support: str = "gantry") -> Guard:
    return Guard(LIMITS, support=support)


# ----------------------------------------------------------------------------------------------- SERVO_ALERT


@pytest.mark.parametrize(("error", "alert"), [(0, False), (1, False), (7, False), (127, False), (128, True),
                                              (129, True), (135, True), (255, True)])  # fmt: skip
def test_servo_alert_the_alert_bit_alone_faults_the_joint_at_once(error: int, alert: bool) -> None:
    judgement = guard().judge(facts(alerts=at(1, error)))
    assert judgement.latches == alert
    assert [(one.code, one.joint) for one in judgement.findings] == [(ReasonCode.SERVO_ALERT, 1)] * alert


@pytest.mark.parametrize(("support", "reaction"), [
    ("fixed", Reaction.HOLD), ("gantry", Reaction.HOLD), ("free", Reaction.SETTLE), ("?", Reaction.SETTLE),
])  # fmt: skip
def test_servo_alert_the_others_hold_or_settle_by_support_and_unknown_is_free(
    support: str, reaction: Reaction
) -> None:
    assert guard(support).judge(facts(alerts=at(0, 128))).reaction is reaction


@pytest.mark.parametrize(("bits", "word"), [
    (1, "input voltage"), (4, "overheating"), (8, "encoder"), (16, "electrical shock"), (32, "overload"),
    (36, "overheating, overload"), (2, "bit 1"), (0, "not read yet"), (-1, "not read yet"),
])  # fmt: skip
def test_servo_alert_the_bits_of_register_70_are_named_in_words(bits: int, word: str) -> None:
    """e-manual, Hardware Error Status (70): bits 0, 2, 3, 4, 5."""
    assert word in words(bits)
    assert "70" not in words(bits)
    finding = guard().judge(facts(alerts=at(2, 128), fault=at(2, bits, 0, np.int16))).findings[0]
    assert word in finding.message
    assert (finding.value, finding.bound) == ((bits, 0.0) if bits > 0 else (None, None))


@pytest.mark.parametrize(("bits", "word"), [
    (1, "input voltage"), (2, "not calibrated"), (4, "overheating"), (8, "encoder"), (16, "electrical shock"),
    (32, "overload"), (64, "silent to its master"), (128, "an error that has no name here"),
    (66, "not calibrated, silent to its master"), (256, "bit 8"), (0, "not read yet"),
])  # fmt: skip
def test_servo_alert_on_can_more_bits_have_a_name_and_only_there(bits: int, word: str) -> None:
    """The contract's bits of every CAN family (`twind_drivers.can.actuator_family`)."""
    judge = Guard(LIMITS, support="gantry", buses=("arm",), can={"arm": [0, 2]})
    told = facts(traffic=(BusTraffic(),), alerts=np.full(N, 128, np.uint8), fault=np.full(N, bits, np.int16))
    first, second, third = (finding.message for finding in judge.judge(told).findings)
    assert first == third
    assert f"hardware error: {words(bits, can=True)}: " in first
    assert word in words(bits, can=True)
    assert first.endswith("reboot BUS ID`, or switch its power off and on")
    assert second.endswith("reboot BUS ID`")
    assert f"hardware error: {words(bits)}: " in second


def test_servo_alert_the_bits_on_can_are_those_of_its_families() -> None:
    named = {
        actuator_family.VOLTAGE: "input voltage",
        actuator_family.UNCALIBRATED: "not calibrated",
        actuator_family.HEAT: "overheating",
        actuator_family.ENCODER: "encoder",
        actuator_family.ELECTRICAL: "electrical shock",
        actuator_family.OVERLOAD: "overload",
        actuator_family.SILENCE: "silent to its master",
        actuator_family.UNKNOWN: "an error that has no name here",
    }
    assert {bits: words(bits, can=True) for bits in named} == named


@pytest.mark.parametrize(("torque", "joint", "support", "reaction"), [
    (0, 0, "free", Reaction.DAMP), (1, 0, "free", Reaction.SETTLE), (-1, 0, "free", Reaction.SETTLE),
    (0, 1, "free", Reaction.SETTLE), (0, 0, "gantry", Reaction.HOLD),
])  # fmt: skip
def test_servo_alert_a_leg_that_shut_itself_down_damps_what_stands_on_it(
    torque: int, joint: int, support: str, reaction: Reaction
) -> None:
    legs = replace(ActuatorRatings.unknown(N), leg=np.array([True, False, False]))
    judge = Guard(LIMITS, support=support, ratings=legs)
    judgement = judge.judge(facts(alerts=at(joint, 128), torque=at(joint, torque, 1, np.int8)))
    assert [one.code for one in judgement.findings] == [ReasonCode.SERVO_ALERT]
    assert judgement.reaction is reaction


def test_servo_alert_a_leg_that_is_limp_by_request_has_not_shut_itself_down() -> None:
    legs = replace(ActuatorRatings.unknown(N), leg=np.ones(N, np.bool_))
    judge = Guard(LIMITS, support="free", ratings=legs)
    alert = {"alerts": at(0, 128), "torque": at(0, 0, 1, np.int8)}
    assert judge.judge(facts(limp=at(0, True, False, np.bool_), **alert)).reaction is Reaction.SETTLE
    assert judge.judge(facts(limp=at(1, True, False, np.bool_), **alert)).reaction is Reaction.DAMP


@pytest.mark.parametrize(("bits", "servo", "on_can"), [
    (-1, False, False), (0, False, False), (1, True, True), (32, True, True), (128, True, True),
    (actuator_family.SILENCE, True, False), (actuator_family.SILENCE | actuator_family.VOLTAGE, True, True),
])  # fmt: skip
def test_on_can_a_lost_master_alone_is_no_hardware_error_and_only_there_an_error_is_kept(
    bits: int, servo: bool, on_can: bool
) -> None:
    """Arming clears a tripped watchdog. Errors are kept where no reading shows that they have gone."""
    rules = Guard(LIMITS, buses=("arm",), can={"arm": [0, 2]}).devices
    fault = np.full(N, bits, np.int16)
    assert rules.faulty(fault).tolist() == [on_can, servo, on_can]
    assert rules.kept_errors(fault).tolist() == [on_can, False, on_can]


@pytest.mark.parametrize("torque", [0, 1])
def test_servo_alert_before_there_is_torque_no_leg_has_let_go(torque: int) -> None:
    legs = replace(ActuatorRatings.unknown(N), leg=np.ones(N, np.bool_))
    judge = Guard(LIMITS, support="free", ratings=legs)
    row = at(0, torque, 0, np.int8)
    assert judge.judge(facts(alerts=at(0, 128), torque=row, **ARMING)).reaction is Reaction.SETTLE


def test_servo_alert_is_reported_again_once_its_bits_are_read_and_then_no_more() -> None:
    judge = guard()
    over = {"alerts": at(0, 128), "state": RobotState.FAULT}
    told = [codes(judge.judge(facts(fault=at(0, bits, 0, np.int16), **over))) for bits in (0, 0, 32, 32)]
    assert told == [[ReasonCode.SERVO_ALERT], [], [ReasonCode.SERVO_ALERT], []]


@pytest.mark.parametrize("over", [{}, ARMING])
def test_servo_alert_while_arming_or_armed_it_is_a_fault_and_bars_arming(over: dict[str, object]) -> None:
    judge = guard()
    assert judge.judge(facts(alerts=at(0, 128), **over)).latches
    assert [one.code for one in judge.bars] == [ReasonCode.SERVO_ALERT]


@pytest.mark.parametrize("over", [DISARMED, MIRROR])
def test_servo_alert_without_our_torque_is_reported_and_prevents_arming_while_it_lasts(
    over: dict[str, object],
) -> None:
    judge = guard()
    judgement = judge.judge(facts(alerts=at(0, 128), **over))
    assert (judgement.reaction, judgement.latches) == (Reaction.NONE, False)
    assert [one.code for one in judge.bars] == [ReasonCode.SERVO_ALERT]
    assert judge.judge(facts(alerts=at(0, 128), **over)) == FINE  # told once
    assert judge.bars
    judge.judge(facts(**over))
    assert not judge.bars


def test_servo_alert_gives_no_finding_in_sim() -> None:
    assert guard().judge(facts(alerts=at(0, 128), **SIM)) == FINE


# --------------------------------------------------------------------------------------------- SERVO_REBOOTED


class Clocks:
    """Servos whose clocks are read; joint 1 is the one that may restart."""

    def __init__(self, start: int, begin: float = 100.0, **over: object) -> None:
        self.guard = guard()
        self.over = over
        self.now = begin
        self.ticks = np.full(N, start, np.int64)
        self.read()

    def read(self) -> GuardDecision:
        tick = (self.ticks % CLOCK).astype(np.int32)
        return self.guard.judge(facts(tick=tick, health_time=np.full(N, self.now), **self.over))

    def later(self, seconds: float, drift: float = 0.0) -> GuardDecision:
        self.now += seconds
        self.ticks += round(seconds * (1.0 + drift) * 1e3)
        return self.read()

    def restart(self, seconds: float, uptime: float) -> GuardDecision:
        """`seconds` after the last reading joint 1 has been up for `uptime` s."""
        self.now += seconds
        self.ticks += round(seconds * 1e3)
        self.ticks[1] = round(uptime * 1e3)
        return self.read()


@given(st.integers(0, CLOCK - 1), st.lists(st.floats(0.001, 250.0), max_size=8), st.floats(-0.04, 0.04))
def test_servo_rebooted_a_clock_that_goes_on_is_never_a_restart_whatever_it_wraps(
    start: int, gaps: list[float], drift: float
) -> None:
    """e-manual, Realtime Tick (120): 0..32767 ms, then 0."""
    clocks = Clocks(start)
    assert all(clocks.later(gap, drift) == FINE for gap in gaps)


@given(st.integers(0, CLOCK - 1), st.floats(0.05, 5.0), st.floats(0.0, 1.0))
def test_servo_rebooted_a_restart_is_seen_unless_the_clock_stands_where_it_would_have(
    start: int, gap: float, share: float
) -> None:
    clocks = Clocks(start)
    expected = (start + gap * 1e3) % CLOCK
    uptime = gap * share * 1e3
    off = abs((uptime - expected + CLOCK / 2) % CLOCK - CLOCK / 2)
    assume(off > 52.0 + 0.05 * gap * 1e3)
    judgement = clocks.restart(gap, gap * share)
    assert [(one.code, one.joint) for one in judgement.findings] == [(ReasonCode.SERVO_REBOOTED, 1)]
    assert (judgement.latches, judgement.reaction) == (True, Reaction.HOLD)


@pytest.mark.parametrize(("off", "restarted"), [(58.0, False), (62.0, True)])
def test_servo_rebooted_the_margin_is_fifty_milliseconds_and_five_per_cent(
    off: float, restarted: bool
) -> None:
    clocks = Clocks(int(-200 + off) % CLOCK)  # expected to stand at `off` ms, read at 0
    assert clocks.restart(0.2, 0.0).latches == restarted


@pytest.mark.parametrize(("off", "restarted"), [(60, False), (61, True)])
def test_servo_rebooted_a_clock_wraps_at_32768_milliseconds_and_no_other(off: int, restarted: bool) -> None:
    clocks = Clocks((-210 + off) % CLOCK)
    assert clocks.restart(0.21, 0.0).latches == restarted  # 50 ms, and 5 % of 210


@pytest.mark.parametrize(("off", "restarted"), [(75, False), (76, True)])
def test_servo_rebooted_right_at_the_margin_a_clock_goes_on(off: int, restarted: bool) -> None:
    assert Clocks((-500 + off) % CLOCK).restart(0.5, 0.0).latches == restarted


@pytest.mark.parametrize(("uptime", "restarted"), [(0.575, True), (0.576, False)])
def test_servo_rebooted_right_at_the_margin_a_clock_is_young(uptime: float, restarted: bool) -> None:
    assert Clocks(20_000).restart(0.5, uptime).latches == restarted


def test_servo_rebooted_a_clock_older_than_its_reading_was_read_late_not_restarted() -> None:
    clocks = Clocks(20_000)
    clocks.now += 5.0  # the process stood still between the question and the look at the answer
    clocks.ticks += 10
    assert clocks.read() == FINE


def test_servo_rebooted_who_was_not_read_for_minutes_is_not_known_to_be_the_same() -> None:
    clocks = Clocks(0)
    assert codes(clocks.later(400.0)) == [ReasonCode.SERVO_REBOOTED] * N


def test_servo_rebooted_a_cleared_clock_starts_anew() -> None:
    clocks = Clocks(20_000)
    clocks.guard.judge(facts())  # -1: the bus was lost, or the restart was ordered
    assert clocks.restart(0.2, 0.1) == FINE


def test_servo_rebooted_an_unknown_clock_gives_no_finding() -> None:
    clocks = Clocks(20_000)
    for unknown in (-1, -1):
        clocks.now += 0.2
        gone = {"tick": np.full(N, unknown, np.int32), "health_time": np.full(N, clocks.now)}
        assert clocks.guard.judge(facts(**gone)) == FINE
    assert clocks.restart(0.2, 0.01) == FINE


def test_servo_rebooted_a_restart_is_one_event_and_the_next_reading_is_fine() -> None:
    clocks = Clocks(20_000, **DISARMED)
    judgement = clocks.restart(0.4, 0.2)
    assert (judgement.latches, codes(judgement)) == (False, [ReasonCode.SERVO_REBOOTED])
    assert [one.code for one in clocks.guard.bars] == [ReasonCode.SERVO_REBOOTED]
    assert clocks.later(0.2) == FINE


@pytest.mark.parametrize("over", [{}, ARMING])
def test_servo_rebooted_while_arming_or_armed_it_is_a_fault_and_bars_arming(over: dict[str, object]) -> None:
    clocks = Clocks(20_000, **over)
    assert clocks.restart(0.4, 0.2).latches
    assert [one.code for one in clocks.guard.bars] == [ReasonCode.SERVO_REBOOTED]


@pytest.mark.parametrize(("uptime", "latches"), [(0.2, False), (0.16, False), (0.14, True), (0.05, True)])
@pytest.mark.parametrize("over", [{}, ARMING])
def test_servo_rebooted_a_restart_before_the_arming_is_reported_and_is_no_fault(
    over: dict[str, object], uptime: float, latches: bool
) -> None:
    """Power that has just come back: the clock that tells of it is read only after the arming."""
    clocks = Clocks(20_000, facts().now - 0.3, **DISARMED)
    clocks.over = over
    judgement = clocks.restart(0.4, uptime)
    assert codes(judgement) == [ReasonCode.SERVO_REBOOTED]
    assert judgement.latches is latches


@pytest.mark.parametrize(("joint", "reaction"), [(0, Reaction.DAMP), (1, Reaction.SETTLE)])
def test_servo_rebooted_a_leg_that_went_limp_is_damped_and_an_arm_is_lowered_with_the_rest(
    joint: int, reaction: Reaction
) -> None:
    legs = replace(ActuatorRatings.unknown(N), leg=np.array([True, False, False]))
    judge = Guard(LIMITS, support="free", ratings=legs)
    assert judge.judge(facts(watchdog=at(joint, 0, 5, np.int16))).reaction is reaction


@pytest.mark.parametrize(("watchdog", "restarted"), [(0, True), (1, False), (5, False), (-1, False)])
def test_servo_rebooted_an_armed_watchdog_that_reads_zero_is_a_restart(
    watchdog: int, restarted: bool
) -> None:
    judgement = guard().judge(facts(watchdog=at(2, watchdog, 5, np.int16)))
    assert judgement.latches == restarted
    told = [(one.code, one.joint, one.value, "restarted" in one.message) for one in judgement.findings]
    assert told == [(ReasonCode.SERVO_REBOOTED, 2, 0.0, True)] * restarted


def test_servo_rebooted_a_watchdog_read_before_or_during_arming_gives_no_finding() -> None:
    judge = guard()
    zero = at(0, 0, 5, np.int16)
    judge.judge(facts(watchdog=zero, **DISARMED))
    assert judge.judge(facts(watchdog=zero)) == FINE  # read at the same time as before
    assert judge.judge(facts(watchdog=zero, status_time=np.full(N, 10.1), torque_settled=False)) == FINE
    assert judge.judge(facts(watchdog=zero, status_time=np.full(N, 10.2))).latches


def test_servo_rebooted_a_fresh_reading_of_one_joint_does_not_affect_another() -> None:
    judge = guard()
    zero = at(0, 0, 5, np.int16)
    judge.judge(facts(watchdog=zero, **DISARMED))
    anew = np.full(N, 9.99)
    anew[1] = 10.1
    assert judge.judge(facts(watchdog=zero, status_time=anew)) == FINE


@pytest.mark.parametrize("value", [0, 255])
def test_a_watchdog_read_before_the_arming_gives_no_servo_rebooted_though_torque_was_read_after(
    value: int,
) -> None:
    """A status is as old as its older half: the torque's new half may be all that makes its time move."""
    judge = guard()
    watchdog = at(0, value, 5, np.int16)
    judge.judge(facts(now=10.0, watchdog=watchdog, status_time=np.full(N, 9.8), **DISARMED))
    assert judge.judge(facts(now=10.01, watchdog=watchdog, status_time=np.full(N, 9.9))) == FINE
    assert judge.judge(facts(now=10.01, watchdog=watchdog, status_time=np.full(N, 10.0))) == FINE
    assert judge.judge(facts(now=10.02, watchdog=watchdog, status_time=np.full(N, 10.01))).latches


def test_watchdog_tripped_before_an_arming_counts_no_more_after_it() -> None:
    """Between the two it was cleared, and its register may be read again only later."""
    judge = guard()
    tripped = {"watchdog": at(0, 255, 5, np.int16), "status_time": np.full(N, 9.9)}
    assert codes(judge.judge(facts(now=10.0, **tripped))) == [ReasonCode.WATCHDOG_TRIPPED]
    judge.judge(facts(now=10.01, **tripped, **DISARMED))
    assert judge.judge(facts(now=10.02, **tripped)) == FINE


@pytest.mark.parametrize("between", [DISARMED, {"torque": np.ones(N, np.int8)}])
def test_torque_mismatch_counts_from_the_last_time_that_all_was_right(between: dict[str, object]) -> None:
    judge = guard()
    off = at(1, 0, 1, np.int8)
    rows = [{"torque": off}, {"torque": off} | between, {"torque": off}, {"torque": off}]
    found = [
        judge.judge(
            facts(now=10.0 + 1e-3 * count, **(row | {"status_time": np.full(N, 9.9995 + 1e-3 * count)}))
        )
        for count, row in enumerate(rows)
    ]
    assert [one.latches for one in found] == [False, False, False, True]


@pytest.mark.parametrize(("limp", "torque", "bound", "words"), [
    (True, 0, None, ""), (True, 1, 0.0, "in a limp joint"), (True, -1, 0.0, "in a limp joint"),
    (False, 1, None, ""), (False, 0, 1.0, "off (0)"), (False, -1, 1.0, "off (0)"),
])  # fmt: skip
def test_torque_mismatch_a_limp_joint_must_read_off_and_any_other_on(
    limp: bool, torque: int, bound: float | None, words: str
) -> None:
    judge = guard()
    over = {"limp": at(1, limp, False, np.bool_), "torque": at(1, torque, 1, np.int8)}
    assert judge.judge(facts(**over)) == FINE  # one reading may be older than the command
    found = judge.judge(facts(now=10.01, status_time=np.full(N, 10.0), **over))
    assert found.latches == (bound is not None)
    stated = [(one.code, one.joint, one.value, one.bound) for one in found.findings]
    assert stated == [(ReasonCode.TORQUE_MISMATCH, 1, float(torque), bound)] * found.latches
    assert all(words in one.message for one in found.findings)


def test_torque_mismatch_readings_during_a_procedure_count_as_no_restart() -> None:
    judge = guard()
    off = {"torque": at(1, 0, 1, np.int8)}
    judge.judge(facts(status_time=np.full(N, 10.0), **off))
    judge.judge(facts(now=10.11, status_time=np.full(N, 10.1), torque_settled=False, **off))
    stamps = np.full(N, 10.1)
    for time in (10.2, 10.3):
        stamps = np.where(np.arange(N) == 1, time, stamps)
        last = judge.judge(facts(now=time + 0.01, status_time=stamps, **off))
    assert [(one.code, one.joint) for one in last.findings] == [(ReasonCode.TORQUE_MISMATCH, 1)]


def test_servo_rebooted_a_watchdog_read_off_before_a_procedure_counts_no_more_after_it() -> None:
    judge = guard()
    unwatched = {"watchdog": at(0, 0, 5, np.int16)}
    assert judge.judge(facts(status_time=np.full(N, 10.0), **unwatched)).latches
    judge.judge(facts(now=10.11, status_time=np.full(N, 10.1), torque_settled=False, **unwatched))
    others = np.where(np.arange(N) == 1, 10.2, 10.1)
    found = judge.judge(facts(now=10.21, status_time=others, torque=at(1, 0, 1, np.int8)))
    assert (codes(found), found.latches) == ([], False)


def test_servo_rebooted_torque_off_and_watchdog_off_is_a_restart_at_the_first_reading() -> None:
    off = at(0, 0, 1, np.int8)
    zero = at(0, 0, 5, np.int16)
    assert codes(guard().judge(facts(torque=off, watchdog=zero))) == [ReasonCode.SERVO_REBOOTED]
