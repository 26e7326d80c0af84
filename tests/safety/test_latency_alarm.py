"""A hop that is slow is told once, and once that it has recovered; never one of them twice."""

from math import inf, isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.safety.latency_alarm import LatencyAlarm, LatencyAlert

# of the bound; s: as docs/reason-codes.md says
CALM = 0.8
CALM_FOR = 1.0
BOUND = 0.05
LOW = 0.01
MIDDLE = 0.045
HIGH = 0.06


def alarm_reports(*values: tuple[float, float], bound: float = BOUND) -> list[tuple[float, bool]]:
    """(time, calm) of what is told of (time, value)."""
    alarm = LatencyAlarm("reply")
    alerts = [(time, alarm.judge(value, bound, time)) for time, value in values]
    return [(time, alert.calm) for time, alert in alerts if alert is not None]


def test_a_latency_alert_gives_hop_value_and_bound() -> None:
    alarm = LatencyAlarm("reply")
    assert alarm.judge(BOUND, BOUND, 1.0) is None
    assert alarm.judge(HIGH, BOUND, 2.0) == LatencyAlert("reply", HIGH, BOUND)
    assert alarm.judge(HIGH, BOUND, 3.0) is None
    assert alarm.judge(LOW, BOUND, 5.0) == LatencyAlert("reply", LOW, BOUND, calm=True)
    assert alarm.judge(LOW, BOUND, 7.0) is None


def test_an_alarm_is_off_before_it_begins_and_after_its_end() -> None:
    alarm = LatencyAlarm("reply")
    assert alarm.is_off is True
    alarm.judge(HIGH, BOUND, 0.0)
    assert alarm.is_off is False
    alarm.judge(LOW, BOUND, 0.5)
    assert alarm.is_off is False, "it has not been calm for long enough"
    alarm.judge(LOW, BOUND, 2.0)
    assert alarm.is_off is True
    alarm.judge(HIGH, BOUND, 3.0)
    alarm.drop()
    assert alarm.is_off is True


@pytest.mark.parametrize("wrong", [HIGH, inf, -1e-9, -inf])
def test_too_long_and_negative_latencies_are_reported_alike(wrong: float) -> None:
    assert alarm_reports((0.0, wrong)) == [(0.0, False)]


def test_an_unknown_latency_is_neither_an_alert_nor_a_recovery() -> None:
    assert alarm_reports((0.0, nan), (5.0, LOW)) == []
    assert alarm_reports((0.0, HIGH), (0.9, nan), (1.5, LOW), (2.0, LOW)) == [(0.0, False), (2.0, True)]


def test_a_hop_recovers_after_more_than_a_second_below_the_calm_share() -> None:
    calm = CALM * BOUND
    assert alarm_reports((0.0, HIGH), (CALM_FOR, calm)) == [(0.0, False)]
    assert alarm_reports((0.0, HIGH), (CALM_FOR + 1e-9, calm)) == [(0.0, False), (CALM_FOR + 1e-9, True)]
    above = calm * (1.0 + 1e-12)
    assert alarm_reports((0.0, 0.0), (0.1, HIGH), (1.2, 0.0)) == [(0.1, False), (1.2, True)]
    assert alarm_reports((0.0, HIGH), (0.5, above), (1.2, LOW), (1.4, LOW)) == [(0.0, False)]
    assert alarm_reports((0.0, HIGH), (5.0, above), (5.1, LOW)) == [(0.0, False)]


def test_a_hop_that_is_slow_again_before_recovery_is_not_reported_again() -> None:
    assert alarm_reports((0.0, HIGH), (0.5, LOW), (0.9, HIGH), (1.2, LOW), (1.9, HIGH)) == [(0.0, False)]
    assert alarm_reports((0.0, HIGH), (1.5, LOW), (1.6, HIGH)) == [(0.0, False), (1.5, True), (1.6, False)]


def test_a_hop_no_longer_measured_ends_its_alert_once_and_may_be_reported_anew() -> None:
    alarm = LatencyAlarm("reply")
    assert alarm.drop() is None
    assert alarm.judge(HIGH, BOUND, 1.0) is not None
    over = alarm.drop()
    assert over is not None
    assert (over.hop, over.calm) == ("reply", True)
    assert isnan(over.value) and isnan(over.bound)
    assert alarm.drop() is None
    assert alarm.judge(HIGH, BOUND, 1.1) == LatencyAlert("reply", HIGH, BOUND)


steps = st.tuples(
    st.floats(0.0, 2.0), st.sampled_from([LOW, MIDDLE, HIGH, nan, inf, -1.0]) | st.floats(0.0, 0.1)
)


@given(st.lists(steps, max_size=60))
def test_slow_and_calm_alerts_alternate_for_any_values(
    steps: list[tuple[float, float]],
) -> None:
    alarm = LatencyAlarm("reply")
    now = 0.0
    last = True
    wrong_at = -inf
    for wait, value in steps:
        now += wait
        alert = alarm.judge(value, BOUND, now)
        if alert is not None:
            assert alert.calm is not last
            last = alert.calm
            if alert.calm:
                assert now - wrong_at > CALM_FOR
                assert 0.0 <= value <= CALM * BOUND
            else:
                assert not 0.0 <= value <= BOUND
        elif not 0.0 <= value <= BOUND and value == value:
            assert not last  # it was told before
        if not 0.0 <= value <= CALM * BOUND:
            wrong_at = now
